"""The command as a user meets it: exit codes, one-line errors, help."""

import re
import shutil
import subprocess
import sys

import pyarrow.parquet as pq
import pytest

from runs import JOBS_PER_PAIR, command, one_line
from scenes import road, write_bin


def test_a_run_ends_with_zero_and_says_where_the_results_are(dataset, tmp_path):
    result = command("run", dataset, "--workers", 1, cwd=tmp_path, code=0)
    assert "report runs/streets" in result.stdout and "r_lambda" in result.stdout
    assert (tmp_path / "runs" / "streets" / "run.json").exists()
    again = command("run", dataset, "--workers", 1, cwd=tmp_path)
    assert f"0 jobs done, {2 * JOBS_PER_PAIR} reused" in again.stdout
    other = ("run", dataset, "--workers", 1, "--set", "matching.delta_m=3")
    refused = command(*other, cwd=tmp_path, code=1)
    assert "matching.delta_m" in one_line(refused.stderr)
    changed = command(*other, "--replace", cwd=tmp_path)
    assert "replacing matching, selection, metrics" in changed.stderr
    assert "metrics" in command("status", "runs/streets", cwd=tmp_path, code=0).stdout


def test_a_renamed_pair_is_told_under_its_new_name(data, tmp_path):
    assert command("run", data, "--workers", 1, "--out", tmp_path / "run").returncode == 0
    for side in ("real", "sim"):
        (data / side / "001.bin").rename(data / side / "renamed.bin")
    assert command("run", data, "--workers", 1, "--out", tmp_path / "run").returncode == 0
    for table in ("pairs", "timings"):
        rows = pq.read_table(tmp_path / "run" / f"{table}.parquet")
        assert set(rows.column("pair_id").to_pylist()) == {"000", "renamed"}


def test_failed_pairs_end_with_three_and_are_listed(data, tmp_path):
    (data / "sim" / "001.bin").write_bytes(b"")
    result = command("run", data, "--workers", 1, "--out", tmp_path / "run", code=3)
    reason = "sim/001.bin: "
    assert (result.stderr.count(reason), result.stdout.count(reason)) == (1, 1)
    shown = command("show", tmp_path / "run").stdout
    assert "1 of 2" in shown
    assert shown.count(reason) == 1


def test_a_failure_from_before_is_listed_beside_the_number_of_those_told_now(data, tmp_path):
    out = tmp_path / "run"
    reason = "object points after ground"
    write_bin(data / "sim" / "000.bin", road(400) * [1, 1, 0] - [0, 0, 1.7])
    assert command("run", data, "--workers", 1, "--out", out).returncode == 3
    (data / "sim" / "001.bin").write_bytes(b"")
    result = command("run", data, "--workers", 1, "--out", out, "--pairs", "001", code=3)
    assert "2 of 2 pairs" in result.stdout
    assert "fidpipe report" not in result.stdout
    assert (result.stderr.count(reason), result.stdout.count(reason)) == (0, 1)


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["nowhere"], "error: dataset nowhere: "),
        (["loop"], "error: dataset loop: "),
        (["ftp://bucket/data"], "error: ftp://: "),
        (["{data}", "--out=memory://x"], "error: memory://: "),
        (["{data}", "--set", "graph.k=0"], "error: setting graph.k: "),
        (["{data}", "--settings", "gone.toml"], "error: settings file gone.toml: "),
        (["{data}", "--pairs", "x*"], "error: --pairs 'x*' "),
    ],
)
def test_a_wrong_input_ends_with_one_and_one_line(dataset, tmp_path, words, fault):
    (tmp_path / "loop").symlink_to("loop")
    result = command(
        "run",
        *[word.format(data=dataset) for word in words],
        "--workers",
        1,
        cwd=tmp_path,
        code=1,
    )
    assert one_line(result.stderr).startswith(fault)
    assert result.stdout == ""
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        ("run --workers 1", ""),
        ("run {data} --from nowhere --workers 1", ""),
        ("run {data} --workers 0", ""),
        ("nosuch", ""),
        ("run --what --workers 1", ""),
        ("run {data} --workers 2 --scheduler tcp://a:1", ""),
        ("compare {run}", "expected two or more runs, got 1"),
        ("compare {run} {run} --fail-on nose", "'nose'"),
        ("diagnose {run} elsewhere", "--tell-apart"),
        ("diagnose {run} --tell-apart --set input.min_range_m=1", "a run has its settings"),
        ("show {run} 000 --best-case {run}", "leave out the pair"),
        ("gate {run}", "no criterion given"),
        ("export {run}", "no format given"),
        ("settings --json-schema --preset paper", "give it alone"),
        ("ablate {data} --workers 1 --k many", "'many'"),
    ],
)
def test_wrong_usage_ends_with_two(dataset, finished, tmp_path, words, fault):
    result = command(
        *(word.format(data=dataset, run=finished) for word in words.split()),
        cwd=tmp_path,
        code=2,
    )
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ") and fault in line and line.endswith(" --help")
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_check_ends_with_zero_on_good_data_and_one_on_any_fault(dataset, data):
    good = command("check", dataset, code=0)
    assert good.stdout.endswith(f"next: fidpipe run {dataset} --preset reference\n")
    with_settings = command(
        "check", dataset, "--preset", "reference", "--set", "matching.delta_m=3"
    )
    assert with_settings.stdout.endswith(" --set matching.delta_m=3.0\n")
    (data / "real" / "000.bin").unlink()
    bad = command("check", data, code=1)
    assert "error: pair 000:" in bad.stdout


@pytest.mark.parametrize(
    "name", ["ablate", "check", "compare", "gate", "perturb", "run", "show", "status", "synth"]
)
def test_every_command_has_an_example_in_its_help(name):
    result = command(name, "--help", code=0)
    assert f"fidpipe {name} " in result.stdout
    assert "[[" not in result.stdout


def test_help_imports_nothing_heavy():
    heavy = ("numpy", "pandas", "dask", "pyarrow", "pydantic")
    code = f"import sys, fidpipe.pipeline.cli.main; print([name for name in {heavy} if name in sys.modules])"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"


def test_status_show_and_a_run_with_nothing_to_do_import_no_numerics(scenario, tmp_path):
    streets = scenario("plain") / "streets"
    folder = shutil.copytree(scenario("plain") / "run", tmp_path / "run")
    # the first repetition rewrites the table timings
    assert command("run", streets, "--out", folder, "--workers", 1).returncode == 0
    heavy = (
        "scipy.sparse",
        "scipy.spatial",
        "sklearn",
        "pandas",
        "dask",
        "matplotlib",
        "plotly",
        "pyarrow.compute",
    )
    # until their file is met
    heavy += (
        "rosbags",
        "mcap",
        "velodyne_decoder",
        "dpkt",
        "laspy",
        "lazrs",
    )
    words = [
        ["status", str(folder)],
        ["show", str(folder)],
        ["run", str(streets), "--out", str(folder)],
    ]
    code = (
        "import sys; from fidpipe.pipeline.cli.main import app\n"
        f"for words in {words}:\n"
        "    try: app(words, standalone_mode=False)\n"
        "    except SystemExit as end: assert not end.code\n"
        f"print('loaded', [name for name in {heavy} if name in sys.modules])"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert "0 jobs done" in found.stdout, found.stderr
    assert found.stdout.splitlines()[-1] == "loaded []"


def test_the_version_is_told():
    assert re.fullmatch(r"fidpipe \d+\.\d+\.\d+\n", command("--version").stdout)
