"""A finished run, a pair or an object of it, as `fidpipe show` shows it: in the terminal, as JSON, Markdown and CSV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pydantic import JsonValue
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.columns import SIDES, Row
from ....schemas.metrics import COVERAGE_REACHES, METRIC, narrow_labels, reach_words
from ....schemas.results import JsonObject
from ....stages.coverage import surface_state
from ...results.finished import FinishedRun, ObjectFacts, PairFacts, object_facts, pair_facts, run_facts
from ...results.floor import RunExcess
from ...results.overview import BAD_ALIGNMENT_WORDS, alignment_is_bad, over_floor
from .floor import pair_excess_view
from .layout import csv_table, markdown_table, number, percent, plain_table
from .overview import FirstAnswer
from .run import claims_view, summary_view

#: Columns of `metrics` in the order in which an object shows them: r_lambda stands beside what it is made of.
_OBJECT_SCORES = (
    *("cdc", "r_lambda", "max_eigenvalue_shift", "laplacian_change", "r_gap", "gap_real", "gap_sim"),
    *("eigenspectrum_distance", "alignment_rms_m", "centroid_distance_m"),
)
_MATCHED_SCORES = ("cdc", "r_lambda", "r_gap", "centroid_distance_m", "alignment_rms_m")
_COVERED = tuple(f"covered_{reach}" for reach in COVERAGE_REACHES)
_MOST_UNCOVERED = 10
_MOST_ALIGNMENTS = 3
#: What is pasted of an object; CSV has all.
_MARKDOWN_COLUMNS = (
    *("status", "label", "real_id", "sim_id", "range_m", "n_real", "n_sim", "covered_real_0p3m", "covered_sim_0p3m"),
    *("cdc", "r_lambda", "alignment_rms_m"),
)
#: Columns of `objects` and `coverage`: place and shape, and how much of it the other side has.
_OBJECT_COLUMNS = (
    *("n_points", "range_m", "cx", "cy", "cz", "extent_x", "extent_y", "extent_z"),
    *("linearity", "planarity", "scattering", "label", *_COVERED, "median_distance_m"),
)


def as_view(
    run: FinishedRun,
    pair: str | None,
    name: str | None,
    excess: RunExcess | None = None,
    *,
    paper: bool = False,
    with_all: bool = False,
) -> RenderableType:
    """What is shown of a run, of a pair of it, or of the object `name` of a pair.

    Parameters
    ----------
    excess : of run or pair over a floor, to be shown as well
    paper : the paper's claims instead
    with_all : all tables of the run
    """
    if paper:
        return claims_view(run.record.findings)
    if pair is not None and name is not None:
        return object_view(pair, object_facts(run, pair, name))
    if pair is not None:
        notes = (Text(f"note: {note}", style="yellow") for note in (run.record.notes or {}).get(pair, ()))
        view = Group(pair_view(pair_facts(run, pair)), *notes)
        return view if excess is None else Group(view, pair_excess_view(excess, pair))
    overview = over_floor(run, excess.floor) if excess else run.record.overview
    return summary_view(run.folder, run.rows, run.record, overview, excess=excess, with_all=with_all)


def as_json(
    run: FinishedRun, pair: str | None, name: str | None, excess: RunExcess | None = None, *, paper: bool = False
) -> JsonValue:
    """The same as plain values."""
    over: JsonObject = {} if excess is None else {"excess": excess.as_dict()}
    if paper:
        return [claim.as_dict() for claim in run.record.claims]
    if pair is not None and name is not None:
        return {"pair_id": pair, **object_facts(run, pair, name).as_dict()}
    return (run_facts(run) if pair is None else pair_facts(run, pair).as_dict()) | over


def as_text(run: FinishedRun, pair: str | None, name: str | None, *, as_csv: bool) -> str:
    """The same as CSV, one row per pair, object or value; or as Markdown."""
    if pair is None:
        if not as_csv and run.record.overview:
            return FirstAnswer(run.folder, run.record, run.record.overview).markdown()
        columns = list(run.rows[0]) if as_csv else ["pair_id", "status", "reason"]
        headings, *rows = [columns, *([row[column] for column in columns] for row in run.rows)]
    elif name is None:
        facts = pair_facts(run, pair)
        if not as_csv:
            return pair_markdown(facts)
        headings, *rows = pair_rows(facts)
    else:
        headings, *rows = object_rows(object_facts(run, pair, name))
    return csv_table(headings, rows) if as_csv else markdown_table(headings, rows)


def pair_view(facts: PairFacts) -> RenderableType:
    """The counts of a pair and its surfaces, its matched objects worst first, and those that only one side has."""
    row = facts.pair
    if row["status"] != "scored":
        return Text.assemble(f"pair {row['pair_id']} ", ("failed", "red"), f": {row['reason']}")
    title = pair_title(row)
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
    warning = alignment_warning(facts.objects)
    return Group(
        counts,
        surfaces,
        matched,
        *([Text(f"{warning}\n", style="yellow")] * bool(warning)),
        _least_covered(facts),
        alone,
    )


def alignment_warning(objects: Sequence[ObjectFacts]) -> str:
    """Which objects have an r_lambda that stands on a bad alignment, worst first; "" where none has."""
    scored = [
        (each.real["community_id"], each.scores["alignment_rms_m"], _diagonal_m(each.real))
        for each in objects
        if each.real and each.scores and each.scores["r_lambda"] is not None
    ]
    bad = sorted((one for one in scored if alignment_is_bad(one[1], one[2])), key=lambda one: -one[1])
    if not bad:
        return ""
    named = ", ".join(f"real:{i} ({rms:.1f} m apart, {size:.1f} m large)" for i, rms, size in bad[:_MOST_ALIGNMENTS])
    more = ", ..." * (len(bad) > _MOST_ALIGNMENTS)
    return (
        f"warning: r_lambda of {len(bad)} of {len(scored)} objects stands on a bad alignment ({BAD_ALIGNMENT_WORDS}), "
        f"which alone lowers it: {named}{more}"
    )


def _diagonal_m(own: Row) -> float:
    return math.hypot(*(own[f"extent_{axis}"] for axis in "xyz"))


def pair_rows(facts: PairFacts) -> list[list[Any]]:
    """Headings, then one row per object of a pair: what it is, its place, how much is covered, and its scores."""
    scores = ("n_keep", *_OBJECT_SCORES)
    headings = [*("pair_id", "status", "label", "real_id", "sim_id", "range_m", "n_real", "n_sim")]
    rows: list[list[Any]] = [[*headings, "covered_real_0p3m", "covered_sim_0p3m", *scores, "reason"]]
    for each in facts.objects:
        real, sim, own = each.real or {}, each.sim or {}, each.scores or {}
        place = real or sim
        rows.append(
            [
                *(
                    facts.pair["pair_id"],
                    each.status,
                    place["label"],
                    real.get("community_id"),
                    sim.get("community_id"),
                ),
                *(place["range_m"], real.get("n_points"), sim.get("n_points")),
                *(real.get("covered_0p3m"), sim.get("covered_0p3m"), *map(own.get, scores), own.get("reason")),
            ]
        )
    return rows


def pair_markdown(facts: PairFacts) -> str:
    """What a pair is in a line, then its objects with the headline scores."""
    row = facts.pair
    if row["status"] != "scored":
        return f"Pair {row['pair_id']} failed: {row['reason']}\n"
    headings, *rows = pair_rows(facts)
    chosen = [headings.index(name) for name in _MARKDOWN_COLUMNS]
    words = [METRIC[str(name)].label if name in METRIC else str(name) for name in _MARKDOWN_COLUMNS]
    lines = [pair_title(row), markdown_table(words, [[own[i] for i in chosen] for own in rows])]
    warning = alignment_warning(facts.objects)
    return "\n\n".join(part.rstrip("\n") for part in [*lines, *[warning] * bool(warning)]) + "\n"


def object_rows(facts: ObjectFacts) -> list[list[Any]]:
    """Headings, then one row for what is known of an object on each side, and one for each score."""
    rows: list[list[Any]] = [["", "real", "simulated", "score"]]
    rows += [
        [name, *(own and own[name] for own in (facts.real, facts.sim)), None]
        for name in ("community_id", *_OBJECT_COLUMNS)
    ]
    return rows + [[name, None, None, value] for name, value in (facts.scores or {"status": facts.status}).items()]


def pair_title(row: Row) -> str:
    """Match rate and counts of a scored pair."""
    return (
        f"Pair {row['pair_id']}: match rate {number(row['match_rate'])}; {row['n_matched']} objects on both sides, "
        f"{row['n_missing']} missing, {row['n_hallucinated']} hallucinated"
    )


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
    warning = alignment_warning([facts])
    return Group(table, score_table, *reason, *([Text(warning, style="yellow")] * bool(warning)))


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
