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
#: Columns of the table of all objects of a pair, and with how many digits.
_MATCHED_SCORES = {"cdc": 3, "r_lambda": 3, "r_gap": 3, "centroid_distance_m": 2, "alignment_rms_m": 2}
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
    counts = plain_table(
        f"Pair {row['pair_id']}: match rate {number(row['match_rate'])}; {row['n_matched']} objects on both sides, "
        f"{row['n_missing']} missing, {row['n_hallucinated']} hallucinated",
        ("side", "points read", "clean", "not ground", "ground below (m)", "objects"),
        (
            (
                side,
                *(row[f"n_{side}_{name}"] for name in ("raw", "clean", "points")),
                number(row[f"ground_{side}_threshold_m"], 2),
                row[f"n_communities_{side}"],
            )
            for side in SIDES
        ),
    )
    matched = plain_table(
        "Objects that both sides have, largest r_lambda first",
        ("class", "real", "sim", "range\n(m)", "points\nreal", "\nsim", *narrow_labels(_MATCHED_SCORES)),
        (
            (
                real["label"],
                *(scores["real_id"], scores["sim_id"], number(real["range_m"], 1), scores["n_real"], scores["n_sim"]),
                *(number(scores[name], digits) for name, digits in _MATCHED_SCORES.items()),
            )
            for real, scores in ((each.real, each.scores) for each in facts.objects)
            if real is not None and scores is not None
        ),
    )
    alone = plain_table(
        "Objects that only one side has",
        ("class", "status", "object", "range (m)", "points", "height of centroid (m)"),
        (
            (
                *(own["label"], each.status, f"{side}:{own['community_id']}"),
                *(number(own["range_m"], 1), own["n_points"], number(own["cz"], 1)),
            )
            for each in facts.objects
            for side, own in zip(SIDES, (each.real, each.sim), strict=True)
            if each.scores is None and own is not None
        ),
        words=(0, 1),
    )
    return Group(counts, matched, alone)


def object_view(pair_id: str, facts: ObjectFacts) -> RenderableType:
    """Place and shape of an object on both sides, then its scores."""
    sides, scores = (facts.real, facts.sim), facts.scores
    table = plain_table(
        f"Object of pair {pair_id}: {facts.status}",
        ("", "real", "simulated"),
        (
            (name, *(own and own[column] for own in sides))
            for name, column in {"object": "community_id", **{name: name for name in _OBJECT_COLUMNS}}.items()
        ),
    )
    if scores is None:
        side = "real" if facts.real else "simulated"
        return Group(table, Text(f"only the {side} side has this object, so that it has no scores"))
    score_table = plain_table(
        f"Scores ({scores['status']}, on {scores['n_keep']} aligned nodes)",
        ("score", "value", "how to read it"),
        ((METRIC[name].label, number(scores[name], 4), METRIC[name].reading) for name in _OBJECT_SCORES),
        words=(0, 2),
    )
    reason = [Text(f"null scores: {scores['reason']}")] if scores["reason"] else []
    return Group(table, score_table, *reason)
