"""Times of points by hand: a turn of a tenth of a second, and each way in which its times can be wrong."""

import numpy as np
import pytest

from fidpipe.stages.inspect.stamps import describe_stamps, stamp_differences

TURN_S = 0.1


def turn(n=6000, way=-1):
    """Points and times of one turn, 16 beams, clockwise as a Velodyne goes."""
    share = np.arange(n) / n
    azimuth = way * 2 * np.pi * share + 1.0
    points = np.column_stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), np.arange(n) % 16 - 8.0])
    return points, TURN_S * share


def faults(times, points=None, stamp_s=None):
    return describe_stamps(times, turn()[0] if points is None else points, stamp_s).faults


def test_a_turn_whose_times_are_right_has_no_fault():
    points, times = turn()
    facts = describe_stamps(times, points, 0.0)
    assert (facts.faults, facts.place, facts.rotation) == ((), "first", -1)
    assert facts.span_s == pytest.approx(TURN_S, rel=1e-3)
    assert describe_stamps(times, points * [1, -1, 1]).rotation == 1


@pytest.mark.parametrize("wrong", [np.nan, 0.0])
def test_half_as_many_times_as_points_are_seen(wrong):
    _, times = turn()
    times[::2] = wrong
    (fault,) = faults(times)
    assert fault.startswith("50% of the points have no time")


def test_fewer_times_than_points_are_counted():
    assert faults(turn()[1][:3000]) == ("expected 6000 times, one per point, got 3000",)


def test_one_time_for_all_points_is_named():
    (fault,) = faults(np.full(6000, 1.7e9))
    assert fault.startswith("all points have one time")


def test_points_without_a_return_need_no_time():
    points, times = turn()
    points[::2], times[::2] = 0.0, 0.0
    points[1::4], times[1::4] = np.nan, np.nan
    assert faults(times, points) == ()


@pytest.mark.parametrize(
    ("scale", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds"), (1e-6, "seconds")]
)
def test_another_unit_is_named(scale, unit):
    (fault,) = faults(scale * turn()[1])
    assert f"are they in {unit}" in fault


@pytest.mark.parametrize(
    "shuffle",
    [lambda times: np.random.default_rng(0).permutation(times), lambda times: np.sort(times.reshape(-1, 16).T.ravel())],
    ids=["anyhow", "by row of a file that is sorted by beam"],
)
def test_times_of_other_points_do_not_go_round(shuffle):
    points, times = turn()
    points = points.reshape(-1, 16, 3).swapaxes(0, 1).reshape(-1, 3)  # beam by beam, as organised clouds are
    right = times.reshape(-1, 16).T.ravel()
    assert faults(right, points) == ()
    assert faults(shuffle(right), points) == ("times do not follow the azimuth; do they belong to other points?",)


@pytest.mark.parametrize(("place", "at"), [("first", 0.0), ("middle", 0.5), ("last", 1.0)])
@pytest.mark.parametrize("is_relative", [True, False])
def test_it_is_told_of_which_point_the_time_of_the_scan_is(place, at, is_relative):
    points, times = turn()
    stamp_s = 1713492677.1
    times = times - at * TURN_S + (0 if is_relative else stamp_s)
    facts = describe_stamps(times, points, stamp_s)
    assert (facts.place, facts.faults) == (place, ())
    assert describe_stamps(times, points).place is None


def test_a_time_of_the_scan_outside_of_its_turn_is_a_fault():
    points, times = turn()
    (fault,) = faults(1.7e9 + times, points, 1.7e9 + 5.0)
    assert "the scan's own time is +5.000 s after its first point" in fault


def test_sides_whose_times_are_of_other_points_or_go_another_way_differ():
    points, times = turn()
    first, last = describe_stamps(times, points, 0.0), describe_stamps(times - TURN_S, points * [1, -1, 1], 0.0)
    assert stamp_differences(first, first) == stamp_differences(first, None) == []
    places, ways = stamp_differences(first, last)
    assert (
        "of its first point, the time of a simulated scan that of its last point: scans with the same time are 0.1 s"
        in places
    )
    assert ways == "by the times, the real sensor rotates clockwise and the simulated one anticlockwise"


def test_few_and_no_returns_are_not_judged():
    assert describe_stamps(np.empty(0), np.empty((0, 3))).faults == ()
    assert faults(np.linspace(0, 0.1, 100), turn()[0][:100]) == ()
    ahead = turn()[0]
    ahead = np.abs(ahead) * [1, 1, 1]  # a quarter of a turn: no spinning sensor's
    assert faults(np.random.default_rng(0).permutation(turn()[1]), ahead) == ()
