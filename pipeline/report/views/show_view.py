"""Views of `fidpipe show`: a finished run, a pair, or an object of a pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ....schemas.columns import SIDES, Row
from ....schemas.metric_catalogue import (
    COVERAGE_REACHES,
    METRIC,
    narrow_labels,
    reach_words,
    scores_in,
)
from ...results.best_case import RunExcess
from ...results.finished import FinishedRun, run_values
from ...results.object_frame import COLUMNS_OF, UNKNOWN
from ...results.overview import alignment_is_bad
from ..look import FATE_WORDS
from ..view import Note, Part, Table, View, columns_of, number, percent, warnings
from .run_view import summary_view

_NEAR = "covered_0p3m"
#: An object of which less surface is covered on a side is not called faithful.
_LEAST_COVERED = 0.6
_LEAST_ROAD = 0.005  # share that rounds to a per cent
_MOST_UNMATCHED = 10
#: Place, shape, and how much of it the other side has.
_OBJECT_COLUMNS = ("n_points", *COLUMNS_OF["objects"], *COLUMNS_OF["coverage"])
#: Outcomes of rays as shares, and the mean error of range.
_RAYS = (
    *("rays_same", "rays_in_front", "rays_behind", "rays_dropped", "rays_no_surface"),
    *("rays_sim_only", "rays_bias_m"),
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
    excess : of the run over a best case, to be shown as well
    with_all : all tables of the run, all objects of the pair
    """
    if pair is None:
        return summary_view(run, excess, with_all=with_all)
    if name is not None:
        return object_view(run.object(pair, name))
    parts = pair_view(run.pair(pair), with_all=with_all)
    return [*parts, *warnings((run.record.notes or {}).get(pair, ()))]


def show_json(
    run: FinishedRun, pair: str | None, name: str | None, excess: RunExcess | None = None
) -> Row:
    """A run, a pair of it, or an object of a pair as plain values."""
    if pair is None:
        return run_values(run) | ({"excess": excess.as_dict()} if excess else {})
    return run.pair(pair) if name is None else run.object(pair, name)


def pair_view(values: Mapping[str, Any], *, with_all: bool = False) -> View:
    """A sentence on a pair, its sides, its rays, its matched objects worst first, the unmatched.

    Parameters
    ----------
    values : from `FinishedRun.pair`
    with_all : all unmatched objects, not only the largest
    """
    row = values["pair"]
    if row["status"] != "scored":
        return [Note(f"pair {row['pair_id']} failed: {row['reason']}", "red")]
    objects = [of_sides["real"] or of_sides["sim"] for of_sides in values["objects"]]
    matched = [entry for entry in objects if entry["fate"] == "matched"]
    parts: list[Part] = [Note(_pair_sentence(row), "bold"), _sides_table(row)]
    parts += [_rays(row["rays_reason"], values["rays"]), _matched_table(matched)]
    if matched:
        words = (
            "offset: distance between the centroids; align: RMS distance of the aligned nodes"
        )
        parts.append(Note(words))
    return [*parts, *_unmatched(objects, with_all=with_all)]


def _pair_sentence(row: Row) -> str:
    return (
        f"pair {row['pair_id']}: {percent(row['covered_real_0p3m'])} of the real surface is "
        f"simulated within 0.3 m, {percent(row['covered_sim_0p3m'])} of the simulated surface is "
        f"real; {row['n_matched']} objects on both sides, {row['n_not_found']} not found, "
        f"{row['n_extra']} extra: match rate {number(row['match_rate'], 2)}, found "
        f"{number(row['found'], 2)} of the real objects"
    )


def _sides_table(row: Row) -> Table:
    """Points and objects of both sides, and how much of their surface the other side has."""
    reaches = [f"within\n{reach_words(reach)}" for reach in COVERAGE_REACHES]
    headings = (
        "side",
        "points",
        "clean",
        "not\nground",
        "ground\nbelow (m)",
        "objects",
        *reaches,
    )
    columns = [
        "n_{}_raw",
        "n_{}_clean",
        "n_{}_points",
        "ground_{}_threshold_m",
        "n_communities_{}",
    ]
    columns += [f"covered_{{}}_{reach}" for reach in COVERAGE_REACHES]
    rows = []
    for side in SIDES:
        rows.append([side, *(row[column.format(side)] for column in columns)])
    title = "Sides (within: share of the object points with one of the other side)"
    return Table(title, headings, rows)


def _rays(reason: str | None, of_groups: Sequence[Row]) -> Part:
    """Outcomes of the rays and error of range, of all and by range; or why there are none."""
    if reason:
        return Note(f"no rays: {reason}", "yellow")
    rows = []
    for row in of_groups:
        if row["by"] in ("all", "range"):
            rows.append((row["band"] or "all", row["n_rays"], *(row[name] for name in _RAYS)))
    title = "Rays (share of those with a return on either side), and simulated minus real range"
    headings = ("rays", "number", *narrow_labels(_RAYS))
    return Table(title, headings, rows, digits=2, whole=(0,))


def _matched_table(matched: Sequence[Row]) -> Table:
    scores = scores_in("pair")
    columns = ("label", "community_id", "partner", "range_m", "n_real", "n_sim", *scores)
    rows = columns_of(matched, columns)
    title = "Objects that both sides have, largest r_lambda first"
    headings = ["class", "real", "sim", "range\n(m)", "points\nreal", "\nsim"]
    headings += narrow_labels(scores)
    return Table(title, headings, rows, digits=2, whole=(0,))


def _unmatched(objects: Sequence[Row], *, with_all: bool) -> View:
    """The unmatched objects, real ones first; without `with_all` the largest ones."""
    unmatched = [row for row in objects if row["fate"] != "matched"]
    unmatched.sort(key=lambda row: (row["fate"] == "extra", -row["n_points"]))
    rows = []
    for row in unmatched[: None if with_all else _MOST_UNMATCHED]:
        name = f"{row['side']}:{row['community_id']}"
        place = (row["range_m"], row["n_points"], row["cz"], row[_NEAR])
        rows.append((row["label"], FATE_WORDS[row["fate"]], name, *place))
    headings = ("class", "status", "object", "range\n(m)", "points", "z (m)", "within\n0.3 m")
    title = "Objects that only one side has"
    table = Table(title, headings, rows, (0, 1), digits=2, whole=(0,))
    n_more = len(unmatched) - len(rows)
    return [table, Note(f"{n_more} more: --all")] if n_more else [table]


def object_view(rows: Mapping[str, Row | None]) -> View:
    """A sentence on an object, its scores, and its place and shape on both sides.

    rows : from `FinishedRun.object`
    """
    real = rows["real"] or {}
    sim = rows["sim"] or {}
    row = real or sim
    places = [("object", real.get("community_id"), sim.get("community_id"))]
    places += [(column, real.get(column), sim.get(column)) for column in _OBJECT_COLUMNS]
    title = f"Object of pair {row['pair_id']}: {FATE_WORDS[row['fate']]}"
    table = Table(title, ("", "real", "simulated"), places)
    if row["fate"] != "matched":
        parts: list[Part] = [Note(alone_judgement(row)), table]
        if real and sim:
            n_sim = sim["n_points"] or "no"
            parts.append(Note(f"{n_sim} of its points are simulated, too few to match it"))
        return parts
    title = f"Scores ({row['status']}, on {row['n_keep']} aligned nodes)"
    values = []
    for name in scores_in("object"):
        values.append((METRIC[name].label, row[name], METRIC[name].reading))
    headings = ("score", "value", "how to read it")
    covered = {"covered_real_0p3m": real[_NEAR], "covered_sim_0p3m": sim[_NEAR]}
    return [
        Note(judgement(row | covered)),
        Table(title, headings, values, words=(0, 2), digits=4),
        table,
    ]


def judgement(row: Mapping[str, Any]) -> str:
    """Sentence on what is wrong with an object that both sides have.

    Parameters
    ----------
    row : its scores, quadrant and coverage on both sides, as in `RunResults.objects`
    """
    real = row["covered_real_0p3m"]
    sim = row["covered_sim_0p3m"]
    cdc = f"CDC {number(row['cdc'], 2)}"
    r_lambda = f"r_lambda {number(row['r_lambda'], 2)}"
    is_covered = min(real, sim) >= _LEAST_COVERED
    words = {
        "faithful": "Faithful" if is_covered else f"Faithful by {cdc}, but its surface differs",
        "structure lost": f"Structure lost ({r_lambda}), shape right",
        "displaced": f"Displaced or misshapen ({cdc}), structure right",
        "failed": f"Shape and structure differ ({cdc}, {r_lambda})",
        UNKNOWN: f"Without a spectral score ({row['reason'] or row['status']})",
    }
    text = (
        f"{words[row['quadrant']]}: {percent(real)} of the real surface is simulated within 0.3 m, "
        f"{percent(sim)} of the simulated one is real; centroids "
        f"{number(row['centroid_distance_m'], 2)} m apart."
    )
    rms_m = row["alignment_rms_m"]
    has_score = row["r_lambda"] is not None and rms_m is not None
    if has_score and alignment_is_bad(rms_m, row["diagonal_m"]):
        text += (
            f" Its r_lambda is unreliable: the nodes were aligned {number(rms_m, 1)} m apart."
        )
    return text


def alone_judgement(row: Mapping[str, Any]) -> str:
    """Sentence on an object that only one side has; `row` is that of the frame of objects."""
    verdict = "Missing in the simulation"
    other = "simulated"
    if row["side"] == "sim":
        verdict = "Invented by the simulation"
        other = "real"
    covered = percent(row[_NEAR])
    text = f"{verdict}: {covered} of its points have one of the other side within 0.3 m"
    road = row["road_share"] or 0.0
    if road >= _LEAST_ROAD:
        text += f"; {percent(road)} of it is road on the {other} side"
    return f"{text}."
