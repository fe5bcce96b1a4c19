"""Views of `fidpipe show`: a finished run, a pair, or an object of a pair."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

from pydantic import JsonValue

from ....schemas.columns import SIDES
from ....schemas.metric_catalogue import COVERAGE_REACHES, METRIC, narrow_labels, reach_words
from ....schemas.results import JsonObject
from ....stages.coverage import surface_state
from ...results.best_case import RunExcess
from ...results.finished import FinishedRun, ObjectFacts, PairFacts, object_facts, pair_facts, run_facts
from ...results.object_frame import UNKNOWN
from ...results.overview import BAD_ALIGNMENT_WORDS, alignment_is_bad
from ...storage.urls import url_or_path
from ..view import Note, Table, View, number, percent
from .best_case_view import pair_excess_table
from .run_view import summary_view

#: Columns of `metrics` in the order in which an object shows them: r_lambda is next to its components.
_OBJECT_SCORES = (
    *("cdc", "r_lambda", "max_eigenvalue_shift", "laplacian_change", "r_gap", "gap_real", "gap_sim"),
    *("eigenspectrum_distance", "alignment_rms_m", "centroid_distance_m"),
)
_MATCHED_SCORES = ("cdc", "r_lambda", "r_gap", "centroid_distance_m", "alignment_rms_m")
_NEAR = "covered_0p3m"
_COVERED = tuple(f"covered_{reach}" for reach in COVERAGE_REACHES)
_OUTCOMES = ("rays_same", "rays_in_front", "rays_behind", "rays_dropped", "rays_no_surface", "rays_sim_only")
_MOST_UNCOVERED = 10
#: An object of which less surface is covered on a side is not called faithful.
_LEAST_COVERED = 0.6
_LEAST_ROAD = 0.005  # share that rounds to a per cent
_MOST_ALIGNMENTS = 3
_MOST_UNMATCHED = 10
#: Columns of `objects` and `coverage`: place and shape, and how much of it the other side has.
_OBJECT_COLUMNS = (
    *("n_points", "range_m", "cx", "cy", "cz", "extent_x", "extent_y", "extent_z"),
    *("linearity", "planarity", "scattering", "label", *_COVERED, "median_distance_m"),
)


def show_view(
    run: FinishedRun,
    pair: str | None,
    name: str | None,
    excess: RunExcess | None = None,
    *,
    with_all: bool = False,
) -> View:
    """A run, a pair of it, or the object `name` of a pair.

    Parameters
    ----------
    excess : of run or pair over a best case, to be shown as well
    with_all : all tables of the run, all objects of the pair
    """
    if pair is not None and name is not None:
        return object_view(pair, object_facts(run, pair, name))
    if pair is not None:
        notes = [Note(f"note: {note}", "yellow") for note in (run.record.notes or {}).get(pair, ())]
        command = "" if with_all else shlex.join(["fidpipe", "show", url_or_path(run.folder), pair, "--all"])
        return [
            *pair_view(pair_facts(run, pair), command),
            *notes,
            *([pair_excess_table(excess, pair)] if excess else ()),
        ]
    return summary_view(run.folder, run.rows, run.record, run.diagnosis, excess=excess, with_all=with_all)


def show_json(run: FinishedRun, pair: str | None, name: str | None, excess: RunExcess | None = None) -> JsonValue:
    """The same as plain values."""
    over: JsonObject = {} if excess is None else {"excess": excess.as_dict()}
    if pair is not None and name is not None:
        return {"pair_id": pair, **object_facts(run, pair, name).as_dict()}
    return (run_facts(run) if pair is None else pair_facts(run, pair).as_dict()) | over


def show_records(run: FinishedRun, pair: str | None, name: str | None) -> Table:
    """The same for programs that read tables: one row per pair, object or value."""
    if pair is None:
        columns = list(run.rows[0])
        return Table("", columns, [[row[column] for column in columns] for row in run.rows])
    if name is None:
        return pair_records(pair_facts(run, pair))
    return object_records(object_facts(run, pair, name))


def pair_view(facts: PairFacts, command: str = "") -> View:
    """The counts of a pair and its surfaces, its matched objects worst first, and those that only one side has.

    Parameters
    ----------
    command : shows all unmatched objects; given if only the largest ones are to be shown here
    """
    row = facts.pair
    if row["status"] != "scored":
        return [Note(f"pair {row['pair_id']} failed: {row['reason']}", "red")]
    title = (
        f"Pair {row['pair_id']}: match rate {number(row['match_rate'])} (of the side with more objects), found "
        f"{number(row['found'])} of the real objects; {row['n_matched']} objects on both sides, {row['n_missing']} "
        f"missing, {row['n_hallucinated']} hallucinated"
    )
    names = ("side", "points read", "clean", "not ground", "ground below (m)", "objects")
    keys = ("n_{}_raw", "n_{}_clean", "n_{}_points", "ground_{}_threshold_m", "n_communities_{}")
    counts = [(side, *(row[key.format(side)] for key in keys)) for side in SIDES]
    within = [f"within {reach_words(reach)}" for reach in COVERAGE_REACHES]
    shares = [(side, *(row[f"covered_{side}_{reach}"] for reach in COVERAGE_REACHES)) for side in SIDES]
    has_matches = any(each.scores for each in facts.objects)
    return [
        Table(title, names, counts, digits={4: 2}),
        Table("Surface (share of the object points with one of the other side)", ("side", *within), shares),
        *_rays(facts),
        _matched(facts),
        *([Note("offset: distance between the centroids; align: RMS distance of the aligned nodes")] * has_matches),
        *alignment_warning(facts.objects),
        Note(""),
        _least_covered(facts),
        *_unmatched(facts, command),
    ]


def _rays(facts: PairFacts) -> View:
    """Outcomes of the rays and errors of range, of all and by range, incidence and class; or why there are none."""
    if facts.pair["rays_reason"]:
        return [Note(f"no rays: {facts.pair['rays_reason']}", "yellow")]
    order = {"all": 0, "range": 1, "incidence": 2, "class": 3}
    groups = [row for row in facts.rays if row["by"] in order]
    groups.sort(key=lambda row: (order[row["by"]], *_lower_edge(row["band"])))
    columns = (*_OUTCOMES, "rays_bias_m", "rays_rmse_m")
    names = [_short(row["band"]) if row["by"] != "class" else row["band"] for row in groups]
    rows = [
        (name or "all", row["n_rays"], *(row[column] for column in columns))
        for name, row in zip(names, groups, strict=True)
    ]
    headings = ("rays", "number", "same", "in front", "behind", "dropped", "no\nsurface", "sim\nonly")
    title = "Rays (share of those with a return on either side), and simulated minus real range (m)"
    return [Table(title, (*headings, "bias", "RMSE"), rows, words=(0,), digits=dict.fromkeys(range(2, 10), 2))]


def _short(band: str) -> str:
    """`10-20m` for `10 to 20 m`: a column that does not wrap."""
    return band.replace(" to ", "-").replace("over ", ">").replace(" degrees", "°").replace(" m", "m")


def _lower_edge(band: str) -> tuple[float, str]:
    """Order of bands such as `10 to 20 m` and `over 50 m`; classes by name."""
    first = band.removeprefix("over ").split(" ")[0]
    return (float(first), "") if first.replace(".", "").isdigit() else (0.0, band)


def _matched(facts: PairFacts) -> Table:
    scores = narrow_labels(_MATCHED_SCORES)
    headings = ("class", "real", "sim", "range\n(m)", "points\nreal", "\nsim", *scores, "real covered", "sim covered")
    columns = ("label", "community_id", "partner", "range_m", "n_real", "n_sim", *_MATCHED_SCORES)
    rows = [
        [*(each.row[column] for column in columns), each.real[_NEAR], each.sim[_NEAR]]
        for each in facts.objects
        if each.scores and each.real and each.sim
    ]
    title = "Objects that both sides have, largest r_lambda first"
    return Table(title, headings, rows, digits={3: 1, 9: 2, 10: 2}, wide=(11, 12))


def _unmatched(facts: PairFacts, command: str) -> View:
    names = ("n_points", "cz", _NEAR)
    largest = sorted(facts.objects, key=lambda each: -each.row["n_points"])
    by_status = [[each for each in largest if each.status == status] for status in ("missing", "hallucinated")]
    kept = [own[:_MOST_UNMATCHED] if command else own for own in by_status]
    rows = [
        (
            *(own["label"], own["fate"], f"{own['side']}:{own['community_id']}", own["range_m"]),
            *(*(own[name] for name in names), surface_state(own[_NEAR])),
        )
        for own in (each.row for each in chain(*kept))
    ]
    headings = ("class", "status", "object", "range\n(m)", "points", "centroid\nz (m)", "within\n0.3 m", "surface")
    table = Table("Objects that only one side has", headings, rows, words=(0, 1, 7), digits={3: 1, 5: 1})
    left_out = [(len(own) - len(few), own[0].status) for own, few in zip(by_status, kept, strict=True) if own != few]
    more = " and ".join(f"{n} more {status}" for n, status in left_out)
    return [table, *([Note(f"{more}, with fewer points: {command}")] if more else ())]


def _least_covered(facts: PairFacts) -> Table:
    """The matched objects of which the other side has least."""
    both = [(each.real, each.sim) for each in facts.objects if each.scores and each.real and each.sim]
    least = sorted(both, key=lambda sides: sides[0][_NEAR] + sides[1][_NEAR])[:_MOST_UNCOVERED]
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
    return Table(title, headings, rows, digits=dict.fromkeys(range(3, 9), 2))


def pair_records(facts: PairFacts) -> Table:
    """One row per object of a pair: what it is, its place, how much is covered, and its scores."""
    scores = ("n_keep", *_OBJECT_SCORES)
    headings = ("pair_id", "status", "label", "real_id", "sim_id", "range_m", "n_real", "n_sim")
    rows = []
    for each in facts.objects:
        place, sides, own = each.row, (each.real or {}, each.sim or {}), each.scores or {}
        ids, points, covered = ([side.get(name) for side in sides] for name in ("community_id", "n_points", _NEAR))
        named = (place["pair_id"], each.status, place["label"])
        rows.append([*named, *ids, place["range_m"], *points, *covered, *map(own.get, scores), own.get("reason")])
    return Table("", (*headings, "covered_real_0p3m", "covered_sim_0p3m", *scores, "reason"), rows)


def object_view(pair_id: str, facts: ObjectFacts) -> View:
    """Warnings and scores of an object, then its place and shape on both sides."""
    sides, scores = (facts.real, facts.sim), facts.scores
    rows = [(name, *(own and own[name] for own in sides)) for name in _OBJECT_COLUMNS]
    rows.insert(0, ("object", *(own and own["community_id"] for own in sides)))
    table = Table(f"Object of pair {pair_id}: {facts.status}", ("", "real", "simulated"), rows)
    if scores is None:
        return [table, *map(Note, _alone_lines(facts))]
    title = f"Scores ({scores['status']}, on {scores['n_keep']} aligned nodes)"
    values = [(METRIC[name].label, scores[name], METRIC[name].reading) for name in _OBJECT_SCORES]
    score_table = Table(title, ("score", "value", "how to read it"), values, words=(0, 2), digits={1: 4})
    covered = {f"covered_{side}_0p3m": own and own[_NEAR] for side, own in zip(SIDES, sides, strict=True)}
    return [Note(judgement(facts.row | covered)), score_table, table]


def judgement(row: Mapping[str, Any]) -> str:
    """Sentence on what is wrong with an object that both sides have.

    Parameters
    ----------
    row : its scores, quadrant and coverage on both sides, as in `RunResults.objects`
    """
    real, sim = row["covered_real_0p3m"], row["covered_sim_0p3m"]
    cdc, r_lambda = f"CDC {number(row['cdc'], 2)}", f"r_lambda {number(row['r_lambda'], 2)}"
    words = {
        "faithful": "Faithful" if min(real, sim) >= _LEAST_COVERED else f"Faithful by {cdc}, but its surface differs",
        "structure lost": f"Structure lost ({r_lambda}), shape right",
        "displaced": f"Displaced or misshapen ({cdc}), structure right",
        "failed": f"Shape and structure differ ({cdc}, {r_lambda})",
        UNKNOWN: f"Without a spectral score ({row['reason'] or row['status']})",
    }
    rms_m = row["alignment_rms_m"]
    is_unsure = row["r_lambda"] is not None and rms_m is not None and alignment_is_bad(rms_m, row["diagonal_m"])
    unsure = f" Its r_lambda is unreliable: the nodes were aligned {number(rms_m, 1)} m apart." if is_unsure else ""
    return (
        f"{words[row['quadrant']]}: {percent(real)} of the real surface is simulated within 0.3 m, {percent(sim)} of "
        f"the simulated one is real; centroids {number(row['centroid_distance_m'], 2)} m apart.{unsure}"
    )


def alone_judgement(row: Mapping[str, Any]) -> str:
    """Sentence on an object that only one side has; `row` is one of `RunResults.objects`."""
    side = row["side"]
    verdict, other = {
        "real": ("Missing in the simulation", "simulated"),
        "sim": ("Invented by the simulation", "real"),
    }[side]
    road = row[f"road_share_{side}"] or 0.0
    more = f"; {percent(road)} of it is road on the {other} side" if road >= _LEAST_ROAD else ""
    covered = percent(row[f"covered_{side}_0p3m"])
    return f"{verdict}: {covered} of its points have one of the other side within 0.3 m{more}."


def object_records(facts: ObjectFacts) -> Table:
    """One row for each column of an object, on each side, and one for each score."""
    rows: list[tuple[object, ...]] = [
        (name, *(own and own[name] for own in (facts.real, facts.sim)), None)
        for name in ("community_id", *_OBJECT_COLUMNS)
    ]
    rows += [(name, None, None, value) for name, value in (facts.scores or {"status": facts.status}).items()]
    return Table("", ("", "real", "simulated", "score"), rows)


def alignment_warning(objects: Sequence[ObjectFacts]) -> list[Note]:
    """Objects whose r_lambda depends on a poor alignment, worst first; no note without any."""
    scored = [each.row for each in objects if each.row["r_lambda"] is not None]
    bad = [row for row in scored if alignment_is_bad(row["alignment_rms_m"], row["diagonal_m"])]
    if not bad:
        return []
    bad.sort(key=lambda row: -row["alignment_rms_m"])
    named = ", ".join(
        f"real:{row['community_id']} ({row['alignment_rms_m']:.1f} m apart, {row['diagonal_m']:.1f} m large)"
        for row in bad[:_MOST_ALIGNMENTS]
    )
    more = ", ..." * (len(bad) > _MOST_ALIGNMENTS)
    text = (
        f"warning: r_lambda of {len(bad)} of {len(scored)} objects depends on a poor alignment "
        f"({BAD_ALIGNMENT_WORDS}), which alone lowers it: {named}{more}"
    )
    return [Note(text, "yellow")]


def _alone_lines(facts: ObjectFacts) -> list[str]:
    """Reason why an unmatched object has no scores, and whether the other side has its surface."""
    side, other = {"real": ("real", "simulated"), "sim": ("simulated", "real")}[facts.row["side"]]
    why = f"only the {side} side has this object, so that it has no scores"
    if facts.real and facts.sim:
        n_sim = facts.sim["n_points"] or "no"
        why = f"{n_sim} points of this object are simulated, too few to match it, so that it has no scores"
    covered, state = facts.row[_NEAR], surface_state(facts.row[_NEAR])
    place = {"there": "there, only partitioned differently", "partly": "there in part"}.get(state, state)
    return [why, f"its surface is {place}: {percent(covered)} of its points have a {other} one within 0.3 m"]
