"""Frames of two recordings that are of one time."""

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.datasets.pairing import dataset_of, pair_times, read_timeline
from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.errors import DatasetError
from recordings import cloud, columns_of, rows, write_bag
from runs import command
from scenes import drifted, street, write_bin


def bag_at(path, times_s, scan):
    made = [
        ("/points", round(t * 1e9), lambda types, i=i: cloud(types, rows(scan(i))))
        for i, t in enumerate(times_s)
    ]
    return write_bag(path, made)


def nearest_pairs(real_s, sim_s, tolerance_s):
    """By hand: all gaps, each other's nearest."""
    gaps = np.abs(real_s[:, None] - sim_s[None])
    return [
        (i, j)
        for i in range(len(real_s))
        for j in range(len(sim_s))
        if gaps[i, j] <= tolerance_s and gaps[i].argmin() == j and gaps[:, j].argmin() == i
    ]


def test_pairs_are_each_other_s_nearest_within_the_tolerance():
    rng = np.random.default_rng(0)
    for _ in range(50):
        real_s, sim_s = (
            np.sort(rng.random(rng.integers(1, 12))),
            np.sort(rng.random(rng.integers(1, 12))),
        )
        pairing = pair_times(real_s, sim_s, 0.05, 0.0)
        assert list(zip(pairing.real_ids, pairing.sim_ids, strict=True)) == nearest_pairs(
            real_s, sim_s, 0.05
        )
        np.testing.assert_allclose(
            pairing.gaps_s, sim_s[pairing.sim_ids] - real_s[pairing.real_ids]
        )


@pytest.mark.parametrize("offset", [0.0, 1713492672.25, -3.7])
def test_the_offset_is_found_where_the_time_lines_have_a_pattern(offset):
    rng = np.random.default_rng(1)
    real_s = np.cumsum(rng.uniform(0.08, 0.13, 60)) + max(offset, 0)
    sim_s = real_s[13:40] - offset
    pairing = pair_times(real_s, sim_s, 0.02)
    assert pairing.offset_s == pytest.approx(offset, abs=1e-3)
    assert pairing.real_ids.tolist() == list(range(13, 40))
    assert pairing.others_s == ()


def test_an_offset_that_even_steps_leave_open_is_said_to_be_open():
    pairing = pair_times(np.arange(10) * 0.1 + 50, np.arange(4) * 0.1, 0.02)
    assert len(pairing.real_ids) == 4
    assert pairing.offset_s == pytest.approx(50)
    assert len(pairing.others_s) == 6


def test_clocks_that_agree_get_no_offset():
    pairing = pair_times(np.arange(10) * 0.1, np.arange(2, 6) * 0.1 + 0.004, 0.05)
    assert (pairing.offset_s, pairing.others_s) == (0, ())
    assert pairing.real_ids.tolist() == [2, 3, 4, 5]


@pytest.fixture
def recordings(tmp_path):
    real = bag_at(tmp_path / "real.bag", [100.0, 100.1, 100.2, 100.3, 100.4], street)
    sim = bag_at(tmp_path / "sim_mcap", [3.1, 3.2, 3.3, 9.0], lambda i: drifted(street(i + 1)))
    return real, sim


def test_pair_writes_a_manifest_that_points_into_the_recordings(recordings, tmp_path):
    out = tmp_path / "sets" / "one"
    shown = command("pair", *recordings, "-o", out, "--offset", 97.003, code=0)
    assert (
        f"3 pairs by time, at most 0.0030 s apart: {out}/pairs.csv; clock offset +97.0030 s"
        in shown.stdout
    )
    assert sorted(path.name for path in out.iterdir()) == ["pairs.csv"]
    pairs = read_dataset(out).pairs
    assert [pair.fault for pair in pairs] == [None] * 3
    assert [pair.timestamp_s for pair in pairs] == [100.1, 100.2, 100.3]
    for number, pair in enumerate(pairs, start=1):
        np.testing.assert_array_equal(
            read_scan(pair.real).points, street(number).astype(np.float32)
        )
        np.testing.assert_array_equal(
            read_scan(pair.sim).points, drifted(street(number)).astype(np.float32)
        )
    assert "frames without a partner: 3" in shown.stdout
    assert command("pair", *recordings, "-o", out).returncode == 1
    assert command("check", out).returncode == 0


@pytest.mark.parametrize(
    ("words", "times"),
    [
        (("--every", 2), [100.0, 100.2, 100.4]),
        (("--from", 0.15), [100.2, 100.3, 100.4]),
        (("--from", 0.05, "--to", 0.25), [100.1, 100.2]),
    ],
)
def test_pairs_can_be_fewer(tmp_path, words, times):
    stamps = [100.0, 100.1, 100.2, 100.3, 100.4]
    real = bag_at(tmp_path / "real.bag", stamps, street)
    sim = bag_at(tmp_path / "sim.bag", stamps, street)
    assert command("pair", real, sim, "-o", tmp_path / "out", *words).returncode == 0
    assert [pair.timestamp_s for pair in read_dataset(tmp_path / "out").pairs] == times


def test_times_that_never_meet_are_refused(recordings, tmp_path):
    shown = command("pair", *recordings, "-o", tmp_path / "out", "--offset", 5, code=1)
    assert "100.400" in shown.stderr and "3.100" in shown.stderr
    assert not (tmp_path / "out").exists()


def test_two_sides_are_paired_by_name_then_by_number_then_by_time(recordings, tmp_path):
    names = {
        "real": ["2.bin", "10.bin", "11.bin"],
        "same": ["10.ply", "2.ply"],
        "numbered": ["f_0010.csv", "f_0003.csv"],
    }
    for folder, files in names.items():
        (tmp_path / folder).mkdir()
        for name in files:
            (tmp_path / folder / name).touch()
    folder, how = dataset_of(tmp_path / "real", tmp_path / "same", tmp_path / "a")
    assert how.startswith(f"2 pairs by name: {tmp_path}/a/pairs.csv; ") and how.endswith(
        "without a partner: 1"
    )
    pairs = read_dataset(folder).pairs
    assert [(pair.pair_id, pair.real.file.name, pair.sim.file.name) for pair in pairs] == [
        ("10", "10.bin", "10.ply"),
        ("2", "2.bin", "2.ply"),
    ]
    pairs = read_dataset(
        dataset_of(tmp_path / "real", tmp_path / "numbered", tmp_path / "b")[0]
    ).pairs
    assert [(pair.pair_id, pair.sim.file.name, pair.timestamp_s) for pair in pairs] == [
        ("10", "f_0010.csv", None)
    ]
    folder, how = dataset_of(*recordings, tmp_path / "c")
    assert "by time" in how and "+96.9000 s" in how
    # again, over the same manifest
    assert dataset_of(*recordings, tmp_path / "c") == (
        folder,
        how,
    )
    with pytest.raises(DatasetError, match="other scans.*--out"):
        dataset_of(tmp_path / "real", tmp_path / "same", tmp_path / "c")
    (tmp_path / "same").rename(tmp_path / "sim")
    assert dataset_of(tmp_path / "real", tmp_path / "sim", tmp_path / "d") == (tmp_path, "")
    (tmp_path / "sim").rename(tmp_path / "same")
    (tmp_path / "numbered").rename(tmp_path / "sim")
    assert dataset_of(tmp_path / "real", tmp_path / "sim", tmp_path / "d")[0] == tmp_path / "d"


def test_columns_that_were_added_to_the_manifest_of_two_sides_stay(tmp_path):
    for side in ("pre", "post"):
        for name in ("1", "2"):
            write_bin(tmp_path / side / f"{name}.bin", street())
    sides = (tmp_path / "pre", tmp_path / "post", tmp_path / "pairs")
    dataset_of(*sides)
    manifest = tmp_path / "pairs" / "pairs.csv"
    moved = pd.read_csv(manifest, dtype=str).assign(T_real_sim="1 0 0 5 0 1 0 0 0 0 1 0")
    moved.to_csv(manifest, index=False)
    dataset_of(*sides)
    assert [pair.T_real_sim[3] for pair in read_dataset(tmp_path / "pairs").pairs] == [5.0, 5.0]
    write_bin(tmp_path / "post" / "3.bin", street())
    write_bin(tmp_path / "pre" / "3.bin", street())
    dataset_of(*sides)
    assert len(read_dataset(tmp_path / "pairs").pairs) == 3


def test_a_folder_of_recordings_is_answered_with_the_command_that_works(recordings, tmp_path):
    refused = command("check", tmp_path).stderr
    assert "got real.bag, sim_mcap; " in refused and refused.endswith("fidpipe run REAL SIM\n")
    assert command("check", *recordings, cwd=tmp_path).returncode == 0


def test_a_folder_has_its_times_from_a_file_or_from_its_names(tmp_path):
    for i in range(3):
        write_bin(tmp_path / "listed" / f"{i:06}.bin", street(i))
        write_bin(tmp_path / "named" / f"{9 + i}.250.bin", street(i))
    with pytest.raises(DatasetError, match=r"times\.txt or poses\.tum"):
        read_timeline(tmp_path / "listed")
    (tmp_path / "listed" / "times.txt").write_text("0.5\n0.6\n0.8\n")
    assert read_timeline(tmp_path / "listed").times_s.tolist() == [0.5, 0.6, 0.8]
    line = read_timeline(tmp_path / "named")
    assert line.times_s.tolist() == [9.25, 10.25, 11.25]
    assert [scan.file.name for scan in line.frames] == ["9.250.bin", "10.250.bin", "11.250.bin"]


def test_a_capture_and_a_bag_of_the_same_turns_are_paired_turn_by_turn(real_data, tmp_path):
    folder = real_data / "velodyne_vlp32c"
    words = (folder / "sweeps.pcap", folder / "rosbag2_mcap", "-o", tmp_path / "out")
    assert "frames without a partner: 2" in command("pair", *words, code=0).stdout
    pairs = read_dataset(tmp_path / "out").pairs
    assert len(pairs) == 3
    for pair in pairs:
        assert columns_of(read_scan(pair.real)) == columns_of(read_scan(pair.sim))


@pytest.mark.parametrize(
    ("row", "fault"),
    [("0," + "x" * 200_000 + ",b", "not a CSV table"), ("0,a\0b,c", "pairs of other scans")],
)
def test_a_damaged_list_of_pairs_is_an_error_in_one_line(tmp_path, row, fault):
    for side in ("left", "right"):
        write_bin(tmp_path / side / "a.bin", street())
    folder, _ = dataset_of(tmp_path / "left", tmp_path / "right", tmp_path / "pairs")
    (folder / "pairs.csv").write_text(f"pair_id,real,sim\n{row}\n")
    with pytest.raises(DatasetError, match=fault):
        dataset_of(tmp_path / "left", tmp_path / "right", tmp_path / "pairs")
