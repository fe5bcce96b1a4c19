"""Points that would make a prescription wrong are named, and no cause that they feign is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fidpipe.schemas.cause_catalogue import CAUSES, LOSSES
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import InputSettings
from fidpipe.stages.causes.beams import second_returns
from fidpipe.stages.causes.estimates import (
    Amount,
    _losses,
    _maximum_range,
    _stray_amount,
    doubts_of,
    estimate,
    only_known,
)
from fidpipe.stages.causes.sides import PairScans, Side
from fidpipe.stages.frame_search import check_frames
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.plausibility import implausible
from fidpipe.stages.sensor_description import describe_sensor
from fidpipe.stages.sweep import Sweep
from fidpipe.stages.trust import (
    BEAMS,
    ENOUGH,
    FINE,
    FRAME,
    MISSES,
    ONE_SWEEP,
    POSITION,
    RETURNS,
    ROAD,
    SAME_SWEEPS,
    STEPS,
    UNCROPPED,
    UPRIGHT,
    alternation_text,
    cropped_box,
)

ROAD_M = -1.5  # all that is lower


@pytest.fixture(scope="module")
def scan():
    return make_pair(0, 3, SENSORS["hdl32"]).real.rows[:, :3].astype(float)


def with_misses(scan, share, range_m):
    rng = np.random.default_rng(0)
    rays = scan[rng.choice(len(scan), int(share * len(scan) / (1 - share)), replace=False)]
    rays *= (np.resize(range_m, len(rays)) / np.linalg.norm(rays, axis=1))[:, None]
    return np.vstack([scan, rays])


def with_second_returns(scan, share):
    rng = np.random.default_rng(0)
    behind = scan[rng.random(len(scan)) < share]
    return np.vstack([scan, behind * rng.choice([1.0, 1.2], (len(behind), 1))])


def thinned(scan):
    """The first point of each voxel of 20 cm."""
    _, first = np.unique(np.floor(scan / 0.2), axis=0, return_index=True)
    return scan[np.sort(first)]


def of_image(scan, n_columns=1024, n_rows=64):
    """The nearest return of each pixel of a range image, at its centre."""
    range_m = np.linalg.norm(scan, axis=1)
    low, high = np.radians([-31.0, 11.0])
    column = np.arctan2(scan[:, 1], scan[:, 0]) / (2 * np.pi) * n_columns // 1
    row = (np.arcsin(scan[:, 2] / range_m) - low) / (high - low) * n_rows // 1
    order = np.argsort(range_m)
    _, first = np.unique((row * 2 * n_columns + column)[order], return_index=True)
    nearest = order[first]
    azimuth = (column[nearest] + 0.5) / n_columns * 2 * np.pi
    slope = low + (row[nearest] + 0.5) / n_rows * (high - low)
    level = np.cos(slope)
    rays = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(slope)])
    return range_m[nearest, None] * rays


def turned(scan, degrees):
    return scan @ Rotation.from_euler("z", degrees, degrees=True).as_matrix().T


@pytest.mark.parametrize(
    ("change", "need"),
    [
        (lambda scan: with_misses(scan, 0.05, 120.0), MISSES),
        (lambda scan: with_misses(scan, 0.29, 200.0), MISSES),
        (
            lambda scan: with_misses(
                scan, 0.25, np.random.default_rng(1).normal(150.0, 0.3, 9999)
            ),
            MISSES,
        ),
        (lambda scan: with_misses(with_misses(scan, 0.2, 150.0), 0.2, 200.0), MISSES),
        (thinned, BEAMS),
        (lambda scan: thinned(scan[np.linalg.norm(scan, axis=1) < 15.0]), BEAMS),
        (lambda scan: np.vstack([scan, scan]), RETURNS),
        (lambda scan: with_second_returns(scan, 0.4), RETURNS),
        (lambda scan: scan + [300.0, 120.0, 4.0], POSITION),
        (lambda scan: np.vstack([scan, scan + [1.1, 0.05, 0]]), ONE_SWEEP),
        (lambda scan: np.vstack([scan, turned(scan, 0.05)]), ONE_SWEEP),
        (lambda scan: np.vstack([scan, turned(scan, 0.06), turned(scan, 0.1)]), ONE_SWEEP),
        (of_image, ONE_SWEEP),
        (lambda scan: of_image(scan, 2048), ONE_SWEEP),
        (lambda scan: np.round(scan, 2), FINE),
        (lambda scan: np.round(scan, 1), FRAME),
        (
            lambda scan: (scan + [448262, 5411932, 115]).astype("f4") - [448262, 5411932, 115],
            FRAME,
        ),
    ],
)
def test_what_cannot_be_trusted_is_named(scan, change, need):
    assert [*describe_sensor(change(scan)).doubts] == [need]


def test_a_healthy_scan_its_thinning_and_its_jitter_raise_no_doubt(scan):
    rng = np.random.default_rng(0)
    azimuth = np.arctan2(scan[:, 1], scan[:, 0]) + np.radians(rng.normal(0, 0.08, len(scan)))
    level = np.hypot(scan[:, 0], scan[:, 1])
    blurred = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), scan[:, 2]])
    for points in (scan, scan[rng.random(len(scan)) < 0.4], rng.permutation(scan), blurred):
        assert describe_sensor(points).doubts == {}


def test_misses_and_second_returns_do_not_change_the_sensor(scan):
    alone = describe_sensor(scan)
    for points in (
        with_misses(scan, 0.29, 200.0),
        with_second_returns(scan, 0.4),
        np.vstack([scan, scan]),
    ):
        sensor = describe_sensor(points)
        assert len(sensor.elevation_deg) == pytest.approx(len(alone.elevation_deg), abs=1)
        assert sensor.azimuth_step_deg == pytest.approx(alone.azimuth_step_deg, abs=0.01)
        assert sensor.range_noise_m == pytest.approx(alone.range_noise_m, abs=0.003)


def test_a_cause_whose_need_is_in_doubt_is_unknown_with_the_reason(scan):
    doubts = doubts_of(describe_sensor(scan), describe_sensor(scan + [300.0, 120.0, 4.0]))
    known = only_known(dict.fromkeys(CAUSES, Amount(1.0)), doubts)
    assert known["missing parts"].amount == 1.0
    for name in ("height", "maximum range", "lost returns", "range noise", "blind sector"):
        assert known[name].amount is None and "not in the sensor's frame" in known[name].reason
    assert all(
        amount.amount is None for amount in only_known(known, {FRAME: "mirrored"}).values()
    )


def test_every_need_of_the_catalogue_can_be_in_doubt():
    assert {need for cause in CAUSES.values() for need in cause.needs} == {
        ONE_SWEEP,
        SAME_SWEEPS,
        POSITION,
        BEAMS,
        FINE,
        STEPS,
        UNCROPPED,
        ROAD,
        UPRIGHT,
        ENOUGH,
    }


def amounts_of(real, sim):
    """Amounts of the causes of a pair without ground cut, by cause."""
    sides = []
    for points in (real, sim):
        is_ground = points[:, 2] < ROAD_M
        sides.append(Side(points, is_ground, describe_sensor(points)))
    return estimate(PairScans(*sides)).amounts


def unknown_of(real, sim):
    """Reasons of unknown causes of a pair without ground cut, by cause."""
    amounts = amounts_of(real, sim)
    return {name: amount.reason for name, amount in amounts.items() if amount.amount is None}


def columns_of(scan):
    """Number of the firing of each point within the revolution."""
    azimuth_deg = np.degrees(np.arctan2(scan[:, 1], scan[:, 0])) + 180.0
    return np.round(azimuth_deg / describe_sensor(scan).azimuth_step_deg).astype(int)


def with_gaps(scan, n_gaps, width_deg):
    azimuth_deg = np.degrees(np.arctan2(scan[:, 1], scan[:, 0])) + 1.5
    return scan[azimuth_deg % (360.0 / n_gaps) > width_deg]


def test_even_sweeps_in_any_order_are_not_a_finer_azimuth_step(scan):
    rng = np.random.default_rng(0)
    step_deg = describe_sensor(scan).azimuth_step_deg
    twice = rng.permutation(np.vstack([scan, turned(scan, step_deg / 2)]))
    sensors = [describe_sensor(points) for points in (scan, twice)]
    assert sensors[1].doubts == {}
    doubts = doubts_of(*sensors)
    assert [*doubts] == [STEPS] and "2 sweeps in one scan, or a finer sensor?" in doubts[STEPS]
    assert doubts_of(sensors[0], sensors[0]) == {}
    model = SENSORS["hdl32"]
    usual = replace(sensors[1], model=model.title, azimuth_step_deg=model.azimuth_step_deg)
    coarse = replace(usual, azimuth_step_deg=2 * model.azimuth_step_deg)
    assert doubts_of(coarse, usual) == {}


def test_ranges_of_two_sweeps_of_a_moving_sensor_alternate():
    rng = np.random.default_rng(0)
    range_m = 20 + 3 * np.sin(np.arange(2000) / 300) + rng.normal(0, 0.02, 2000)
    beam = np.repeat([0, 1], 1000)
    sweep = Sweep(beam, np.zeros(2000), np.zeros(2000), range_m, beam)
    assert alternation_text(sweep) is None
    moving = replace(sweep, range_m=range_m + np.tile([0, 0.5], 1000))
    assert "ranges of a beam alternate" in alternation_text(moving)


def test_a_simulated_side_without_road_has_no_dead_beams(scan):
    above = scan[scan[:, 2] > ROAD_M]
    unknown = unknown_of(scan, above)
    assert all(
        "the road" in unknown[name] for name in ("beams", "lost returns", "blind sector")
    )


def test_a_real_side_without_road_has_no_invented_parts(scan):
    above = scan[scan[:, 2] > ROAD_M]
    unknown = unknown_of(above, scan)
    names = ("beams", "elevation noise", "invented parts", "clutter", "maximum range")
    assert {unknown[name] for name in names} == {
        "real scan: the road of the simulated scan is missing"
    }


def test_on_slopes_a_side_without_its_lowest_points_has_no_blind_directions():
    sides = []
    scan = make_pair(0, 3, SENSORS["hdl32"]).real.rows[:, :3].astype(float)
    for points in (scan, scan[scan[:, 2] > ROAD_M]):
        is_ground = np.zeros(len(points), dtype=bool)  # a cut that missed it
        sides.append(Side(points, is_ground, describe_sensor(points)))
    unknown = estimate(PairScans(*sides)).amounts["blind sector"].reason
    assert unknown == "simulated scan: the road of the real scan is missing"


def test_parts_between_few_returns_are_not_missing(scan):
    few = scan[np.random.default_rng(0).random(len(scan)) < 0.2]
    amounts = amounts_of(scan, few)
    for name in ("missing parts", "far surface", "maximum range", "beams"):
        assert abs(amounts[name].amount) < CAUSES[name].tolerance
    assert amounts_of(few, scan)["invented parts"].amount < CAUSES["invented parts"].tolerance


def test_what_few_returns_feign_is_unknown(scan):
    few = scan[np.random.default_rng(0).random(len(scan)) < 0.08]
    for pair, side in (((scan, few), "simulated"), ((few, scan), "real")):
        amounts = amounts_of(*pair)
        for name in ("missing parts", "invented parts", "flat shapes", "elevation noise"):
            assert amounts[name].reason.startswith(f"{side} scan: too few returns")
        assert abs(amounts["beams"].amount) < CAUSES["beams"].tolerance


def test_a_sensor_with_a_quarter_of_the_beams_lacks_beams_and_no_parts(scan):
    fewer = scan[describe_sensor(scan).beam_of(scan) % 4 == 0]
    amounts = amounts_of(scan, fewer)
    assert amounts["beams"].amount == pytest.approx(-24, abs=1)
    assert amounts["missing parts"].amount < CAUSES["missing parts"].tolerance


def test_uneven_firings_are_not_lost_returns(scan):
    kept = np.cumsum(np.random.default_rng(0).choice([4, 5], 600))
    uneven = scan[np.isin(columns_of(scan), kept)]
    sensor = describe_sensor(uneven)
    step_deg = describe_sensor(scan).azimuth_step_deg
    assert sensor.firing_deg == pytest.approx(4.5 * step_deg, rel=0.03)
    assert sensor.azimuth_step_deg == pytest.approx(4 * step_deg, rel=0.03)
    lost = amounts_of(scan, uneven)["lost returns"].amount
    assert abs(lost) < CAUSES["lost returns"].tolerance


def test_gaps_of_the_real_side_hold_no_invented_parts(scan):
    amounts = amounts_of(with_gaps(scan, 10, 4.0), scan)
    assert amounts["invented parts"].amount < CAUSES["invented parts"].tolerance
    assert amounts["blind sector"].amount == 0


def test_blind_directions_are_found_without_an_azimuth_step(scan):
    azimuth = np.random.default_rng(0).uniform(-0.01, 0.01, len(scan))
    turn = np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])
    shaken = np.column_stack([np.einsum("ijn,nj->ni", turn, scan[:, :2]), scan[:, 2]])
    assert describe_sensor(shaken).azimuth_step_deg is None
    blind_deg = amounts_of(shaken, with_gaps(shaken, 8, 5.0))["blind sector"].amount
    assert blind_deg == pytest.approx(40, abs=9)


def test_the_range_of_both_sides_is_compared_in_common_directions(scan):
    ahead = scan[np.abs(scan[:, 1]) < scan[:, 0]]
    near_ahead = ahead[np.linalg.norm(ahead, axis=1) < 40.0]
    behind = scan[scan[:, 0] < 0]
    amount = amounts_of(near_ahead, np.vstack([near_ahead, behind]))["maximum range"]
    assert amount.amount == 0
    nothing = Side(scan[:0], np.zeros(0, dtype=bool), describe_sensor(scan))
    whole = Side(scan, np.zeros(len(scan), dtype=bool), describe_sensor(scan))
    for sides in ((nothing, whole), (whole, nothing)):
        assert "no direction in common" in _maximum_range(*sides).reason


def test_beams_of_a_pattern_without_rings_are_not_counted(scan):
    rng = np.random.default_rng(0)
    partner = scan[cKDTree(scan).query(scan, k=4)[1][:, 3]]
    near = np.linalg.norm(partner - scan, axis=1) < 0.03 * np.linalg.norm(scan, axis=1)
    between = scan[near] + rng.random((near.sum(), 1)) * (partner - scan)[near]
    unknown = unknown_of(scan, between[between[:, 2] > -1.4])
    assert "beams" in unknown


def test_the_road_is_not_judged_on_a_range_image(scan):
    assert "range image" in unknown_of(of_image(scan), scan)["road height"]


def test_returns_at_the_minimum_range_are_not_clutter(scan):
    road = scan[np.linalg.norm(scan, axis=1) > 3.0]
    for range_m, is_clutter in ((3.05, False), (3.6, True)):
        angle = np.linspace(0.0, 6.0, 30)
        ring = np.column_stack([np.cos(angle), np.sin(angle), np.full(30, 0.3)])
        ring *= range_m / np.linalg.norm(ring, axis=1)[:, None]
        amount = amounts_of(road, np.vstack([road, ring]))["clutter"].amount
        assert (amount > 0) == is_clutter


@pytest.mark.parametrize("cropped", ["real", "sim"])
def test_a_sector_has_no_noise_of_elevations_nor_another_range(scan, cropped):
    sector = scan[np.abs(scan[:, 1]) < scan[:, 0]]
    real, sim = (sector, scan) if cropped == "real" else (scan, sector)
    assert unknown_of(real, sim)["elevation noise"] == "the fields of view differ"


def test_a_crop_is_not_a_shorter_range(scan):
    cropped = scan[(np.abs(scan[:, :2]) < 20).all(axis=1)]
    assert np.abs(cropped_box(cropped, scan)) == pytest.approx(20, abs=0.2)
    assert cropped_box(scan, cropped) is None
    near = scan[np.linalg.norm(scan, axis=1) < 25]
    assert cropped_box(near, scan) is None
    assert "cropped to x -20 to 20" in unknown_of(scan, cropped)["maximum range"]


def test_losses_are_unknown_if_only_one_side_has_an_azimuth_step(scan):
    sensor = describe_sensor(scan)
    without_step = replace(
        sensor, azimuth_step_deg=None, untold={"azimuth_step_deg": "no common distance"}
    )
    assert doubts_of(sensor, without_step) == {BEAMS: "simulated scan: no common distance"}
    assert doubts_of(without_step, without_step) == {}


@pytest.mark.parametrize("factor", [0.3, 0.7, 0.93, 1.08, 1.6, 4.0])
def test_a_scan_of_another_size_is_named_with_it(scan, factor):
    found = check_frames(scan, scan * factor, InputSettings())
    assert found.is_other_frame and found.reading.startswith("in units of")
    assert float(found.reading.split()[3]) == pytest.approx(1 / factor, rel=0.04)


def test_the_axes_of_unity_are_named_with_a_motion_that_fits(scan):
    unity = np.column_stack([-scan[:, 1], scan[:, 2], scan[:, 0]])
    found = check_frames(scan, unity, InputSettings())
    assert (found.reading, found.is_other_frame) == ("read as x right, y up, z forward", True)
    T = np.array(found.setting.split('"')[1].split(), dtype=float).reshape(3, 4)
    assert check_frames(scan, unity, InputSettings(sim_frame="carla"), T).as_it_lies > 0.95
    assert not any("kitti-cam" in text for text in implausible(unity, "sim", 2.5))


def test_angles_and_a_repeated_point_are_named(scan):
    level = np.hypot(scan[:, 0], scan[:, 1])
    angles = [
        np.arctan2(scan[:, 1], scan[:, 0]),
        np.arctan2(scan[:, 2], level),
        np.linalg.norm(scan, axis=1),
    ]
    for turn in (1.0, 180 / np.pi):
        for above in (angles[1], np.pi / 2 - angles[1]):
            columns = np.column_stack([angles[2], above * turn, angles[0] * turn])
            (text,) = implausible(columns, "sim", 2.5)
            assert "angles and ranges" in text
    repeated = np.vstack([scan, np.tile([1.2, 0.0, 1.8], (2 * len(scan), 1))])
    (text,) = implausible(repeated, "sim", 2.5)
    assert "67% of the points are one repeated point" in text
    assert implausible(scan, "sim", 2.5) == []


def test_second_returns_of_exactly_one_direction_are_all_found():
    rng = np.random.default_rng(0)
    first = rng.normal(size=(500, 3)) * [10, 10, 1]
    points = np.vstack([first, 1.5 * first])
    side = Side(points, np.zeros(len(points), dtype=bool), describe_sensor(points))
    rows = np.arange(len(points))
    assert not (side.near_rays(rows, 8)[1] == rows[:, None]).any()
    assert second_returns(side).tolist() == [False] * 500 + [True] * 500


def test_strays_are_unknown_if_no_side_has_beams(scan):
    above = scan + [0.0, 0.0, 1.5]
    side = Side(above, np.zeros(len(above), dtype=bool), describe_sensor(above))
    amount = _stray_amount(side, side)
    assert amount.amount is None and "do not lie on rings" in amount.reason


def test_losses_are_unknown_if_the_other_causes_take_all_points():
    points = np.random.default_rng(0).normal(size=(400, 3)) * [10, 10, 1]
    side = Side(points, np.zeros(400, dtype=bool), describe_sensor(points))
    nothing = np.zeros(400, dtype=bool)
    amounts = _losses(side, side, ~nothing, nothing, np.empty(0, dtype=int))
    assert {amounts[name].reason for name in LOSSES} == {"no surface that both sides see"}


@pytest.mark.parametrize(
    ("unit", "factor"), [("inches", 39.37), ("decimetres", 10.0), ("feet", 3.2808)]
)
def test_units_are_named(scan, unit, factor):
    found = check_frames(scan, scan * factor, InputSettings())
    assert (found.reading, found.doubt) == (
        f"in {unit}",
        f"the simulated scan is in another frame: in {unit}",
    )


def test_scans_of_two_places_are_in_doubt(scan):
    found = check_frames(scan, turned(scan, 45.0) + [6.0, 3.0, 0.0], InputSettings())
    assert found.doubt == "the two scans do not show the same place"


@pytest.mark.parametrize("scale", [1.0, 100.0, 1000.0])
def test_a_lifted_scan_is_named_in_any_unit(scan, scale):
    check = check_frames(scan, scale * (scan + [0, 0, 0.5]), InputSettings())
    assert check.is_suspect
    assert "-0.50 m in z" in check.reading
