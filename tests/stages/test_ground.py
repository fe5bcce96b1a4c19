import os

import numpy as np
import pytest

from fidpipe import evaluate_pair
from fidpipe.schemas.errors import StageError
from fidpipe.schemas.settings import GroundSettings
from fidpipe.stages.ground import remove_ground
from scenes import box, road, street


def tilted(points, degrees):
    a = np.radians(degrees)
    R = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return points @ R.T


def test_the_road_goes_and_the_car_stays():
    walls = np.vstack([box([0, y, 2.2], [30, 0.2, 6], 400) for y in (-12, 12)])
    scan = np.vstack([road(1500), box([8, 4, -0.6], [4, 1.8, 1.2], 200), walls])
    cut = remove_ground(scan, GroundSettings())
    assert cut.is_ground[:1500].mean() > 0.99
    assert cut.is_ground[1500:1700].mean() < 0.05
    assert cut.is_ground[1700:].mean() < 0.1
    assert cut.peak_m == pytest.approx(-1.7, abs=0.05)
    np.testing.assert_allclose(cut.height_m, scan @ cut.axis - cut.peak_m)


def test_fewer_than_eight_points_are_refused():
    with pytest.raises(StageError, match="got 7"):
        evaluate_pair(road(7), road(900))


def test_the_threshold_is_lowered_until_the_loss_is_allowed_and_ends_at_the_peak():
    rng = np.random.default_rng(3)
    # a rough road
    low = np.column_stack([rng.uniform(-15, 15, (900, 2)), rng.uniform(-1.8, -1.3, 900)])
    scan = np.vstack([low, box([8, 0, -0.6], [3, 3, 1.5], 100)])
    strict = remove_ground(scan, GroundSettings(max_variance_loss=0.0))
    assert strict.threshold_m == strict.peak_m
    assert strict.iterations == 6  # 0.30 m in steps of 0.05 m
    lenient = remove_ground(scan, GroundSettings(max_variance_loss=1.0))
    assert lenient.iterations == 0
    assert lenient.threshold_m == pytest.approx(lenient.peak_m + 0.30)


def test_a_steep_axis_falls_back_to_plus_z_and_says_so():
    scan = tilted(street(2), 25)
    cut = remove_ground(scan, GroundSettings(prior_m=0.1))
    assert cut.tilt_deg > 10
    assert cut.axis.tolist() == [0, 0, 1]
    assert "tilted" in cut.notes[0]


def test_without_near_points_the_peak_is_that_of_all_points_and_it_says_so():
    far = street(0) + [60, 0, 0]
    cut = remove_ground(far, GroundSettings())
    (note,) = cut.notes
    assert "30 m" in note


def two_levels(seed, lift_m=0.0):
    """Road in stripes of two heights, equally many points each, and two walls; 3 % loss and 3 cm noise by seed."""
    rng = np.random.default_rng(seed)
    upper = road(2000, z=-1.71 + lift_m, seed=9)
    upper[:, 0] -= upper[:, 0] % 12 / 2  # every other stripe of 6 m
    ground = np.vstack([upper, upper + [6, 0, -0.15]])
    walls = np.vstack([box([0, y, 2.2], [30, 0.2, 6], 800, seed=9) for y in (-12, 12)])
    scan = np.vstack([ground, walls])[rng.random(5600) > 0.03]
    return scan + rng.normal(0, 0.03, scan.shape)


def test_own_peaks_jump_between_two_road_levels_and_that_of_the_real_side_does_not():
    settings = GroundSettings(peak="real")
    real = two_levels(0)
    sims = [two_levels(seed) for seed in range(1, 7)]
    own = remove_ground(real, settings)
    assert max(abs(remove_ground(sim, settings).peak_m - own.peak_m) for sim in sims) > 0.05
    for sim in sims:
        cut = remove_ground(sim, settings, own, real)
        assert cut.peak_m == pytest.approx(own.peak_m, abs=0.01)
        assert cut.threshold_m - cut.peak_m == pytest.approx(
            own.threshold_m - own.peak_m, abs=1e-12
        )


@pytest.mark.parametrize("lift_m", [-0.5, -0.1, 0.2])
def test_the_simulated_cut_follows_a_road_that_lies_lower_or_higher(lift_m):
    real = two_levels(0)
    own = remove_ground(real, GroundSettings())
    whole_scan = remove_ground(
        two_levels(1) + [0, 0, lift_m], GroundSettings(peak="real"), own, real
    )
    road_alone = remove_ground(two_levels(1, lift_m), GroundSettings(peak="real"), own, real)
    for cut in (whole_scan, road_alone):
        assert cut.peak_m - own.peak_m == pytest.approx(lift_m, abs=0.01)
        assert cut.threshold_m - own.threshold_m == pytest.approx(lift_m, abs=0.01)


def test_the_simulated_cut_is_its_own_where_the_sides_share_no_road():
    real = street(0)
    sim = street(1) + [40, 0, 0]
    alone = remove_ground(sim, GroundSettings())
    cut = remove_ground(
        sim, GroundSettings(peak="real"), remove_ground(real, GroundSettings()), real
    )
    assert (cut.peak_m, cut.threshold_m) == (alone.peak_m, alone.threshold_m)
    assert "20 cells" in cut.notes[-1]


def test_simulated_road_that_rises_out_of_the_cut_is_road_where_the_real_scan_has_road():
    walls = np.vstack([box([0, y, 2], [40, 0.2, 6], 800, seed=3) for y in (-40, 40)])
    box_on_road = box([15, 0, -0.7], [0.5, 0.5, 0.6], 60, seed=2)
    flat = road(3000, z=-1.7, seed=1)
    rise = np.where((flat[:, 0] > 10) & (flat[:, 0] < 20), 0.25, 0.0)[:, None] * [0, 0, 1]
    real = np.vstack([flat + rise, walls])
    sim = np.vstack([flat + 1.8 * rise, walls, box_on_road])
    settings = GroundSettings(peak="real", max_variance_loss=1)
    own = remove_ground(real, settings)
    alone = remove_ground(sim, settings)
    cut = remove_ground(sim, settings, own, real)
    assert not alone.is_ground[:3000].all()
    assert cut.is_ground[:3000].all()
    assert not cut.is_ground[-60:].any(), "a box on the road is an object"


def test_patchwork_takes_the_road():
    pytest.importorskip("pypatchworkpp")
    scan = np.vstack([road(20000, 25.0), box([8, 4, -0.3], [4, 1.8, 1.2], 800)])
    cut = remove_ground(scan, GroundSettings(method="patchwork"))
    assert cut.is_ground[:20000].mean() > 0.9
    assert cut.is_ground[20000:].mean() < 0.1
    assert cut.threshold_m is None


def test_patchwork_writes_nothing_to_the_standard_output(capfd):
    pytest.importorskip("pypatchworkpp")
    remove_ground(street(), GroundSettings(method="patchwork"))
    os.write(1, b"results go on")
    assert capfd.readouterr() == ("results go on", "")
