"""The scores of papers on LiDAR synthesis once more, from the stored points, by `stages.literal`."""

from __future__ import annotations

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import BEV_JSD, METRIC, NVS_SCORES
from ...stages.literal import literal_nvs as literal
from ...stages.nvs import NOT_INSTALLED
from .stored import StoredPair

_FROM_ALL_DISTANCES = ("nvs_chamfer_m2", "nvs_f_score_0p05m2")


def nvs(pair: StoredPair) -> None:
    """All scores of the pair; distances of clouds only if whole sides are compared."""
    if not pair.settings.nvs.scores:
        return
    expected: dict[str, float | None] = dict.fromkeys(metric.column for metric in NVS_SCORES)
    expected |= _scores(pair)
    pair.compare("nvs", [{"score": name, "unit": METRIC[name].unit} for name in expected])
    skipped = () if pair.whole_sides else _FROM_ALL_DISTANCES
    if NOT_INSTALLED in pair.table("nvs")["reason"].tolist():
        pair.tally.skip("SSIM: scikit-image was not installed")
        skipped = (*skipped, *(name for name in expected if name.endswith("_ssim")))
    known = [{"score": name, "value": value} for name, value in expected.items() if name not in skipped]
    pair.compare("nvs", known, is_whole=False)


def _scores(pair: StoredPair) -> dict[str, float | None]:
    tables = [pair.table("ground", side) for side in SIDES]
    intensities = [None if table["intensity"].isna().any() else table["intensity"].tolist() for table in tables]
    points = [pair.sides[side].all_points for side in SIDES]
    (real, real_intensity), (sim, sim_intensity) = map(literal.project, points, intensities)
    in_metres = {"rmse": "rmse_m", "medae": "medae_m"}
    of_depth = literal.image_scores(real, sim, 80.0)
    found = {f"nvs_depth_{in_metres.get(name, name)}": value for name, value in of_depth.items()}
    if all(own and max(own) > 0 and min(own) >= 0 and max(own) <= 1 for own in intensities):
        of_intensity = literal.image_scores(real_intensity, sim_intensity, 1.0)
        found |= {f"nvs_intensity_{name}": value for name, value in of_intensity.items()}
    of_clouds = literal.cloud_scores(*map(literal.unproject, (real, sim))) if pair.whole_sides else {}
    found |= {f"nvs_{name}": value for name, value in (literal.hit_scores(real, sim) | of_clouds).items()}
    return found | {BEV_JSD.column: literal.map_jsd(*map(literal.map_from_above, points))}
