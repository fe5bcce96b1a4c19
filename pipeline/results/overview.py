"""The overview of a run: the verdict, five numbers, the worst objects, the commonest failings, and what limits trust.

The objects are counted while the findings read them (`Tally`), some pairs at a time, so that the overview costs no
memory of its own. Its rules stand here; they are fidpipe's.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from heapq import nsmallest
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import NDArray

from ...schemas.metrics import metric_of
from ...schemas.record import RunRecord
from ...schemas.results import (
    Caution,
    Failing,
    Findings,
    HeadlineNumber,
    ObjectOverview,
    Overview,
    Verdict,
    WorstObject,
)
from ...schemas.settings import MatchingSettings
from ...stages.arrays import BoolArray, FloatArray
from ...stages.coverage import THERE, surface_state
from ...stages.statistics.comparison import BLOCK_S, LEAST_PAIRS
from ...stages.statistics.findings import BAND_EDGES_M
from ..datasets.frame_checks import frames_summary
from ..storage.files import path_exists
from .findings import ObjectRows, SideRows, read_objects
from .finished import FinishedRun
from .floor import FLOOR_RECIPE
from .quadrants import QUADRANTS, UNKNOWN, quadrant_of

#: The five numbers, by column of `pairs`.
NUMBERS = ("match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean", "covered_real_0p3m")
#: So many objects and failings are named.
N_NAMED = 3
#: A failing is named if at least so many of at least so many objects fail.
FEWEST_FAILING, FEWEST_OBJECTS = 3, 5
#: An alignment is bad beyond this share of the diagonal of the real object's bounding box. Paired at random, the points
#: of a filled cube give 0.41: the distance of two of them (root mean square: edge / sqrt 2) over edge sqrt 3.
BAD_ALIGNMENT = 0.25
#: So far apart it is bad whatever the object's size: as far as centroids may lie for two objects to be matched at all.
BAD_ALIGNMENT_M = MatchingSettings().delta_m
#: From this share of badly aligned objects on it is said.
_MANY_BADLY_ALIGNED = 0.05
BAD_ALIGNMENT_WORDS = f"nodes over {100 * BAD_ALIGNMENT:g} % of the object's size or {BAD_ALIGNMENT_M:g} m apart"
NO_LABEL = "(no label)"

_FAITHFUL, *_FAILED = QUADRANTS
_ALONE = ("missing", "hallucinated")
_KINDS = (*_ALONE, *_FAILED)
_VERDICT_NAMES = (*(key.replace(" ", "_") for key in QUADRANTS), "unjudged", "missing")
_ALL, _THERE = "all", " there"  # beside the fates: all objects, and those whose surface the other side has
_STATES = {"partly": "partly there", "absent": "absent"}


@overload
def alignment_is_bad(alignment_rms_m: float, diagonal_m: float) -> bool: ...


@overload
def alignment_is_bad(alignment_rms_m: FloatArray, diagonal_m: FloatArray) -> BoolArray: ...


def alignment_is_bad(alignment_rms_m: float | FloatArray, diagonal_m: float | FloatArray) -> bool | BoolArray:
    """Whether nodes are aligned so far apart that r_lambda says little, (n,) bool; or of one object.

    Parameters
    ----------
    alignment_rms_m : (n,) float64, of `metrics`
    diagonal_m : (n,) float64, of the real object's axis-aligned bounding box

    Examples
    --------
    >>> alignment_is_bad(np.array([20.0, 2.0, 1.0]), np.array([90.0, 6.0, 6.0])).tolist()
    [True, True, False]
    """
    return alignment_rms_m > np.minimum(BAD_ALIGNMENT * diagonal_m, BAD_ALIGNMENT_M)


class Tally:
    """Counts the objects of a run, some pairs at a time, and keeps the worst.

    Worst objects: matched ones that are not faithful, and unmatched ones whose surface the other side lacks, by
    loss x ln(points), largest first; ties by pair, side and number. The loss, 0 to 1, of an unmatched object is the
    share of its points that the other side does not have within 0.3 m, of a matched one the mean of CDC / 2 and
    r_lambda. So a large object that is gone comes before one that is badly made, and both before a handful of points.

    Failings: by class, range band and kind, n of n_objects, if at least 3 of at least 5; by n^2 / n_objects, largest
    first: how many they are, times the share of such objects. Ties by kind, class and band. Missing and hallucinated
    objects whose surface the other side has are only divided differently, and no failing.
    """

    def __init__(self) -> None:
        self._n_pairs = self._n_aligned = self._n_badly_aligned = 0
        self._counts: Counter[tuple[str, str, str, int, str, bool]] = Counter()  # side, label, shape, band, fate, there
        self._worst: list[_Candidate] = []

    def add(self, rows: ObjectRows) -> None:
        """Counts the objects of some more pairs."""
        scores, real, sim = rows.scores, rows.real, rows.sim
        quadrant = quadrant_of(scores["cdc"], scores["r_lambda"])
        self._n_pairs += len(rows.pair_ids)
        fates = np.full(len(real.pair), "missing", dtype=object), np.full(len(sim.pair), "hallucinated", dtype=object)
        fates[0][rows.real_rows], fates[1][rows.sim_rows] = quadrant, "matched"
        for name, side, fate in (("real", real, fates[0]), ("sim", sim, fates[1])):
            band = np.searchsorted(BAND_EDGES_M, side.range_m, side="right") - 1
            columns = (side.label, side.shape, band, fate, side.covered > THERE)
            self._counts.update((name, *key) for key in zip(*(own.tolist() for own in columns), strict=True))
        is_bad = alignment_is_bad(scores["alignment_rms_m"], real.diagonal_m[rows.real_rows])
        has_r_lambda = ~np.isnan(scores["r_lambda"])
        self._n_aligned += int(np.count_nonzero(has_r_lambda))
        self._n_badly_aligned += int(np.count_nonzero(is_bad & has_r_lambda))
        found = [*self._worst, *_worst_matched(rows, quadrant), *_worst_alone(rows, "real"), *_worst_alone(rows, "sim")]
        self._worst = nsmallest(N_NAMED, found, key=lambda one: one.order)

    def objects(self) -> ObjectOverview:
        """What the objects say that were counted."""
        is_labelled = any(label for _, label, *_ in self._counts)
        fates: Counter[str] = Counter()
        for (_, _, _, _, fate, _), n in self._counts.items():
            fates[fate] += n
        n_of = {name: fates[key] for name, key in zip(_VERDICT_NAMES, (*QUADRANTS, UNKNOWN, "missing"), strict=True)}
        verdict = Verdict(n_pairs=self._n_pairs, n_real=sum(n_of.values()), **n_of, hallucinated=fates["hallucinated"])
        return ObjectOverview(
            class_is="class" if is_labelled else "shape",
            verdict=verdict,
            n_aligned=self._n_aligned,
            n_badly_aligned=self._n_badly_aligned,
            worst=tuple(one.named(is_labelled) for one in self._worst),
            failings=self._failings(is_labelled),
        )

    def _failings(self, is_labelled: bool) -> tuple[Failing, ...]:
        groups: dict[tuple[str, int, str], Counter[str]] = {}  # label, band, side: objects by fate, and those there
        for (side, label, shape, band, fate, is_there), n in self._counts.items():
            own = groups.setdefault(((label or NO_LABEL) if is_labelled else shape, band, side), Counter())
            is_gone = not (is_there and fate in _ALONE)
            own.update({_ALL: n, (fate if is_gone else fate + _THERE): n})
        named = [
            (-(own[kind] ** 2) / own[_ALL], i, group)
            for group, own in groups.items()
            for i, kind in enumerate(_KINDS)
            if own[kind] >= FEWEST_FAILING and own[_ALL] >= FEWEST_OBJECTS
        ]
        return tuple(_failing(_KINDS[i], group, groups[group]) for _, i, group in nsmallest(N_NAMED, named))


def verdict_sentence(verdict: Verdict) -> str:
    """What has become of the real objects, and how many simulated ones have no counterpart."""
    n = verdict.n_real

    def share(count: int) -> str:
        return f"{100 * count / max(1, n):.0f} %"

    unknown = f", {share(verdict.unjudged)} are too small to judge" if verdict.unjudged else ""
    has = "object has" if verdict.hallucinated == 1 else "objects have"
    return (
        f"Of the {n:,} real objects in {verdict.n_pairs:,} pair{'s' * (verdict.n_pairs > 1)} of scans the simulation "
        f"reproduces {share(verdict.faithful)} faithfully, {share(verdict.structure_lost)} with the right shape but "
        f"lost structure, {share(verdict.displaced)} with the right structure but displaced; {share(verdict.failed)} "
        f"fail in both, {share(verdict.missing)} are missing{unknown}; {verdict.hallucinated:,} simulated {has} no "
        "real counterpart."
    )


def overview_of(key: str, objects: ObjectOverview, record: RunRecord) -> Overview:
    """The overview of a run: what its objects say, and the numbers and cautions of its record.

    Parameters
    ----------
    key : hash of all that `objects` was made from
    record : of the run, with or without an overview
    """
    of_objects = {name: getattr(objects, name) for name in ObjectOverview.model_fields}
    return Overview(key=key, **of_objects, numbers=tuple(_numbers(record)), trust=tuple(_cautions(objects, record)))


def run_overview(run: FinishedRun) -> Overview | None:
    """The overview of a finished run: as recorded, or from its tables where an older fidpipe wrote the record.

    None where no pair is scored.

    Raises
    ------
    RunError
        There is none in the record, and a table is damaged.
    """
    if run.record.overview or not run.scored:
        return run.record.overview
    names, tally = [row["pair_id"] for row in run.scored], Tally()
    for name in names:
        run.check(name)
    read_objects(run.store, names, by_reference=run.preset == "reference", watch=tally.add)
    return overview_of("", tally.objects(), run.record)


def independence(findings: Findings | None) -> list[str]:
    """Which pairs count as one, or that this is not known."""
    if findings is None or not findings.claims:
        return []
    n_pairs, n_independent = findings.n_pairs, max(claim.n_pairs for claim in findings.claims)
    if n_independent < n_pairs:
        return [f"{n_pairs} pairs count as {n_independent}: copies, and scans within {BLOCK_S:g} s, count once"]
    if n_pairs > 1 and all(scan.timestamp_s is None for scan in findings.scans.scans):
        return ["no timestamps: each pair counts as independent, which neighbouring frames of a drive are not"]
    return []


@dataclass(frozen=True)
class _Candidate:
    """One of the worst objects so far; its class is its label, its shape where nothing is labelled."""

    severity: float
    shape: str
    found: WorstObject

    @property
    def order(self) -> tuple[float, str, str, int]:
        """What the worst come first by."""
        return -self.severity, self.found.pair_id, self.found.side, self.found.object_id

    def named(self, is_labelled: bool) -> WorstObject:
        """The object with its class."""
        return self.found.model_copy(update={"label": (self.found.label or NO_LABEL) if is_labelled else self.shape})


def _worst_matched(rows: ObjectRows, quadrant: NDArray[np.str_]) -> Iterator[_Candidate]:
    cdc, r_lambda = rows.scores["cdc"], rows.scores["r_lambda"]
    loss = np.where(np.isin(quadrant, _FAILED), (cdc / 2 + r_lambda) / 2, 0.0)
    severity = loss * np.log(rows.scores["n_real"])
    for i in _largest(severity):
        what = f"{QUADRANTS[quadrant[i]]}: CDC {cdc[i]:.2f}, r_lambda {r_lambda[i]:.2f}"
        yield _candidate(
            rows.pair_ids, rows.real, "real", rows.real_rows[i], severity[i], "matched", what, cdc[i], r_lambda[i]
        )


def _worst_alone(rows: ObjectRows, side: str) -> Iterator[_Candidate]:
    own, status = {"real": (rows.real, "missing"), "sim": (rows.sim, "hallucinated")}[side]
    is_gone = ~own.is_matched & (own.covered <= THERE)
    severity = np.where(is_gone, 1 - own.covered, 0.0) * np.log(np.maximum(own.n_points, 1))
    for i in _largest(severity):
        state = _STATES[surface_state(own.covered[i])]
        what = f"{status}, {state}: {100 * own.covered[i]:.0f} % of it covered within 0.3 m"
        yield _candidate(rows.pair_ids, own, side, i, severity[i], status, what)


def _largest(severity: FloatArray) -> list[int]:
    """Places of the largest values that are above 0; more than are named where the last ones tie."""
    known = np.sort(severity[severity > 0])[-N_NAMED:]
    return np.flatnonzero(severity >= known[0]).tolist() if len(known) else []


def _candidate(
    pair_ids: list[str],
    side: SideRows,
    name: str,
    i: int,
    severity: float,
    status: str,
    what: str,
    cdc: float | None = None,
    r_lambda: float | None = None,
) -> _Candidate:
    found = WorstObject(
        pair_id=pair_ids[side.pair[i]],
        side=name,
        object_id=int(side.object_id[i]),
        label=side.label[i],
        range_m=float(side.range_m[i]),
        n_points=int(side.n_points[i]),
        status=status,
        covered=float(side.covered[i]),
        cdc=cdc,
        r_lambda=r_lambda,
        what=what,
    )
    return _Candidate(float(severity), str(side.shape[i]), found)


def _failing(kind: str, group: tuple[str, int, str], own: Counter[str]) -> Failing:
    label, band, _ = group
    from_m, to_m = BAND_EDGES_M[band], (*BAND_EDGES_M, None)[band + 1]
    where = f"beyond {from_m:g} m" if to_m is None else f"at {from_m:g} to {to_m:g} m"
    n_there = own[kind + _THERE]
    there = f" ({n_there} more {'is' if n_there == 1 else 'are'} there, only divided differently)" if n_there else ""
    words = f"{label} {where}: {QUADRANTS.get(kind, kind)} {own[kind]} of {own[_ALL]}{there}"
    return Failing(
        label=label, from_m=from_m, to_m=to_m, kind=kind, n=own[kind], n_objects=own[_ALL], n_there=n_there, words=words
    )


def _numbers(record: RunRecord) -> Iterator[HeadlineNumber]:
    last = record.previous.means if record.previous else {}
    for column in NUMBERS:
        metric, score = metric_of(column), record.summary[column]
        yield HeadlineNumber(
            column=column,
            label=metric.label,
            mean=score.mean,
            std=score.std,
            n_pairs=score.n_pairs,
            better=metric.better or "lower",
            last=last.get(column),
        )


def _cautions(objects: ObjectOverview, record: RunRecord) -> Iterator[Caution]:
    """What limits the trust in the numbers, the gravest first."""
    pairs = record.pairs
    n_pairs = pairs.scored + pairs.failed + pairs.to_do
    if pairs.failed:
        yield Caution(kind="failed", words=f"{pairs.failed} of {n_pairs} pairs failed and count nowhere")
    if pairs.to_do:
        yield Caution(kind="to_do", words=f"{pairs.to_do} of {n_pairs} pairs are not evaluated yet")
    if record.frames:
        yield Caution(kind="frames", words=frames_summary(record.frames, n_pairs))
    if record.notes:
        pair_id, (note, *_) = next(iter(record.notes.items()))
        words = f"ground cut, notes on {len(record.notes)} of {n_pairs} pairs; {pair_id}: {note}"
        yield Caution(kind="ground", words=words)
    n_independent = max((claim.n_pairs for claim in record.claims), default=pairs.scored)
    if n_independent < LEAST_PAIRS:
        few = f"{n_independent} independent pair{'s' * (n_independent != 1)}"
        yield Caution(kind="pairs", words=f"{few}: too few to tell change from chance, which takes {LEAST_PAIRS}")
    for words in independence(record.findings):
        yield Caution(kind="independence", words=words)
    if objects.n_aligned and objects.n_badly_aligned >= _MANY_BADLY_ALIGNED * objects.n_aligned:
        share = f"{100 * objects.n_badly_aligned / objects.n_aligned:.0f} %"
        words = f"r_lambda of {share} of the matched objects stands on a bad alignment: {BAD_ALIGNMENT_WORDS}"
        yield Caution(kind="alignment", words=words)
    if record.preset != "reference":
        words = "each side is divided into objects by itself, and small changes move that; to compare simulators: "
        yield Caution(kind="partition", words=f"{words}fidpipe run --preset reference")
    if path_exists(Path(record.dataset) / FLOOR_RECIPE):
        return  # it is a floor itself
    floor = shlex.join(["fidpipe", "floor", record.dataset])
    yield Caution(kind="floor", words=f"what a perfect simulator would score is not known from this run: {floor}")
