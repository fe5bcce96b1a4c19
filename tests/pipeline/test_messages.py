"""Datasets and mistakes of newcomers: what is paired, and the one-line message for each mistake."""

import os
import re
import resource
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import fidpipe
from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.engine.time_limit import OutOfTimeError, TimeLimit, limited
from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.storage.urls import cache_of
from fidpipe.schemas.errors import (
    DatasetError,
    RunError,
    ScanError,
    SettingsError,
    StageError,
    StoreError,
)
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import Settings, load
from fidpipe.stages.generate.ray_casting import fire
from runs import FIDPIPE, command, one_line, read_only, run
from scenes import street, write_bin, write_dataset, write_pair

N_PAIRS = 1


def one_error(result):
    assert result.returncode == 1
    return one_line(result.stderr)


def read_truncated(folder):
    (folder / "a.bin").write_bytes(bytes(45))
    read_scan(folder / "a.bin")


def use_up_the_time(folder):
    (folder / "a.seconds").write_text("100.5")
    limited(TimeLimit(100.0, folder)).__enter__()


#: By error class: a call that raises it in a folder, and the whole message.
SENTENCES = {
    SettingsError: (
        lambda folder: load(None, ["graph.k=0"]),
        "setting graph.k: expected greater than or equal to 1, got 0; fidpipe settings lists the allowed values",
    ),
    DatasetError: (
        lambda folder: read_dataset(folder / "none"),
        "dataset {}/none: no such folder",
    ),
    ScanError: (
        read_truncated,
        "{}/a.bin: expected a multiple of 16 bytes (4 float32 columns: x y z intensity), got 45; "
        "the file is truncated, or has other columns: name them in input.columns, or of one side alone in "
        "input.real_columns or input.sim_columns",
    ),
    StoreError: (
        lambda folder: cache_of("ftp://host/set"),
        "ftp://: expected a URL of s3, gs, az, http, https, or a local path",
    ),
    StageError: (
        lambda folder: fidpipe.evaluate_pair(np.zeros((1, 3)), street()),
        "stage ground, real: expected at least 8 points after cleaning, got 0 (1 zero); "
        "check that the export is complete",
    ),
    OutOfTimeError: (
        use_up_the_time,
        "not finished after 100 s of work; a larger --pair-timeout gives it more",
    ),
    RunError: (
        lambda folder: FinishedRun(folder / "none"),
        "run {0}/none: no such folder, expected a folder written by fidpipe run; make a run: "
        "fidpipe run DATASET --out {0}/none",
    ),
}


@pytest.mark.parametrize("kind", SENTENCES)
def test_each_class_of_errors_has_one_sentence(kind, tmp_path):
    call, sentence = SENTENCES[kind]
    with pytest.raises(kind) as error:
        call(tmp_path)
    assert str(error.value) == sentence.format(tmp_path)


def test_a_manifest_in_place_of_its_folder_is_named_as_a_file(tmp_path):
    (tmp_path / "pairs.csv").write_text("pair_id,real,sim\n")
    with pytest.raises(DatasetError, match=rf"pairs\.csv: .*{tmp_path}"):
        read_dataset(tmp_path / "pairs.csv")


def test_a_file_of_an_unknown_format_is_named(data):
    (data / "sim" / "000.bin").rename(data / "sim" / "000.e57")
    alone = read_dataset(data)
    assert "000.bin: no partner" in alone.pairs[0].fault
    shutil.copy(data / "real" / "000.bin", data / "sim" / "000.bin")
    beside = read_dataset(data)
    assert beside.pairs[0].fault is None
    for (warning,) in (alone.warnings, beside.warnings):
        assert "sim/000.e57: not a known scan format" in warning


def folders(folder, real=("a",), sim=("a",)):
    for side, names in (("real", real), ("sim", sim)):
        (folder / side).mkdir(parents=True, exist_ok=True)
        for name in names:
            write_bin(folder / side / f"{name}.bin", street())
    return folder


@pytest.mark.parametrize("verb", ["run", "check"])
def test_scans_without_any_partner_are_counted_with_an_example_and_the_next_step(
    tmp_path, verb
):
    data = folders(tmp_path / "data", ["left", "right"], ["west"])
    words = ["--workers", 1] if verb == "run" else []
    counts = "none of 2 real and 1 simulated scans"
    alone = one_error(command(verb, data, *words))
    assert (
        counts in alone
        and f"{data}/real/left.bin and {data}/sim/west.bin" in alone
        and "pairs.csv" in alone
    )
    both = one_error(command(verb, data / "real", data / "sim", *words, cwd=tmp_path))
    assert counts in both and "pairs.csv" in both and "times.txt" in both


def test_names_of_the_same_number_are_answered_with_the_command_that_pairs_them(tmp_path):
    data = folders(tmp_path / "data", ["0000", "0001"], ["frame_0000", "frame_0001"])
    advice = f"fidpipe run {data}/real {data}/sim"
    assert one_error(command("run", data, "--workers", 1)).endswith(advice)
    checked = command("check", data / "real", data / "sim", cwd=tmp_path)
    assert checked.stdout.endswith(f"next: {advice} --preset reference\n")


@pytest.mark.parametrize(
    ("sides", "words"),
    [
        ((), "got nothing; .*fidpipe run REAL SIM"),
        (("real",), "folders real/ and sim/ .*got real; .*fidpipe run REAL SIM"),
        (("sim",), "folders real/ and sim/ .*got sim; .*fidpipe run REAL SIM"),
        (("real", "sim"), "no scans found in {0}/sim"),
    ],
)
def test_an_empty_folder_or_side_is_named_in_one_line_with_the_next_step(
    tmp_path, sides, words
):
    for side in sides:
        (tmp_path / side).mkdir()
    if len(sides) == 2:
        write_bin(tmp_path / "real" / "0.bin", street())
    found = one_error(command("run", tmp_path, "--workers", 1))
    assert re.search(words.format(tmp_path), found), found


def test_a_box_of_three_numbers_is_refused_with_their_number(tmp_path):
    words = ["check", tmp_path, "--set", "input.include_box=1,2,3"]
    assert "input.include_box: expected 6 numbers, got '1,2,3'" in one_error(command(*words))


def test_a_manifest_column_of_ones_own_is_ignored_with_a_warning(data):
    (data / "pairs.csv").write_text(
        "pair_id,real,sim,weather\na,real/000.bin,sim/000.bin,rain\n"
    )
    (warning,) = read_dataset(data).warnings
    assert "column weather" in warning


@pytest.mark.exhaustive
def test_a_run_on_a_read_only_medium_is_judged_compared_and_reported_elsewhere(
    dataset, finished, tmp_path
):
    medium = shutil.copytree(finished, tmp_path / "medium")
    before = {path: path.stat().st_mtime_ns for path in medium.rglob("*")}
    forbid = read_only(medium)
    judged = command("gate", medium, "--max", "r_lambda.mean=1", preexec_fn=forbid, code=0)
    assert "gate.xml" in judged.stderr
    assert "report.html" in one_error(command("report", medium, preexec_fn=forbid))
    out = tmp_path / "elsewhere"
    for words in (
        ("gate", medium, "--max", "r_lambda.mean=1", "--out", out),
        ("report", medium, "--out", out),
        ("compare", medium, medium, "--out", out),
        ("show", medium),
        ("status", medium),
    ):
        result = command(*words, preexec_fn=forbid, code=0)
        assert result.stderr == "", words
    assert {"gate.xml", "gate.json", "report.html", "compare.html"} == {
        path.name for path in out.iterdir()
    }
    assert {path: path.stat().st_mtime_ns for path in medium.rglob("*")} == before


@pytest.mark.parametrize(
    "words", [("status",), ("gate", "--max", "r_lambda.mean=1"), ("check",)]
)
def test_a_folder_that_may_not_be_searched_is_named_in_one_line(tmp_path, words):
    (tmp_path / "shut").mkdir()
    forbid = read_only(tmp_path / "shut", mode=0o600)
    result = command(words[0], tmp_path / "shut" / "run", *words[1:], preexec_fn=forbid)
    assert "shut/run" in one_error(result)
    assert "Permission denied" in result.stderr


@pytest.mark.parametrize(
    "words", [("show",), ("status",), ("gate", "--max", "r_lambda.mean=1")]
)
def test_a_file_in_place_of_a_run_is_named_as_a_file(finished, tmp_path, words):
    (tmp_path / "page.html").touch()
    assert f"run {tmp_path}/page.html: " in one_error(
        command(words[0], tmp_path / "page.html", *words[1:])
    )
    assert str(finished) in one_error(command(words[0], finished / "run.json", *words[1:]))


@pytest.mark.parametrize("address", ["tls://host:1", "foo", "tcp://host"])
def test_what_is_no_address_of_a_scheduler_is_said_at_once(dataset, tmp_path, address):
    advice = "tcp://HOST:PORT.*DASK_DISTRIBUTED__COMM__TLS__CA_FILE"
    with pytest.raises(RunError, match=f"^{re.escape(f'scheduler {address!r}: ')}.*{advice}"):
        run(dataset, tmp_path / "run", scheduler=address)


@pytest.mark.parametrize("words", [("show",), ("show", "--json"), ("settings",), ("--help",)])
def test_a_full_standard_output_is_named_in_one_line(finished, words):
    run_folder = () if words[0] in ("settings", "--help") else (finished,)
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [FIDPIPE, *words, *run_folder],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert one_error(ended).startswith("error: standard output: ")


def test_a_run_without_standard_streams_does_its_work(dataset, tmp_path):
    command(
        "run",
        dataset,
        "--out",
        tmp_path / "run",
        "--workers",
        1,
        preexec_fn=lambda: os.closerange(0, 3),
        code=0,
    )
    assert FinishedRun(tmp_path / "run").record.pairs.scored == 1


def test_a_reader_that_stops_ends_a_command_without_a_word(finished):
    with subprocess.Popen(
        [FIDPIPE, "show", finished, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as shown:
        shown.stdout.close()
        assert shown.stderr.read() == b""


def test_a_working_folder_that_is_gone_is_said_in_one_line(data, tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    ended = command("check", "../streets", cwd=gone, preexec_fn=gone.rmdir)
    assert one_error(ended)


def test_too_little_address_space_for_workers_is_said_before_they_wait_for_ever(
    dataset, tmp_path
):
    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (10**9, 10**9))

    ended = command(
        "run", dataset, "--out", tmp_path / "run", "--workers", 2, preexec_fn=limit, timeout=60
    )
    assert "0.9 GiB" in one_error(ended)


def test_the_name_of_a_dataset_that_is_not_utf8_is_said_in_one_line_and_that_of_a_run_is_shown(
    dataset, finished, tmp_path
):
    odd = tmp_path / "run\udcff"
    odd.symlink_to(finished)
    assert "run\\udcff" in command("show", odd, cwd=tmp_path, code=0).stdout
    data = shutil.copytree(dataset, tmp_path / "odd\udcff")
    result = command("run", data, "--workers", 1, cwd=tmp_path)
    assert f"{str(data)!a}" in one_error(result)


def test_a_scan_that_is_a_loop_of_links_fails_its_pair_alone(tmp_path):
    folder = write_dataset(tmp_path / "set", n_pairs=2, n=100)
    for side in ("real", "sim"):
        (folder / side / "b.bin").symlink_to("b.bin")
    ended = command("run", folder, "--out", tmp_path / "run", "--workers", 1, code=3)
    assert "pair b: " in ended.stderr
    assert FinishedRun(tmp_path / "run").record.pairs.scored == 2


@pytest.mark.exhaustive
def test_a_home_that_cannot_be_written_is_no_news(finished, tmp_path):
    nowhere = dict.fromkeys(
        ("HOME", "MPLCONFIGDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"), "/dev/null"
    )
    ended = command("report", finished, "--out", tmp_path / "page", env=os.environ | nowhere)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_name_that_is_too_long_is_said_in_one_line():
    assert "n" * 300 in one_error(command("check", "n" * 300))


def test_a_command_to_type_next_can_be_typed_where_a_name_has_spaces(dataset, tmp_path):
    data = shutil.copytree(dataset, tmp_path / "two words")
    ended = command("run", data, "--out", "my run", "--workers", 1, cwd=tmp_path)
    assert "fidpipe report 'my run' --open" in ended.stdout
    everything = command("show", "my run", "--all", cwd=tmp_path).stdout
    assert f"fidpipe run '{data}' --preset reference" in " ".join(everything.split())
    assert "fidpipe show my run" not in ended.stdout


def test_a_fault_of_a_file_that_is_both_sides_is_said_once(data, tmp_path):
    shutil.rmtree(data / "sim")
    np.save(data / "scan.npy", np.ones((3, 100)))
    (data / "pairs.csv").write_text("pair_id,real,sim\n7,scan.npy,scan.npy\n")
    ended = command("run", data, "--out", tmp_path / "run", "--workers", 1)
    assert (ended.returncode, ended.stderr.count("pair 7: ")) == (3, 1)
    assert ended.stderr.count("save array.T") == 1


def manifest(tmp_path, rows, header="pair_id,real,sim,timestamp_s,T_real_sim"):
    folders(tmp_path)
    (tmp_path / "pairs.csv").write_text("\n".join([header, *rows]) + "\n")
    return tmp_path


def test_folders_are_paired_by_stem_and_scans_without_a_partner_fail(tmp_path):
    dataset = read_dataset(folders(tmp_path, ("b", "a"), ("a", "c")))
    paired, *alone = dataset.pairs
    assert (paired.pair_id, paired.real.file.name, paired.fault) == ("a", "a.bin", None)
    for pair, name in zip(alone, "bc", strict=True):
        assert pair.pair_id == name
        assert f"{name}.bin: no partner" in pair.fault


def test_two_files_of_one_stem_stop_everything(tmp_path):
    folders(tmp_path)
    write_bin(tmp_path / "sim" / "a.pcd.bin", street(), 5)
    with pytest.raises(DatasetError, match=r"a\.bin and a\.pcd\.bin"):
        read_dataset(tmp_path)


def test_unknown_files_are_ignored_with_a_warning_and_labels_without(tmp_path):
    folders(tmp_path)
    (tmp_path / "real" / "notes.txt").touch()
    (tmp_path / "real" / "a.label").touch()
    (tmp_path / "real" / ".hidden").touch()
    (warning,) = read_dataset(tmp_path).warnings
    assert "notes.txt" in warning


def test_a_manifest_wins_over_folders(tmp_path):
    T = "1 0 0 0.5 0 1 0 0 0 0 1 0"
    dataset = read_dataset(manifest(tmp_path, [f"first,real/a.bin,sim/a.bin,12.5,{T}"]))
    (pair,) = dataset.pairs
    assert (pair.pair_id, pair.timestamp_s) == ("first", 12.5)
    assert pair.T_real_sim == (1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0)


def test_a_manifest_file_that_is_not_there_is_a_fault_of_its_pair(tmp_path):
    dataset = read_dataset(manifest(tmp_path, ["p,real/a.bin,sim/b.bin,,", "q,,sim/a.bin,,"]))
    assert "sim/b.bin" in dataset.pairs[0].fault
    assert "line 3" in dataset.pairs[1].fault


@pytest.mark.parametrize(
    ("row", "fault"),
    [
        ("p,real/a.bin,sim/a.bin,soon,", "line 3: timestamp_s"),
        ("p,real/a.bin,sim/a.bin,,1 2 3", "line 3: T_real_sim"),
        ("p,real/a.bin,sim/a.bin,,2 0 0 0 0 1 0 0 0 0 1 0", "line 3: T_real_sim"),
        ("p,real/a.bin,sim/a.bin,,1 0 0 1e300 0 1 0 0 0 0 1 0", "line 3: T_real_sim"),
        ("p,real/a.bin,sim/a.bin,,1 0 0 0 0 -1 0 0 0 0 1 0", "line 3: T_real_sim .*mirror"),
        ("p,real/a.bin,sim/a.bin,,1 0 0 x 0 1 0 0 0 0 1 0", "line 3: T_real_sim: .*'x'"),
        (" ,real/a.bin,sim/a.bin,,", "line 3: pair_id is empty"),
        ("first,real/a.bin,sim/a.bin,,", "line 3: pair_id first occurs twice"),
    ],
)
def test_a_bad_manifest_stops_everything(tmp_path, row, fault):
    with pytest.raises(DatasetError, match=fault):
        read_dataset(manifest(tmp_path, ["first,real/a.bin,sim/a.bin,,", row]))


@pytest.mark.parametrize(
    ("columns", "fault"),
    [
        ("pair_id,real,sim,T_sim_real", "T_sim_real .*did you mean T_real_sim"),
        ("pair_id,real,sim,t_real_sim", "t_real_sim .*did you mean T_real_sim"),
        ("pair_id,real,sim", "line 2: .*got more"),
        ("pair_id,real,sim,real", "column real"),
        ("name,real", "pair_id, sim; got name, real"),
    ],
)
def test_a_manifest_of_other_columns_stops_everything(tmp_path, columns, fault):
    with pytest.raises(DatasetError, match=fault):
        read_dataset(manifest(tmp_path, ["a,real/a.bin,sim/a.bin,1"], columns))


def test_spaces_quotes_empty_lines_and_absent_values_of_a_manifest_are_no_fault(tmp_path):
    pairs = read_dataset(
        manifest(tmp_path, ['"a", real/a.bin ,sim/a.bin', "", "b,real/a.bin,sim/a.bin"])
    ).pairs
    assert [(pair.pair_id, pair.fault, pair.timestamp_s) for pair in pairs] == [
        ("a", None, None),
        ("b", None, None),
    ]


def test_a_half_sweep_on_one_side_is_a_warning(tmp_path):
    scan = street()
    write_pair(tmp_path, scan, scan[scan[:, 1] <= 0])
    (warning,) = check_dataset(tmp_path, Settings()).warnings
    assert "half sweep" in warning


def test_every_fault_is_found_in_one_go(tmp_path):
    folders(tmp_path, ("a", "b", "c", "d"), ("a", "b", "c"))
    (tmp_path / "real" / "a.bin").write_bytes(b"123")
    (tmp_path / "sim" / "b.bin").write_bytes(b"")
    write_bin(tmp_path / "sim" / "c.bin", np.zeros((20, 3)))
    found = check_dataset(tmp_path, Settings())
    assert len(found.faults) == 4
    for name, fault in zip("abcd", found.faults, strict=True):
        assert fault.startswith(f"pair {name}: ")
    assert "20 zero" in found.faults[2]


def test_check_estimates_the_sensors_of_both_sides_from_the_sampled_pairs(tmp_path):
    beams = fire(SENSORS["vlp16"], step_deg=0.5)
    azimuth = np.arctan2(beams[:, 1], beams[:, 0])
    rows = (10 + 4 * np.sin(3 * azimuth))[:, None] * beams
    dataset = folders(tmp_path, ("a", "b", "c"), ("a", "b"))
    for name in ("a", "b", "c"):
        is_seen = (name != "c") | (np.round(np.degrees(np.arcsin(beams[:, 2]))) % 4 == 1)
        write_bin(dataset / "real" / f"{name}.bin", rows[np.broadcast_to(is_seen, len(rows))])
    sensors = check_dataset(dataset, Settings()).sensors
    assert sensors["real"].model == "Velodyne VLP-16"
    assert sensors["real"].azimuth_step_deg == pytest.approx(0.5, abs=0.001)
    assert sensors["sim"].model is None


def test_settings_in_python_may_be_named_as_on_the_command_line(tmp_path):
    with pytest.raises(SettingsError, match="input.sim_frame"):
        fidpipe.run(tmp_path, settings={"input.sim_fram": "carla"})
    with pytest.raises(SettingsError, match="setting input.sim_frame: expected"):
        fidpipe.run(
            tmp_path, settings={"input": {"min_range_m": 3}, "input.sim_frame": "elsewhere"}
        )


def test_a_preset_does_not_apply_to_runs_that_are_compared(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").touch()
    done = command("compare", tmp_path / "a", tmp_path / "b", "--preset", "paper", code=2)
    assert "these are runs" in done.stderr


def test_after_an_error_check_does_not_advise_a_run(tmp_path):
    misses = np.random.default_rng(0).normal(size=(1000, 3))
    misses *= 80.0 / np.linalg.norm(misses, axis=1, keepdims=True)
    write_pair(tmp_path, street(), np.vstack([street(), misses]))
    done = command("check", tmp_path, code=1)
    assert "next: fix" in done.stdout and "next: fidpipe run" not in done.stdout
