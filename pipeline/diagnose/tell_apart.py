"""`fidpipe diagnose --tell-apart`: a classifier two-sample test on the pairs of a run, or on two folders of scans."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TypeVar, cast

import numpy as np
from pydantic import JsonValue

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError, StageError
from ...schemas.results import JsonObject
from ...schemas.settings import Settings
from ...stages.arrays import BoolArray, FloatArray, IndexArray, IntArray
from ...stages.clean import as_ros
from ...stages.diagnose.tell_apart import FAMILIES, LEAST_PLACES, Separation, auc_of, describe_points, separate
from ...stages.inspect.sensor_description import describe_sensor
from ...stages.method import remove_road
from ...stages.statistics.comparison import blocks_of
from ...stages.statistics.findings import BAND_EDGES_M
from ...stages.statistics.neighbours import neighbours
from ..datasets.readers import frames_of, holds_frames, read_scan
from ..datasets.readers.scan import Scan
from ..datasets.sequences import scans_in
from ..jobs.points_job import column
from ..results.finished import FinishedRun

#: Points per side, and frames that they are drawn from at most.
POINTS, MOST_FRAMES = 20_000, 40
_ROAD_M = 0.3
_Item = TypeVar("_Item")


@dataclass(frozen=True)
class Frame:
    """Clean points of a scan, with the road.

    points : (n, 3) float64, metres, in the frame in which both sides are compared
    own_points : (n, 3) float64, the same in the sensor's own frame
    height_m : (n,) float64, above the road
    intensity : (n,) float64, or None
    """

    points: FloatArray
    own_points: FloatArray
    height_m: FloatArray
    is_ground: BoolArray
    intensity: FloatArray | None


#: Reads a frame.
Source = Callable[[], Frame]


@dataclass(frozen=True)
class Sample:
    """Points drawn from the frames of a side.

    points : (n, 3) float64, metres
    height_m : (n,) float64, above the road
    frame : (n,) int32, number of the frame
    features, names : as `describe_points` returns them
    """

    points: FloatArray
    height_m: FloatArray
    frame: IntArray
    features: FloatArray
    names: tuple[str, ...]


@dataclass(frozen=True)
class TellApart:
    """Real against simulated, and real against real.

    title : what was compared
    test : real against simulated, by all features
    base, base_of : real against real, by all features, and which real points these are
    families : real against simulated by the features of each family alone
    where : on and above the road, and by range: AUC of the points there by the surface, None for too few
    maps : points, and their probability of being simulated by the surface, of the real and the simulated side
    notes : cautions
    """

    title: str
    n_points: int
    test: Separation
    base: Separation
    base_of: str
    families: dict[str, Separation]
    where: dict[str, float | None]
    maps: tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
    notes: tuple[str, ...] = ()

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON."""
        families = [{"name": name, **_summary(one), "features": _rows(one)} for name, one in self.families.items()]
        return {
            **_summary(self.test),
            "folds": "places" if self.test.by_place else "sectors",
            "n_folds": len(self.test.by_fold),
            "n_points": self.n_points,
            "real_against_real": {**_summary(self.base), "of": self.base_of},
            "families": cast(JsonValue, families),
            "where": [{"name": name, "auc": auc} for name, auc in self.where.items()],
            "notes": [*self.notes],
        }


def _summary(test: Separation) -> dict[str, float]:
    return {"auc": test.auc, "low": test.low, "high": test.high}


def _rows(test: Separation) -> list[dict[str, str | float]]:
    return [{"name": name, "auc_alone": auc, "loss": test.loss[name]} for name, auc in test.alone.items()]


def tell_apart_run(run: FinishedRun, floor: FinishedRun | None = None) -> TellApart:
    """Test the pairs of a run.

    Parameters
    ----------
    floor : a run of `fidpipe floor` on the same real scans; its second measurements stand for the real sensor

    Raises
    ------
    FidpipeError
        No pair is scored, a table is damaged, or the floor lacks a pair.
    """
    chosen = _evenly(run.select())
    sides = [[partial(_read_stored, run, name, side) for name in chosen] for side in SIDES]
    second = [partial(_read_stored, floor, name, "sim") for name in chosen] if floor else []
    steps = [run.read_table("sensor", chosen[0], side).column("azimuth_step_deg").null_count for side in SIDES]
    return _compare(str(run.folder), sides[0], sides[1], second, has_rays=not any(steps), is_paired=True)


def tell_apart_folders(real: Path, sim: Path, settings: Settings) -> TellApart:
    """Test two folders of scans, or two recordings, that need no pairs.

    Parameters
    ----------
    settings : of input and ground

    Raises
    ------
    FidpipeError
        A side has no scans, or one cannot be read or has too few points.
    """
    sides, steps = [], []
    for side, source in zip(SIDES, (real, sim), strict=True):
        paths = frames_of(source) if holds_frames(source) else scans_in(source) if source.is_dir() else []
        if not paths:
            raise DatasetError(f"{source}: no {side} scans found; expected a folder of scans, or a recording")
        sides.append([partial(_read_clean, path, side, settings) for path in _evenly(paths)])
        own_axes = as_ros(_read(paths[0], side, settings).points, settings.input.frame_of(side))
        steps.append(describe_sensor(own_axes).azimuth_step_deg)
    return _compare(f"{real} and {sim}", sides[0], sides[1], [], has_rays=None not in steps, is_paired=False)


def _compare(
    title: str,
    real: Sequence[Source],
    sim: Sequence[Source],
    second: Sequence[Source],
    *,
    has_rays: bool,
    is_paired: bool,
) -> TellApart:
    first = [side[0]().intensity for side in (real, sim)]
    has_intensity = all(one is not None and np.ptp(one) > 0 for one in first)
    draw = partial(draw_sample, has_rays=has_rays, has_intensity=has_intensity)
    (a, place_a), (b, place_b) = draw(real), draw(sim)
    place_b = place_a if is_paired else place_b
    test = compare_samples(a, b, place_a, place_b)
    families = {
        name: compare_samples(a, b, place_a, place_b, family=name)
        for name, own in FAMILIES.items()
        if not set(own).isdisjoint(a.names)
    }
    by_surface = families["surface"]
    notes = []
    if not is_paired:
        notes.append("the two folders may show different places; so do the two halves of the real frames")
    if not test.by_place:
        notes.append(f"fewer than {LEAST_PLACES} places, hence cross-validated by sectors: other places are not tested")
    half = len(real) // 2
    first_rows, other_rows = np.arange(half), np.arange(half, 2 * half)
    if is_paired:
        first_rows, other_rows = 2 * first_rows, 2 * first_rows + 1
    if second:
        base_of = "second measurements of the floor"
        base = compare_samples(a, draw(second)[0], place_a, place_a)
    elif half and (not is_paired or (place_a[first_rows] == place_a[other_rows]).all()):
        base_of = "even and odd frames" if is_paired else "first and second half of the frames"
        c, d = (_of_frames(a, rows) for rows in (first_rows, other_rows))
        base = compare_samples(c, d, place_a[first_rows], place_a[other_rows])
    else:
        base_of = "two random halves of the points of each frame"
        notes.append("no second real frame of the same place: random halves of one frame differ less than two frames")
        c, d = (draw([partial(_half, source, i, k) for i, source in enumerate(real)])[0] for k in (0, 1))
        base = compare_samples(c, d, place_a, place_a)
    is_sim = np.repeat([False, True], [len(a.frame), len(b.frame)])
    where = dict(_where(np.vstack([a.points, b.points]), np.concatenate([a.height_m, b.height_m]), is_sim, by_surface))
    maps = (a.points, by_surface.probability[~is_sim]), (b.points, by_surface.probability[is_sim])
    return TellApart(title, min(len(a.frame), len(b.frame)), test, base, base_of, families, where, maps, tuple(notes))


def draw_sample(sources: Sequence[Source], *, has_rays: bool, has_intensity: bool) -> tuple[Sample, IntArray]:
    """Points of a side, and the place of each frame."""
    drawn, objects = [], []
    for i, source in enumerate(sources):
        own = source()
        n = min(POINTS // len(sources), len(own.points))
        rows = np.sort(np.random.default_rng(i).choice(len(own.points), n, replace=False))
        features, names = describe_points(
            own.points,
            own.height_m,
            rows,
            own_points=own.own_points if has_rays else None,
            intensity=_ranks(own.intensity, i) if has_intensity else None,
        )
        drawn.append((own.points[rows], own.height_m[rows], np.full(n, i, dtype=np.int32), features))
        objects.append(own.points[~own.is_ground])
    place = blocks_of([str(i) for i in range(len(sources))], [None] * len(sources), neighbours(objects))
    points, height_m, frame, features = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
    return Sample(points, height_m, frame, features, names), place


def _ranks(intensity: FloatArray | None, seed: int) -> FloatArray | None:
    """Ranks from 0 to 1: scales differ. Equal values in random order, as their common rank would mark the frame."""
    if intensity is None:
        return None
    order = np.lexsort((np.random.default_rng(seed).random(len(intensity)), intensity))
    ranks = np.empty(len(order))
    ranks[order] = np.linspace(0, 1, len(order))
    return ranks


def compare_samples(a: Sample, b: Sample, place_a: IntArray, place_b: IntArray, family: str = "") -> Separation:
    """Places of the two sides are brought together by their order; all features, or those of a family."""
    ranks = [np.unique(place, return_inverse=True)[1] for place in (place_a, place_b)]
    n = min(rank.max() + 1 for rank in ranks)
    place = [(rank * n // (rank.max() + 1))[own.frame] for rank, own in zip(ranks, (a, b), strict=True)]
    points = np.vstack([a.points, b.points])
    columns = np.flatnonzero([not family or name in FAMILIES[family] for name in a.names])
    return separate(
        np.vstack([a.features, b.features])[:, columns],
        [a.names[i] for i in columns],
        np.repeat([False, True], [len(a.frame), len(b.frame)]),
        np.concatenate(place),
        np.degrees(np.arctan2(points[:, 1], points[:, 0])),
        by_feature=family != "",
    )


def _of_frames(sample: Sample, frames: IndexArray) -> Sample:
    """The points of some frames, which are numbered from 0 on."""
    is_in = np.isin(sample.frame, frames)
    number = np.searchsorted(frames, sample.frame[is_in]).astype(np.int32)
    return Sample(sample.points[is_in], sample.height_m[is_in], number, sample.features[is_in], sample.names)


def _where(
    points: FloatArray, height_m: FloatArray, is_sim: BoolArray, test: Separation
) -> Iterator[tuple[str, float | None]]:
    range_m = np.linalg.norm(points, axis=1)
    groups = {"road": np.abs(height_m) < _ROAD_M, "above the road": height_m >= _ROAD_M}
    for low, high in pairwise((*BAND_EDGES_M, np.inf)):
        groups[f"{low:g} to {high:g} m" if high < np.inf else f"over {low:g} m"] = (range_m >= low) & (range_m < high)
    for name, is_in in groups.items():
        rows = is_in & ~np.isnan(test.probability)
        yield name, auc_of(is_sim[rows], test.probability[rows])


def _read_stored(run: FinishedRun, name: str, side: str) -> Frame:
    ground = run.read_table("ground", name, side)
    points = np.column_stack([column(ground, axis) for axis in "xyz"])
    moved = run.store.ledger.jobs(name)["ground", side].metadata["T_real_sim"]
    T = np.array(moved).reshape(3, 4) if moved and side == "sim" else np.eye(3, 4)
    intensity = ground.column("intensity")
    return Frame(
        points,
        (points - T[:, 3]) @ T[:, :3],
        column(ground, "height_m"),
        ground.column("is_ground").to_numpy(),
        None if intensity.null_count else intensity.to_numpy(),
    )


def _read(path: Path, side: str, settings: Settings) -> Scan:
    return read_scan(path, settings.input.columns_of(side))


def _read_clean(path: Path, side: str, settings: Settings) -> Frame:
    scan = _read(path, side, settings)
    try:
        clean, cut = remove_road(scan.points, settings, side)
    except StageError as error:
        raise DatasetError(f"{path}: {error}") from error
    intensity = None if scan.intensity is None else scan.intensity[clean.point_ids]
    return Frame(clean.points, clean.points, cut.height_m, cut.is_ground, intensity)


def _half(source: Source, seed: int, which: int) -> Frame:
    """One of two random halves of the points of a frame."""
    own = source()
    is_in = np.random.default_rng(seed).integers(2, size=len(own.points)) == which
    intensity = None if own.intensity is None else own.intensity[is_in]
    return Frame(own.points[is_in], own.own_points[is_in], own.height_m[is_in], own.is_ground[is_in], intensity)


def _evenly(items: Sequence[_Item]) -> list[_Item]:
    """At most `MOST_FRAMES`, evenly over all."""
    n = min(len(items), MOST_FRAMES)
    return [items[i * len(items) // n] for i in range(n)]
