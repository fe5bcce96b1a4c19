"""The tell-apart test on a street whose points are re-measured with known noise, and on random numbers."""

import numpy as np
import pytest

from fidpipe.schemas.errors import StageError
from fidpipe.stages.diagnose.tell_apart import (
    GUARD_DEG,
    describe_points,
    folds,
    separate,
)


@pytest.fixture(scope="module")
def corridor():
    """Road and walls, 40,000 points with 1 cm noise; the azimuth of each in degrees."""
    rng = np.random.default_rng(1)
    x, across, up = (
        rng.uniform(-30, 30, 40_000),
        rng.uniform(-6, 6, 40_000),
        rng.uniform(0, 4, 40_000),
    )
    kind = rng.integers(3, size=len(x))
    y = np.where(kind == 0, across, np.where(kind == 1, -6.0, 6.0))
    points = np.column_stack([x, y, np.where(kind == 0, 0.0, up) - 1.7])
    return points + rng.normal(0, 0.01, points.shape)


def compare(real, sim):
    """The test of both sides by all features, and the AUC of each feature alone."""
    rows = np.arange(0, len(real), 10)
    both = [describe_points(side, side[:, 2] + 1.7, rows) for side in (real, sim)]
    features = np.vstack([np.column_stack([*side.values()]) for side in both])
    azimuth_deg = np.concatenate(
        [np.degrees(np.arctan2(side[rows, 1], side[rows, 0])) for side in (real, sim)]
    )
    is_sim = np.repeat([False, True], len(rows))
    splits = folds(np.zeros(len(is_sim), dtype=np.int32), azimuth_deg, is_sim)
    alone = {
        name: separate(features[:, [i]], is_sim, splits).auc for i, name in enumerate(both[0])
    }
    return separate(features, is_sim, splits), alone


def test_two_halves_of_one_scan_are_indistinguishable(corridor):
    found, _ = compare(corridor[::2], corridor[1::2])
    assert found.low < 0.5 < found.high
    assert found.high - found.low < 0.1


def test_noise_is_recognised_by_roughness_and_position_is_not_recognised(corridor):
    real = corridor[::2]
    sim = corridor[1::2]
    noisy, alone = compare(real, sim + np.random.default_rng(2).normal(0, 0.03, sim.shape))
    assert noisy.low > 0.8
    assert max(alone, key=alone.get).startswith("roughness")
    moved, _ = compare(real, sim + [0.2, 0.0, 0.0])
    assert moved.low < 0.5 < moved.high


@pytest.mark.parametrize("n_places", [1, 4, 5, 23])
def test_places_and_sectors_are_tested_once_and_their_surroundings_are_not_trained_on(n_places):
    rng = np.random.default_rng(0)
    place = np.sort(rng.integers(n_places, size=2000)).astype(np.int32)
    azimuth = rng.uniform(-180, 180, 2000)
    tested = np.zeros(2000, dtype=int)
    for train, test in folds(place, azimuth, rng.random(2000) < 0.5):
        assert len(train)
        tested[test] += 1
        if n_places >= 5:
            assert np.abs(place[test][:, None] - place[train]).min() == 2
        else:
            assert (
                np.abs((azimuth[test][:, None] - azimuth[train] + 180) % 360 - 180).min()
                > GUARD_DEG
            )
    assert (tested == 1).all()


def test_points_of_one_side_only_are_an_error():
    rng = np.random.default_rng(0)
    azimuth = np.concatenate([rng.uniform(0, 20, 500), rng.uniform(180, 200, 500)])
    with pytest.raises(StageError, match="in 0 of"):
        folds(np.zeros(1000, dtype=np.int32), azimuth, azimuth > 90)
