"""Frames and sequences by hand: each error of a side is found, without false alarms."""

import re
from itertools import product

import numpy as np
import pytest

from fidpipe.schemas.settings import FRAME_AXES, InputSettings
from fidpipe.stages.clean import as_ros
from fidpipe.stages.frame_search import FrameCheck, check_frames, ground_height
from fidpipe.stages.generate.flaws import add_noise, drop_points
from fidpipe.stages.inspect.sequence_checks import (
    SequenceScan,
    find_ego_hits,
    find_time_offset,
    is_moving,
    is_nearly_empty,
    is_static,
    moved_m,
)
from scenes import box, moved, rigid, road, street


def scene(seed=0):
    """The small street, with more of what has no symmetry, so densely that its voxels are all met."""
    return np.vstack(
        [
            street(seed, n=1500),
            road(12000, seed=seed + 1),
            box([12, -5, 1], [0.3, 9, 5], 3000, seed + 5),
        ]
    )


def again(points, seed=3):
    rng = np.random.default_rng(seed)
    return add_noise(drop_points(points, 0.3, rng), 0.03, rng)


def check(real, sim, T_real_sim=None, settings=(), **others):
    return check_frames(real, sim, InputSettings(**dict(settings), **others), T_real_sim)


def recorded(points, frame):
    """Coordinates of the points in a recording in this frame."""
    return points @ as_ros(np.eye(3), frame).T


def numbers(setting):
    """The motion that a setting names."""
    return np.array(setting.split('"')[1].split(), dtype=float).reshape(3, 4)


def placed_by(setting):
    """T_real_sim and the frames that a setting names."""
    T = numbers(setting) if "T_real_sim" in setting else None
    return T, dict(re.findall(r"input\.(\w+)=([\w-]+)", setting))


@pytest.mark.parametrize(
    ("matrix", "reading"),
    [
        (np.diag([1, -1, 1]), "mirrored in y"),
        (np.diag([-1, 1, 1]), "mirrored in x"),
        (np.diag([-1, -1, 1]), "rotated by 180 degrees"),
        (rigid(90, [0, 0, 0])[:, :3], "rotated by 270 degrees"),
        (rigid(270, [0, 0, 0])[:, :3], "rotated by 90 degrees"),
        (np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1]]), "with x and y exchanged"),
        (np.array([[0, -1, 0], [-1, 0, 0], [0, 0, 1]]), "with x and y exchanged and negated"),
        (np.diag([1, -1, -1]), "upside down, rotated about x"),
        (np.diag([-1, 1, -1]), "upside down, rotated about y"),
        (np.diag([1, 1, -1]), "mirrored in z"),
        (np.diag([-1, -1, -1]), "mirrored in x, y and z"),
        (100 * np.eye(3), "in centimetres"),
        (1000 * np.eye(3), "in millimetres"),
    ],
)
def test_each_fault_is_seen_and_its_setting_mends_it(matrix, reading):
    real = scene()
    wrong = again(scene()) @ np.asarray(matrix, dtype=float).T
    found = check(real, wrong)
    assert (found.reading, found.is_suspect) == (reading, True)
    assert found.as_it_lies < 0.75 < 0.9 < found.coverage
    if reading.startswith("in "):
        assert found.setting == f"simulated points in metres (they are {reading})"
        return
    mended = check(real, wrong, *placed_by(found.setting))
    assert not mended.is_suspect
    assert mended.as_it_lies == pytest.approx(found.coverage, abs=1e-3)


@pytest.mark.parametrize(("real_frame", "sim_frame"), [*product(FRAME_AXES, FRAME_AXES)])
def test_scans_in_any_two_frames_fit_with_both_named_and_the_setting_that_is_named_mends_the_rest(
    real_frame, sim_frame
):
    real, sim = recorded(scene(), real_frame), recorded(again(scene()), sim_frame)
    assert check(real, sim, real_frame=real_frame, sim_frame=sim_frame).as_it_lies > 0.9
    found = check(real, sim)
    assert found.is_suspect is (real_frame != sim_frame)
    if found.is_suspect:
        T, frames = placed_by(found.setting)
        assert T is None and frames
        assert check(real, sim, T, frames).as_it_lies > 0.9


@pytest.mark.parametrize("sim_frame", ["carla", "nuscenes", "kitti-cam"])
def test_the_frame_of_one_side_is_named(sim_frame):
    assert (
        check(scene(), recorded(again(scene()), sim_frame)).setting
        == f"input.sim_frame={sim_frame}"
    )
    if sim_frame != "carla":  # its own inverse, and simulators are left-handed
        assert (
            check(recorded(again(scene()), sim_frame), scene()).setting
            == f"input.real_frame={sim_frame}"
        )


@pytest.mark.parametrize("real_frame", ["nuscenes", "kitti-cam"])
def test_of_two_frames_the_left_handed_one_is_the_simulators(real_frame):
    found = check(recorded(scene(), real_frame), recorded(again(scene()), "carla"))
    assert found.setting == f"input.real_frame={real_frame} and input.sim_frame=carla"


@pytest.mark.parametrize("shift_m", [1.8, -1.8])
def test_another_height_of_the_sensor_is_seen_by_the_ground(shift_m):
    found = check(scene(), again(scene()) + [0, 0, shift_m])
    assert found.is_suspect
    assert numbers(found.setting)[2, 3] == pytest.approx(-shift_m, abs=0.25)


def test_a_shifted_and_mirrored_scan_is_named_as_both():
    found = check(scene(), again(scene()) * [1, -1, 1] + [0, 0, 1.8])
    assert found.reading.startswith("mirrored in y and shifted by -")
    assert "input.sim_frame=carla and T_real_sim" in found.setting


def test_a_small_rotation_with_a_shift_is_not_named():
    found = check(scene(), moved(again(scene()), rigid(6, [1.6, 0.3, 0])))
    assert (found.is_suspect, found.reading) == (False, "as given")


def test_a_mirror_that_is_set_and_should_not_be_is_named():
    found = check(scene(), again(scene()), sim_frame="carla")
    assert (found.reading, found.setting) == ("mirrored in y", "input.sim_frame=ros")


def test_a_motion_that_is_set_is_kept_in_the_setting_that_mends():
    T = rigid(30, [2, 1, 0.5])
    own = moved(again(scene()) - T[:, 3], np.column_stack([T[:, :3].T, np.zeros(3)]))
    assert not check(scene(), own, T).is_suspect
    found = check(scene(), own * [1, -1, 1], T)
    assert (found.is_suspect, found.setting) == (True, "input.sim_frame=carla")


def test_the_same_scan_fits_wholly_as_it_lies():
    found = check(scene(), scene())
    assert (found.as_it_lies, found.coverage, found.reading, found.setting) == (
        1.0,
        1.0,
        "as given",
        "",
    )


def test_a_symmetric_corridor_raises_no_alarm_however_it_lies():
    def corridor(seed):
        walls = [box([0, y, 0.3], [36, 0.2, 4], 6000, seed + i) for i, y in enumerate((-6, 6))]
        return np.vstack([road(12000, seed=seed), *walls])

    for signs in ([1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1]):
        assert not check(corridor(0), corridor(9) * signs).is_suspect


def test_two_places_raise_no_alarm_because_no_reading_fits(rng):
    other = np.vstack(
        [
            road(12000, seed=7),
            *(box([*rng.uniform(-16, 16, 2), 0], [3, 2, 3], 800, i) for i in range(9)),
        ]
    )
    assert not check(scene(), other).is_suspect


def test_half_a_field_of_view_raises_no_alarm():
    sim = again(scene())
    assert not check(scene(), sim[sim[:, 0] > 0]).is_suspect


def test_what_is_not_finite_is_left_out_and_too_little_is_not_judged():
    sim = scene()
    sim[::3] = np.nan
    assert not check(scene(), sim).is_suspect
    assert check(np.empty((0, 3)), sim) is None
    assert check(scene(), np.full((500, 3), np.nan)) is None
    assert check(scene()[:20], sim) is None


def test_only_what_is_inside_the_box_is_compared():
    beyond = np.vstack([again(scene()), box([-15, 15, 5], [6, 6, 6], 4000)])
    low = (-20, -20, -3, 20, 11, 6)
    assert (
        check(scene(), beyond, include_box=low).as_it_lies > check(scene(), beyond).as_it_lies
    )


def test_ground_is_where_most_of_a_thinned_scan_lies():
    assert ground_height(road(z=-1.7)) == pytest.approx(-1.7, abs=0.4)
    assert ground_height(np.empty((0, 3))) == 0.0


STEP_M = 1.0
GROUND_M = -1.7


def world():
    rng = np.random.default_rng(5)
    boxes = []
    for x in range(-40, 60, 4):
        for side in (-1, 1):
            middle = [x, side * rng.uniform(6, 12), -0.5]
            boxes.append(box(middle, rng.uniform(0.5, 3, 3), 300, len(boxes)))
    return np.vstack(boxes)


def drive(n=6, step_m=STEP_M, seed=0, noise_m=0.02, extra=None):
    """Scans of a sensor that moves ahead by a step from scan to scan; `extra` moves with it."""
    rng = np.random.default_rng(seed)
    boxes = world()
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
    assert (
        find_time_offset([(sides[0][:2], sides[1][:2]), (sides[0][3:5], sides[1][3:5])]) is None
    )


def test_a_sensor_that_stands_still_is_never_late():
    still = places(drive(step_m=0.0)), places(drive(step_m=0.0, seed=9))
    assert find_time_offset([still]) is None
    assert find_time_offset([(still[0][1:], still[1][:-1])]) is None


def test_places_that_have_nothing_in_common_are_not_late():
    other = [
        SequenceScan(points @ np.diag([-1.0, 1, 1])) for points in drive(step_m=7.0, seed=3)
    ]
    assert find_time_offset([(places(drive()), other)]) is None


@pytest.mark.parametrize("noise_m", [0.0, 0.05])
def test_a_side_that_is_one_scan_again_and_again_is_static(sides, noise_m):
    still = moved_m([places(drive(step_m=0.0, noise_m=noise_m))])
    moving = moved_m([sides[0]])
    assert is_moving(moving) and not is_moving(still)
    assert is_static(still, moving)
    assert not (
        is_static(moving, still) or is_static(moving, moving) or is_static(still, still)
    )


def test_a_slow_side_is_not_static(sides):
    slow, fast = moved_m([places(drive(step_m=0.3))]), moved_m([sides[0]])
    assert not is_static(slow, fast)


def test_a_side_with_a_twentieth_of_the_points_is_nearly_empty():
    assert is_nearly_empty(400, 10_000) and is_nearly_empty(0, 10_000)
    assert not (is_nearly_empty(10_000, 400) or is_nearly_empty(5_000, 10_000))
    assert not (is_nearly_empty(np.nan, 10_000) or is_nearly_empty(0, 0))


BONNET = ([1.8, 0, -0.9], [1.5, 1.6, 0.3])


@pytest.mark.parametrize("n", [200, 20_000])
def test_hits_that_go_with_the_sensor_are_found_with_their_box(n):
    found = find_ego_hits(drive(extra=box(*BONNET, n)), GROUND_M)
    n_others = 0.7 * (len(world()) + 6000)
    assert found.share == pytest.approx(n / (n + n_others), rel=0.1)
    low = np.array(BONNET[0]) - np.array(BONNET[1]) / 2
    high = np.array(BONNET[0]) + np.array(BONNET[1]) / 2
    assert np.all(np.array(found.low) == pytest.approx(low, abs=0.25))
    assert np.all(np.array(found.high) == pytest.approx(high, abs=0.25))
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
    assert not is_static(float("nan"), 0.5)


def test_another_size_is_another_frame_also_if_the_ground_is_lifted():
    lifted = FrameCheck(0.86, "shifted by +0.30 m in z", 0.95, True, "")
    scaled = FrameCheck(0.86, "shifted by +0.30 m in z, in units of 0.9 m", 0.95, True, "")
    assert lifted.doubt is None
    assert scaled.doubt == f"the simulated scan is in another frame: {scaled.reading}"


@pytest.mark.parametrize("n_points", [200, 300, 500, 1000])
def test_thinned_scans_of_one_place_are_never_called_scans_of_two(n_points):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        real = scene(seed)
        sim = again(real)
        result = check(
            rng.choice(real, n_points, replace=False),
            rng.choice(sim, n_points, replace=False),
        )
        assert result is None or result.doubt is None
