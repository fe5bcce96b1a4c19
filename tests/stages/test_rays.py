"""Rays and intensities of two scans of a room whose walls, losses and materials are known, and of real recordings."""

import numpy as np
import pytest

from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.stages.generate.ray_casting import fire
from fidpipe.stages.intensity import explained_share, intensity_law, score_intensity
from fidpipe.stages.rays import OUTCOMES, Rays, find_rays, score_rays
from fidpipe.stages.sensor_description import SensorDescription, describe_sensor

STEP_DEG = 0.4
CORNERS_M = np.array([[-18.0, -12.0, -1.8], [31.0, 9.0, 6.0]])


def grid(name="vlp16", step_deg=STEP_DEG):
    elevation_deg = tuple(sorted(SENSORS[name].elevation_deg))
    return SensorDescription(0, elevation_deg, azimuth_step_deg=step_deg)


def room(name="vlp16", step_deg=STEP_DEG, turned_deg=0.0, corners_m=CORNERS_M):
    """Returns of a sensor inside a box, one per firing."""
    directions = fire(SENSORS[name], step_deg=step_deg)
    angle = np.radians(turned_deg)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    directions = directions @ turn.T
    steep = np.where(np.abs(directions) < 1e-9, 1e-9, directions)
    range_m = (np.where(steep > 0, corners_m[1], corners_m[0]) / steep).min(axis=1)
    return directions * range_m[:, None]


def counts(rays):
    return dict(
        zip(OUTCOMES, np.bincount(rays.outcome, minlength=len(OUTCOMES)).tolist(), strict=True)
    )


def test_a_scan_against_itself_is_the_same_on_all_rays():
    scan = room()
    rays = find_rays(scan, scan, (grid(), grid()))
    assert counts(rays) == dict.fromkeys(OUTCOMES, 0) | {"same": len(scan)}
    assert (rays.real_row == rays.sim_row).all()
    scores = score_rays(rays)
    assert (scores["rays_same"], scores["rays_hit_f1"]) == (1, 1)
    assert (scores["rays_bias_m"], scores["rays_rmse_m"]) == pytest.approx((0, 0), abs=1e-12)
    assert scores["rays_drop_f1"] is None


def test_no_two_rays_share_a_cell_and_rays_without_any_return_are_listed():
    scan = room()
    seen = scan[scan[:, 0] > 0]
    rays = find_rays(seen, seen, (grid(), grid()))
    cells = set(zip(rays.beam.tolist(), rays.column.tolist(), strict=True))
    assert len(cells) == len(rays.beam) == len(scan)
    assert counts(rays)["none"] == len(scan) - len(seen)
    assert score_rays(rays)["rays_drop_f1"] == 1


@pytest.mark.parametrize("name", ["vlp16", "vlp32c", "hdl64"])
def test_lost_returns_of_either_side_are_counted_one_by_one(name):
    scan = room(name)
    is_kept = np.random.default_rng(0).random(len(scan)) > 0.2
    n_lost = int((~is_kept).sum())
    lost = counts(find_rays(scan, scan[is_kept], (grid(name), grid(name))))
    assert lost["dropped"] + lost["no_surface"] == pytest.approx(n_lost, rel=0.02)
    assert lost["same"] == len(scan) - n_lost
    invented = counts(find_rays(scan[is_kept], scan, (grid(name), grid(name))))
    assert invented["sim_only"] == pytest.approx(n_lost, rel=0.02)


def test_a_lost_return_is_dropped_next_to_simulated_surface_and_else_on_no_surface():
    scan = room()
    ahead = scan[:, 0] > 20  # a wall that the simulation lacks
    outcome = counts(find_rays(scan, scan[~ahead], (grid(), grid())))
    assert outcome["no_surface"] > 0.8 * ahead.sum()
    assert outcome["no_surface"] + outcome["dropped"] == ahead.sum()


@pytest.mark.parametrize(("factor", "added_m"), [(1.03, 0.0), (0.995, 0.0), (1.0, 0.05)])
def test_bias_and_scale_of_the_range_are_found(factor, added_m):
    scan = room()
    range_m = np.linalg.norm(scan, axis=1)[:, None]
    noisy = scan * (1 + np.random.default_rng(0).normal(0, 0.02, range_m.shape) / range_m)
    scores = score_rays(find_rays(scan, noisy * (factor + added_m / range_m), (grid(), grid())))
    if added_m:
        assert scores["rays_bias_low_m"] <= added_m <= scores["rays_bias_high_m"]
        assert scores["rays_bias_m"] == pytest.approx(added_m, rel=0.05)
    else:
        assert scores["rays_scale"] == pytest.approx(factor - 1, abs=2e-4)


def test_columns_that_lie_between_those_of_the_real_sensor_change_no_range_of_a_plane():
    inside = np.array([[-18.0, -12.0, -100.0], [31.0, 9.0, 100.0]])  # walls alone
    turned = room(corners_m=inside, turned_deg=0.15)
    rays = find_rays(room(corners_m=inside), turned, (grid(), grid()))
    both = np.isfinite(rays.real_range_m) & np.isfinite(rays.sim_range_m)
    assert both.mean() > 0.99
    assert np.quantile(np.abs(rays.sim_range_m - rays.real_range_m)[both], 0.95) < 1e-6


@pytest.mark.parametrize("step_deg", [0.2, 0.36])
def test_returns_of_a_finer_grid_are_no_rays_of_their_own(step_deg):
    outcome = counts(
        find_rays(room(), room(step_deg=step_deg), (grid(), grid(step_deg=step_deg)))
    )
    n = len(room())
    assert outcome["sim_only"] < 0.02 * n
    assert outcome["same"] > 0.95 * n


def test_a_nearer_and_a_farther_wall_are_in_front_and_behind():
    near = CORNERS_M * [1, 0.9, 1]
    far = CORNERS_M * [1, 1.2, 1]
    assert counts(find_rays(room(), room(corners_m=near), (grid(), grid())))["in_front"] > 100
    assert counts(find_rays(room(), room(corners_m=far), (grid(), grid())))["behind"] > 100


def test_incidence_is_the_angle_to_the_wall():
    scan = room()
    rays = find_rays(scan, scan, (grid(), grid()))
    hit = scan[rays.real_row]
    ahead = np.isclose(hit[:, 0], 31.0) & (np.abs(hit[:, 1]) < 5) & (np.abs(hit[:, 2]) < 1)
    truth = np.degrees(np.arccos(hit[ahead, 0] / np.linalg.norm(hit[ahead], axis=1)))
    assert np.median(np.abs(rays.incidence_deg[ahead] - truth)) < 0.1


def test_without_beams_or_from_another_place_there_is_a_reason_in_place_of_rays():
    scan = room("vlp32c", 0.2)
    sensor = describe_sensor(scan)
    cloud = np.random.default_rng(0).uniform(-20, 20, (5000, 3))
    assert "simulated scan: " in find_rays(scan, cloud, (sensor, describe_sensor(cloud)))
    away = np.column_stack([np.eye(3), [0.5, 0, 0]])
    assert "0.50 m" in find_rays(scan, scan, (sensor, sensor), away)
    here = np.column_stack([np.eye(3), [0, 0, 0]])
    assert counts(find_rays(scan, scan, (sensor, sensor), here))["same"] == len(scan)


def unity(path):
    """Returns in rows of known order; zeros for rays without one."""
    columns = np.loadtxt(path, delimiter=",", skiprows=1)
    return columns[:, [4, 2, 3]] * [1, -1, 1]


def test_rays_paired_by_direction_are_those_of_the_known_rows(real_data):
    names = ("", "_Precise")
    scans = [
        unity(real_data / "unity_vlp16" / f"Geometric_16Channel__First_Frame{name}.csv")
        for name in names
    ]
    rows = [np.flatnonzero(np.linalg.norm(scan, axis=1) > 0.5) for scan in scans]
    real = scans[0][rows[0]]
    sim = scans[1][rows[1]]
    rays = find_rays(real, sim, (describe_sensor(real), describe_sensor(sim)))
    both = rays.outcome < OUTCOMES.index("dropped")
    real_row = rows[0][rays.real_row[both]]
    sim_row = rows[1][rays.sim_row[both]]
    assert both.sum() >= len(np.intersect1d(*rows))
    assert (real_row == sim_row).mean() > 0.99
    by_row = np.linalg.norm(scans[1][sim_row], axis=1) - np.linalg.norm(
        scans[0][real_row], axis=1
    )
    paired = (rays.sim_range_m - rays.real_range_m)[both]
    assert np.median(np.abs(paired - by_row)) < 0.03  # both versions round their directions


SCANS = {
    "vlp32c": ("rellis/vel000104.bin", 4),
    "hdl64": ("kitti_sequence/000000.bin", 4),
    "os1": ("rellis/000104.bin", 4),
}


@pytest.mark.parametrize("name", SCANS)
def test_a_real_scan_measured_again_shows_its_losses_and_errors_of_range(real_data, name):
    path, n_columns = SCANS[name]
    scan = np.fromfile(real_data / path, np.float32).reshape(-1, n_columns)[:, :3].astype(float)
    scan = np.unique(scan[(np.linalg.norm(scan, axis=1) > 2.5)], axis=0)
    sensor = describe_sensor(scan)
    rng = np.random.default_rng(1)
    range_m = np.linalg.norm(scan, axis=1)[:, None]
    noisy = scan * (1 + rng.normal(0, 0.02, range_m.shape) / range_m)
    is_lost = rng.random(len(scan)) < np.where(range_m[:, 0] > 20, 0.3, 0.05)
    rays = find_rays(scan, noisy[~is_lost] * (1 + 0.05 / range_m[~is_lost]), (sensor, sensor))
    is_single = np.isin(rays.outcome, [OUTCOMES.index("dropped"), OUTCOMES.index("no_surface")])
    for is_far in (False, True):
        own = (rays.real_range_m > 20) == is_far
        n = (is_lost & ((range_m[:, 0] > 20) == is_far)).sum()
        assert (is_single & own).sum() == pytest.approx(n, abs=max(0.05 * n, 3 * np.sqrt(n)))
    assert score_rays(rays)["rays_bias_m"] == pytest.approx(0.05, rel=0.05)


def test_a_beam_with_more_returns_than_columns_turns_no_other_ray():
    beam = np.repeat([0, 1], [10, 14]).astype(np.int32)
    column = np.r_[np.arange(10), np.arange(14)].astype(np.int32)
    filled = {name: np.zeros(24) for name in ("real_range_m", "sim_range_m", "incidence_deg")}
    none = {name: np.zeros(24, np.int32) for name in ("real_row", "sim_row", "outcome")}
    azimuth = Rays(beam=beam, column=column, **filled, **none).azimuth_deg
    assert azimuth[:10] == pytest.approx(np.arange(-162, 180, 36))
    assert azimuth[10:20] == pytest.approx(azimuth[:10])
    assert azimuth.max() <= 180


@pytest.fixture(scope="module")
def scan():
    return room()


@pytest.fixture(scope="module")
def material(scan):
    """Brightness of the walls by their place, with the speckle of each return."""
    speckle = np.random.default_rng(0).lognormal(0, 0.3, len(scan))
    return (0.3 + 0.2 * np.sign(scan[:, 0]) + 0.1 * np.sin(scan[:, 1])) * speckle


def scores(scan, real, sim, *, moved=0.0, **options):
    rays = find_rays(scan, scan + moved, (grid(), grid()))
    classes = np.where(rays.real_row >= 0, (scan[rays.real_row, 0] > 0).astype(int), -1)
    return score_intensity(rays, [real, sim], classes, **options)


def test_equal_intensities_agree_in_every_score(scan, material):
    found = scores(scan, material, material, has_one_scale=True)
    assert found["intensity_rank_corr"] == pytest.approx(1)
    assert (found["intensity_rank_distance"], found["intensity_rmse"]) == (0, 0)
    assert found["intensity_ratio"] == pytest.approx(1)
    assert found["intensity_real_by_class"] > 0.3
    assert found["intensity_note"] is None


@pytest.mark.parametrize(
    ("flaw", "note"),
    [
        (lambda scan, own: np.full(len(own), 0.3), "sim: constant (0.3)"),
        (
            lambda scan, own: np.exp(-0.004 * np.linalg.norm(scan, axis=1)),
            "sim: a function of range alone",
        ),
        (lambda scan, own: 255 * own, None),
    ],
)
def test_flaws_of_the_intensity_are_seen(scan, material, flaw, note):
    found = scores(scan, material, flaw(scan, material))
    assert found["intensity_note"] == note
    if note is None:
        assert found["intensity_ratio"] == pytest.approx(255)
        assert found["intensity_rank_distance"] == pytest.approx(0)
    else:
        assert found["intensity_rank_distance"] > 0.15


def test_a_change_of_geometry_does_not_change_what_is_decided(scan, material):
    before = scores(scan, material, material, moved=0.0)
    after = scores(scan, material, material, moved=[0, 0, 0.03])
    for name in ("intensity_rank_distance", "intensity_ratio", "intensity_sim_by_range"):
        assert after[name] == pytest.approx(before[name], abs=0.02)


def test_a_side_without_intensity_has_no_scores_and_a_note(scan, material):
    found = scores(scan, material, None)
    assert found["intensity_note"] == "sim: no intensity"
    assert "intensity_rank_corr" not in found
    assert found["intensity_real_by_range"] is not None


def test_few_returns_have_no_score(scan):
    few = np.arange(50.0)
    assert explained_share(few, np.zeros(50, dtype=int)) is None
    assert intensity_law(few, few) == ""
