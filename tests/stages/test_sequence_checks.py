"""Sequences by hand: a sensor that drives through a street of boxes, and each way in which a side can be wrong."""

import numpy as np
import pytest

from fidpipe.stages.inspect.sequence_checks import (
    SequenceScan,
    find_ego_hits,
    find_empty_side,
    find_static_side,
    find_time_offset,
    is_moving,
    moved_m,
)
from scenes import box, road

STEP_M = 1.0
GROUND_M = -1.7


def world():
    rng = np.random.default_rng(5)
    boxes = [
        box([x, side * rng.uniform(6, 12), -0.5], rng.uniform(0.5, 3, 3), 300, i)
        for i, (x, side) in enumerate((x, side) for x in range(-40, 60, 4) for side in (-1, 1))
    ]
    return np.vstack(boxes)


def drive(n=6, step_m=STEP_M, seed=0, noise_m=0.02, extra=None):
    """Scans of a sensor that moves ahead by a step from scan to scan; `extra` moves with it."""
    rng, boxes = np.random.default_rng(seed), world()
    scans = []
    for i in range(n):
        points = np.vstack([boxes - [i * step_m, 0, 0], road(6000, seed=seed + i, z=GROUND_M)])
        points = points[rng.random(len(points)) < 0.7]
        points = points if extra is None else np.vstack([points, extra])
        scans.append(points + rng.normal(0, noise_m, points.shape))
    return scans


def places(scans):
    return [SequenceScan(points) for points in scans]


@pytest.fixture(scope="module")
def sides():
    return places(drive(9)), places(drive(9, seed=50))


@pytest.mark.parametrize("late", [-3, -2, -1, 1, 2, 3])
def test_a_side_that_is_late_or_early_is_found_with_its_frames(sides, late):
    real, sim = sides
    paired = (real[late:], sim[: len(sim) - late]) if late > 0 else (real[:late], sim[-late:])
    # pairs i of (real i + late, sim i): what real i shows stands in pair i + late on the simulated side
    found = find_time_offset([paired])
    assert found is not None and found.frames == late
    assert found.misfit_m < 0.2 < found.as_paired_m


def test_sides_of_one_time_are_not_late(sides):
    assert find_time_offset([sides]) is None
    assert find_time_offset([(sides[0][:2], sides[1][:2]), (sides[0][3:5], sides[1][3:5])]) is None


def test_a_sensor_that_stands_still_is_never_late():
    still = places(drive(step_m=0.0)), places(drive(step_m=0.0, seed=9))
    assert find_time_offset([still]) is None
    assert find_time_offset([(still[0][1:], still[1][:-1])]) is None


def test_places_that_have_nothing_in_common_are_not_late():
    other = [SequenceScan(points @ np.diag([-1.0, 1, 1])) for points in drive(step_m=7.0, seed=3)]
    assert find_time_offset([(places(drive()), other)]) is None


@pytest.mark.parametrize("noise_m", [0.0, 0.05])
def test_a_side_that_is_one_scan_again_and_again_is_static(sides, noise_m):
    still = moved_m([places(drive(step_m=0.0, noise_m=noise_m))])
    moving = moved_m([sides[0]])
    assert is_moving(moving) and not is_moving(still)
    assert find_static_side(moving, still) == "sim"
    assert find_static_side(still, moving) == "real"
    assert find_static_side(moving, moving) is find_static_side(still, still) is None


def test_a_slow_side_is_not_static(sides):
    slow, fast = moved_m([places(drive(step_m=0.3))]), moved_m([sides[0]])
    assert find_static_side(slow, fast) is None


def test_a_side_with_a_twentieth_of_the_points_is_nearly_empty():
    many, few, half = (np.array([n, n, n]) for n in (10_000, 400, 5_000))
    assert (find_empty_side(many, few), find_empty_side(few, many)) == ("sim", "real")
    assert find_empty_side(many, 0 * many) == "sim"
    assert find_empty_side(many, half) is find_empty_side(many, few[:0]) is find_empty_side(0 * many, 0 * many) is None


BONNET = ([1.8, 0, -0.9], [1.5, 1.6, 0.3])


@pytest.mark.parametrize("n", [200, 20_000])
def test_hits_that_go_with_the_sensor_are_found_with_their_box(n):
    found = find_ego_hits(drive(extra=box(*BONNET, n)), GROUND_M)
    n_others = 0.7 * (len(world()) + 6000)
    assert found.share == pytest.approx(n / (n + n_others), rel=0.1)
    low, high = np.array(BONNET[0]) - np.array(BONNET[1]) / 2, np.array(BONNET[0]) + np.array(BONNET[1]) / 2
    assert np.all(np.array(found.low) == pytest.approx(low, abs=0.25))
    assert np.all(np.array(found.high) == pytest.approx(high, abs=0.25))
    assert 2.5 < found.farthest_m < 3.1
    assert found.others_in_box < 0.002


def test_a_street_without_a_vehicle_has_none(sides):
    assert find_ego_hits(drive(), GROUND_M) is None


def test_a_wall_along_the_road_is_not_the_vehicle():
    wall = box([0, 3, 0], [60, 0.2, 2], 30_000)
    assert find_ego_hits(drive(extra=wall), GROUND_M) is None


def test_two_scans_and_a_few_hits_tell_nothing():
    assert find_ego_hits(drive(extra=box(*BONNET, 2000))[:2], GROUND_M) is None
    assert find_ego_hits(drive(extra=box(*BONNET, 10)), GROUND_M) is None
    assert find_ego_hits([np.empty((0, 3))] * 3, GROUND_M) is None


def test_too_few_points_compare_as_nothing():
    few = places([np.empty((0, 3)), np.ones((5, 3))])
    assert np.isnan(moved_m([few])) and np.isnan(few[0].misfit_m(few[1]))
    assert find_time_offset([(few * 3, few * 3)]) is None
    assert find_static_side(float("nan"), 0.5) is None
