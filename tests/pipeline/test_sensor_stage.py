"""Stage sensor: what a run records of the sensor of each side."""

import numpy as np
import pandas as pd
import pytest

from fidpipe import evaluate_pair
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.measures import Measures
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import Settings
from fidpipe.stages.generate.street_scans import make_pair
from runs import command, run

N_POINTS = 12_000


@pytest.fixture(scope="module")
def streets():
    """One street as two sensors see it, (n, 3) by side."""
    names = {"real": "vlp16", "sim": "hdl32"}
    return {
        side: make_pair(0, 0, SENSORS[name], N_POINTS).real.rows[:, :3]
        for side, name in names.items()
    }


@pytest.fixture(scope="module")
def finished(streets, tmp_path_factory):
    """A run over them; the simulated file has the axes of nuScenes, x right and y forward, and a T_real_sim."""
    folder = tmp_path_factory.mktemp("two_sensors")
    x, y, z = streets["sim"].T
    for name, points in (("real", streets["real"]), ("sim", np.column_stack([-y, x, z]))):
        np.column_stack([points, np.zeros(len(points))]).astype(np.float32).tofile(
            folder / f"{name}.bin"
        )
    (folder / "pairs.csv").write_text(
        "pair_id,real,sim,T_real_sim\na,real.bin,sim.bin,1 0 0 0.5 0 1 0 0 0 0 1 0.2\n"
    )
    settings = Settings.model_validate({"input": {"sim_frame": "nuscenes"}})
    assert not run(folder, folder / "run", settings).failures
    return folder / "run"


def test_the_table_has_the_sensor_of_each_side_in_the_frame_of_its_own_file(finished):
    real, sim = pd.read_parquet(finished / "sensor").sort_values("side").to_dict("records")
    assert (real["model"], real["n_beams"]) == ("Velodyne VLP-16", 16)
    assert (sim["model"], sim["n_beams"]) == ("Velodyne HDL-32E", 32)
    assert (sim["lowest_deg"], sim["highest_deg"]) == pytest.approx((-30.67, 10.67), abs=0.02)
    assert real["origin_height_m"] == sim["origin_height_m"] == 0
    assert real["range_noise_m"] == pytest.approx(0.03, rel=0.15)


def test_a_gate_tests_every_property_of_both_sensors(finished):
    pairs = pd.read_parquet(finished / "pairs.parquet")
    measures = Measures(FinishedRun(finished))
    for side in ("real", "sim"):
        for name in (
            "beams",
            "azimuth_step_deg",
            "range_quantum_m",
            "range_noise_m",
            "lost_share",
        ):
            expected = pairs[f"sensor_{side}_{name}"].mean()
            assert measures.named(f"sensor.{side}.{name}.mean") == (expected, "")
    command(
        "gate",
        finished,
        "--min",
        "sensor.sim.beams.min=32",
        "--max",
        "sensor.sim.range_noise_m.mean=0.05",
        code=0,
    )
    failed = command("gate", finished, "--max", "sensor.sim.beams.max=16", code=4)
    assert "sensor.sim.beams.max" in failed.stdout


def test_points_of_no_sensor_leave_nulls_with_a_reason_and_fail_no_pair(rng):
    scan = rng.uniform((-20, -20, -2), (20, 20, 5), (600, 3))
    result = evaluate_pair(scan, scan)
    assert result.summary["sensor_real_beams"] is None
    assert "rings" in result.sensor["real"].reason[0]
