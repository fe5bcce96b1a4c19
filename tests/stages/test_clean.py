import numpy as np
import pytest

import literal_method
from fidpipe.schemas.errors import SettingsError
from fidpipe.schemas.settings import InputSettings, load
from fidpipe.stages.clean import clean_scan
from scenes import rigid


def test_each_reason_is_counted_in_its_order():
    scan = np.array(
        [
            [np.nan, 0, 0],
            [0, 0, 0],
            [5, 0, 0],
            [5, 0, 0],
            [1, 0, 0],
            [200, 0, 0],
            [4, 0, 0],
            [6, 1, 0],
        ]
    )
    settings = InputSettings(
        exclude_box=(3.5, -1, -1, 4.5, 1, 1), include_box=(-10, -10, -10, 5.5, 10, 10)
    )
    result = clean_scan(scan, settings)
    assert result.point_ids.tolist() == [2]
    in_order = [
        "not_finite",
        "zero",
        "duplicate",
        "too_near",
        "too_far",
        "in_exclude_box",
        "outside_include_box",
    ]
    assert [reason for reason, n in result.dropped.items() if n == 1] == in_order
    assert sum(result.dropped.values()) == len(in_order)


def test_rays_without_a_return_are_dropped(rng):
    scan = rng.uniform(-40, 40, (900, 3))
    misses = rng.normal(size=(100, 3))
    misses *= 80.0 / np.linalg.norm(misses, axis=1, keepdims=True)
    result = clean_scan(np.vstack([scan, misses]), InputSettings(min_range_m=0.0))
    assert (result.dropped["no_return"], result.point_ids.tolist()) == (100, list(range(900)))
    ids, _ = literal_method.clean(
        np.vstack([scan, misses]), InputSettings(min_range_m=0.0).model_dump(), "ros", None
    )
    assert ids == result.point_ids.tolist()


def test_the_first_point_of_each_voxel_is_kept_in_the_real_frame(rng):
    scan = rng.uniform(-20, 20, (2000, 3))
    scan[1000:] = scan[:1000] + rng.uniform(-0.01, 0.01, (1000, 3))
    settings = InputSettings(voxel_m=0.5, min_range_m=4.0)
    T = rigid(30, [1, 2, 0.5])
    result = clean_scan(scan, settings, T_real_sim=T)
    ids, points = literal_method.clean(scan, settings.model_dump(), "ros", T)
    assert result.point_ids.tolist() == ids
    np.testing.assert_allclose(result.points, points, atol=1e-12)
    assert (
        result.dropped["thinned"]
        == len(clean_scan(scan, InputSettings(min_range_m=4.0)).points) - len(ids)
        > 900
    )
    assert "thinned" not in clean_scan(scan, InputSettings()).dropped


def test_range_limits_are_inclusive():
    scan = np.array([[2.5, 0, 0], [100.0, 0, 0], [2.4999, 0, 0], [100.001, 0, 0]])
    assert clean_scan(scan, InputSettings()).point_ids.tolist() == [0, 1]


def test_the_scan_given_is_not_changed():
    scan = np.array([[10.0, 3, 0], [np.nan, 0, 0]])
    before = scan.copy()
    clean_scan(scan, InputSettings(), frame="carla")
    np.testing.assert_array_equal(scan, before)


@pytest.mark.parametrize("frame", ["ros", "carla", "nuscenes", "kitti-cam"])
def test_agrees_with_the_textbook_on_a_dirty_scan(rng, frame):
    # coarse, so that many points are equal or zero
    scan = np.round(rng.normal(0, 4, (800, 3)), 0)
    scan[rng.random(800) < 0.05, 1] = np.inf
    T = rigid(30, [1, 2, 0.5])
    box = (2.0, -3.0, -9.0, 5.0, 3.0, 9.0)
    keep = (-8.0, -8.0, -8.0, 8.0, 8.0, 8.0)
    settings = InputSettings(exclude_box=box, include_box=keep)
    result = clean_scan(scan, settings, frame=frame, T_real_sim=T)
    ids, points = literal_method.clean(scan, settings.model_dump(), frame, T)
    assert result.point_ids.tolist() == ids
    np.testing.assert_allclose(result.points, points, atol=1e-12)
    assert sum(result.dropped.values()) + len(ids) == 800


def test_a_range_that_float64_does_not_hold_is_too_far():
    scan = np.array([[5.0, 0, 0], [1e200, 0, 0], [np.finfo(float).max] * 3, [np.inf, 0, 0]])
    dropped = clean_scan(scan, InputSettings(max_range_m=1e9)).dropped
    assert (dropped["too_far"], dropped["not_finite"]) == (2, 1)
    with pytest.raises(SettingsError, match="input.max_range_m"):
        load(None, ["input.max_range_m=1e300"])
