"""The whole command on real scans."""

import pytest

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.evaluate import evaluate_pair
from fidpipe.schemas.settings import load
from runs import run, some_of
from scenes import moved, rigid


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("real", "sim", "words"),
    [
        ("rellis/vel000104.bin", "rellis/000104.bin", []),
        ("registration/target.ply", "registration/source.ply", []),
        ("velodyne_vlp32c/one_sweep.pcd", "velodyne_vlp32c/one_sweep.pcd", []),
        ("carla/000030.bin", "carla/000031.bin", ["input.min_range_m=3"]),
    ],
)
def test_every_kind_of_real_scan_runs_to_the_end(real_data, tmp_path, real, sim, words):
    (tmp_path / "pairs.csv").write_text(
        f"pair_id,real,sim\np,{real_data / real},{real_data / sim}\n"
    )
    outcome = run(tmp_path, tmp_path / "run", load(None, [*words, "graph.k=30"]), workers=2)
    assert not outcome.failures


@pytest.mark.parametrize("turn_deg", some_of([0, 40], [40]))
def test_objects_fixed_on_the_real_side_are_found_whatever_the_order_of_rows_and_the_frame(
    real_data, rng, turn_deg
):
    points = moved(
        read_scan(real_data / "rellis" / "vel000104.bin").points,
        rigid(turn_deg, [0.5, -0.3, 0.2]),
    )
    result = evaluate_pair(points, rng.permutation(points), {"preset": "reference"})
    assert set(result.metrics.status) == {"identical"}
    assert result.summary["match_rate"] == 1.0
    for name in (
        "cdc",
        "r_lambda",
        "r_gap",
        "max_eigenvalue_shift",
        "eigenspectrum_distance",
        "centroid_distance_m",
    ):
        assert (result.metrics[name] == 0.0).all(), name
    assert result.summary["shift_m"] == 0.0
    assert result.summary["covered_real_0p1m"] == result.summary["covered_sim_0p1m"] == 1.0


@pytest.mark.exhaustive
def test_what_a_simulator_loses_shows_with_objects_fixed_on_the_real_side(real_data, rng):
    points = read_scan(real_data / "rellis" / "vel000104.bin").points
    cdc = {}
    for share in (0.95, 0.6):
        result = evaluate_pair(
            points, points[rng.random(len(points)) < share], {"preset": "reference"}
        )
        # of a copy that has lost points no object is missing
        assert result.summary["match_rate"] > 0.9
        cdc[share] = result.summary["cdc_mean"]
    assert 0 < cdc[0.95] < 0.01 < cdc[0.6] < 0.1
