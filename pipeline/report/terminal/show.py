"""A pair or an object of a finished run in the terminal."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from ....schemas.columns import SIDES
from ....schemas.metrics import METRIC, narrow_labels
from ...results.finished import ObjectFacts, PairFacts
from .layout import number, plain_table

#: Columns of `metrics` in the order in which an object shows them: r_lambda stands beside what it is made of.
_OBJECT_SCORES = (
    *("cdc", "r_lambda", "max_eigenvalue_shift", "laplacian_change", "r_gap", "gap_real", "gap_sim"),
    *("eigenspectrum_distance", "alignment_rms_m", "centroid_distance_m"),
)
_MATCHED_SCORES = ("cdc", "r_lambda", "r_gap", "centroid_distance_m", "alignment_rms_m")
#: Columns of `objects`: place and shape.
_OBJECT_COLUMNS = (
    *("n_points", "range_m", "cx", "cy", "cz", "extent_x", "extent_y", "extent_z"),
    *("linearity", "planarity", "scattering", "label"),
)


def pair_view(facts: PairFacts) -> RenderableType:
    """The counts of a pair, its matched objects worst first, and those that only one side has."""
    row = facts.pair
    if row["status"] != "scored":
        return Text.assemble(f"pair {row['pair_id']} ", ("failed", "red"), f": {row['reason']}")
    title = (
        f"Pair {row['pair_id']}: match rate {number(row['match_rate'])}; {row['n_matched']} objects on both sides, "
        f"{row['n_missing']} missing, {row['n_hallucinated']} hallucinated"
    )
    names = ("side", "points read", "clean", "not ground", "ground below (m)", "objects")
    keys = ("n_{}_raw", "n_{}_clean", "n_{}_points", "ground_{}_threshold_m", "n_communities_{}")
    sides = [(side, *(row[key.format(side)] for key in keys)) for side in SIDES]
    counts = plain_table(title, names, sides, digits={4: 2})

    headings = ("class", "real", "sim", "range\n(m)", "points\nreal", "\nsim", *narrow_labels(_MATCHED_SCORES))
    columns = ("label", "real_id", "sim_id", "range_m", "n_real", "n_sim", *_MATCHED_SCORES)
    both = [{**each.real, **each.scores} for each in facts.objects if each.real and each.scores]
    rows = [[values[column] for column in columns] for values in both]
    title = "Objects that both sides have, largest r_lambda first"
    matched = plain_table(title, headings, rows, digits={3: 1, 9: 2, 10: 2})

    titles = ("class", "status", "object", "range (m)", "points", "height of centroid (m)")
    others = [
        (own["label"], each.status, f"{side}:{own['community_id']}", own["range_m"], own["n_points"], own["cz"])
        for each in facts.objects
        for side, own in zip(SIDES, (each.real, each.sim), strict=True)
        if each.scores is None and own is not None
    ]
    alone = plain_table("Objects that only one side has", titles, others, words=(0, 1), digits={3: 1, 5: 1})
    return Group(counts, matched, alone)


def object_view(pair_id: str, facts: ObjectFacts) -> RenderableType:
    """Place and shape of an object on both sides, then its scores."""
    sides, scores = (facts.real, facts.sim), facts.scores
    rows = [(name, *(own and own[name] for own in sides)) for name in _OBJECT_COLUMNS]
    rows.insert(0, ("object", *(own and own["community_id"] for own in sides)))
    table = plain_table(f"Object of pair {pair_id}: {facts.status}", ("", "real", "simulated"), rows)
    if scores is None:
        side = "real" if facts.real else "simulated"
        return Group(table, Text(f"only the {side} side has this object, so that it has no scores"))
    title = f"Scores ({scores['status']}, on {scores['n_keep']} aligned nodes)"
    rows = [(METRIC[name].label, scores[name], METRIC[name].reading) for name in _OBJECT_SCORES]
    score_table = plain_table(title, ("score", "value", "how to read it"), rows, words=(0, 2), digits={1: 4})
    reason = [Text(f"null scores: {scores['reason']}")] if scores["reason"] else []
    return Group(table, score_table, *reason)
