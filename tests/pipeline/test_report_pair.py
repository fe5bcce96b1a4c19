"""Data of one pair in a report's page, against the run's tables and against scenes by hand."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial import cKDTree

from fidpipe.pipeline.report.page.pair_data import pair_data, thinned
from fidpipe.pipeline.report.run_frames import PairFrames, read_results
from reports import points_in, unpacked


@pytest.mark.parametrize("run_of", ["report_run", "by_reference"])
def test_points_in_the_page_have_the_distances_that_the_stored_coverage_is_of(run_of, request):
    results = read_results(request.getfixturevalue(run_of))
    pair = results.pairs.iloc[0]
    tables, view = PairFrames(results, pair.pair_id), pair_data(results, pair.pair_id)
    for side, distance_m in tables.distances_m.items():
        for reach_m, reach in ((0.1, "0p1m"), (0.3, "0p3m"), (1.0, "1m")):
            assert (distance_m <= reach_m).mean() == pytest.approx(pair[f"covered_{side}_{reach}"], abs=1e-12)
        nearest = cKDTree(tables.clouds[side].points).query(points_in(view, side))[1]
        shown = unpacked(view)[f"{side}_distance"] / 255
        assert np.abs(shown - np.minimum(distance_m[nearest], 1)).max() <= 0.5 / 255 + 1e-12


@pytest.mark.parametrize("run_of", ["report_run", "by_reference"])
def test_a_page_has_every_point_of_every_object_and_no_other(run_of, request):
    results = read_results(request.getfixturevalue(run_of))
    for pair_id in results.select(None):
        tables, view = PairFrames(results, pair_id), pair_data(results, pair_id)
        for side, cloud in tables.clouds.items():
            counted, shown = view["sides"][side], points_in(view, side)
            assert counted["n"] == len(cloud.points) == len(shown)
            distance_m, nearest = cKDTree(cloud.points).query(shown)
            assert distance_m.max() <= np.sqrt(3) / 2 * view["step_m"] + 1e-9
            assert sorted(nearest) == list(range(len(shown)))
            assert np.repeat(counted["ids"], counted["counts"]).tolist() == cloud.community[nearest].tolist()
            kept = cloud.point_ids[nearest[unpacked(view)[f"{side}_kept"] == 1]]
            assert set(kept) == set(tables.selection[f"{side}_point_id"])
            road = points_in(view, f"{side}_road")
            assert 0 < len(road) <= len(cloud.road)
            assert cKDTree(cloud.road).query(road)[0].max() <= np.sqrt(3) / 2 * view["step_m"] + 1e-9


def test_aligned_points_lie_as_the_alignment_error_is_measured(report_run):
    results = read_results(report_run)
    pair_id = results.pairs.pair_id[0]
    tables, view = PairFrames(results, pair_id), pair_data(results, pair_id)
    columns = unpacked(view)
    real, sim = (points_in(view, side) for side in ("real", "sim"))
    owner = np.repeat(view["sides"]["real"]["ids"], view["sides"]["real"]["counts"])
    for row in tables.matched.itertuples():
        move = np.array(view["moves"][str(row.real_id)])
        is_own = owner[columns["real_line"]] == row.real_id
        assert is_own.sum() == row.n_keep
        apart = real[columns["real_line"][is_own]] - sim[columns["sim_line"][is_own]] - move
        assert np.sqrt((apart**2).sum(axis=1).mean()) == pytest.approx(row.alignment_rms_m, abs=2 * view["step_m"])
        assert np.abs(apart.mean(axis=0)).max() < view["step_m"], "both sides have one mean"


def test_the_share_of_an_object_that_is_road_to_the_other_side_is_that_of_the_table(report_run):
    results = read_results(report_run)
    coverage = pd.read_parquet(report_run / "coverage").dropna(subset="community_id")
    share = coverage.set_index(["pair_id", "side", "community_id"]).road_share
    for row in results.matched.itertuples():
        assert row.road_share_real == share[row.pair_id, "real", row.real_id]
        assert row.road_share_sim == share[row.pair_id, "sim", row.sim_id]
    for row in results.unmatched.itertuples():
        own, other = (row.road_share_real, row.road_share_sim)[:: 1 if row.side == "real" else -1]
        assert own == share[row.pair_id, row.side, row.community_id]
        assert np.isnan(other), "it is not on that side"


def test_an_object_shows_up_to_20000_points():
    assert len(thinned(np.zeros(30_000, dtype=int), most=10**6)) == 20_000
    assert len(thinned(np.zeros(20_000, dtype=int), most=10**6)) == 20_000


def test_thinning_leaves_no_object_out():
    community = np.repeat(np.arange(40), np.linspace(3, 4000, 40).astype(int))
    shown = np.bincount(community[thinned(community, 2000)], minlength=40)
    assert (shown >= np.minimum(80, np.bincount(community))).all()
    assert shown.sum() < 2000 + 40 * 80
