"""`fidpipe diagnose --tell-apart`: a classifier two-sample test on the pairs of a run, or on two folders of scans."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError, StageError
from ...schemas.settings import Settings
from ...stages.arrays import BoolArray, FloatArray, IndexArray
from ...stages.diagnose.tell_apart import (
    FAMILIES,
    HEIGHT,
    LEAST_PLACES,
    Fold,
    Separation,
    auc_of,
    describe_points,
    separate,
    simulated_probability,
    usable_folds,
)
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
_RANDOM_HALVES = "two random halves of the points"
_AXES = ["x", "y", "z"]


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
class TellApart:
    """Real against simulated, and real against real.

    title : what was compared
    test : real against simulated, by all features
    base, base_of : real against real, by all features, and which real points these are
    families : real against simulated by the features of each family alone
    features : by family and feature, the AUC of a classifier that has no other, largest first
    where : on and above the road, and by range: AUC of the points there by the surface, None for too few
    points : x, y, z, `is_sim` and the `probability` of being simulated by the surface
    notes : cautions
    """

    title: str
    n_points: int
    test: Separation
    base: Separation
    base_of: str
    families: dict[str, Separation]
    features: dict[tuple[str, str], float]
    where: dict[str, float | None]
    points: pd.DataFrame
    by_place: bool
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        features = [
            {"family": names[0], "name": names[1], "auc": auc}
            for names, auc in self.features.items()
        ]
        return _summary(self.test) | {
            "folds": "places" if self.by_place else "sectors",
            "n_folds": len(self.test.by_fold),
            "n_points": self.n_points,
            "real_against_real": _summary(self.base) | {"of": self.base_of},
            "families": [_summary(test) | {"name": name} for name, test in self.families.items()],
            "features": features,
            "where": [{"name": name, "auc": auc} for name, auc in self.where.items()],
            "notes": [*self.notes],
        }


def _summary(test: Separation) -> dict[str, Any]:
    return {"auc": test.auc, "low": test.low, "high": test.high}


def tell_apart_run(run: FinishedRun, best_case: FinishedRun | None = None) -> TellApart:
    """Test the pairs of a run.

    Parameters
    ----------
    best_case : a run of `fidpipe best-case` on the same real scans; its second measurements stand for the real sensor

    Raises
    ------
    FidpipeError
        No pair is scored, a table is damaged, or the best case lacks a pair.
    """
    chosen = _evenly(run.select())
    real = [partial(_read_stored, run, name, "real") for name in chosen]
    sim = [partial(_read_stored, run, name, "sim") for name in chosen]
    second = []
    if best_case is not None:
        second = [
            partial(_read_stored, best_case, best_case.row(name)["pair_id"], "sim")
            for name in chosen
        ]
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
            raise DatasetError(
                f"{source}: no {side} scans found; expected a folder of scans, or a recording"
            )
        sides.append([partial(_read_clean, scan, side, settings) for scan in _evenly(scans)])
    return _compare(f"{real} and {sim}", sides[0], sides[1], [], is_paired=False)


def _compare(
    title: str,
    real: Sequence[Source],
    sim: Sequence[Source],
    second: Sequence[Source],
    *,
    is_paired: bool,
) -> TellApart:
    draw = _sampler(real[0](), sim[0]())
    real_points = draw(real)
    sim_points = draw(sim)
    points, splits = both_sides(real_points, sim_points, is_paired=is_paired)
    base, base_of = _base_samples(real_points, draw(second) if second else None, is_paired)
    families = {}
    features = {}
    for family, names in FAMILIES.items():
        if names[0] in points:
            families[family] = _separate(points, splits, names)
            for name in names:
                features[family, name] = _separate(points, splits, [name]).auc
    points["probability"] = simulated_probability(
        points[[*FAMILIES["surface"]]].to_numpy(), points.is_sim.to_numpy(), splits
    )
    by_place = points.place.nunique() >= LEAST_PLACES
    return TellApart(
        title=title,
        n_points=min(len(real_points), len(sim_points)),
        test=_separate(points, splits, _features_of(points)),
        base=compare_samples(*base, is_paired=is_paired),
        base_of=base_of,
        families=families,
        features=dict(sorted(features.items(), key=lambda item: -item[1])),
        where=_where(points),
        points=points,
        by_place=by_place,
        notes=_notes(base_of, is_paired=is_paired, by_place=by_place),
    )


def _sampler(real: Frame, sim: Frame) -> Callable[[Sequence[Source]], pd.DataFrame]:
    """Draws a sample of frames with the features that both sides have, as the first frames show."""
    frames = (real, sim)
    return partial(
        draw_sample,
        has_rays=all(describe_sensor(f.own_points).azimuth_step_deg is not None for f in frames),
        has_intensity=all(f.intensity is not None and np.ptp(f.intensity) > 0 for f in frames),
    )


def _notes(base_of: str, *, is_paired: bool, by_place: bool) -> tuple[str, ...]:
    notes = []
    if not is_paired:
        notes.append(
            "the two folders may show different places; so do the two halves of the real frames"
        )
    if not by_place:
        notes.append(
            f"fewer than {LEAST_PLACES} places, hence cross-validated by sectors: other places are "
            "not tested"
        )
    if base_of == _RANDOM_HALVES:
        notes.append(
            "no second real frame of the same place: random halves of one frame differ less than "
            "two frames"
        )
    return tuple(notes)


def _base_samples(
    real: pd.DataFrame, second: pd.DataFrame | None, is_paired: bool
) -> tuple[tuple[pd.DataFrame, pd.DataFrame], str]:
    """Two samples of the real side, which a classifier should hardly tell apart, and what they are."""
    if second is not None:
        return (real, second), "second measurements of the best case"
    half = (int(real.frame.max()) + 1) // 2
    frames = np.arange(2 * half)
    if half and is_paired and real.place.nunique() <= half:
        return (
            _of_frames(real, frames[::2]),
            _of_frames(real, frames[1::2]),
        ), "even and odd frames"
    if half and not is_paired:
        halves = _of_frames(real, frames[:half]), _of_frames(real, frames[half:])
        return halves, "first and second half of the frames"
    some = real.sample(frac=0.5, random_state=0)
    return (some, real.drop(some.index)), _RANDOM_HALVES


def draw_sample(sources: Sequence[Source], *, has_rays: bool, has_intensity: bool) -> pd.DataFrame:
    """Points of a side: x, y, z, frame, place and features.

    A place begins with the first frame that does not show that of the frames before.
    """
    tables = []
    place = -1
    first: PlaceMap | None = None
    for i, source in enumerate(sources):
        frame = source()
        n = min(POINTS // len(sources), len(frame.points))
        rows = np.sort(np.random.default_rng(i).choice(len(frame.points), n, replace=False))
        rays = frame.own_points if has_rays else None
        ranks = (
            _ranks(frame.intensity, i) if has_intensity and frame.intensity is not None else None
        )
        features, names = describe_points(
            frame.points, frame.height_m, rows, own_points=rays, intensity=ranks
        )
        seen = map_place(frame.points[~frame.is_ground])
        if first is None or overlap(first, seen) < SAME_PLACE:
            first = seen
            place += 1
        table = pd.DataFrame(features, columns=[*names])
        table[_AXES] = frame.points[rows]
        tables.append(table.assign(frame=i, place=place))
    return pd.concat(tables, ignore_index=True)


def _ranks(intensity: FloatArray, seed: int) -> FloatArray:
    """Ranks up to 1: scales differ. Equal values in random order, as their common rank would mark the frame."""
    shuffled = pd.Series(intensity).sample(frac=1.0, random_state=seed)
    return np.asarray(shuffled.rank(method="first", pct=True).sort_index(), dtype=np.float64)


def both_sides(
    a: pd.DataFrame, b: pd.DataFrame, *, is_paired: bool
) -> tuple[pd.DataFrame, list[Fold]]:
    """The points of two samples with a column `is_sim`, and the folds of a test.

    Parameters
    ----------
    is_paired : frames of one number show the same place; else places are brought together by their order
    """
    if is_paired:
        b = b.assign(place=b.frame.map(a.groupby("frame").place.first()))
    points = pd.concat([a.assign(is_sim=False), b.assign(is_sim=True)], ignore_index=True)
    n_places = points.groupby("is_sim").place.max() + 1
    points["place"] = points.place * n_places.min() // points.is_sim.map(n_places)
    azimuth_deg = np.degrees(np.arctan2(points.y.to_numpy(), points.x.to_numpy()))
    return points, usable_folds(
        points.place.to_numpy(np.int32), azimuth_deg, points.is_sim.to_numpy()
    )


def compare_samples(
    a: pd.DataFrame, b: pd.DataFrame, family: str = "", *, is_paired: bool = True
) -> Separation:
    """Test two samples by all features, or by those of a family."""
    points, splits = both_sides(a, b, is_paired=is_paired)
    return _separate(points, splits, FAMILIES[family] if family else _features_of(points))


def _features_of(points: pd.DataFrame) -> list[str]:
    return [name for names in FAMILIES.values() if names[0] in points for name in names]


def _separate(points: pd.DataFrame, splits: list[Fold], names: Sequence[str]) -> Separation:
    return separate(points[[*names]].to_numpy(), points.is_sim.to_numpy(), splits)


def _of_frames(sample: pd.DataFrame, frames: IndexArray) -> pd.DataFrame:
    """The points of some frames, which are numbered from 0 on, as are their places."""
    chosen = sample[sample.frame.isin(frames)]
    return chosen.assign(frame=pd.factorize(chosen.frame)[0], place=pd.factorize(chosen.place)[0])


def _where(points: pd.DataFrame) -> dict[str, float | None]:
    """AUC of the points on and above the road, and by range."""
    range_m = np.linalg.norm(points[_AXES], axis=1)
    groups: dict[str, Any] = {
        "road": points[HEIGHT].abs() < _ROAD_M,
        "above the road": points[HEIGHT] >= _ROAD_M,
    }
    for low, high in pairwise((*BAND_EDGES_M, np.inf)):
        name = f"{low:g} to {high:g} m" if high < np.inf else f"over {low:g} m"
        groups[name] = (range_m >= low) & (range_m < high)
    where = {}
    for name, is_in in groups.items():
        chosen = points[is_in & points.probability.notna()]
        where[name] = auc_of(chosen.is_sim.to_numpy(), chosen.probability.to_numpy())
    return where


def _read_stored(run: FinishedRun, name: str, side: str) -> Frame:
    ground = run.store.read_table("ground", name, side)
    points = np.column_stack([column(ground, axis) for axis in "xyz"])
    moved = run.store.ledger.jobs(name)["ground", side].metadata["T_real_sim"]
    T = np.array(moved).reshape(3, 4) if moved and side == "sim" else np.eye(3, 4)
    intensity = None if ground.column("intensity").null_count else column(ground, "intensity")
    own_points = (points - T[:, 3]) @ T[:, :3]
    return Frame(
        points, own_points, column(ground, "height_m"), column(ground, "is_ground"), intensity
    )


def _read_clean(ref: ScanRef, side: str, settings: Settings) -> Frame:
    scan = read_scan(ref, settings.input.columns_of(side))
    try:
        clean, cut = remove_road(scan.points, settings, side)
    except StageError as error:
        raise DatasetError(f"{ref}: {error}") from error
    intensity = None if scan.intensity is None else scan.intensity[clean.point_ids]
    return Frame(clean.points, clean.points, cut.height_m, cut.is_ground, intensity)


def _evenly(items: Sequence[Any]) -> Sequence[Any]:
    """At most `MOST_FRAMES`: neighbours in twos, evenly over all."""
    if len(items) <= MOST_FRAMES:
        return items
    n = MOST_FRAMES // 2
    return [item for i in range(n) for item in items[i * len(items) // n :][:2]]
