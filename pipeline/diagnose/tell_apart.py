"""`fidpipe diagnose --tell-apart`: a classifier two-sample test on the pairs of a run, or on two folders of scans.

A scan is its table `ground`, and the motion from the frame of its sensor into that of the table, None if they are one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
import pyarrow as pa

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError, StageError
from ...schemas.settings import Settings
from ...stages.arrays import FloatArray, transform_of
from ...stages.diagnose.tell_apart import (
    FAMILIES,
    LEAST_PLACES,
    Fold,
    Separation,
    describe_points,
    folds,
    separate,
)
from ...stages.sensor_description import describe_sensor
from ...stages.statistics.neighbours import SAME_PLACE, PlaceMap, map_place, overlap
from ..datasets.pairs import scans_of
from ..datasets.readers import read_scan
from ..datasets.readers.scan_ref import ScanRef
from ..engine.worker import run_in_memory
from ..jobs import ground_job
from ..jobs.points_job import column, coordinates
from ..results.finished import FinishedRun

#: Points per side, and frames that they are drawn from at most.
POINTS, MOST_FRAMES = 20_000, 40
GroundTables = Iterable[tuple[pa.Table, FloatArray | None]]
_Item = TypeVar("_Item")


def tell_apart_run(run: FinishedRun) -> dict[str, Any]:
    """Test the pairs of a run: real against simulated, and real against real, for JSON.

    Raises
    ------
    FidpipeError
        No pair is scored, or a table is damaged.
    """
    names = _evenly(run.select())
    real, sim = [draw_sample(_stored_scans(run, side, names), len(names)) for side in SIDES]
    return _compare(real, sim, is_paired=True)


def tell_apart_folders(real: Path, sim: Path, settings: Settings) -> dict[str, Any]:
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
        chosen = _evenly(scans)
        samples.append(draw_sample(_read_scans(settings, side, chosen), len(chosen)))
    return _compare(samples[0], samples[1], is_paired=False)


def _stored_scans(run: FinishedRun, side: str, names: Sequence[str]) -> GroundTables:
    for name in names:
        metadata = run.store.ledger.jobs(name)["ground", side].metadata
        ground = run.store.read_table("ground", name, side)
        yield ground, transform_of(metadata["T_real_sim"])


def _read_scans(settings: Settings, side: str, scans: Sequence[ScanRef]) -> GroundTables:
    for ref in scans:
        scan = read_scan(ref, settings.input.columns_of(side))
        try:
            tables, _ = run_in_memory([ground_job.STAGE], settings, scans={side: scan})
        except StageError as error:
            raise DatasetError(f"{ref}: {error}") from error
        yield tables["ground", side], None


def _evenly(items: Sequence[_Item]) -> Sequence[_Item]:
    """At most `MOST_FRAMES`: neighbours in twos, evenly over all."""
    if len(items) <= MOST_FRAMES:
        return items
    n = MOST_FRAMES // 2
    chosen: list[_Item] = []
    for i in range(n):
        chosen += items[i * len(items) // n :][:2]
    return chosen


def draw_sample(scans: GroundTables, n_scans: int) -> pd.DataFrame:
    """Points of a side: azimuth, frame, place and features; NaN for intensities that a frame lacks.

    A place begins with the first frame that does not show that of the frames before.
    """
    tables = []
    place = -1
    first: PlaceMap | None = None
    has_rays = False
    for i, (ground, T) in enumerate(scans):
        points = coordinates(ground)
        own_points = points if T is None else (points - T[:, 3]) @ T[:, :3]
        if i == 0:
            has_rays = describe_sensor(own_points).azimuth_step_deg is not None
        n = min(POINTS // n_scans, len(points))
        rows = np.sort(np.random.default_rng(i).choice(len(points), n, replace=False))
        features = describe_points(
            points,
            column(ground, "height_m"),
            rows,
            own_points=own_points if has_rays else None,
            intensity=_ranks(column(ground, "intensity"), i),
        )
        seen = map_place(points[~column(ground, "is_ground")])
        if first is None or overlap(first, seen) < SAME_PLACE:
            first = seen
            place += 1
        azimuth_deg = np.degrees(np.arctan2(points[rows, 1], points[rows, 0]))
        tables.append(
            pd.DataFrame(features).assign(azimuth_deg=azimuth_deg, frame=i, place=place)
        )
    return pd.concat(tables, ignore_index=True)


def _ranks(intensity: FloatArray, seed: int) -> FloatArray | None:
    """Ranks up to 1, as scales differ; None for values that are unknown or constant.

    Equal values are in random order, as their common rank would mark the frame.
    """
    if not np.ptp(intensity) > 0:
        return None
    shuffled = pd.Series(intensity).sample(frac=1.0, random_state=seed)
    return np.asarray(shuffled.rank(method="first", pct=True).sort_index(), dtype=np.float64)


def _compare(real: pd.DataFrame, sim: pd.DataFrame, *, is_paired: bool) -> dict[str, Any]:
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
    base_of, a, b = _real_samples(real, is_paired)
    base = compare_samples(a, b, features, is_paired=is_paired)
    return _values(_separate(points, splits, features)) | {
        "folds": "places" if points.place.nunique() >= LEAST_PLACES else "sectors",
        "n_folds": len(splits),
        "n_points": min(len(real), len(sim)),
        "real_against_real": _values(base) | {"of": base_of},
        "families": families,
        "features": sorted(alone, key=lambda row: -row["auc"]),
    }


def _values(test: Separation) -> dict[str, Any]:
    return {"auc": test.auc, "low": test.low, "high": test.high}


def _real_samples(
    real: pd.DataFrame, is_paired: bool
) -> tuple[str, pd.DataFrame, pd.DataFrame]:
    """Two samples that differ only by chance, and the words for what they are.

    A classifier that tells these apart would also tell any simulator apart. Paired samples are frames of the same
    places; their numbers are those of the pairs.
    """
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
    columns = [points[name].to_numpy() for name in ("place", "azimuth_deg", "is_sim")]
    return points, folds(*columns)


def compare_samples(
    a: pd.DataFrame,
    b: pd.DataFrame,
    features: Sequence[str],
    *,
    is_paired: bool = True,
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
