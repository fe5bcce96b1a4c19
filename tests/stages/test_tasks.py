"""What a perception stack gets from scenes of boxes on a road, worked out by hand."""

import numpy as np
import pytest

from fidpipe.schemas.settings import TaskSettings
from fidpipe.stages.pieces import CutScan
from fidpipe.stages.tasks import (
    compare_free_space,
    compare_ground,
    compare_obstacles,
    compare_occupancy,
    find_obstacles,
)

SETTINGS = TaskSettings(names="all")
CAR = ((10, 0), (4, 2))
POLE = ((5, 6), (0.4, 0.4))
FAR_CAR = ((-20, 5), (4, 2))


def solid(centre, size, height_m=1.5, step_m=0.2):
    """Points on a grid in a box above the road."""
    axes = [
        np.arange(c - s / 2, c + s / 2 + 1e-9, step_m)
        for c, s in zip(centre, size, strict=True)
    ]
    x, y, z = np.meshgrid(*axes, np.arange(0.5, 0.5 + height_m, step_m))
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


def scene(*boxes, road_m=0.0):
    """A road of 60 by 60 m with boxes on it, the sensor above its centre."""
    x, y = np.meshgrid(np.arange(-30, 30, 0.5), np.arange(-30, 30, 0.5))
    road = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, road_m)])
    points = np.vstack([road, *(solid(*box) for box in boxes)])
    is_ground = np.arange(len(points)) < len(road)
    return CutScan(points, is_ground, points[:, 2] - road_m)


def gaps(result, group="all"):
    found = result.gaps if hasattr(result, "gaps") else result
    return {gap.measure: gap.gap for gap in found if gap.group == group}


def test_a_scan_has_no_gap_to_itself():
    street = scene(CAR, POLE)
    for compare in (compare_obstacles, compare_ground, compare_occupancy, compare_free_space):
        assert set(gaps(compare(street, street, SETTINGS)).values()) == {0.0}


def test_obstacles_are_clusters_with_boxes_nearest_first():
    street = scene(FAR_CAR, POLE, CAR)
    obstacles = find_obstacles(street, SETTINGS)
    assert obstacles.centre[:, :2] == pytest.approx(np.array([POLE[0], CAR[0], FAR_CAR[0]]))
    assert obstacles.size_m[1] == pytest.approx([4, 2, 1.4])
    assert np.bincount(obstacles.labels + 1)[1:].tolist() == obstacles.n_points.tolist()
    assert (obstacles.labels[street.is_ground] == -1).all()


def test_what_is_high_above_the_road_is_no_obstacle():
    street = scene(CAR)
    raised = CutScan(street.points, street.is_ground, street.height_m + 3.0)
    assert len(find_obstacles(raised, SETTINGS).n_points) == 0
    lost = compare_obstacles(street, raised, SETTINGS)
    assert gaps(lost) == {"lost": 1.0, "added": None, "size_m": None, "place_m": None}


def test_the_distance_that_links_points_grows_with_range():
    near = ((5, 0), (0.2, 0.2))
    far = ((40, 0), (0.2, 0.2))
    apart = [((5, 0.7), (0.2, 0.2)), ((40, 0.7), (0.2, 0.2))]
    settings = TaskSettings(names="all", min_points=1)
    obstacles = find_obstacles(scene(near, far, *apart), settings)
    assert (obstacles.range_m < 20).sum() == 2
    assert (obstacles.range_m > 20).sum() == 1


def test_lost_added_resized_and_displaced_obstacles_are_counted():
    moved = ((10.4, 0.3), (4, 2))
    longer = ((-20, 5), (5, 2))
    real, sim = scene(CAR, POLE, FAR_CAR), scene(moved, longer, ((0, -12), (1, 1)))
    task = compare_obstacles(real, sim, SETTINGS)
    found = gaps(task)
    assert (found["lost"], found["added"]) == (pytest.approx(1 / 3), pytest.approx(1 / 3))
    assert found["size_m"] == pytest.approx((0 + 1) / 2)
    assert found["place_m"] == pytest.approx((0.5 + 0) / 2)
    assert task.real.partner.tolist() == [-1, 0, 2]
    common = (4.2 - 0.4) * (2.2 - 0.3)
    both = 2 * 4.2 * 2.2
    assert task.real.iou[1] == pytest.approx(common / (both - common))
    assert gaps(task, "smaller than 1.5 m") == {"lost": 1.0, "added": 1.0}
    assert gaps(task, "1.5 to 6 m") == {"lost": 0.0, "added": 0.0}
    assert gaps(task, "15 to 30 m") == {"lost": 0.0, "added": 0.0}


def test_the_order_of_rows_does_not_matter():
    real, sim = scene(CAR, POLE, FAR_CAR), scene(CAR, FAR_CAR)
    order = np.random.default_rng(0).permutation(len(real.points))
    mixed = CutScan(real.points[order], real.is_ground[order], real.height_m[order])
    for compare in (compare_obstacles, compare_ground, compare_occupancy, compare_free_space):
        assert gaps(compare(mixed, sim, SETTINGS)) == pytest.approx(
            gaps(compare(real, sim, SETTINGS))
        )


def test_ground_is_compared_where_both_sides_see_it():
    real, sim = scene(CAR), scene(CAR, road_m=0.1)
    assert gaps(compare_ground(real, sim, SETTINGS)) == {
        "disagreement": 0.0,
        "height_m": pytest.approx(0.1),
    }
    is_car = ~real.is_ground
    all_ground = CutScan(real.points, np.ones_like(is_car), real.height_m)
    found = gaps(compare_ground(real, all_ground, SETTINGS))
    assert found["disagreement"] == pytest.approx(is_car.mean())
    nothing = CutScan(real.points[:0], is_car[:0], real.height_m[:0])
    assert gaps(compare_ground(real, nothing, SETTINGS)) == {
        "disagreement": None,
        "height_m": None,
    }


def test_a_lost_obstacle_is_wrongly_free_and_an_added_one_wrongly_occupied():
    settings = TaskSettings(names="all", cell_m=0.5)
    both, without = scene(CAR, POLE), scene(CAR)
    lost = compare_occupancy(both, without, settings)
    n_real = lost[0].real / 0.25
    n_sim = lost[0].sim / 0.25
    assert gaps(lost)["mismatch"] == pytest.approx(1 - n_sim / n_real)
    assert gaps(lost)["wrongly_free"] == pytest.approx(1 - n_sim / n_real)
    assert gaps(lost)["wrongly_occupied"] == 0
    added = gaps(compare_occupancy(without, both, settings))
    assert (added["wrongly_free"], added["wrongly_occupied"]) == (0, gaps(lost)["wrongly_free"])


def test_free_space_ends_at_the_first_obstacle():
    ahead = scene(((10, 0), (0.2, 4)))
    shifted = scene(((11, 0), (0.2, 4)))
    found = compare_free_space(ahead, shifted, SETTINGS)
    assert found[0].real == pytest.approx(9.9, abs=0.3)
    assert 0.9 < found[0].gap < 1.1
    assert found[1].gap > 0.9
    nearer = compare_free_space(shifted, ahead, SETTINGS)
    assert nearer[1].gap < 0.1
