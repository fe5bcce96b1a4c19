import numpy as np
import pytest

from fidpipe.stages.inspect.plausibility import implausible, widest_azimuth_gap_deg
from scenes import road, street


def test_plausible_scans_raise_no_warning():
    assert implausible(np.vstack([street(), road(3000, 40)]), "real", 2.5) == []


@pytest.mark.parametrize(
    ("change", "warning"),
    [
        (lambda p: p + [481000.0, 0, 0], "are they projected"),
        (lambda p: p / 100, "expected metres"),
        (lambda p: p[:, [2, 1, 0]], "are the columns right"),
        (lambda p: np.vstack([p, np.random.default_rng(0).uniform(-1, 1, (3 * len(p), 3))]), "hits on the ego vehicle"),
    ],
)
def test_an_implausible_scan_is_warned_of(change, warning):
    assert any(warning in text for text in implausible(change(street()), "sim", 2.5))


def test_camera_axes_are_named_with_the_setting_of_the_side():
    scan = np.vstack([street(), road(3000, 40)])
    (odd,) = implausible(scan[:, [1, 2, 0]] * [-1, -1, 1], "real", 2.5)  # right, down, forward
    assert odd.endswith("is it in camera axes? set input.real_frame=kitti-cam")


def test_near_hits_are_told_with_what_the_present_settings_leave_of_them():
    ring = 2.0 * np.column_stack([np.cos(np.arange(3000)), np.sin(np.arange(3000)), np.zeros(3000)])
    scan = np.vstack([road(1000), ring])
    (dropped,) = implausible(scan, "real", 2.5)
    assert "hits on the ego vehicle? 0.2% are kept by input.min_range_m=2.5; " in dropped
    (left,) = implausible(scan, "real", 1.0)
    assert "75.3% are kept by input.min_range_m=1; " in left and left.endswith(
        "input.min_range_m=3 or input.exclude_box drops them"
    )


def test_the_widest_gap_is_found_across_the_seam():
    angles = np.radians(np.arange(-60, 61, 5))
    assert widest_azimuth_gap_deg(np.column_stack([-np.cos(angles), np.sin(angles), angles])) == pytest.approx(240)


def test_a_reach_beyond_all_measure_is_told_in_short():
    (text, *_) = implausible(street() * 1e300, "real", 2.5)
    assert text.startswith("coordinates reach 2e+301 m; ")
