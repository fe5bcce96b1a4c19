"""Small flaws of a measurement that once looked like another cause: they are not named."""

import numpy as np
import pytest

from fidpipe.pipeline.results.diagnosis import confirm, unexplained_share
from fidpipe.schemas.results import Cause
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.stages.causes.estimates import estimate
from fidpipe.stages.causes.sides import PairScans, Side
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.sensor_description import describe_sensor

ROAD_M = 0.3  # above the lowest points


@pytest.fixture(scope="module")
def street():
    """A street scanned by an HDL-32E, whose beams are 4/3 degrees apart: every third lies at an even elevation."""
    sensor = SENSORS["hdl32"]
    points = make_pair(7, 0, sensor).real.rows[:, :3].astype(float)
    return points[np.linalg.norm(points, axis=1) > 1.0]


def side_of(points):
    lowest_m = np.quantile(points[:, 2], 0.02)
    return Side(points, points[:, 2] < lowest_m + ROAD_M, describe_sensor(points))


def again(points, seed, loss=0.02):
    rng = np.random.default_rng(seed)
    kept = points[rng.random(len(points)) >= loss]
    return kept * (
        1 + rng.normal(0, 0.01, (len(kept), 1)) / np.linalg.norm(kept, axis=1, keepdims=True)
    )


def test_beams_at_the_edges_of_cells_are_not_lost(street):
    tilt = np.radians(0.02)
    tilted = again(street, 0) @ np.array(
        [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
    )
    amounts = estimate(PairScans(side_of(street), side_of(tilted))).amounts
    assert amounts["lost returns"].amount == pytest.approx(0.02, abs=0.004)


def test_missing_beams_are_not_lost_returns(street):
    real = side_of(street)
    beam = real.sensor.beam_of(street)
    left = street[~np.isin(beam, (4, 9, 15, 18, 22, 27))]
    amounts = estimate(PairScans(real, side_of(again(left, 1)))).amounts
    assert amounts["beams"].amount == -6
    assert abs(amounts["lost returns"].amount) < 0.05


def test_a_road_of_another_slope_is_not_a_tilted_sensor(street):
    is_road = side_of(street).is_ground
    sloped = street.copy()
    sloped[is_road, 2] += 0.01 * street[is_road, 0]
    amounts = estimate(PairScans(side_of(street), side_of(again(sloped, 3)))).amounts
    assert amounts["pitch"].share == 0.0
    tilt = np.radians(0.57)
    tilted = street @ np.array(
        [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
    )
    amounts = estimate(PairScans(side_of(street), side_of(again(tilted, 3)))).amounts
    assert amounts["pitch"].share > 0.5


def test_a_second_measurement_is_at_the_best_case(street):
    estimates = estimate(PairScans(side_of(street), side_of(again(street, 2))))
    assert (
        unexplained_share((estimates.distance_m, estimates.distance_m, estimates.best_case_m))
        is None
    )


def cause(name):
    words = {"name": name, "kind": "sensor", "words": name, "setting": "", "unit": "m"}
    return Cause(
        **words, estimate=0.1, low=0.05, high=0.15, n_pairs=3, real=None, sim=None, share=0.2
    )


def test_a_cause_whose_correction_brings_nothing_closer_is_doubtful():
    causes = [cause("height"), cause("range noise"), cause("elevation noise")]
    confirmed, doubtful = confirm(
        causes, {"height": 0.001, "range noise": 0.03}, (0.10, 0.06, 0.02)
    )
    assert [item.name for item in confirmed] == ["range noise", "elevation noise"]
    assert [item.name for item in doubtful] == ["height"]
    assert confirmed[0].gain == pytest.approx(0.03 / 0.08)
    assert unexplained_share((0.10, 0.06, 0.02)) == pytest.approx(0.5)


def test_within_the_accuracy_of_a_second_measurement_a_gain_is_a_part_of_the_whole_distance():
    confirmed, doubtful = confirm(
        [cause("lost returns")], {"lost returns": 0.002}, (0.10, 0.098, 0.098)
    )
    assert not confirmed
    assert doubtful[0].gain is None
