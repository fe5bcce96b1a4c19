"""Inputs after public bug reports: what is wrong is named, and no cause that it feigns is."""

import numpy as np
import pytest

from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.pipeline.open_run import open_run
from fidpipe.schemas.settings import load
from runs import command

#: Causes of the twin of `00_base` itself; of scans of one side alone, none.
TWIN = {
    *(
        "forward",
        "yaw",
        "missing parts",
        "invented parts",
        "moved parts",
        "far surface",
        "solid foliage",
    ),
    *("azimuth step", "lost far returns", "second returns"),
}
CASES = {
    "00_base": ("", TWIN),
    "01a_no_misses": ("", set()),
    "01b_misses_at_80m": ("29% of the points lie at 80.0 m", set()),
    "02a_each_twice": ("second returns of a ray", TWIN),
    "02c_once": ("", TWIN),
    "03_unity": ("read as x right, y up, z forward", set()),
    "04_world": (
        "not in the sensor's frame",
        {"missing parts", "invented parts", "moved parts"},
    ),
    "07_ouster_count0": ("", TWIN),
    "08_veloview": ("", TWIN),
    "13a_av2_parquet": ("", TWIN),
    "16_awsim_dual": ("second returns of a ray", TWIN),
    "18_two_sweeps": ("two or more sweeps", set()),
}
FAILED = {"01b_misses_at_80m", "03_unity", "04_world", "18_two_sweeps"}


@pytest.mark.parametrize("case", CASES)
def test_each_case_is_named_and_prescribes_nothing_wrong(real_data, case):
    checked = check_dataset(real_data / "reports" / case, load(None, [], preset="reference"))
    text, allowed = CASES[case]
    assert any(text in line for line in [*checked.doubts, *checked.warnings, ""])
    assert bool(checked.doubts) == (case in FAILED) and not checked.faults
    assert {cause.name for cause in checked.causes} <= allowed


def test_a_run_leaves_out_rays_without_a_return_and_says_so_first(real_data, tmp_path):
    case = real_data / "reports" / "01b_misses_at_80m"
    without = real_data / "reports" / "01a_no_misses"
    assert "29% of the points lie at 80.0 m" in command("check", case, code=1).stdout
    numbers = {}
    for folder in (case, without):
        out = tmp_path / folder.name
        finished = command("run", folder, "--out", out, "--preset", "reference")
        printed = finished.stdout + finished.stderr
        numbers[folder] = open_run(out).pairs.iloc[0]
        assert ("29% of the points lie at 80.0 m" in printed) == (folder == case)
    assert numbers[case].n_sim_clean == pytest.approx(numbers[without].n_sim_clean, rel=0.002)
    assert numbers[case].cdc_mean == pytest.approx(numbers[without].cdc_mean, abs=0.02)


def test_a_run_of_two_sweeps_names_them_and_no_cause(real_data, tmp_path):
    out = tmp_path / "sweeps"
    finished = command(
        "run", real_data / "reports" / "18_two_sweeps", "--out", out, "--preset", "reference"
    )
    printed = " ".join(finished.stdout.split())
    assert "Check first simulated scans (1 of 1): two or more sweeps" in printed
    assert "no cause can be named: 36 of 38 are unknown" in printed
    assert "larger than the differences" not in printed
    run = open_run(out)
    assert run.causes.empty
    assert np.isnan(run.pairs.iloc[0].sensor_sim_range_noise_m)
