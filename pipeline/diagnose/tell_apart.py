"""`fidpipe diagnose --tell-apart`: a classifier two-sample test on the pairs of a run, or on two folders of scans."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import JsonValue

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError, StageError
from ...schemas.results import JsonObject
from ...schemas.settings import Settings
from ...stages.arrays import BoolArray, FloatArray, IndexArray, IntArray
from ...stages.diagnose.tell_apart import FAMILIES, LEAST_PLACES, Separation, auc_of, describe_points, separate
from ...stages.method import remove_road
from ...stages.sensor_description import describe_sensor
from ...stages.statistics.findings import BAND_EDGES_M
from ...stages.statistics.neighbours import SAME_PLACE, PlaceMap, map_place, overlap
from ..datasets.pairs import scans_of
from ..datasets.readers import read_scan
from ..datasets.readers.scan_ref import ScanRef
from ..jobs.points_job import column
from ..results.finished import FinishedRun

#: Points per side, and frames that they are drawn from at most.
POINTS, MOST_FRAMES = 20_000, 40
_ROAD_M = 0.3


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
    place : (n,) int32, number of the place that the frame shows, in the order of the frames
    features, names : as `describe_points` returns them
    """

    points: FloatArray
    height_m: FloatArray
    frame: IntArray
    place: IntArray
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
        families: list[JsonValue] = []
        for name, test in self.families.items():
            features: list[JsonValue] = []
            for feature, auc in test.alone.items():
                features.append({"name": feature, "auc_alone": auc, "loss": test.loss[feature]})
            families.append(_summary(test) | {"name": name, "features": features})
        return _summary(self.test) | {
            "folds": "places" if self.test.by_place else "sectors",
            "n_folds": len(self.test.by_fold),
            "n_points": self.n_points,
            "real_against_real": _summary(self.base) | {"of": self.base_of},
            "families": families,
            "where": [{"name": name, "auc": auc} for name, auc in self.where.items()],
            "notes": [*self.notes],
        }


def _summary(test: Separation) -> JsonObject:
    return {"auc": test.auc, "low": test.low, "high": test.high}


def tell_apart_run(run: FinishedRun, best_case: FinishedRun | None = None, pattern: str | None = None) -> TellApart:
    """Test the pairs of a run.

    Parameters
    ----------
    best_case : a run of `fidpipe best-case` on the same real scans; its second measurements stand for the real sensor
    pattern : only pairs whose name matches (shell style)

    Raises
    ------
    FidpipeError
        No pair is scored, a table is damaged, or the best case lacks a pair.
    """
    chosen = _evenly(run.select(pattern))
    real = [partial(_read_stored, run, name, "real") for name in chosen]
    sim = [partial(_read_stored, run, name, "sim") for name in chosen]
    second = []
    if best_case is not None:
        second = [partial(_read_stored, best_case, best_case.row(name)["pair_id"], "sim") for name in chosen]
    return _compare(str(run.folder), real, sim, second, is_paired=True)


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
    sides = []
    for side, source in zip(SIDES, (real, sim), strict=True):
        scans = scans_of(source)
        if not scans:
            raise DatasetError(f"{source}: no {side} scans found; expected a folder of scans, or a recording")
        sides.append([partial(_read_clean, scan, side, settings) for scan in _evenly(scans)])
    return _compare(f"{real} and {sim}", sides[0], sides[1], [], is_paired=False)


def _compare(
    title: str, real: Sequence[Source], sim: Sequence[Source], second: Sequence[Source], *, is_paired: bool
) -> TellApart:
    first = [side[0]() for side in (real, sim)]
    has_rays = all(describe_sensor(own.own_points).azimuth_step_deg is not None for own in first)
    has_intensity = all(own.intensity is not None and np.ptp(own.intensity) > 0 for own in first)
    draw = partial(draw_sample, has_rays=has_rays, has_intensity=has_intensity)
    a, b = draw(real), draw(sim)
    test = compare_samples(a, b, is_paired=is_paired)
    known = [name for name, own in FAMILIES.items() if not set(own).isdisjoint(a.names)]
    families = {name: compare_samples(a, b, name, is_paired=is_paired) for name in known}
    notes = []
    if not is_paired:
        notes.append("the two folders may show different places; so do the two halves of the real frames")
    if not test.by_place:
        notes.append(f"fewer than {LEAST_PLACES} places, hence cross-validated by sectors: other places are not tested")
    frames = np.arange(len(real))
    half = len(real) // 2
    if second:
        base_of = "second measurements of the best case"
        c, d = a, draw(second)
    elif half and is_paired and len(np.unique(a.place)) <= half:
        base_of = "even and odd frames"
        c, d = _of_frames(a, frames[: 2 * half : 2]), _of_frames(a, frames[1::2])
    elif half and not is_paired:
        base_of = "first and second half of the frames"
        c, d = _of_frames(a, frames[:half]), _of_frames(a, frames[half : 2 * half])
    else:
        base_of = "two random halves of the points of each frame"
        notes.append("no second real frame of the same place: random halves of one frame differ less than two frames")
        c = draw([partial(_half, source, i, 0) for i, source in enumerate(real)])
        d = draw([partial(_half, source, i, 1) for i, source in enumerate(real)])
    base = compare_samples(c, d, is_paired=is_paired)
    n_points = min(len(a.frame), len(b.frame))
    by_surface = families["surface"]
    is_sim = np.repeat([False, True], [len(a.frame), len(b.frame)])
    maps = (a.points, by_surface.probability[~is_sim]), (b.points, by_surface.probability[is_sim])
    where = dict(_where(a, b, is_sim, by_surface.probability))
    return TellApart(title, n_points, test, base, base_of, families, where, maps, tuple(notes))


def draw_sample(sources: Sequence[Source], *, has_rays: bool, has_intensity: bool) -> Sample:
    """Points of a side. A place begins with the first frame that does not show that of the frames before."""
    drawn = []
    place = -1
    first: PlaceMap | None = None
    for i, source in enumerate(sources):
        own = source()
        n = min(POINTS // len(sources), len(own.points))
        rows = np.sort(np.random.default_rng(i).choice(len(own.points), n, replace=False))
        rays = own.own_points if has_rays else None
        ranks = _ranks(own.intensity, i) if has_intensity and own.intensity is not None else None
        features, names = describe_points(own.points, own.height_m, rows, own_points=rays, intensity=ranks)
        seen = map_place(own.points[~own.is_ground])
        if first is None or overlap(first, seen) < SAME_PLACE:
            first = seen
            place += 1
        drawn.append((own.points[rows], own.height_m[rows], np.full(n, i), np.full(n, place), features))
    points, height_m, frame, places, features = map(np.concatenate, zip(*drawn, strict=True))
    return Sample(points, height_m, frame.astype(np.int32), places.astype(np.int32), features, names)


def _ranks(intensity: FloatArray, seed: int) -> FloatArray:
    """Ranks from 0 to 1: scales differ. Equal values in random order, as their common rank would mark the frame."""
    order = np.lexsort((np.random.default_rng(seed).random(len(intensity)), intensity))
    ranks = np.empty(len(order))
    ranks[order] = np.linspace(0, 1, len(order))
    return ranks


def compare_samples(a: Sample, b: Sample, family: str = "", *, is_paired: bool = True) -> Separation:
    """Test two samples by all features, or by those of a family.

    Parameters
    ----------
    is_paired : frames of one number show the same place; else places are brought together by their order
    """
    place = [a.place, b.place]
    if is_paired:
        first = np.unique(a.frame, return_index=True)[1]
        place[1] = a.place[first][b.frame]
    n = min(int(own.max()) + 1 for own in place)
    place = [own * n // (own.max() + 1) for own in place]
    columns = np.flatnonzero([not family or name in FAMILIES[family] for name in a.names])
    x, y, _ = np.vstack([a.points, b.points]).T
    return separate(
        np.vstack([a.features, b.features])[:, columns],
        [a.names[i] for i in columns],
        np.repeat([False, True], [len(a.frame), len(b.frame)]),
        np.concatenate(place),
        np.degrees(np.arctan2(y, x)),
        by_feature=family != "",
    )


def _of_frames(sample: Sample, frames: IndexArray) -> Sample:
    """The points of some frames, which are numbered from 0 on, as are their places."""
    own = np.isin(sample.frame, frames)
    number = np.searchsorted(frames, sample.frame[own]).astype(np.int32)
    place = np.unique(sample.place[own], return_inverse=True)[1].astype(np.int32)
    return Sample(sample.points[own], sample.height_m[own], number, place, sample.features[own], sample.names)


def _where(a: Sample, b: Sample, is_sim: BoolArray, probability: FloatArray) -> Iterator[tuple[str, float | None]]:
    range_m = np.linalg.norm(np.vstack([a.points, b.points]), axis=1)
    height_m = np.concatenate([a.height_m, b.height_m])
    groups = {"road": np.abs(height_m) < _ROAD_M, "above the road": height_m >= _ROAD_M}
    for low, high in pairwise((*BAND_EDGES_M, np.inf)):
        groups[f"{low:g} to {high:g} m" if high < np.inf else f"over {low:g} m"] = (range_m >= low) & (range_m < high)
    for name, is_in in groups.items():
        rows = is_in & ~np.isnan(probability)
        yield name, auc_of(is_sim[rows], probability[rows])


def _read_stored(run: FinishedRun, name: str, side: str) -> Frame:
    ground = run.read_table("ground", name, side)
    points = np.column_stack([column(ground, axis) for axis in "xyz"])
    moved = run.store.ledger.jobs(name)["ground", side].metadata["T_real_sim"]
    T = np.array(moved).reshape(3, 4) if moved and side == "sim" else np.eye(3, 4)
    intensity = None if ground.column("intensity").null_count else column(ground, "intensity")
    own_points = (points - T[:, 3]) @ T[:, :3]
    return Frame(points, own_points, column(ground, "height_m"), column(ground, "is_ground"), intensity)


def _read_clean(ref: ScanRef, side: str, settings: Settings) -> Frame:
    scan = read_scan(ref, settings.input.columns_of(side))
    try:
        clean, cut = remove_road(scan.points, settings, side)
    except StageError as error:
        raise DatasetError(f"{ref}: {error}") from error
    intensity = None if scan.intensity is None else scan.intensity[clean.point_ids]
    return Frame(clean.points, clean.points, cut.height_m, cut.is_ground, intensity)


def _half(source: Source, seed: int, which: int) -> Frame:
    """One of two random halves of the points of a frame."""
    own = source()
    is_in = np.random.default_rng(seed).integers(2, size=len(own.points)) == which
    half: dict[str, Any] = {name: values if values is None else values[is_in] for name, values in vars(own).items()}
    return Frame(**half)


def _evenly(items: Sequence[Any]) -> Sequence[Any]:
    """At most `MOST_FRAMES`: neighbours in twos, evenly over all."""
    if len(items) <= MOST_FRAMES:
        return items
    n = MOST_FRAMES // 2
    return [item for i in range(n) for item in items[i * len(items) // n :][:2]]
