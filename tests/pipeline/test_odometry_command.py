"""`fidpipe tasks --odometry`: of which scans, and what it shows."""

import json

import numpy as np
import pytest

import fidpipe
from fidpipe.pipeline.results import odometry
from fidpipe.pipeline.results.measures import Measures
from fidpipe.schemas.errors import RunError
from runs import command, run
from scenes import drifted, street, write_pair


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of four scans of one street, 0.3 m apart; the last one is two seconds later."""
    folder = tmp_path_factory.mktemp("odometry")
    scene = street(n=400)
    rows = ["pair_id,real,sim,timestamp_s,T_world_sensor"]
    for i, time_s in enumerate((0.0, 0.1, 0.2, 2.2)):
        scan = scene - [0.3 * i, 0, 0]
        write_pair(folder / "drive", scan, drifted(scan, noise=0.01), f"{i}")
        rows.append(f"{i},real/{i}.bin,sim/{i}.bin,{time_s},1 0 0 {0.3 * i} 0 1 0 0 0 0 1 0")
    (folder / "drive" / "pairs.csv").write_text("\n".join(rows) + "\n")
    run(folder / "drive", folder / "run")
    return folder


def test_the_longest_sequence_is_taken(folder):
    assert odometry._sequence(fidpipe.open_run(folder / "run")) == ["0", "1", "2"]


def test_scans_that_do_not_follow_one_another_are_named(folder, monkeypatch):
    finished = fidpipe.open_run(folder / "run")
    monkeypatch.setattr(odometry, "_LONGEST_STEP_S", 0.05)
    with pytest.raises(RunError, match="expected scans that follow one another"):
        odometry.compare_odometry(finished)


def test_motion_and_drift_of_both_sides_are_shown(folder):
    pytest.importorskip("kiss_icp")
    words = ("tasks", folder / "run", "--odometry")
    assert "Odometry over 3 scans" in command(*words, code=0).stdout
    drift, step, _ = json.loads(command(*words, "--json", code=0).stdout)
    assert step["real"] == pytest.approx(0.3, abs=0.05)
    assert drift["real"] == pytest.approx(0, abs=0.1)
    assert drift["gap"] <= drift["real"] + drift["sim"] + 1e-9
    assert drift["measure"] == "drift_m"
    assert np.isfinite(drift["sim"])


def test_both_options_at_once_are_rejected(folder):
    words = ("tasks", folder / "run", "--odometry", "--predictions", "a", "b")
    assert "expected --predictions or --odometry" in command(*words, code=2).stderr


def test_a_gate_bounds_the_gaps(folder):
    pytest.importorskip("kiss_icp")
    rows = json.loads(command("tasks", folder / "run", "--odometry", "--json", code=0).stdout)
    drift_m = rows[0]["gap"]
    for limit_m, code in ((2 * drift_m, 0), (drift_m / 2, 4)):
        words = ("gate", folder / "run", "--max", f"tasks.odometry.drift_m={limit_m}")
        command(*words, code=code)


def test_a_gate_without_a_sequence_says_so(folder, monkeypatch):
    monkeypatch.setattr(odometry, "_LONGEST_STEP_S", 0.05)
    value, reason = Measures(fidpipe.open_run(folder / "run")).named("tasks.odometry.step_m")
    assert value is None
    assert "scans that follow one another" in reason
