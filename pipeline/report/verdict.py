"""The first screen of a run's page: surface, pieces, what to fix first, worst places, object scores, and trust.

The answers of `results.overview`, which the terminal also gives, with references, links and pictures.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter
from scipy.spatial import KDTree

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ...schemas.metrics import metric_of
from ...schemas.record import RunRecord
from ...schemas.results import Cause, Piece
from ..results.floor import RunExcess
from ..results.gate import Criterion, judge_run
from ..results.overview import over_floor
from ..results.quadrants import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ..storage.record import unmatched_worst
from .camera import Camera, box_around, inside, object_address
from .results import PairTables, RunResults
from .terminal.layout import mean_and_spread, number, percent
from .terminal.overview import change_words, headline_scores, pieces_words, surface_words
from .terminal.run import coverage_rows, surface_line, unmatched_lines

_SCORES = (
    *("match_rate", "found", "cdc_mean", "r_lambda_mean", "max_eigenvalue_shift_mean", "laplacian_change_mean"),
    *("r_gap_mean", "alignment_rms_m_mean", "centroid_distance_m_mean"),
)
#: Causes on the first screen.
_MOST_CAUSES = 6
#: Surroundings of a piece in its picture.
_AROUND_M = 1.0


@dataclass(frozen=True)
class Tile:
    """A score: `good` names its best value, `references` are further values by name."""

    name: str
    mean: str
    std: str
    good: str
    reading: str
    references: dict[str, str]


@dataclass(frozen=True)
class Picture:
    """One of the largest pieces: its words, the address of its object in 3D, and a drawing of its surroundings.

    layers : SVG paths of points: "others" in grey, then those of each side that the other side lacks
    bar, bar_m : a bar of some metres as the scale
    """

    link: str
    title: str
    what: str
    layers: dict[str, str]
    bar: float
    bar_m: float


@dataclass(frozen=True)
class Verdict:
    """The first screen.

    sentence, pieces : surface and pieces
    causes : most severe first
    is_met, good_enough : True if the acceptance criteria of the last gate are met, None without any; sentences
    warning : that scans seem to lie in another frame, which makes all numbers wrong; "" if none does
    change : since the results that this run replaced
    scores, coverage, groups : tables of the section that follows: headings, then rows
    unmatched, surface : surface behind unmatched objects; displacement and roughness
    """

    sentence: str
    pieces: str
    causes: tuple[Cause, ...]
    worst: list[Picture]
    numbers: list[Tile]
    is_met: bool | None
    good_enough: list[str]
    warning: str
    change: str
    trust: list[str]
    scores: list[list[str]]
    unmatched: str
    surface: str
    coverage: list[list[str]]
    groups: list[list[str]]


def verdict_of(results: RunResults, excess: RunExcess | None = None) -> Verdict:
    """The first screen of a run's page, over a floor if there is one."""
    record = results.run.record
    overview = over_floor(results.run, excess.floor) if excess else record.overview
    if overview is None:
        raise RunError(f"run {results.run.folder}: no pair is scored, so there is nothing to report")
    is_met, good_enough = _good_enough(results, excess)
    groups = [["", "real points", "missing", "simulated points", "invented"]]
    for own in overview.surface:
        shares = percent(own.missing_share), percent(own.invented_share)
        groups.append([own.name, f"{own.n_real:,}", shares[0], f"{own.n_sim:,}", shares[1]])
    return Verdict(
        sentence=_sentence(surface_words(record, excess)),
        pieces=_sentence(pieces_words(record).replace(" missing", " pieces missing", 1)),
        causes=overview.causes[:_MOST_CAUSES],
        worst=[_picture(results, piece) for piece in overview.pieces],
        numbers=[_tile(column, record, excess) for column in headline_scores(record)],
        is_met=is_met,
        good_enough=good_enough,
        warning=" ".join(f"Warning: {one.words}" for one in overview.trust if one.kind == "frames"),
        change=_sentence(change_words(record)) if record.previous else "",
        trust=[_sentence(one.words) for one in overview.trust if one.kind not in ("frames", "failed")],
        scores=_score_rows(record),
        unmatched=" ".join(map(_sentence, unmatched_lines(record))),
        surface=_sentence(surface_line(record)),
        coverage=coverage_rows(record),
        groups=groups,
    )


def limits_in_words() -> str:
    """The four quadrants and where they part."""
    faithful, lost, displaced, failed = QUADRANTS.values()
    return (
        f"{faithful}: CDC at most {CDC_LIMIT} and r_lambda at most {R_LAMBDA_LIMIT}; {lost}: r_lambda above "
        f"{R_LAMBDA_LIMIT}; {displaced}: CDC above {CDC_LIMIT}; {failed}: both above. The limits are fidpipe's, "
        "not the paper's: each side about half a metre from the other on average, and the upper end of what is usual "
        "for a twin that was meshed from scans"
    )


def _sentence(text: str) -> str:
    """A line of the terminal as a sentence; r_lambda and the like keep their names."""
    return f"{text}." if text.startswith("r_") else f"{text[0].upper()}{text[1:]}."


def _good_enough(results: RunResults, excess: RunExcess | None) -> tuple[bool | None, list[str]]:
    """The criteria of the folder's last gate, judged anew; else how to set some."""
    folder = results.run.folder
    criteria = _last_criteria(folder / "gate.json")
    if criteria is None:
        return None, [
            f"No acceptance limits are set yet: fidpipe gate {folder} --max r_lambda.mean=0.4 judges by yours."
        ]
    try:
        result = judge_run(folder, criteria, None if excess is None else excess.floor)
    except (RunError, ValueError) as error:
        return None, [f"The criteria of {folder / 'gate.json'} cannot be judged again: {error}"]
    unmet = [verdict for verdict in result.judged if not verdict.passed]
    on_scores = [verdict for verdict in result.judged if not verdict.criterion.measure.startswith("pairs.")]
    n_met = sum(verdict.passed for verdict in on_scores)
    met = f"{n_met} of {len(on_scores)} acceptance criteria on scores are met"
    if not unmet:
        return True, [f"Yes: {met}, and those on the run itself (complete, no pair failed, nothing changed since)."]
    why = [f"{one.criterion.name}: {one.why or number(one.value)}" for one in unmet[:3]]
    return False, [f"No: {met}.", *map(_sentence, why)]


_CRITERIA = TypeAdapter(list[Criterion])


def _last_criteria(path: Path) -> list[Criterion] | None:
    """The criteria that a gate wrote down; None where there are none that can be read."""
    try:
        return _CRITERIA.validate_python(json.loads(path.read_text(encoding="utf-8"))["criteria"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _tile(column: str, record: RunRecord, excess: RunExcess | None) -> Tile:
    metric, score = metric_of(column), record.summary[column]
    references = {}
    if excess and column in excess.scores:
        references["floor"] = number(excess.scores[column].floor)
    if record.previous and (last := record.previous.means.get(column)) is not None:
        references["last run"] = number(last)
    if metric.paper and record.preset == "paper":
        references["paper"] = number(metric.paper.mean)
    n_all = record.pairs.scored
    count = f"; mean of {score.n_pairs} of {n_all} pairs" if score.n_pairs < n_all else ""
    return Tile(
        name=metric.label,
        mean=number(score.mean),
        std=number(score.std),
        good=f"{'1' if metric.higher_is_better else '0'} is best",
        reading=f"{metric.reading}{count}",
        references=references,
    )


def _score_rows(record: RunRecord) -> list[list[str]]:
    """Headings, then for each score mean and deviation over pairs, how many, and the mean with unmatched as worst."""
    rows = [["score", "mean ± std", "pairs", "unmatched as worst", "how to read it"]]
    for column in _SCORES:
        metric, score = metric_of(column), record.summary[column]
        worst = record.summary.get(unmatched_worst(metric.column))
        mean = mean_and_spread(score.mean, score.std)
        pairs = f"{score.n_pairs} of {record.pairs.scored}"
        rows.append([metric.label, mean, pairs, number(worst.mean) if worst else "", metric.reading or metric.meaning])
    return rows


def _picture(results: RunResults, piece: Piece) -> Picture:
    """The box around a piece: in colour the points that the other side lacks, everything else in grey."""
    tables = PairTables(results, piece.pair_id)
    clouds = tables.clouds
    everything = {side: np.concatenate([clouds[side].points, tables.road[side]]) for side in SIDES}
    reach_m = float(str(results.run.record.settings["pieces"]["reach_m"]))
    row = next(
        row
        for row in results.run.read_table("pieces", piece.pair_id).to_pylist()
        if (row["side"], row["piece_id"]) == (piece.side, piece.piece_id)
    )
    centre, extents = np.array([row["cx"], row["cy"], row["cz"]]), np.array(piece.extents_m)
    moved = np.array([row[f"moved_{axis}_m"] or 0.0 for axis in "xyz"])
    ends = np.stack([centre, centre + moved])
    low, high = ends.min(axis=0) - extents, ends.max(axis=0) + extents
    own, alone = clouds[piece.side], {}
    for side, other in (SIDES, SIDES[::-1]):
        points = clouds[side].points[inside(clouds[side].points, low, high)]
        alone[side] = points[KDTree(everything[other]).query(points)[0] > reach_m]
    low, high = box_around(np.concatenate([*alone.values()]))
    low, high = low - _AROUND_M, high + _AROUND_M
    around = np.concatenate([points[inside(points, low, high)] for points in everything.values()])
    communities = own.community[inside(own.points, *box_around(alone[piece.side]))]
    camera = Camera(low, high)
    return Picture(
        link=object_address(piece.pair_id, f"{piece.side} {np.bincount(communities).argmax()}"),
        title=piece.words,
        what=f"{piece.fate_words}; pair {piece.pair_id}, {piece.n_points:,} points",
        layers={"others": camera.path(around), **{side: camera.path(points) for side, points in alone.items()}},
        bar=camera.bar_m * camera.scale,
        bar_m=camera.bar_m,
    )
