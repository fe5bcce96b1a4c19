"""`fidpipe diagnose --tell-apart`: a classifier two-sample test on the pairs of a run, or on two folders of scans."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError, StageError
from ...schemas.settings import Settings
from ...stages.arrays import BoolArray, FloatArray
from ...stages.diagnose.tell_apart import (
    FAMILIES,
    LEAST_PLACES,
    Fold,
    Separation,
    describe_points,
    folds,
    separate,
    simulated_probability,
)
from ...stages.ground import remove_road
from ...stages.sensor_description import describe_sensor
from ...stages.statistics.neighbours import SAME_PLACE, PlaceMap, map_place, overlap
from ..datasets.pairs import scans_of
from ..datasets.readers import read_scan
from ..datasets.readers.scan_ref import ScanRef
from ..jobs.points_job import column
from ..results.finished import FinishedRun

#: Points per side, and frames that they are drawn from at most.
POINTS, MOST_FRAMES = 20_000, 40
_AXES = ["x", "y", "z"]
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


@dataclass(frozen=True)
class TellApart:
    """Real against simulated, and real against real.

    values : for JSON
    points : x, y, z, `is_sim` and the `probability` of being simulated by the surface
    """

    title: str
    values: dict[str, Any]
    points: pd.DataFrame


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
    names = _evenly(run.select())
    real, sim = [draw_sample(partial(_read_stored, run, side), names) for side in SIDES]
    second = None
    if best_case is not None:
        same_pairs = [best_case.row(name)["pair_id"] for name in names]
        second = draw_sample(partial(_read_stored, best_case, "sim"), same_pairs)
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
    samples = []
    for side, source in zip(SIDES, (real, sim), strict=True):
        scans = scans_of(source)
        if not scans:
            raise DatasetError(
                f"{source}: no {side} scans found; expected a folder of scans, or a recording"
            )
        samples.append(draw_sample(partial(_read_clean, settings, side), _evenly(scans)))
    return _compare(f"{real} and {sim}", samples[0], samples[1], None, is_paired=False)


def _compare(
    title: str,
    real: pd.DataFrame,
    sim: pd.DataFrame,
    second: pd.DataFrame | None,
    *,
    is_paired: bool,
) -> TellApart:
    points, splits = _both_sides(real, sim, is_paired=is_paired)
    features = features_of(points)
    families = []
    alone: list[dict[str, Any]] = []
    for family, names in FAMILIES.items():
        if names[0] in features:
            families.append({"name": family, **_values(_separate(points, splits, names))})
            for name in names:
                auc = _separate(points, splits, [name]).auc
                alone.append({"family": family, "name": name, "auc": auc})
    base_of, a, b = _real_samples(real, second, is_paired)
    base = compare_samples(a, b, features, is_paired=is_paired)
    values = _values(_separate(points, splits, features)) | {
        "folds": "places" if points.place.nunique() >= LEAST_PLACES else "sectors",
        "n_folds": len(splits),
        "n_points": min(len(real), len(sim)),
        "real_against_real": _values(base) | {"of": base_of},
        "families": families,
        "features": sorted(alone, key=lambda row: -row["auc"]),
    }
    surface = points[[*FAMILIES["surface"]]].to_numpy()
    points["probability"] = simulated_probability(surface, points.is_sim.to_numpy(), splits)
    return TellApart(title, values, points)


def _values(test: Separation) -> dict[str, Any]:
    return {"auc": test.auc, "low": test.low, "high": test.high}


def _real_samples(
    real: pd.DataFrame, second: pd.DataFrame | None, is_paired: bool
) -> tuple[str, pd.DataFrame, pd.DataFrame]:
    """Two samples of the real side, after their name: the baseline with which real against simulated is compared.

    Paired samples are frames of the same places; their numbers are those of the pairs.
    """
    if second is not None:
        return "second measurements of the best case", real, second
    n_pairs = (int(real.frame.max()) + 1) // 2
    pairable = real[real.frame < 2 * n_pairs]
    if n_pairs and not is_paired:
        is_first = pairable.frame < n_pairs
        return "first and second half of the frames", pairable[is_first], pairable[~is_first]
    if n_pairs and real.place.nunique() <= n_pairs:
        is_even = pairable.frame % 2 == 0
        pairable = pairable.assign(frame=pairable.frame // 2)
        return "even and odd frames", pairable[is_even], pairable[~is_even]
    first = real.sample(frac=0.5, random_state=0)
    return "two random halves of the points, which differ less", first, real.drop(first.index)


def draw_sample(read: Callable[[_Item], Frame], items: Sequence[_Item]) -> pd.DataFrame:
    """Points of a side: x, y, z, frame, place and features; NaN for intensities that a frame lacks.

    A place begins with the first frame that does not show that of the frames before.
    """
    tables = []
    place = -1
    first: PlaceMap | None = None
    has_rays = False
    for i, item in enumerate(items):
        frame = read(item)
        if i == 0:
            has_rays = describe_sensor(frame.own_points).azimuth_step_deg is not None
        n = min(POINTS // len(items), len(frame.points))
        rows = np.sort(np.random.default_rng(i).choice(len(frame.points), n, replace=False))
        ranks = None
        if frame.intensity is not None and np.ptp(frame.intensity) > 0:
            ranks = _ranks(frame.intensity, i)
        features, names = describe_points(
            frame.points,
            frame.height_m,
            rows,
            own_points=frame.own_points if has_rays else None,
            intensity=ranks,
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


def _both_sides(
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
    by_side = points.groupby("is_sim")
    place = by_side.place.rank(method="dense").astype(int) - 1
    n_places = by_side.place.nunique()
    points["place"] = place * n_places.min() // points.is_sim.map(n_places)
    azimuth_deg = np.degrees(np.arctan2(points.y.to_numpy(), points.x.to_numpy()))
    return points, folds(points.place.to_numpy(np.int32), azimuth_deg, points.is_sim.to_numpy())


def compare_samples(
    a: pd.DataFrame, b: pd.DataFrame, features: Sequence[str], *, is_paired: bool = True
) -> Separation:
    """Test two samples by those of the features that both have."""
    points, splits = _both_sides(a, b, is_paired=is_paired)
    common = features_of(points)
    return _separate(points, splits, [name for name in features if name in common])


def features_of(points: pd.DataFrame) -> list[str]:
    """The features that every point has."""
    complete = points.columns[points.notna().all()]
    names: list[str] = []
    for family in FAMILIES.values():
        if family[0] in complete:
            names += family
    return names


def _separate(points: pd.DataFrame, splits: list[Fold], names: Sequence[str]) -> Separation:
    return separate(points[[*names]].to_numpy(), points.is_sim.to_numpy(), splits)


def _read_stored(run: FinishedRun, side: str, name: str) -> Frame:
    ground = run.store.read_table("ground", name, side)
    points = np.column_stack([column(ground, axis) for axis in "xyz"])
    moved = run.store.ledger.jobs(name)["ground", side].metadata["T_real_sim"]
    T = np.array(moved).reshape(3, 4) if moved and side == "sim" else np.eye(3, 4)
    intensity = None if ground.column("intensity").null_count else column(ground, "intensity")
    own_points = (points - T[:, 3]) @ T[:, :3]
    return Frame(
        points, own_points, column(ground, "height_m"), column(ground, "is_ground"), intensity
    )


def _read_clean(settings: Settings, side: str, ref: ScanRef) -> Frame:
    scan = read_scan(ref, settings.input.columns_of(side))
    try:
        clean, cut = remove_road(scan.points, settings, side)
    except StageError as error:
        raise DatasetError(f"{ref}: {error}") from error
    intensity = None if scan.intensity is None else scan.intensity[clean.point_ids]
    return Frame(clean.points, clean.points, cut.height_m, cut.is_ground, intensity)


def _evenly(items: Sequence[_Item]) -> Sequence[_Item]:
    """At most `MOST_FRAMES`: neighbours in twos, evenly over all."""
    if len(items) <= MOST_FRAMES:
        return items
    n = MOST_FRAMES // 2
    chosen: list[_Item] = []
    for i in range(n):
        chosen += items[i * len(items) // n :][:2]
    return chosen
