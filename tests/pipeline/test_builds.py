"""The path of a user with two builds of a simulator: from folders of scans to a decision and its cause."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fidpipe.pipeline.builds import runs_of, side_run_folder, side_run_folders
from fidpipe.pipeline.results.finished import record_of_run
from fidpipe.schemas.errors import DatasetError, RunError
from fidpipe.schemas.settings import load
from runs import QUIET, command
from scan_files import write_pcd, write_ply
from scenes import street, write_bin

#: The second build is this much higher.
HIGHER_M = 0.12
DECISION = Path(__file__).parents[2] / "docs" / "decision.md"


@pytest.fixture(scope="module")
def builds(real_data, tmp_path_factory):
    """Real scans in drive/velodyne, build41/lidar_out in .pcd, and build42/lidar_out in .ply and CARLA's frame."""
    folder = tmp_path_factory.mktemp("builds")
    for i, path in enumerate(sorted((real_data / "kitti_twin/real").iterdir())[:2]):
        real = np.fromfile(real_data / "kitti_twin" / "real" / path.name, np.float32).reshape(
            -1, 4
        )[::3]
        sim = np.fromfile(real_data / "kitti_twin" / "sim" / path.name, np.float32).reshape(
            -1, 4
        )[::3]
        write_bin(folder / "drive" / "velodyne" / f"{i:04}.bin", real[:, :3])
        first = folder / "build41" / "lidar_out"
        second = folder / "build42" / "lidar_out"
        for out in (first, second):
            out.mkdir(parents=True, exist_ok=True)
        write_pcd(first / f"frame_{i:04}.pcd", sim, "binary")
        higher = sim + np.float32([0, 0, HIGHER_M, 0])
        write_ply(
            second / f"frame_{i:04}.ply",
            higher * np.float32([1, -1, 1, 1]),
            "binary_little_endian",
        )
    return folder


def test_three_commands_lead_from_two_builds_to_a_decision_and_its_first_cause(builds):
    section = DECISION.read_text("utf-8").partition("## Builds in different frames")[2]
    first, second, third = re.findall(
        r"^fidpipe (.*)", section.partition("\n## ")[0], re.MULTILINE
    )
    for words in (first, second):
        command(*words.split(), "--workers", 1, cwd=builds, code=0)
    text = command(*third.split(), cwd=builds, code=0).stdout
    assert re.match(r"worse: world 2[012] cm too high, before \d+ cm", text), text
    assert "2 neighbouring frames of one place" in text


def test_compare_evaluates_with_the_settings_given_and_names_runs_after_the_builds(
    builds, tmp_path
):
    words = ("compare", builds / "drive", builds / "build41", builds / "build41")
    found = command(
        *words, "--set", "graph.k=20", "--workers", 1, "--json", cwd=tmp_path, code=0
    )
    assert [json.loads(found.stdout)[0][name] for name in ("base", "other")] == [
        "runs/build41"
    ] * 2
    record = record_of_run(tmp_path / "runs" / "build41")
    assert (record["preset"], record["settings"]["graph"]["k"]) == ("reference", 20)


def test_several_folders_with_scans_are_named_and_one_is_used(tmp_path):
    for name in ("left", "right"):
        write_bin(tmp_path / "drive" / name / "0.bin", street(n=80))
        write_bin(tmp_path / name / "out" / "0.bin", street(n=80))
    with pytest.raises(
        DatasetError, match=r"2 folders hold scans \(left, right\); name one of them"
    ):
        runs_of(
            [tmp_path / name for name in ("drive", "left", "right")],
            load(preset="reference"),
            QUIET,
        )


def test_a_folder_of_scans_is_no_run_and_the_advice_does_not_write_into_it(tmp_path):
    write_bin(tmp_path / "drive" / "velodyne" / "0.bin", street(n=80))
    with pytest.raises(
        RunError, match="if it holds scans, evaluate them: fidpipe run .*drive SIM"
    ):
        record_of_run(tmp_path / "drive")
    for name in ("run", "check"):
        words = ("--workers", 1) if name == "run" else ()
        refused = command(name, tmp_path / "drive", *words, code=1)
        assert "got velodyne; " in refused.stderr
        assert refused.stderr.endswith("fidpipe run REAL SIM\n")


def test_runs_of_builds_have_the_names_that_tell_them_apart(tmp_path):
    assert side_run_folder(tmp_path / "build41" / "lidar_out").name == "build41"
    assert [
        run.name
        for run in side_run_folders([tmp_path / "a" / "scans", tmp_path / "b" / "scans"])
    ] == ["a", "b"]
    same = [tmp_path / "v1" / "town" / "out", tmp_path / "v2" / "town" / "out"]
    assert [run.name for run in side_run_folders(same)] == ["v1-town-out", "v2-town-out"]
