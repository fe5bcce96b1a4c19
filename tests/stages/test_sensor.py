"""Sensors and plausibility of scans of a room that is known."""

from dataclasses import replace

import numpy as np
import pytest

from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import InputSettings
from fidpipe.stages.beam_patterns import BeamPattern, find_beams, recognise
from fidpipe.stages.generate.ray_casting import fire, measure_ranges
from fidpipe.stages.plausibility import implausible, inspect_points, widest_azimuth_gap_deg
from fidpipe.stages.sensor_description import beams_text, describe_sensor, sensor_lines
from runs import some_of
from scenes import road, street

CORNERS_M = np.array([[-18.0, -12.0, -1.8], [31.0, 9.0, 6.0]])  # of the room
TILT = np.array([[0.9962, 0, 0.0872], [0, 1, 0], [-0.0872, 0, 0.9962]])  # by five degrees
STEP_DEG = 0.4

# Elevations of units that are in no table. HDL-64E S3: velodyne_decoder, calibrations/HDL-64E_S3-xiesc.yml. OS1-64:
# ouster-sdk, tests/metadata/2_1_2_os1-991913000010-64.json. VLP-32A: velodyne_decoder, calibrations/VLP-32A.yml.
HDL64_S3 = """
-24.555 -24.147 -23.549 -22.966 -22.358 -21.976 -21.491 -21.064 -20.429 -19.892 -19.247 -18.923 -18.429 -17.964 -17.368
-16.801 -16.274 -15.906 -15.385 -14.927 -14.291 -13.806 -13.163 -12.83 -12.294 -11.913 -11.295 -10.754 -10.176 -9.744
-9.3 -8.775 -8.563 -8.219 -7.943 -7.552 -7.23 -6.849 -6.56 -6.19 -5.889 -5.483 -5.135 -4.809 -4.53 -4.157 -3.819 -3.469
-3.119 -2.792 -2.488 -2.091 -1.81 -1.459 -1.143 -0.756 -0.452 -0.089 0.204 0.591 0.895 1.293 1.562 1.96
"""
OS1_64 = """
-16.679 -16.078 -15.504 -14.968 -14.49 -13.902 -13.347 -12.807 -12.35 -11.777 -11.226 -10.687 -10.227 -9.66 -9.112
-8.572 -8.116 -7.563 -7.02 -6.471 -6.028 -5.472 -4.929 -4.391 -3.935 -3.386 -2.839 -2.3 -1.854 -1.39 -0.756 -0.205 0.239
0.787 1.337 1.88 2.328 2.881 3.424 3.967 4.419 4.961 5.504 6.056 6.513 7.049 7.594 8.149 8.603 9.138 9.693 10.251 10.704
11.251 11.801 12.378 12.837 13.381 13.937 14.526 14.995 15.543 16.118 16.729
"""
VLP32A = """
-14.3 -12.5 -10.7 -8.9 -7.0 -6.0 -4.9 -3.8 -2.5 -2.167 -1.834 -1.5 -1.167 -0.834 -0.5 -0.167 0.167 0.5 0.834 1.167 1.5
1.834 2.167 2.5 3.8 4.9 6.0 7.0 8.9 10.7 12.5 14.3
"""


def room(sensor, step_deg=STEP_DEG, lost_share=None):
    """Scan of a sensor tilted in the room, in its own frame, with the noise, quantum and losses of its model."""
    rng = np.random.default_rng(0)
    if sensor.column_deg and step_deg:
        step_deg = sensor.column_deg * round(step_deg / sensor.column_deg)
    directions = fire(sensor, step_deg=step_deg)
    steep = directions @ TILT.T
    steep = np.where(np.abs(steep) < 1e-9, 1e-9, steep)
    range_m = (np.where(steep > 0, CORNERS_M[1], CORNERS_M[0]) / steep).min(axis=1)
    answered = rng.random(len(range_m)) >= (
        sensor.lost_share if lost_share is None else lost_share
    )
    return (directions * measure_ranges(sensor, range_m, rng)[:, None])[answered]


def pattern(text):
    return BeamPattern(
        np.sort(np.array(text.split(), dtype=float)), 0.02, False, (), -90.0, 1.0
    )


def even(low, high, n):
    return replace(
        SENSORS["hdl64"],
        elevation_deg=tuple(np.linspace(low, high, n)),
        azimuth_offset_deg=(0.0,) * n,
        lost_share=0.0,
    )


@pytest.mark.parametrize("name", SENSORS)
def test_each_known_sensor_is_named_and_its_elevations_are_those_of_its_table(name):
    facts = describe_sensor(room(SENSORS[name]))
    assert facts.model == SENSORS[name].title
    np.testing.assert_allclose(
        facts.elevation_deg, np.sort(SENSORS[name].elevation_deg), atol=0.011
    )
    assert facts.is_sharp and facts.origin_height_m == ()


def test_step_quantum_noise_and_losses_are_those_of_the_model():
    facts = describe_sensor(room(SENSORS["vlp32c"], step_deg=None, lost_share=0.2))
    assert facts.azimuth_step_deg == pytest.approx(0.1991, abs=0.001)
    assert facts.range_quantum_m == 0.004
    assert facts.range_noise_m == pytest.approx(0.03, rel=0.15)
    assert facts.lost_share == pytest.approx(0.2, abs=0.02)
    assert facts.field_of_view_deg == pytest.approx((-25.0, 15.0, 360.0), abs=0.5)


def test_what_cannot_be_told_is_none_with_a_reason():
    facts = describe_sensor(room(replace(SENSORS["vlp16"], range_quantum_m=0.0)))
    assert facts.range_quantum_m is None and "no quantum" in facts.untold["range_quantum_m"]
    few = describe_sensor(np.ones((3, 3)))
    assert (
        few.elevation_deg == ()
        and few.model is None
        and "at least 500" in few.untold["elevation_deg"]
    )
    assert describe_sensor(np.full((900, 3), np.nan)).n_points == 0


@pytest.mark.parametrize(
    "change",
    [
        lambda points, rng: points @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]).T,
        lambda points, rng: points * [1, -1, 1],
        lambda points, rng: points[rng.random(len(points)) < 0.6],
        lambda points, rng: np.vstack([points, np.zeros((500, 3)), np.full((5, 3), np.nan)]),
    ],
    ids=["turned about z", "mirrored", "40 % lost", "zeros and NaN"],
)
def test_the_sensor_does_not_depend_on(change):
    points = room(SENSORS["hdl32"])
    before, after = (
        describe_sensor(points),
        describe_sensor(change(points, np.random.default_rng(1))),
    )
    assert after.model == before.model == "Velodyne HDL-32E"
    np.testing.assert_allclose(after.elevation_deg, before.elevation_deg, atol=0.01)
    assert after.azimuth_step_deg == pytest.approx(before.azimuth_step_deg, abs=1e-3)
    assert after.range_noise_m == pytest.approx(before.range_noise_m, rel=0.15)


def test_noise_of_the_angles_is_that_of_elevation_and_of_azimuth():
    points = room(SENSORS["vlp32c"])
    rng = np.random.default_rng(1)
    range_m = np.linalg.norm(points, axis=1)
    x, y, z = points.T
    level = np.arcsin(z / range_m)
    turn = np.arctan2(y, x)
    sharp = describe_sensor(points)
    assert max(sharp.elevation_noise_deg, sharp.azimuth_noise_deg) < 0.003
    for e_deg, a_deg in ((0.03, 0.0), (0.0, 0.02), (0.05, 0.02)):
        e = level + np.radians(e_deg) * rng.normal(size=len(x))
        a = turn + np.radians(a_deg) * rng.normal(size=len(x))
        noisy = range_m[:, None] * np.column_stack(
            [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]
        )
        found = describe_sensor(noisy)
        assert found.elevation_noise_deg == pytest.approx(e_deg, rel=0.1, abs=0.003)
        assert found.azimuth_noise_deg == pytest.approx(a_deg, rel=0.1, abs=0.003)
        assert found.range_noise_m == pytest.approx(sharp.range_noise_m, rel=0.3)


def test_noise_is_known_where_most_returns_are_lost():
    points = room(SENSORS["vlp32c"])
    thinned = points[np.random.default_rng(1).random(len(points)) < 0.3]
    assert describe_sensor(thinned).range_noise_m == pytest.approx(
        describe_sensor(points).range_noise_m, rel=0.1
    )


def test_the_order_of_rows_changes_no_bit():
    points = room(SENSORS["vlp32c"])
    assert describe_sensor(points[::-1]) == describe_sensor(points)


@pytest.mark.parametrize(
    "name", some_of(["vlp16", "hdl64", "os1-128", "pandar40p"], ["vlp16", "hdl64"])
)
@pytest.mark.parametrize(
    "change",
    [
        lambda points: points[:, [0, 2, 1]],
        lambda points: points[:, [2, 1, 0]],
        lambda points: points + [0, 0, 1.7],
        lambda points: points @ TILT.T,
    ],
    ids=["y and z exchanged", "x and z exchanged", "1.7 m up", "tilted by 5"],
)
def test_no_sensor_is_named_out_of_its_frame(name, change):
    assert describe_sensor(change(room(SENSORS[name]))).model is None


@pytest.mark.parametrize(
    ("low", "high", "n"),
    [(-24.8, 2.0, 64), (-25.0, 15.0, 32), (-15.0, 16.0, 16), (-22.5, 22.5, 128)],
)
def test_even_channels_are_no_known_sensors(low, high, n):
    facts = describe_sensor(room(even(low, high, n)))
    assert (facts.model, facts.is_even, len(facts.elevation_deg)) == (None, True, n)


def test_units_that_are_in_no_table_are_known_by_their_pattern():
    assert recognise(pattern(HDL64_S3)).title == "Velodyne HDL-64E"
    assert recognise(pattern(OS1_64)).title == "Ouster OS1-64 (gen 1)"
    halved = BeamPattern(pattern(HDL64_S3).elevation_deg[1::2], 0.02, False, (), -90.0, 1.0)
    assert recognise(halved).title == "every second beam of Velodyne HDL-64E"
    assert recognise(pattern(VLP32A)).title is None
    assert "at least 8" in recognise(pattern("-3 -2 0 1")).reason


def test_a_name_agrees_with_step_and_quantum():
    beams = pattern(" ".join(map(str, SENSORS["xt16"].elevation_deg)))
    assert recognise(beams).title == "Velodyne VLP-16 or Hesai PandarXT-16"
    assert (
        recognise(beams, 0.18, 0.004).title
        == recognise(beams, None, 0.004).title
        == "Hesai PandarXT-16"
    )
    assert (
        recognise(beams, 0.1991).title
        == recognise(beams, None, 0.002).title
        == "Velodyne VLP-16"
    )
    neither = recognise(beams, 0.18, 0.05)
    assert neither.title is None and "2 mm, not 50 mm" in neither.reason
    ouster = recognise(pattern(OS1_64), 0.2)
    assert ouster.reason.endswith("0.176 degrees, not 0.200")


def test_beams_without_returns_are_counted_against_the_table():
    points = room(SENSORS["pandar40p"])
    slope_deg = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    facts = describe_sensor(points[(slope_deg < 13) & (slope_deg > -22)])
    assert beams_text(facts) == "38 of 40 beams, -19 to +11 degrees, uneven: Hesai Pandar40P"
    assert beams_text(describe_sensor(room(even(-24.8, 2.0, 64)))).startswith(
        "at least 64 beams, "
    )


@pytest.mark.parametrize(
    ("heights_m", "text"),
    [
        ((-0.12,), "-0.12 m from the origin"),
        ((0.11, 0.19), "+0.11 and +0.19 m from the origin"),
        ((-0.02, 0.1), "-0.02 and +0.1 m from the origin"),
    ],
)
def test_heights_are_above_or_below_the_origin(heights_m, text):
    facts = replace(describe_sensor(room(SENSORS["vlp16"])), origin_height_m=heights_m)
    assert f"beams start: {text}" in sensor_lines(facts)


def test_two_blocks_of_beams_that_start_above_the_origin_are_seen_through():
    points = room(SENSORS["hdl64"])
    slope_deg = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    points[:, 2] += np.where(slope_deg < -8.6, 0.12, 0.2)
    facts = describe_sensor(points)
    assert facts.origin_height_m == pytest.approx((0.12, 0.2), abs=0.011)
    assert facts.model == "Velodyne HDL-64E"
    assert len(facts.elevation_deg) == 64


def test_rings_tell_the_beams_of_a_scan_that_is_smeared():
    points = room(SENSORS["hdl32"], lost_share=0.0)
    ring = np.tile(np.arange(32), int(360 / STEP_DEG))
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    smeared = points + np.column_stack([1.5 * turn, 0 * turn, 0.2 * turn])
    facts = describe_sensor(smeared, ring)
    assert (facts.model, len(facts.elevation_deg)) == ("Velodyne HDL-32E", 32)
    assert not describe_sensor(smeared).is_sharp
    assert (
        describe_sensor(points, np.zeros(len(points), dtype=np.int32)).model
        == "Velodyne HDL-32E"
    )


def test_points_anywhere_lie_in_no_beams():
    cloud = np.random.default_rng(0).uniform(-20, 20, (20_000, 3))
    assert "is the scan moved or tilted" in find_beams(cloud)


@pytest.mark.parametrize("with_rings", [False, True])
@pytest.mark.parametrize("name", ["vlp32c", "vlp16"])
def test_beams_that_cross_before_the_axis_are_those_of_a_sensor_whose_beams_do_so_there(
    name, with_rings
):
    sensor = SENSORS[name]
    points = room(sensor, lost_share=0.0)
    level = np.hypot(points[:, 0], points[:, 1])
    # in a room so small that it matters
    points[:, :2] *= ((0.4 * level + sensor.focal_m) / level)[:, None]
    points[:, 2] *= 0.4
    ring = np.tile(np.arange(sensor.n_beams), int(360 / STEP_DEG)) if with_rings else None
    facts = describe_sensor(points, ring)
    assert (facts.model, facts.focal_m) == (sensor.title, sensor.focal_m)
    np.testing.assert_allclose(facts.elevation_deg, np.sort(sensor.elevation_deg), atol=0.02)
    assert f"beams cross: {1e3 * sensor.focal_m:.1f} mm before the axis" in sensor_lines(facts)


def test_a_focal_distance_of_another_sensor_names_none():
    crossing = replace(
        pattern(" ".join(map(str, SENSORS["pandar40p"].elevation_deg))), focal_m=0.0424
    )
    assert recognise(crossing).title is None
    assert recognise(replace(crossing, focal_m=0.0)).title == "Hesai Pandar40P"


def test_rings_that_lie_upon_each_other_are_no_beams(rng):
    angle = np.linspace(0, 2 * np.pi, 2000)
    flat = 10 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(2000)])
    assert describe_sensor(flat, rng.integers(0, 32, 2000).astype(np.int32)).model is None


def test_plausible_scans_raise_no_warning():
    assert implausible(np.vstack([street(), road(3000, 40)]), "real", 2.5) == []


@pytest.mark.parametrize(
    ("change", "warning"),
    [
        (lambda p: p + [481000.0, 0, 0], "are they projected"),
        (lambda p: p + [4000, 9000, 0], "are they projected"),
        (lambda p: p * 100, "or in another unit?"),
        (lambda p: p / 100, "expected metres"),
        (lambda p: p[:, [2, 1, 0]], "are the columns right"),
        (
            lambda p: np.vstack([p, np.random.default_rng(0).uniform(-1, 1, (3 * len(p), 3))]),
            "hits on the ego vehicle",
        ),
    ],
)
def test_an_implausible_scan_is_warned_of(change, warning):
    assert any(warning in text for text in implausible(change(street()), "sim", 2.5))


def test_half_the_points_not_finite_is_a_warning():
    scan = street()
    scan[::2] = np.nan
    assert "50% of the points" in inspect_points(scan, "sim", InputSettings()).warnings[-1]


def test_camera_axes_are_named_with_the_setting_of_the_side():
    scan = np.vstack([street(), road(3000, 40)])
    (odd,) = implausible(scan[:, [1, 2, 0]] * [-1, -1, 1], "real", 2.5)  # right, down, forward
    assert "is z up" in odd and "input.real_frame" in odd


def test_axes_that_a_motion_turns_upright_are_not_named():
    scan = np.vstack([street(), road(3000, 40)])
    y_up = scan[:, [0, 2, 1]] * [1, 1, -1]
    T_real_sim = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0]])
    assert len(inspect_points(y_up, "sim", InputSettings()).warnings) == 1
    assert not inspect_points(y_up, "sim", InputSettings(), T_real_sim).warnings


def test_near_hits_are_told_with_what_the_present_settings_leave_of_them():
    ring = 2.0 * np.column_stack(
        [np.cos(np.arange(3000)), np.sin(np.arange(3000)), np.zeros(3000)]
    )
    scan = np.vstack([road(1000), ring])
    (dropped,) = implausible(scan, "real", 2.5)
    assert "0.2%" in dropped and "input.min_range_m=2.5" in dropped
    (left,) = implausible(scan, "real", 1.0)
    assert all(
        words in left
        for words in (
            "75.3%",
            "input.min_range_m=1",
            "input.min_range_m=3",
            "input.exclude_box",
        )
    )


def test_the_widest_gap_is_found_across_the_seam():
    angles = np.radians(np.arange(-60, 61, 5))
    assert widest_azimuth_gap_deg(
        np.column_stack([-np.cos(angles), np.sin(angles), angles])
    ) == pytest.approx(240)


def test_a_reach_beyond_all_measure_is_told_in_short():
    (text, *_) = implausible(street() * 1e300, "real", 2.5)
    assert text.startswith("coordinates reach 2e+301 m; ")
