import numpy as np
import pytest

from fidpipe.stages.sensing.plausibility import implausible, widest_azimuth_gap_deg
from scenes import road, street


def test_plausible_scans_raise_no_warning():
    assert implausible(np.vstack([street(), road(3000, 40)])) == []


@pytest.mark.parametrize(
    ("change", "warning"),
    [
        (lambda p: p + [481000.0, 0, 0], "are they projected"),
        (lambda p: p / 100, "metres are wanted"),
        (lambda p: p[:, [2, 1, 0]], "are the columns right"),
        (lambda p: np.vstack([p, np.random.default_rng(0).uniform(-1, 1, (3 * len(p), 3))]), "hits on the ego vehicle"),
    ],
)
def test_an_implausible_scan_is_warned_of(change, warning):
    assert any(warning in text for text in implausible(change(street())))


def test_the_widest_gap_is_found_across_the_seam():
    angles = np.radians(np.arange(-60, 61, 5))
    assert widest_azimuth_gap_deg(np.column_stack([-np.cos(angles), np.sin(angles), angles])) == pytest.approx(240)


def test_a_reach_beyond_all_measure_is_told_in_short():
    (text, *_) = implausible(street() * 1e300)
    assert text.startswith("coordinates reach 2e+301 m; ")
