"""Scores of papers on LiDAR synthesis: LiDAR4D's and LiDARGen's formulas evaluated by hand, and the literal twin."""

import sys

import numpy as np
import pytest

from fidpipe.schemas.metric_catalogue import METRIC, NVS_SCORES
from fidpipe.stages import nvs
from fidpipe.stages.literal import literal_nvs as literal

N_PIXELS = 66 * 1030


def scan(seed, n=4000):
    """Points on a road and on walls around, some beyond the field of view or 80 m, and their intensities."""
    rng = np.random.default_rng(seed)
    azimuth, range_m = rng.uniform(-np.pi, np.pi, n), rng.uniform(2, 90, n)
    z = np.where(rng.random(n) < 0.5, -1.7, rng.uniform(-1.7, 4, n))
    return np.column_stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), z]), rng.random(n)


def values(*arguments):
    return {each.name: each.value for each in nvs.score_pair(*arguments)}


def test_one_pair_evaluated_by_hand_with_the_formulas_of_lidar4d():
    """Real returns 10 m ahead and 20 m behind; simulated 10.1 m ahead, and a farther one in the same pixel."""
    real, sim = np.array([[10.0, 0, 0], [-20, 0, 0]]), np.array([[12.0, 0, 0], [10.1, 0, 0]])
    image = nvs.project(real).range_m
    # row round(66 - 24.9 / (26.9 / 66)) = round(4.907); columns round(pi / (2 pi / 1030)) and round(0)
    assert (image[5, 515], image[5, 0], np.count_nonzero(image)) == (10, 20, 2)
    found = values(real, sim)
    # (0.1^2 + 20^2) / 67980, a pixel without a return counting with its whole range
    assert found["nvs_depth_rmse_m"] == pytest.approx((400.01 / N_PIXELS) ** 0.5, rel=1e-6)
    assert found["nvs_depth_rmse_m"] == pytest.approx(0.0767088, rel=1e-5)
    assert found["nvs_depth_medae_m"] == 0
    assert found["nvs_depth_psnr_db"] == pytest.approx(60.364896, rel=1e-6)
    # one hit on both sides, one missed: precision 1, recall 1/2
    assert found["nvs_raydrop_hit_f1"] == pytest.approx(2 / 3)
    assert found["nvs_raydrop_accuracy"] == 1 - 1 / N_PIXELS
    assert found["nvs_raydrop_rmse"] == pytest.approx(N_PIXELS**-0.5)
    # squared distances 0.1^2 and 30.1^2 one way, 0.1^2 the other way; shares below 0.05 m2 1/2 and 1
    assert found["nvs_chamfer_m2"] == pytest.approx((0.01 + 906.01) / 2 + 0.01, rel=1e-6)
    assert found["nvs_f_score_0p05m2"] == pytest.approx(2 / 3)


def test_all_numbers_are_those_of_the_literal_twin():
    (real, real_intensity), (sim, sim_intensity) = scan(0), scan(1)
    sim[:2500], sim_intensity[:2500] = real[:2500] + 0.05, real_intensity[:2500]
    found = values(real, sim, (real_intensity, sim_intensity))
    a, b = literal.project(real, real_intensity), literal.project(sim, sim_intensity)
    assert np.array(a[0]).tolist() == nvs.project(real).range_m.tolist()
    expected = {f"depth_{name}": value for name, value in literal.image_scores(a[0], b[0], 80.0).items()}
    expected |= {f"intensity_{name}": value for name, value in literal.image_scores(a[1], b[1], 1.0).items()}
    expected |= literal.hit_scores(a[0], b[0]) | literal.cloud_scores(*map(literal.unproject, (a[0], b[0])))
    if not nvs.can_compare_images():
        expected |= dict.fromkeys(("depth_ssim", "intensity_ssim"))
    own = {f"nvs_{name}" + ("_m" if name in ("depth_rmse", "depth_medae") else ""): expected[name] for name in expected}
    maps = [[literal.map_from_above(points) for points in own] for own in ((real, sim[:90]), (sim, real[:50]))]
    own["bev_jsd_100x100_160m"] = literal.map_jsd(maps[0][0], maps[1][0])
    assert found == {name: own[name] if own[name] is None else pytest.approx(own[name], abs=1e-9) for name in found}
    assert found.keys() == own.keys() == {metric.column for metric in NVS_SCORES}
    discrepancy = nvs.map_discrepancy(np.array(maps[0]), np.array(maps[1]))
    assert discrepancy == pytest.approx(literal.map_mmd(*maps), abs=1e-12)
    assert discrepancy > 0


def test_a_scan_against_itself_has_the_values_of_the_catalogue():
    points, intensity = scan(2)
    for each in nvs.score_pair(points, points, (intensity, intensity)):
        if each.value is None:
            assert each.name.endswith(("_psnr_db", "_ssim"))
            assert each.reason in ("both images are equal", nvs.NOT_INSTALLED)
        else:
            assert each.value == pytest.approx(METRIC[each.name].equal, abs=1e-12), each.name
    maps = np.array([nvs.map_from_above(points).ravel()] * 2)
    assert nvs.map_discrepancy(maps, maps) == pytest.approx(0, abs=1e-12)


def test_maps_without_a_common_cell_are_at_the_upper_bound():
    ahead, behind = (nvs.map_from_above(np.array([[x, 0.1, 0]])) for x in (20, -20))
    assert nvs.map_distance(ahead, behind) == pytest.approx(METRIC["bev_jsd_100x100_160m"].high)
    # two maps with a single cell each: squared distance 2, kernel exp(-2 * 2)
    assert nvs.map_discrepancy(ahead.reshape(1, -1), behind.reshape(1, -1)) == pytest.approx(2 - 2 * np.exp(-4))
    assert nvs.map_from_above(np.array([[2.9, 0, 0], [70.1, 0, 0], [0, 0, 5]])).sum() == 1


@pytest.mark.parametrize(
    ("intensities", "reason"),
    [
        ((None, np.ones(4000)), "the real side has no intensity"),
        ((np.ones(4000), np.zeros(4000)), "the simulated side has no intensity"),
        (
            (np.ones(4000), np.full(4000, 200.0)),
            "expected intensities from 0 to 1, got 200 to 200 on the simulated side",
        ),
    ],
)
def test_intensities_that_cannot_be_compared_are_null_with_their_reason(intensities, reason):
    found = nvs.score_pair(scan(0)[0], scan(1)[0], intensities)
    assert [(each.value, each.reason) for each in found if "intensity" in each.name] == [(None, reason)] * 4


def test_what_a_side_does_not_have_is_null_with_its_reason(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage", None)
    far = np.array([[100.0, 0, 0]])
    found = {each.name: each for each in nvs.score_pair(far, scan(0)[0])}
    assert (
        found["nvs_chamfer_m2"].reason == found["nvs_f_score_0p05m2"].reason == "a side has no point in the range image"
    )
    assert found["nvs_raydrop_hit_f1"].reason == "no pixel with a return on both"
    assert found["bev_jsd_100x100_160m"].reason == "a side has no point between 3 and 70 m"
    assert found["nvs_depth_ssim"].reason == "the real image has a single value"
    assert nvs.image_errors(np.eye(9), np.eye(9), 80.0)[2:] == ("both images are equal", nvs.NOT_INSTALLED)
