"""What a person asks first of a run, answered for the first screen of its page.

Good enough, worst where, missing what, better than last time, and how far the numbers can be trusted. The answers are
those of `results.overview`, which the terminal also gives; here they get references, links and pictures.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ...schemas.metrics import metric_of
from ...schemas.record import RunRecord
from ...schemas.results import HeadlineNumber, Overview, WorstObject
from ..results.floor import RunExcess
from ..results.gate import Criterion, judge_run
from ..results.overview import FEWEST_OBJECTS, run_overview, verdict_sentence
from ..results.quadrants import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ..storage.record import unmatched_worst
from .camera import Camera, box_around, inside, object_address
from .results import PairTables, RunResults
from .terminal.layout import mean_and_spread, number, percent, signed
from .terminal.overview import changes_since, other_objects
from .terminal.run import coverage_rows, surface_line, unmatched_lines

_SCORES = (
    *("match_rate", "cdc_mean", "r_lambda_mean", "max_eigenvalue_shift_mean", "laplacian_change_mean", "r_gap_mean"),
    *("alignment_rms_m_mean", "centroid_distance_m_mean"),
)
_STEADY = 5e-4  #: a mean that moved by less is shown as the same


@dataclass(frozen=True)
class Reference:
    """What stands beside a number: what it is, its value, and how the run stands to it ("better", "worse" or "")."""

    name: str
    value: str
    is_now: str = ""


@dataclass(frozen=True)
class Tile:
    """One of the five numbers; `good` says which end is the best, `reading` how it is read."""

    name: str
    mean: str
    std: str
    good: str
    reading: str
    references: list[Reference]


@dataclass(frozen=True)
class Picture:
    """One of the worst objects: where it is shown, what it is, what is wrong, and how both sides look in one box.

    layers : by side the SVG path of its points, the upper one last; of an unmatched object all that the other side has
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
    """The answers.

    good_enough : sentences on the acceptance criteria that the run was last judged by, or how to judge it
    is_met : whether they are all met; None where there are none
    missing : sentences on what is missing and invented
    moved : since the results that this run replaced; sentences
    trust : what limits the trust in the numbers; sentences
    warning : that scans seem to lie in another frame, which makes all numbers wrong; "" where none does
    scores, coverage : of the section that follows: headings, then a row for each score, and for each side
    unmatched, surface : what is behind the unmatched objects, and how the simulated surface lies
    """

    sentence: str
    good_enough: list[str]
    is_met: bool | None
    numbers: list[Tile]
    worst: list[Picture]
    failings: list[str]
    missing: list[str]
    moved: list[str]
    trust: list[str]
    warning: str
    scores: list[list[str]]
    unmatched: str
    surface: str
    coverage: list[list[str]]


def verdict_of(results: RunResults, excess: RunExcess | None = None) -> Verdict:
    """What the run says of the simulation, over a floor if there is one."""
    record, overview = results.run.record, run_overview(results.run)
    if overview is None:
        raise RunError(f"run {results.run.folder}: no pair is scored, so that nothing can be said of it")
    is_met, good_enough = _good_enough(results, excess)
    told = {"frames", "failed"} | ({"floor"} if excess else set())  # by the page in words of its own
    return Verdict(
        sentence=verdict_sentence(overview.verdict),
        good_enough=good_enough,
        is_met=is_met,
        numbers=[_tile(one, record, excess) for one in overview.numbers],
        worst=[_picture(results, one) for one in overview.worst],
        failings=[_sentence(failing.words) for failing in overview.failings],
        missing=list(_missing(overview, record)),
        moved=list(_moved(overview, record)),
        trust=[_sentence(one.words) for one in overview.trust if one.kind not in told],
        warning=" ".join(f"Warning: {one.words}" for one in overview.trust if one.kind == "frames"),
        scores=_score_rows(record),
        unmatched=" ".join(map(_sentence, unmatched_lines(record))),
        surface=_sentence(surface_line(record)),
        coverage=coverage_rows(record),
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
        return None, [f"Nobody has said what is: fidpipe gate {folder} --max r_lambda.mean=0.4 judges by your limits."]
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


def _tile(one: HeadlineNumber, record: RunRecord, excess: RunExcess | None) -> Tile:
    metric = metric_of(one.column)
    references = []
    if excess is not None and (floor := excess.scores[one.column].floor) is not None:
        references.append(Reference("perfect simulator", number(floor)))
    if one.last is not None:
        references.append(Reference("last run", number(one.last), _change(one)))
    if metric.paper is not None:
        references.append(Reference("paper", number(metric.paper.mean)))
    best = "1" if one.better == "higher" else "0"
    n_all = record.pairs.scored
    count = f"; mean of {one.n_pairs} of {n_all} pairs" if one.n_pairs < n_all else ""
    return Tile(
        name=metric.label,
        mean=number(one.mean),
        std=number(one.std),
        good=f"{best} is best",
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


def _change(one: HeadlineNumber) -> str:
    """Whether a number is better or worse than in the last run, "" where it stayed."""
    if one.mean is None or one.last is None or abs(one.mean - one.last) < _STEADY:
        return ""
    return "better" if (one.mean > one.last) == (one.better == "higher") else "worse"


def _picture(results: RunResults, one: WorstObject) -> Picture:
    tables = PairTables(results, one.pair_id)
    own = tables.clouds[one.side].members(one.object_id)
    if one.status == "matched":
        row = tables.matched[tables.matched.real_id == one.object_id].iloc[0]
        clouds = {"real": own, "sim": tables.clouds["sim"].members(row.sim_id)}
        low, high = box_around(np.concatenate([*clouds.values()]))
    else:
        (other,) = set(SIDES) - {one.side}
        low, high = box_around(own)
        around = tables.clouds[other].points
        clouds = {other: around[inside(around, low, high)], one.side: own}
    camera = Camera(low, high)
    return Picture(
        link=object_address(one.pair_id, f"{one.side} {one.object_id}"),
        title=f"{one.label}, {one.range_m:.0f} m away, {one.n_points:,} points",
        what=one.what,
        layers={side: camera.path(points) for side, points in clouds.items()},
        bar=camera.bar_m * camera.scale,
        bar_m=camera.bar_m,
    )


def _missing(overview: Overview, record: RunRecord) -> Iterator[str]:
    """How many objects are missing and invented, and what they mostly are."""
    of, n_pairs = overview.verdict, max(1, overview.verdict.n_pairs)
    if not of.missing:
        yield "No real object is missing."
    else:
        share = percent(of.missing / of.n_real)
        yield f"{of.missing:,} of {of.n_real:,} real objects ({share}), {of.missing / n_pairs:.1f} a pair."
    findings = record.findings
    if of.missing and findings is not None:
        kinds = [one for one in findings.classes if one.n_real >= FEWEST_OBJECTS and one.missing_share]
        bands = [one for one in findings.range_m.bands if one.n_real >= FEWEST_OBJECTS and one.missing_share]
        if len(findings.classes) > 1 and kinds:
            kind = max(kinds, key=lambda one: one.missing_share or 0.0)
            yield f"Most of all {kind.label}: {percent(kind.missing_share)} of {kind.n_real} are missing."
        if bands:
            band = max(bands, key=lambda one: one.missing_share or 0.0)
            where = f"from {band.from_m:g} m on" if band.to_m is None else f"at {band.from_m:g} to {band.to_m:g} m"
            yield f"Most of all {where}: {percent(band.missing_share)} of {band.n_real} are missing."
    yield f"{of.hallucinated:,} simulated objects are invented, {of.hallucinated / n_pairs:.1f} a pair."


def _moved(overview: Overview, record: RunRecord) -> Iterator[str]:
    """What has changed since the results that this run replaced."""
    last = record.previous
    if last is None:
        yield "These are the first results of this folder. To compare with another run: fidpipe compare OTHER THIS."
        return
    written = last.written[:16].replace("T", " ")
    yield f"Against the results of {written} ({last.n_pairs} pairs, fidpipe {last.fidpipe}):"
    moved = [
        f"{one.label} {signed(one.mean - one.last)} ({_change(one)})"
        for one in overview.numbers
        if _change(one) and one.mean is not None and one.last is not None
    ]
    yield _sentence("; ".join(moved)) if moved else "None of the five numbers moved."
    if changes := changes_since(last):
        yield _sentence(f"what differs: {'; '.join(changes)}")
    yield from map(_sentence, other_objects(overview))
    if moved:
        yield "Whether that is more than chance: fidpipe compare, with both runs kept."
