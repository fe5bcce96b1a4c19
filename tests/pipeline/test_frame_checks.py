"""Scans in different frames, equal files and swapped sides: messages of check, run and gate."""

import html
import json
import re
import shutil
from itertools import pairwise

import numpy as np
import pytest

import fidpipe
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.pipeline.jobs import sensor_job
from fidpipe.pipeline.report.page.run_page import write_report
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.gate import judge_run, parse_word
from fidpipe.pipeline.results.measures import Measures
from fidpipe.pipeline.run_tables import few_of_each
from fidpipe.schemas.settings import InputSettings, Settings, load
from fidpipe.stages.frame_search import check_frames
from runs import command, run
from scenes import box, drifted, road, street, write_bin, write_pair

MENDED = "input.sim_frame=carla"


def scan(seed):
    return np.vstack(
        [
            street(seed, n=300),
            road(5000, seed=seed + 1),
            box([12, -5, 1], [0.3, 9, 5], 600, seed + 5),
        ]
    )


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory):
    """Two pairs, of which the simulated side of the first is mirrored."""
    folder = tmp_path_factory.mktemp("mirrored") / "streets"
    for i, signs in enumerate(([1, -1, 1], [1, 1, 1])):
        write_pair(folder, scan(10 * i), drifted(scan(10 * i)) * signs, i)
    return folder


@pytest.fixture(scope="module")
def finished(mirrored, tmp_path_factory):
    out = tmp_path_factory.mktemp("finished") / "run"
    return out, command(
        "run", mirrored, "--out", out, "--workers", 1, "--set", "graph.k=10", code=0
    )


def frame_warnings(dataset, *words):
    return [
        text
        for text in check_dataset(dataset, load(None, words)).warnings
        if "another frame" in text
    ]


def test_check_names_the_mirrored_pair_with_both_figures_and_the_setting(mirrored):
    (warning,) = frame_warnings(mirrored)
    assert warning.startswith("pair 0: the simulated scan covers 0.")
    assert MENDED in warning
    (other,) = frame_warnings(mirrored, MENDED)
    assert other.startswith("pair 1: ")
    assert other.endswith("set input.sim_frame=ros")


def warning_of(done):
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("warning")]
    return line


def test_a_run_ends_with_a_warning_and_notes_the_suspects(finished):
    out, done = finished
    assert warning_of(done).startswith("warning: in 1 of 2 pairs")
    assert MENDED in warning_of(done)
    assert "\nNext          fidpipe check" in done.stdout
    frames = json.loads((out / "run.json").read_text())["frames"]
    assert frames.keys() == {"0"}
    assert (frames["0"]["reading"], frames["0"]["setting"]) == ("mirrored in y", MENDED)
    assert frames["0"]["coverage"] > frames["0"]["as_it_lies"] + 0.15


def test_a_pair_of_two_places_is_named_wherever_the_run_is_read(mirrored, tmp_path):
    data = shutil.copytree(mirrored, tmp_path / "streets")
    for i in range(2):
        write_bin(data / "sim" / f"{i}.bin", drifted(scan(10 * i)))
    run(data, tmp_path / "same", load(None, ["graph.k=10"]))
    write_bin(
        data / "sim" / "1.bin",
        np.random.default_rng(0).uniform(-30, 30, (6000, 3)) * [1, 1, 0.3],
    )
    out = tmp_path / "run"
    words = "in 1 of 2 pairs the two scans do not show the same place, but count (1)"
    ended = run(data, out, load(None, ["graph.k=10"]))
    assert ended.record.frames["1"].reading == "of another place"
    shown = " ".join(command("show", out).stdout.split())
    assert f"warning: {words}" in shown
    assert "nothing beyond" not in shown
    assert words in html.unescape(write_report(out, out=tmp_path / "report").page.read_text())
    assert not judge_run(out, [parse_word("r_lambda.mean=2", "max")]).passed
    compared = command("compare", tmp_path / "same", out)
    assert "1 of 2 pairs are not in one frame" in " ".join(compared.stdout.split())


def test_two_arrays_in_other_frames_are_warned_of_with_both_figures_and_the_setting():
    real = scan(0)
    sim = drifted(scan(0))
    settings = {"graph": {"k": 10}}
    with pytest.warns(UserWarning, match="mirrored in y.*input.sim_frame=carla"):
        wrong = fidpipe.evaluate_pair(real, sim * [1, -1, 1], settings)
    # warns: error
    mended = fidpipe.evaluate_pair(
        real, sim * [1, -1, 1], settings | {"input": {"sim_frame": "carla"}}
    )
    assert mended.summary["match_rate"] > wrong.summary["match_rate"]
    turned = sim * [-1, -1, 1]
    with pytest.warns(UserWarning, match="rotated by") as told:
        fidpipe.evaluate_pair(real, turned, settings)
    T = np.array(
        re.search('T_real_sim "(.*?)"', str(told[0].message))[1].split(), dtype=float
    ).reshape(3, 4)
    np.testing.assert_allclose(turned @ T[:, :3].T + T[:, 3], sim, atol=1e-9)


def test_a_gate_fails_on_a_suspect_pair_unless_it_is_allowed(finished):
    out, _ = finished
    assert Measures(FinishedRun(out)).named("pairs.frame_suspect")[0] == 1
    assert command("gate", out, "--min", "match_rate.mean=0").returncode == 4
    allowed = judge_run(out, [parse_word("pairs.frame_suspect=1", "max")])
    assert allowed.passed
    assert [own.limit for own in allowed.judged if own.measure == "pairs.frame_suspect"] == [1]


def test_frames_are_compared_again_only_where_files_or_input_settings_changed(
    mirrored, tmp_path, monkeypatch
):
    data = shutil.copytree(mirrored, tmp_path / "streets")
    out = tmp_path / "run"
    settings = load(None, ["graph.k=10"])
    compared = []
    monkeypatch.setattr(
        sensor_job,
        "check_frames",
        lambda *scans: compared.append(scans) or check_frames(*scans),
    )
    assert run(data, out, settings).record.frames.keys() == {"0"}
    assert len(compared) == 2
    assert run(data, out, settings).record.frames.keys() == {"0"}
    assert len(compared) == 2
    shutil.copy(data / "sim" / "1.bin", tmp_path / "kept.bin")
    write_bin(data / "sim" / "1.bin", drifted(scan(10)) * [1, -1, 1])
    assert run(data, out, settings).record.frames.keys() == {"0", "1"}
    assert len(compared) == 3
    assert run(data, out, load(None, ["graph.k=10", MENDED])).record.frames == {}
    assert len(compared) == 5


def test_centimetres_are_named_beside_the_fault(tmp_path):
    write_pair(tmp_path, scan(0), 100 * drifted(scan(0)))
    check = check_dataset(tmp_path, Settings())
    assert len(check.faults) == 1
    assert any("centimetres" in text for text in check.warnings)


def test_equal_files_are_named_within_a_pair_and_between_pairs(tmp_path):
    for name in ("real/a", "sim/a", "real/b"):
        write_bin(tmp_path / f"{name}.bin", scan(0))
    write_bin(tmp_path / "sim/b.bin", drifted(scan(0)))
    warnings = check_dataset(tmp_path, Settings()).warnings
    assert [text.partition(":")[0] for text in warnings] == [
        "pairs a (real), a (sim), b (real)"
    ]


def test_many_warnings_of_a_kind_are_counted():
    lines = few_of_each(
        [*(f"pair {i}: too {i}; set x" for i in range(13)), "pair 1: half a sweep"]
    )
    assert lines[9:] == [
        "pair 9: too 9; set x",
        "3 more like that; fidpipe check lists them",
        "pair 1: half a sweep",
    ]


@pytest.mark.parametrize(
    ("row", "swapped"),
    [
        ("p,real/a.bin,sim/a.bin", None),
        ("p,sim/a.bin,real/a.bin", "the real scan is"),
        ("p,sim/a.bin,sim/b.bin", "the real scan is"),
        ("p,real/a.bin,real/b.bin", "the simulated scan is"),
        ("p,scans/a_real.bin,scans/a_sim.bin", None),
        ("p,scans/a_simulated.bin,scans/b.bin", "the real scan is"),
        ("p,real/similar_sim.bin,sim/a.bin", None),
    ],
)
def test_sides_that_are_named_after_each_other_are_named(tmp_path, row, swapped):
    names = row.split(",")[1:]
    for i, name in enumerate(names):
        write_bin(tmp_path / name, drifted(scan(0), seed=i))
    (tmp_path / "pairs.csv").write_text(f"pair_id,real,sim\n{row}\n")
    warnings = [
        text for text in check_dataset(tmp_path, Settings()).warnings if "swapped" in text
    ]
    assert len(warnings) == (swapped is not None)
    assert all(swapped in text for text in warnings)


def test_a_folder_that_is_a_link_to_the_other_side_is_named(tmp_path):
    data = tmp_path / "data"
    write_bin(tmp_path / "twins" / "simulation" / "a.bin", scan(0))
    write_bin(tmp_path / "recorded" / "a.bin", drifted(scan(0)))
    data.mkdir()
    (data / "real").symlink_to(tmp_path / "twins" / "simulation")
    (data / "sim").symlink_to(tmp_path / "recorded")
    (warning,) = check_dataset(data, Settings()).warnings
    assert "swapped" in warning


@pytest.mark.exhaustive
def test_real_pairs_raise_no_alarm_and_their_mirror_images_do(real_data):
    for real_path in sorted((real_data / "kitti_twin/real").iterdir()):
        real, sim = (
            read_scan(real_path).points,
            read_scan(real_data / "kitti_twin/sim" / real_path.name).points,
        )
        assert not check_frames(real, sim, InputSettings()).is_suspect
        found = check_frames(real, sim * [1, -1, 1], InputSettings())
        assert (found.is_suspect, found.setting) == (True, MENDED)


@pytest.mark.exhaustive
def test_neighbouring_frames_of_a_recording_raise_no_alarm(real_data):
    scans = [
        read_scan(path).points for path in sorted((real_data / "kitti_sequence").glob("*.bin"))
    ]
    assert not any(check_frames(*pair, InputSettings()).is_suspect for pair in pairwise(scans))


@pytest.mark.exhaustive
def test_two_sensors_raise_no_alarm_with_their_extrinsics_and_one_without(real_data):
    from scipy.spatial.transform import Rotation

    lines = (real_data / "rellis/vel2os1.yaml").read_text().splitlines()
    w, x, y, z, *t = [float(line.split(":")[1]) for line in lines if line.split(":")[1].strip()]
    T = np.column_stack([Rotation.from_quat([x, y, z, w]).as_matrix(), t])
    ouster = read_scan(real_data / "rellis/000104.bin").points
    velodyne = read_scan(real_data / "rellis/vel000104.bin").points
    assert not check_frames(ouster, velodyne, InputSettings(), T).is_suspect
    found = check_frames(ouster, velodyne, InputSettings())
    assert (found.is_suspect, found.reading) == (True, "rotated by 180 degrees")
