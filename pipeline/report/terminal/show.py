"""A pair or an object of a finished run in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.columns import SIDES, Row
from ....schemas.metrics import METRIC, narrow_labels
from ...results.finished import ObjectFacts, PairFacts
from .layout import number, plain_table

#: Columns of `metrics` in the order in which an object shows them: r_lambda stands beside what it is made of.
_OBJECT_SCORES = (
    "cdc",
    "r_lambda",
    "max_eigenvalue_shift",
    "laplacian_change",
    "r_gap",
    "gap_real",
    "gap_sim",
    "eigenspectrum_distance",
    "alignment_rms_m",
    "centroid_distance_m",
)
#: Columns of the table of all objects of a pair, and with how many digits.
_MATCHED_SCORES = {"cdc": 3, "r_lambda": 3, "r_gap": 3, "centroid_distance_m": 2, "alignment_rms_m": 2}
_PLACE = ("n_points", "range_m", "cx", "cy", "cz", "extent_x", "extent_y", "extent_z")
_SHAPE = ("linearity", "planarity", "scattering", "label")


def pair_view(facts: PairFacts) -> RenderableType:
    """The counts of a pair, its matched objects worst first, and those that only one side has."""
    row = facts.pair
    if row["status"] != "scored":
        return Text.assemble(f"pair {row['pair_id']} ", ("failed", "red"), f": {row['reason']}")
    alone = [each for each in facts.objects if each.scores is None]
    return Group(_pair_table(row), _matched_table(facts.objects), _alone_table(alone))


def object_view(pair_id: str, facts: ObjectFacts) -> RenderableType:
    """Place and shape of an object on both sides, then its scores."""
    table = plain_table(f"Object of pair {pair_id}: {facts.status}", "", "real", "simulated")
    sides = (facts.real, facts.sim)
    table.add_row("object", *("-" if own is None else str(own["community_id"]) for own in sides))
    for name in (*_PLACE, *_SHAPE):
        table.add_row(name, *(Text("-" if own is None else _shown(own[name])) for own in sides))
    scores = facts.scores
    if scores is None:
        side = "real" if facts.real else "simulated"
        return Group(table, Text(f"only the {side} side has this object, so that it has no scores"))
    score_table = plain_table(f"Scores ({scores['status']}, on {scores['n_keep']} aligned nodes)", "score")
    score_table.add_column("value", justify="right", no_wrap=True)
    score_table.add_column("how to read it")
    for column in _OBJECT_SCORES:
        score_table.add_row(METRIC[column].label, number(scores[column], 4), METRIC[column].reading)
    reason = [Text(f"null scores: {scores['reason']}")] if scores["reason"] else []
    return Group(table, score_table, *reason)


def _pair_table(row: Row) -> Table:
    table = plain_table(
        f"Pair {row['pair_id']}: match rate {number(row['match_rate'])}; {row['n_matched']} objects on both sides, "
        f"{row['n_missing']} missing, {row['n_hallucinated']} hallucinated",
        *("side", "points read", "clean", "not ground", "ground below (m)", "objects"),
    )
    for side in SIDES:
        counts = (str(row[f"n_{side}_{name}"]) for name in ("raw", "clean", "points"))
        threshold = number(row[f"ground_{side}_threshold_m"], 2)
        table.add_row(side, *counts, threshold, str(row[f"n_communities_{side}"]))
    return table


def _matched_table(objects: Sequence[ObjectFacts]) -> Table:
    table = plain_table(
        "Objects that both sides have, largest r_lambda first",
        *("class", "real", "sim", "range\n(m)", "points\nreal", "\nsim"),
        *narrow_labels(_MATCHED_SCORES),
    )
    for each in objects:
        real, scores = each.real, each.scores
        if real is None or scores is None:
            continue
        table.add_row(
            Text(real["label"] or "-"),
            str(scores["real_id"]),
            str(scores["sim_id"]),
            number(real["range_m"], 1),
            str(scores["n_real"]),
            str(scores["n_sim"]),
            *(number(scores[name], digits) for name, digits in _MATCHED_SCORES.items()),
        )
    return table


def _alone_table(alone: Sequence[ObjectFacts]) -> Table:
    table = plain_table(
        "Objects that only one side has",
        *("class", "status", "object", "range (m)", "points", "height of centroid (m)"),
        words=2,
    )
    for each in alone:
        for side, own in zip(SIDES, (each.real, each.sim), strict=True):
            if own is not None:
                table.add_row(
                    Text(own["label"] or "-"),
                    each.status,
                    f"{side}:{own['community_id']}",
                    *(number(own["range_m"], 1), str(own["n_points"]), number(own["cz"], 1)),
                )
    return table


def _shown(value: float | int | str | None) -> str:
    return number(value) if isinstance(value, float) else "-" if value is None else str(value)
