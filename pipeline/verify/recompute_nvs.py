"""The scores of papers on LiDAR synthesis once more, from the stored points, by `stages.literal`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import BEV_JSD, BEV_MMD, METRIC, NVS_SCORES
from ...schemas.record import OF_DATASET
from ...schemas.settings import Settings
from ...stages.arrays import FloatArray
from ...stages.literal import literal_nvs as literal
from ...stages.literal.literal_method import mean_and_std
from ...stages.nvs import NOT_INSTALLED
from ..jobs.nvs_job import MOST_SCANS
from ..results.finished import FinishedRun
from .stored import Part, Skipped, StoredPair, summaries

_FROM_ALL_DISTANCES = ("nvs_chamfer_m2", "nvs_f_score_0p05m2")


def nvs(pair: StoredPair) -> Iterator[Part | Skipped]:
    """All scores of the pair; distances of clouds only if whole sides are compared."""
    if not pair.settings.nvs.scores:
        return
    expected: dict[str, float | None] = dict.fromkeys(metric.column for metric in NVS_SCORES)
    expected |= _scores(pair)
    skipped = () if pair.sample.whole_sides else _FROM_ALL_DISTANCES
    if NOT_INSTALLED in pair.table("nvs")["reason"].tolist():
        yield Skipped("SSIM: scikit-image was not installed")
        skipped = (*skipped, *(name for name in expected if name.endswith("_ssim")))
    rows = [{"score": name, "unit": METRIC[name].unit, "value": value} for name, value in expected.items()]
    yield pair.part("nvs", [{name: row[name] for name in ("score", "unit")} for row in rows])
    known = [{name: row[name] for name in ("score", "value")} for row in rows if row["score"] not in skipped]
    yield pair.part("nvs", known, is_whole=False)


def _scores(pair: StoredPair) -> dict[str, float | None]:
    tables = [pair.table("ground", side) for side in SIDES]
    points = [table[["x", "y", "z"]].to_numpy() for table in tables]
    intensities = [None if table["intensity"].isna().any() else table["intensity"].tolist() for table in tables]
    images = [literal.project(*own) for own in zip(points, intensities, strict=True)]
    (real, real_intensity), (sim, sim_intensity) = images
    found = {
        f"nvs_depth_{name}{'_m' * (name in ('rmse', 'medae'))}": value
        for name, value in literal.image_scores(real, sim, 80.0).items()
    }
    if all(own and max(own) > 0 and min(own) >= 0 and max(own) <= 1 for own in intensities):
        values = literal.image_scores(real_intensity, sim_intensity, 1.0)
        found |= {f"nvs_intensity_{name}": value for name, value in values.items()}
    of_clouds = literal.cloud_scores(*map(literal.unproject, (real, sim))) if pair.sample.whole_sides else {}
    found |= {f"nvs_{name}": value for name, value in (literal.hit_scores(real, sim) | of_clouds).items()}
    return found | {BEV_JSD.column: literal.map_jsd(*map(literal.map_from_above, points))}


def nvs_means(run: FinishedRun, settings: Settings) -> Iterator[Part]:
    """Means and deviations over pairs, and the distances of the maps of all scans, as `run.json` has them."""
    if not settings.nvs.scores:
        return
    pair_ids = sorted(row["pair_id"] for row in run.scored)
    values: dict[str, list[float | None]] = {metric.column: [] for metric in NVS_SCORES}
    maps: dict[str, list[FloatArray]] = {side: [] for side in SIDES}
    for pair_id in pair_ids:
        for row in run.read_table("nvs", pair_id).to_pylist():
            values[row["score"]].append(row["value"])
        for side in SIDES:
            table = run.read_table("ground", pair_id, side)
            maps[side].append(literal.map_from_above(np.column_stack([table[axis].to_numpy() for axis in "xyz"])))
    made: list[tuple[str, str, float | None, float | None, int, int]] = []
    for name, own in values.items():
        n_null = own.count(None)
        made.append((name, "scans", *mean_and_std(own), len(own) - n_null, n_null))
    n = len(pair_ids)
    chosen = sorted({int(i) for i in np.linspace(0, n - 1, min(n, MOST_SCANS))})
    jsd = literal.map_jsd(*(sum(own, np.zeros(1)) for own in maps.values()))
    mmd = literal.map_mmd(*([own[i] for i in chosen] for own in maps.values()))
    for metric, value, size in ((BEV_JSD, jsd, n), (BEV_MMD, mmd, len(chosen))):
        counts = (0, size) if value is None else (size, 0)
        made.append((metric.column, OF_DATASET, value, None, *counts))
    yield summaries(run.record.nvs, made)
