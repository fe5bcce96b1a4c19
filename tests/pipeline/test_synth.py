"""Synthetic datasets: the same for the same seed, whole or not there, and flawed as a digital twin is."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.generate import synth
from fidpipe.schemas.errors import FidpipeError
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import GroundSettings, InputSettings
from fidpipe.stages.clean import clean_scan
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.generate.streets import KINDS
from fidpipe.stages.ground import remove_ground
from runs import QUIET, files_in

N_POINTS = 400  # of a small scan
CLASSES = ("wall", "car", "tree", "vegetation")


def make_dataset(out, **options):
    synth.make_dataset(out, QUIET, **options)


@pytest.fixture(scope="module")
def pairs():
    """Eight pairs as the sensor has them."""
    return [make_pair(0, index, SENSORS["vlp32c"]) for index in range(8)]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """The folder of two small pairs."""
    out = tmp_path_factory.mktemp("synth") / "streets"
    make_dataset(out, n_pairs=2, n_points=N_POINTS)
    return out


def test_another_seed_gives_other_bytes(dataset, tmp_path):
    make_dataset(tmp_path / "other", n_pairs=1, seed=1, n_points=N_POINTS)
    ours, others = files_in(dataset), files_in(tmp_path / "other")
    assert all(ours[name] != others[name] for name in ("real/0000.bin", "sim/0000.bin"))


@pytest.mark.exhaustive
def test_two_processes_make_the_same_dataset(dataset, tmp_path):
    make_dataset(tmp_path / "two", n_pairs=2, n_points=N_POINTS, workers=2)
    assert files_in(tmp_path / "two") == files_in(dataset)


def test_the_reader_finds_pairs_labels_and_frames_over_a_minute_apart(dataset):
    found = read_dataset(dataset)
    assert [pair.pair_id for pair in found.pairs] == ["0000", "0001"]
    assert not any(pair.fault for pair in found.pairs)
    assert np.diff([pair.timestamp_s for pair in found.pairs]).min() > 60
    for pair in found.pairs:
        for path in pair.scans.values():
            scan = read_scan(path, label_names=found.label_names)
            assert path.labels.stat().st_size == 4 * len(scan.points)
            assert set(scan.labels) <= set(KINDS)


def test_the_recipe_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "synth.toml").write_text('wave = "saw"')
    with pytest.raises(FidpipeError, match=str(tmp_path)):
        make_dataset(tmp_path)


def test_a_folder_made_but_never_filled_is_taken(tmp_path):
    (tmp_path / ".synth.toml.0badcafe").write_text("vers")
    make_dataset(tmp_path, n_pairs=1, n_points=N_POINTS)
    assert len(read_dataset(tmp_path).pairs) == 1


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(FidpipeError, match="got a file"):
        make_dataset(tmp_path / "out")


def test_what_was_interrupted_goes_on_where_it_stopped_and_ends_with_the_same_bytes(
    dataset, tmp_path, monkeypatch
):
    made = []

    def interrupted(seed, index, *rest):
        if index == 1 and len(made) == 1:
            made.append(None)
            raise KeyboardInterrupt
        made.append(index)
        return make_pair(seed, index, *rest)

    monkeypatch.setattr(synth, "make_pair", interrupted)
    request = {"n_pairs": 2, "n_points": N_POINTS}
    with pytest.raises(KeyboardInterrupt):
        make_dataset(tmp_path / "out", **request)
    assert not (tmp_path / "out" / "pairs.csv").exists()
    make_dataset(tmp_path / "out", **request)
    assert made == [0, None, 1]
    assert files_in(tmp_path / "out") == files_in(dataset)


def test_another_recipe_replaces_the_pairs_and_fewer_pairs_leave_fewer(dataset, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(dataset, out)
    recipe = (out / "synth.toml").read_text()
    (out / "synth.toml").write_text(recipe.replace("seed = 0", "seed = 5"))
    for path in out.glob("*/0*"):
        path.write_bytes(b"of seed 5")
    (out / "sim" / "notes.txt").write_text("mine")
    before = files_in(out)
    with pytest.raises(FidpipeError, match="8 of its files .*other seed"):
        make_dataset(out, n_pairs=2, n_points=N_POINTS)
    assert files_in(out) == before
    make_dataset(out, n_pairs=2, n_points=N_POINTS, replace=True)
    assert files_in(out) == files_in(dataset) | {"sim/notes.txt": b"mine"}
    with pytest.raises(FidpipeError, match="4 of its files .*other files"):
        make_dataset(out, n_pairs=1, n_points=N_POINTS)
    make_dataset(out, n_pairs=1, n_points=N_POINTS, replace=True)
    assert sorted(path.name for path in out.glob("*/*")) == [
        *["0000.bin"] * 2,
        *["0000.label"] * 2,
        "notes.txt",
    ]
    assert len(read_dataset(out).pairs) == 1


@pytest.mark.parametrize(("sensor", "n_points"), [("vlp32c", 3_000), ("hdl64", 10_000)])
def test_a_scan_has_about_the_points_that_were_asked_for(sensor, n_points):
    pair = make_pair(0, 0, SENSORS[sensor], n_points)
    assert len(pair.real.rows) == pytest.approx(n_points, rel=0.1)
    assert len(pair.sim.rows) == pytest.approx(n_points, rel=0.5)


def test_all_classes_are_seen_on_both_sides(pairs):
    for kind in KINDS:
        for scans in ([pair.real for pair in pairs], [pair.sim for pair in pairs]):
            seen = sum(
                int((np.array(pair.kinds)[scan.object_ids] == kind).sum())
                for pair, scan in zip(pairs, scans, strict=True)
            )
            assert seen > 500, kind


@pytest.mark.parametrize("kind", CLASSES)
def test_objects_have_from_under_a_quarter_to_over_four_times_the_real_points(pairs, kind):
    ratios = []
    for pair in pairs:
        n_things = len(pair.kinds)
        n_real = np.bincount(pair.real.object_ids, minlength=n_things)
        n_sim = np.bincount(pair.sim.object_ids, minlength=n_things)
        wanted = (np.array(pair.kinds) == kind) & (n_real >= 20) & (n_sim > 0)
        ratios += (n_sim[wanted] / n_real[wanted]).tolist()
    assert min(ratios) < 0.25
    assert max(ratios) > 4.0
    assert 0.3 < np.median(ratios) < 2.0


def test_the_twin_stands_where_the_street_stands(pairs):
    for pair in pairs:
        walls = [
            scan.rows[np.array(pair.kinds)[scan.object_ids] == "wall", :3].astype(np.float64)
            for scan in (pair.real, pair.sim)
        ]
        near = [points[np.linalg.norm(points, axis=1) < 25] for points in walls]
        if min(map(len, near)) < 200:
            continue
        off_m, _ = cKDTree(near[0]).query(near[1])
        assert 0.02 < np.median(off_m) < 0.5


def test_the_ground_stage_takes_most_of_the_road_and_few_object_points(pairs):
    for pair in pairs:
        clean = clean_scan(pair.real.rows[:, :3].astype(np.float64), InputSettings())
        cut = remove_ground(clean.points, GroundSettings())
        is_road = np.array(pair.kinds)[pair.real.object_ids[clean.point_ids]] == "ground"
        assert cut.is_ground[is_road].mean() > 0.6
        assert cut.is_ground[~is_road].mean() < 0.2
        assert -2.1 < cut.peak_m < -1.5
