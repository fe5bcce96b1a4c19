"""Degenerate scans: a score within its bounds, a null with a reason, or one line."""

import re

import numpy as np
import pytest

import degenerate
from degenerate import ARRAYS, FURTHER, OPEN, PAGE, SCENES
from fidpipe import evaluate_pair
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.errors import FidpipeError, ScanError
from fidpipe.schemas.tables import TABLES
from runs import command, run, tables
from scenes import cloud, drifted, street

MOST_OBJECTS = "2025 tiny communities"
EXHAUSTIVE = pytest.mark.exhaustive
SAME_THERE = ("n_matched", "match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean", "centroid_distance_m_mean")
LINES = set(PAGE.read_text(encoding="utf-8").splitlines())


@pytest.mark.parametrize("scene", [pytest.param(name, marks=EXHAUSTIVE if name in FURTHER else ()) for name in SCENES])
def test_the_page_says_what_becomes_of_a_scene(scene):
    assert degenerate.row(scene) in LINES, "run python tools/degenerate.py, and say why in CHANGELOG.md"


@pytest.mark.parametrize("name", ARRAYS)
def test_the_page_says_what_becomes_of_an_array(name):
    assert degenerate.array_row(name) in LINES, "run python tools/degenerate.py, and say why in CHANGELOG.md"


def test_the_page_has_no_other_row():
    rows = {line.split("|")[1].strip() for line in LINES if line.startswith("|")}
    assert rows == {*SCENES, *ARRAYS, "scene", "array", "---"}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """All scenes as files whose points have an intensity that is NaN and one of two labels."""
    folder = tmp_path_factory.mktemp("data") / "degenerate"
    for i, scene in enumerate(own for name, own in SCENES.items() if name != MOST_OBJECTS):
        for side, points in zip(("real", "sim"), scene, strict=True):
            rows = np.empty(
                len(points), dtype=[("x", "f8"), ("y", "f8"), ("z", "f8"), ("intensity", "f4"), ("label", "U4")]
            )
            rows["x"], rows["y"], rows["z"] = points.T
            rows["intensity"], rows["label"] = np.nan, np.where(np.arange(len(points)) % 7 < 4, "tree", "wall")
            (folder / side).mkdir(parents=True, exist_ok=True)
            np.save(folder / side / f"{i:03}.npy", rows)
    return folder


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(["--preset", "paper"], id="paper"),
        pytest.param(
            ["--preset", "reference", "--set", "communities.reference=labels", "--set", "metrics.baselines=all"],
            id="reference, labels, baselines",
            marks=EXHAUSTIVE,
        ),
    ],
)
def test_a_run_over_all_scenes_scores_what_can_be_and_names_the_rest(files, tmp_path, words):
    out = tmp_path / "run"
    openly = ["--set", "input.min_range_m=0", "--set", "input.max_range_m=1e9", "--set", "ground.method=none"]
    ended = command("run", files, "--out", out, "--workers", 1, *openly, *words, code=3)
    assert not re.search(r"Traceback|\w+Warning|\.py:\d", ended.stdout + ended.stderr)
    found = tables(out)
    for path, table in found.items():
        for name in table.schema.names:
            values = table.column(name).to_pylist()
            known = [value for value in values if value is not None]
            assert name == "intensity" or not degenerate.fault_of("", name, known), (path, name)
            assert name == "intensity" or all(value == value for value in known), (path, name)
    scenes = [name for name in SCENES if name != MOST_OBJECTS]
    settings = OPEN | {"preset": words[1]}
    for name, row in zip(scenes, found["pairs.parquet"].to_pylist(), strict=True):
        if "communities.reference=labels" in words:
            assert row["status"] == "scored" or row["reason"], name
        else:
            assert _without_names(row) == _in_memory(*SCENES[name], settings), name


@EXHAUSTIVE
def test_a_finished_run_of_all_scenes_is_shown_and_reported(files, tmp_path):
    assert run(files, tmp_path / "run").failures
    for words in (["show"], ["report"], ["status"], ["gate", "--max", "r_lambda.mean=1"], ["export", "--ply"]):
        code = 4 if words[0] == "gate" else 0  # some pairs failed
        ended = command(words[0], tmp_path / "run", *words[1:], code=code)
        assert not re.search(r"Traceback|\w+Warning", ended.stdout + ended.stderr), words


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"z": "c16"}, "column z: expected one real number per row, got complex128 values"),
        ({"x": "?"}, "column x: .* got bool values"),
        ({"y": ("f8", 2)}, r"column y: .* got float64 values of shape \(20, 2\)"),
        ({"intensity": "c8"}, "column intensity: .* got complex64 values"),
    ],
)
def test_a_column_of_no_real_numbers_is_refused_by_its_name(tmp_path, columns, words):
    kinds = {"x": "f8", "y": "f8", "z": "f8", "intensity": "f4"} | columns
    rows = np.ones(20, dtype=[(name, *(kind if isinstance(kind, tuple) else (kind,))) for name, kind in kinds.items()])
    np.save(tmp_path / "a.npy", rows)
    with pytest.raises(ScanError, match=words):
        read_scan(tmp_path / "a.npy")


def test_labels_that_are_infinite_are_text(tmp_path):
    rows = np.zeros(60, dtype=[("x", "f8"), ("y", "f8"), ("z", "f8"), ("label", "f8")])
    rows["x"], rows["y"], rows["z"] = cloud().T
    rows["label"][:30] = np.inf
    np.save(tmp_path / "a.npy", rows)
    assert set(read_scan(tmp_path / "a.npy").labels) == {"inf", "0.0"}  # a warning is an error


def test_arrays_are_read_whatever_their_kind_and_left_as_they_are():
    points = street()
    wanted = evaluate_pair(points, drifted(points)).summary
    frozen = np.asfortranarray(points)
    frozen.flags.writeable = False
    assert evaluate_pair(frozen, np.repeat(drifted(points), 2, axis=0)[::2]).summary == wanted
    half = np.float16(points)
    assert evaluate_pair(half, half).summary["n_identical"] > 3
    assert (half == np.float16(points)).all()


@pytest.mark.parametrize("away_m", [[1e6, 1e6, 0], [4.5e5, 5.4e6, 300]])
def test_projected_coordinates_have_the_scores_of_the_origin(away_m):
    real = street()
    here, there = (degenerate.evaluated(real + move, drifted(real) + move, OPEN).summary for move in (0, away_m))
    for name in SAME_THERE:
        assert there[name] == pytest.approx(here[name], rel=1e-6), name


def test_masked_points_are_dropped():
    points = street()
    mask = np.zeros_like(points, dtype=bool)
    mask[::9, 1] = True
    wanted = evaluate_pair(points[~mask.any(axis=1)], points).summary
    masked = evaluate_pair(np.ma.masked_array(points, mask), points).summary
    assert masked.pop("n_real_raw") == wanted.pop("n_real_raw") + mask.sum()
    assert masked == wanted


def test_no_imaginary_part_is_dropped():
    with pytest.raises(ScanError, match=r"sim: expected real numbers, got complex128 values; convert .* sim\.real$"):
        evaluate_pair(street(), street() + 0j)


def _without_names(row):
    return {name: value for name, value in row.items() if name not in ("pair_id", "reason")}


def _in_memory(real, sim, settings):
    """The row of a pair, without names and reasons."""
    try:
        return _without_names(degenerate.evaluated(real, sim, settings).summary)
    except FidpipeError:
        return _without_names(dict.fromkeys(TABLES["pairs"].schema.names) | {"status": "failed"})
