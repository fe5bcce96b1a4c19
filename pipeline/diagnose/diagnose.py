"""Diagnosis of a finished run: flaws that explain the difference of both sides, and the gain of correcting each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...schemas.cause_catalogue import CAUSES
from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ...schemas.results import CauseEstimate, DiagnosedCause, Diagnosis, Evidence
from ...stages.arrays import FloatArray, IntArray
from ...stages.causes.curves import AXES, curves
from ...stages.causes.evidence import PairEstimates, PairScans, Side, amounts_of_floor, estimate
from ...stages.causes.gain import Shares, changes, corrections, off_shares, shares, surface_distance
from ...stages.displacement import PARAMETERS, Displacement
from ...stages.statistics.comparison import LEAST_FOR_INTERVAL, block_means, blocks_of
from ..engine.progress import Reporter
from ..results.causes import mean_interval, size_words
from ..results.diagnosis import DIAGNOSIS, UNEXPLAINED, results_identity
from ..results.finished import FinishedRun
from ..storage.files import write_whole
from ..storage.run_record import dumps
from .causes import LEAST_EXCESS_M, SCALE, NamedCause, confirm, name_causes
from .latency import AHEAD, follow, latency_words, speed_m_s

#: Without a floor, *unexplained* is the first cause if more of the distance remains, metres, and more than half of it.
MOST_LEFT_M = 0.02
#: Over a floor, if at least this share of the flat surface remains elsewhere, and more than half of what was before.
MOST_OFF = 0.03
_SEED = 20240917
#: Estimates from columns of `pairs`: simulated minus real.
_OF_PAIRS = {
    "intensity by range": ("intensity_sim_by_range", "intensity_real_by_range"),
    "intensity ranks": ("intensity_rank_distance", None),
}
Item = TypeVar("Item")
#: Estimates of a pair, and the amounts of its floor.
Estimates = tuple[PairEstimates, dict[str, float]]
#: Curves of a pair by kind of evidence.
Drawn = dict[str, Mapping[str, FloatArray]]


def diagnose_run(
    folder: Path,
    floor: Path | None = None,
    pattern: str | None = None,
    workers: int = 1,
    reporter: Reporter | None = None,
) -> Diagnosis:
    """Diagnose a finished run and store the result in its folder (unless only some pairs are diagnosed).

    Parameters
    ----------
    floor : run on the same real scans whose estimates and distances are subtracted, such as of `fidpipe floor`
    pattern : only these pairs
    workers : threads
    reporter : shows the progress

    Raises
    ------
    RunError
        A folder is not a finished run, a table is damaged, or no pair can be diagnosed.
    """
    run, base = FinishedRun(folder), None if floor is None else FinishedRun(floor)
    chosen = run.select(pattern)
    if base:
        known = {row["pair_id"] for row in base.scored}
        if not known & set(chosen):
            raise RunError(f"floor {floor}: expected the pairs of {folder}, got none of them; see fidpipe floor --help")
        chosen = [name for name in chosen if name in known]
    show = reporter or Reporter()
    show.start(len(chosen), 3 * len(chosen))
    with ThreadPoolExecutor(workers) as pool:
        both = _each(pool, chosen, lambda name: _estimates(run, base, name), lambda: show.advance(1))
        found = {name: own for name, own in zip(chosen, both, strict=True) if own}
        if not found:
            raise RunError(f"run {folder}: no pair has enough surface in common with its real scan; see fidpipe check")
        names = [*found]
        times_s = run.record.times_s
        blocks, unit = _blocks(run, times_s, names)
        amounts = [own.amounts for own, _ in found.values()]
        candidates = name_causes(amounts, [over for _, over in found.values()] if base else None, blocks)
        steps = iter([1] * len(names))  # not if some are corrected once more

        def correct(amounts: Mapping[str, float], between_sims: bool = False) -> list[Shares]:
            def of_pair(name: str) -> Shares:
                return _gains(*_read_both(run, base, name), found[name], amounts, between_sims)

            return _each(pool, names, of_pair, lambda: show.advance(next(steps, 0)))

        named, doubtful, gains = confirm(candidates, correct, partial(correct, between_sims=True) if base else None)
        ahead = [own for own in named if own.model.name == AHEAD]
        latency = latency_words(ahead[0].values, _speeds_m_s(run, times_s, pool, names)) if ahead else None
        off = _each(pool, names, lambda name: _off(run, base, name, found[name], named), lambda: None) if base else []
        drawn = _each(pool, names, lambda name: _curves(run, name, found[name][0], named), lambda: show.advance(1, 1))
    show.stop()
    before_m, after_m, floor_m = np.mean([(own.before_m, own.after_m, own.floor_m) for own in gains], axis=0).tolist()
    excess_m = before_m - floor_m if before_m - floor_m >= LEAST_EXCESS_M else None
    causes = [_cause(own, gains, drawn, excess_m, latency if own in ahead else None) for own in named]
    if base and is_elsewhere(*np.mean(off, axis=0)):
        left = [after for _, after in off]
        part = size_words(float(np.mean(left)), "share")
        words = f"{part} of the flat surface lies elsewhere than in the floor, which no cause in the catalogue explains"
        causes.insert(0, _unexplained(left, blocks, "share", words))
    elif base is None and is_unexplained(before_m, after_m):
        words = f"no cause in the catalogue for {size_words(after_m / before_m, 'share')} of the distance"
        words += ", unless a second measurement has it too (--floor)"
        causes.insert(0, _unexplained([own.after_m for own in gains], blocks, "m", words))
    diagnosis = Diagnosis(
        of=results_identity(run.record),
        floor=None if floor is None else str(floor),
        n_pairs=len(names),
        n_blocks=len(np.unique(blocks)),
        over=unit,
        distance_m=before_m,
        floor_m=floor_m,
        unexplained=None if excess_m is None else min(max((after_m - floor_m) / excess_m, 0.0), 1.0),
        causes=tuple(causes),
        estimates=tuple(_estimate_rows(names, amounts)),
        doubtful=tuple(own.sentence for own in doubtful),
        left_out=tuple(name for name in chosen if name not in found),
    )
    if pattern is None:
        try:
            write_whole(folder / DIAGNOSIS, dumps(diagnosis.as_dict()))
        except RunError as error:
            show.warn(f"not stored: {error}")
    return diagnosis


def is_unexplained(before_m: float, after_m: float) -> bool:
    """True if most of the distance remains after all corrections: no named cause explains it."""
    return after_m >= MOST_LEFT_M and after_m > before_m / 2


def is_elsewhere(before: float, after: float) -> bool:
    """True if much of the flat surface is elsewhere than in the floor, and corrections bring back less than half."""
    return after >= MOST_OFF and after > before / 2


def _unexplained(left: Sequence[float], blocks: IntArray, unit: str, words: str) -> DiagnosedCause:
    """The rest, of each pair, as the first cause."""
    mean, low, high = mean_interval(block_means(np.array(left), blocks))
    found = {"words": words, "estimate": mean, "low": low, "high": high, "unit": unit, "n_pairs": len(left)}
    return DiagnosedCause(name=UNEXPLAINED, setting="the worst places; diagnose --tell-apart", **found)


def read_pair(run: FinishedRun, pair_id: str) -> PairScans:
    """The clean points of a pair and what is known of its sensors."""
    sides = []
    for side in SIDES:
        table = run.read_table("ground", pair_id, side, ["x", "y", "z", "is_ground"])
        points = np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64)
        sensor = run.read_table("sensor", pair_id, side).to_pylist()[0]
        sides.append(Side(points, table["is_ground"].to_numpy(), sensor))
    return PairScans(*sides)


def _read_both(run: FinishedRun, base: FinishedRun | None, pair_id: str) -> tuple[PairScans, PairScans | None]:
    return read_pair(run, pair_id), read_pair(base, pair_id) if base else None


def _each(
    pool: ThreadPoolExecutor, names: Sequence[str], work: Callable[[str], Item], advance: Callable[[], None]
) -> list[Item]:
    results = []
    for result in pool.map(work, names):
        results.append(result)
        advance()
    return results


def _estimates(run: FinishedRun, base: FinishedRun | None, pair_id: str) -> Estimates | None:
    """Estimates of a pair; None if the scans have too little surface in common."""
    scans, floor = _read_both(run, base, pair_id)
    found = estimate(scans)
    if found is None:
        return None
    of_floor = estimate(floor) if floor else None
    over = amounts_of_floor(found, scans, floor, of_floor.amounts) if floor and of_floor else {}
    for own, amounts in ((run, found.amounts), (base, over)):
        row = own.row(pair_id) if own and amounts else {}
        for name, (sim, real) in _OF_PAIRS.items():
            if row.get(sim) is not None and (real is None or row.get(real) is not None):
                amounts[name] = row[sim] - (row[real] if real else 0.0)
        if row.get("intensity_ratio") is not None and (base or row["intensity_rmse"] is not None):
            amounts[SCALE] = 1.0 - row["intensity_ratio"]
    return found, over


def _gains(
    scans: PairScans, floor: PairScans | None, found: Estimates, amounts: Mapping[str, float], between_sims: bool
) -> Shares:
    """Shares of a pair in the distance between both sides, or between the simulated scans of the run and its floor."""
    rng, (own, over) = np.random.default_rng(_SEED), found
    if floor and between_sims:
        return changes(scans, floor, _moved(own, over), amounts, rng)
    made = corrections(scans, own, amounts, rng)
    return shares(scans, made, rng, surface_distance(floor.real.points, floor.sim.points) if floor else 0.0)


def _off(
    run: FinishedRun, base: FinishedRun, pair_id: str, found: Estimates, named: Sequence[NamedCause]
) -> tuple[float, float]:
    """Share of the flat surface that a pair has elsewhere than its floor, before and after all corrections."""
    scans, floor = read_pair(run, pair_id), read_pair(base, pair_id)
    amounts = {own.model.name: own.mean for own in named}
    return off_shares(scans, floor, _moved(*found), amounts, np.random.default_rng(_SEED))


def _moved(own: PairEstimates, over: Mapping[str, float]) -> Displacement:
    """Displacement of the simulated scan of a run against that of its floor."""
    return Displacement(own.displacement.values - [over.get(name, 0.0) for name in PARAMETERS])


def _curves(run: FinishedRun, pair_id: str, found: PairEstimates, named: Sequence[NamedCause]) -> Drawn:
    scans, kinds = read_pair(run, pair_id), {own.model.curve for own in named if own.model.curve}
    return {kind: curves(scans, found, kind) for kind in kinds}


def _blocks(run: FinishedRun, times_s: Mapping[str, float], names: Sequence[str]) -> tuple[IntArray, str]:
    """The block of each pair; with fewer than three blocks, each pair counts as one."""
    blocks = blocks_of([run.record.inputs[name]["real"] for name in names], [times_s.get(name) for name in names])
    if len(np.unique(blocks)) < LEAST_FOR_INTERVAL:
        return np.arange(len(names), dtype=np.int32), "pairs, although neighbours in time"
    return blocks, "blocks of pairs" if len(np.unique(blocks)) < len(names) else "pairs"


def _speeds_m_s(
    run: FinishedRun, times_s: Mapping[str, float], pool: ThreadPoolExecutor, names: Sequence[str]
) -> FloatArray:
    """Speed of the real sensor by pair, NaN if unknown; the last of a stretch has that of the one before."""
    following = follow(times_s, names)

    def speed(name: str) -> float | None:
        later, duration_s = following[name]
        return speed_m_s(read_pair(run, name), read_pair(run, later), duration_s)

    speeds_m_s = dict(zip(following, pool.map(speed, following), strict=True))
    speeds_m_s |= {later: speeds_m_s[name] for name, (later, _) in following.items() if later not in following}
    return np.array([speeds_m_s.get(name) for name in names], dtype=np.float64)


def _cause(
    own: NamedCause,
    gains: Sequence[Shares],
    drawn: Sequence[Drawn],
    excess_m: float | None,
    remark: tuple[str, str] | None,
) -> DiagnosedCause:
    model = own.model
    parts = [pair.by_cause[model.name] for pair in gains if model.name in pair.by_cause]
    gain_m = float(np.mean(parts)) if parts else None
    return DiagnosedCause(
        name=model.name,
        words=f"{own.sentence}, {remark[0]}" if remark else own.sentence,
        estimate=own.mean,
        low=own.low,
        high=own.high,
        unit=model.unit,
        n_pairs=len(own.values),
        gain_m=gain_m,
        gain=None if excess_m is None or gain_m is None else gain_m / excess_m,
        is_upper_bound=model.is_restored,
        setting=remark[1] if remark else model.setting,
        limbs=model.limbs,
        evidence=_evidence(model.curve, drawn) if model.curve else None,
    )


def _evidence(kind: str, drawn: Sequence[Drawn]) -> Evidence:
    """Mean curves over the pairs."""
    axis = AXES[kind]
    mean = {
        name: tuple(np.mean([pair[kind][name] for pair in drawn], axis=0).round(4).tolist()) for name in drawn[0][kind]
    }
    return Evidence(
        x_label=axis["label"],
        y_label=axis["values"],
        x=tuple(((axis["edges"][:-1] + axis["edges"][1:]) / 2).round(4).tolist()),
        **{name: mean.get(name) for name in ("real", "sim", "corrected")},
    )


def _estimate_rows(names: Sequence[str], amounts: Sequence[dict[str, float]]) -> Iterator[CauseEstimate]:
    for model in CAUSES.values():
        values = {name: own[model.name] for name, own in zip(names, amounts, strict=True) if model.name in own}
        if values:
            yield CauseEstimate(
                name=model.name, unit=model.unit, resolution=model.resolution, setting=model.setting, values=values
            )
