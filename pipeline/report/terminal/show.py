"""A pair or an object of a finished run in the terminal."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.columns import SIDES, Row
from ....schemas.metrics import COVERAGE_REACHES, METRIC, narrow_labels, reach_words
from ....stages.coverage import surface_state
from ...results.finished import ObjectFacts, PairFacts
from .layout import number, percent, plain_table

#: Columns of `metrics` in the order in which an object shows them: r_lambda stands beside what it is made of.
_OBJECT_SCORES = (
    *("cdc", "r_lambda", "max_eigenvalue_shift", "laplacian_change", "r_gap", "gap_real", "gap_sim"),
    *("eigenspectrum_distance", "alignment_rms_m", "centroid_distance_m"),
)
_MATCHED_SCORES = ("cdc", "r_lambda", "r_gap", "centroid_distance_m", "alignment_rms_m")
_COVERED = tuple(f"covered_{reach}" for reach in COVERAGE_REACHES)
_MOST_UNCOVERED = 10
#: Columns of `objects` and `coverage`: place and shape, and how much of it the other side has.
_OBJECT_COLUMNS = (
    *("n_points", "range_m", "cx", "cy", "cz", "extent_x", "extent_y", "extent_z"),
    *("linearity", "planarity", "scattering", "label", *_COVERED, "median_distance_m"),
)


def pair_view(facts: PairFacts) -> RenderableType:
    """The counts of a pair and its surfaces, its matched objects worst first, and those that only one side has."""
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
    within = [f"within {reach_words(reach)}" for reach in COVERAGE_REACHES]
    sides = [(side, *(row[f"covered_{side}_{reach}"] for reach in COVERAGE_REACHES)) for side in SIDES]
    surfaces = plain_table("Surface (share of the object points with one of the other side)", ("side", *within), sides)

    headings = ("class", "real", "sim", "range\n(m)", "points\nreal", "\nsim", *narrow_labels(_MATCHED_SCORES))
    columns = ("label", "real_id", "sim_id", "range_m", "n_real", "n_sim", *_MATCHED_SCORES)
    both = [{**each.real, **each.scores} for each in facts.objects if each.real and each.scores]
    rows = [[values[column] for column in columns] for values in both]
    title = "Objects that both sides have, largest r_lambda first"
    matched = plain_table(title, headings, rows, digits={3: 1, 9: 2, 10: 2})

    titles = (
        "class",
        "status",
        "object",
        "range\n(m)",
        "points",
        "height of\ncentroid (m)",
        "within\n0.3 m",
        "surface",
    )
    others = [
        (
            own["label"],
            each.status,
            *_name_and_place(own, side),
            own["covered_0p3m"],
            surface_state(own["covered_0p3m"]),
        )
        for each in facts.objects
        if each.scores is None
        for side, own in [_only(each)]
    ]
    alone = plain_table("Objects that only one side has", titles, others, words=(0, 1, 7), digits={3: 1, 5: 1})
    return Group(counts, surfaces, matched, _least_covered(facts), alone)


def object_view(pair_id: str, facts: ObjectFacts) -> RenderableType:
    """Place and shape of an object on both sides, then its scores."""
    sides, scores = (facts.real, facts.sim), facts.scores
    rows = [(name, *(own and own[name] for own in sides)) for name in _OBJECT_COLUMNS]
    rows.insert(0, ("object", *(own and own["community_id"] for own in sides)))
    table = plain_table(f"Object of pair {pair_id}: {facts.status}", ("", "real", "simulated"), rows)
    if scores is None:
        return Group(table, *map(Text, _alone_lines(facts)))
    title = f"Scores ({scores['status']}, on {scores['n_keep']} aligned nodes)"
    rows = [(METRIC[name].label, scores[name], METRIC[name].reading) for name in _OBJECT_SCORES]
    score_table = plain_table(title, ("score", "value", "how to read it"), rows, words=(0, 2), digits={1: 4})
    reason = [Text(f"null scores: {scores['reason']}")] if scores["reason"] else []
    return Group(table, score_table, *reason)


def _least_covered(facts: PairFacts) -> Table:
    """The matched objects of which the other side has least."""
    both = [(each.real, each.sim) for each in facts.objects if each.scores and each.real and each.sim]
    least = sorted(both, key=lambda sides: sides[0]["covered_0p3m"] + sides[1]["covered_0p3m"])[:_MOST_UNCOVERED]
    rows = [
        (
            real["label"],
            real["community_id"],
            sim["community_id"],
            *(own[name] for own in (real, sim) for name in _COVERED),
        )
        for real, sim in least
    ]
    within = [reach_words(reach) for reach in COVERAGE_REACHES]
    headings = ("class", "real", "sim", f"real within\n{within[0]}", *(f"\n{own}" for own in within[1:]))
    headings += (f"sim within\n{within[0]}", *(f"\n{own}" for own in within[1:]))
    title = f"Surface of the matched objects, least within {reach_words('0p3m')} of the other side first"
    if len(both) > len(least):
        title += f" ({len(least)} of {len(both)})"
    return plain_table(title, headings, rows, digits=dict.fromkeys(range(3, 9), 2))


def _only(facts: ObjectFacts) -> tuple[str, Row]:
    """The side that has an unmatched object, and the object."""
    return next((side, own) for side, own in zip(SIDES, (facts.real, facts.sim), strict=True) if own)


def _name_and_place(own: Row, side: str) -> tuple[object, ...]:
    return f"{side}:{own['community_id']}", own["range_m"], own["n_points"], own["cz"]


def _alone_lines(facts: ObjectFacts) -> list[str]:
    """Why an unmatched object has no scores, and whether its surface is on the other side."""
    side, own = _only(facts)
    side, other = {"real": ("real", "simulated"), "sim": ("simulated", "real")}[side]
    why = f"only the {side} side has this object, so that it has no scores"
    if facts.real and facts.sim:
        n_sim = facts.sim["n_points"] or "no"
        why = f"{n_sim} points of this object are simulated, too few to match it, so that it has no scores"
    covered, state = own["covered_0p3m"], surface_state(own["covered_0p3m"])
    place = {"there": "there, only divided differently", "partly": "there in part"}.get(state, state)
    return [why, f"its surface is {place}: {percent(covered)} of its points have a {other} one within 0.3 m"]
