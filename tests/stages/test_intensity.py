"""Scores of intensities of scans of a room whose materials are known."""

import numpy as np
import pytest
from test_rays import grid, room

from fidpipe.stages.intensity import explained_share, intensity_law, score_intensity
from fidpipe.stages.literal import literal_rays as literal
from fidpipe.stages.rays import OUTCOMES, compare_rays


@pytest.fixture(scope="module")
def scan():
    return room()


@pytest.fixture(scope="module")
def material(scan):
    """Brightness of the walls by their place, with the speckle of each return."""
    speckle = np.random.default_rng(0).lognormal(0, 0.3, len(scan))
    return (0.3 + 0.2 * np.sign(scan[:, 0]) + 0.1 * np.sin(scan[:, 1])) * speckle


def scores(scan, real, sim, *, moved=0.0, **options):
    rays = compare_rays(scan, scan + moved, grid(), grid())
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
        (lambda scan, own: np.exp(-0.004 * np.linalg.norm(scan, axis=1)), "sim: a function of range alone"),
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
    before, after = (scores(scan, material, material, moved=moved) for moved in (0.0, [0, 0, 0.03]))
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


def test_the_literal_twin_agrees(scan, material):
    other = material * np.random.default_rng(1).lognormal(0, 0.5, len(material))
    rays = compare_rays(scan, scan * 1.001, grid(), grid())
    classes = np.where(rays.real_row >= 0, (scan[rays.real_row, 0] > 0).astype(int), -1)
    found = score_intensity(rays, [material, other], classes, has_one_scale=True)
    again = literal.intensity_scores(
        [OUTCOMES[i] for i in rays.outcome],
        {
            "real": np.where(rays.real_row >= 0, material[rays.real_row], np.nan),
            "sim": np.where(rays.sim_row >= 0, other[rays.sim_row], np.nan),
        },
        {"real": rays.real_range_m, "sim": rays.sim_range_m},
        rays.incidence_deg,
        [None if i < 0 else ["left", "right"][i] for i in classes],
        has_one_scale=True,
    )
    assert found.keys() == again.keys()
    for name in found.keys() - {"intensity_note"}:
        assert found[name] == pytest.approx(again[name], abs=1e-12)
