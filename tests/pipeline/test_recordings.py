"""Frames of bags and captures: addresses, equal points from each format, and messages on broken files."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.datasets.content import scan_content
from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import frames_of, read_scan, rosbag, stem_of, suffix_of, velodyne
from fidpipe.pipeline.datasets.readers.frame_address import address_of
from fidpipe.schemas.errors import ScanError
from recordings import cloud, columns_of, packets_message, write_bag, write_pcap
from runs import command, run
from scenes import drifted, street

BAGS = ("a.bag", "a_sqlite3", "a_mcap")
FIELDS = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("t", "<u4")])
SECOND = 10**9


def rows(points, fields=FIELDS):
    found = np.zeros(len(points), fields)
    for name, column in zip("xyz", points.T, strict=True):
        found[name] = column
    found["intensity"], found["ring"] = np.arange(len(points)) % 256, np.arange(len(points)) % 32
    found["t"] = np.arange(len(points)) * 1000
    return found


def bag_of(path, *scans, topic="/points"):
    """Frames at 5.0 s, 5.1 s, ..."""
    made = [
        (topic, 5 * SECOND + i * SECOND // 10, lambda types, scan=scan: cloud(types, rows(scan)))
        for i, scan in enumerate(scans)
    ]
    return write_bag(path, made)


@pytest.mark.parametrize("name", BAGS)
def test_a_frame_of_a_bag_is_read_by_number_and_by_time(tmp_path, name):
    scans = [street(seed) for seed in range(3)]
    bag = bag_of(tmp_path / name, *scans)
    assert [path.name for path in frames_of(bag)] == [f"points@5.{i}00000000" for i in range(3)]
    for i, scan in enumerate(scans):
        for path in (f"{bag}#{i}", f"{bag}#5.{i}", f"{bag}#/points@{i}", frames_of(bag)[i]):
            read = read_scan(Path(path))
            np.testing.assert_array_equal(read.points, scan.astype(np.float32))
            assert read.intensity.tolist() == (np.arange(len(scan)) % 256).tolist()
            assert read.rings.tolist() == (np.arange(len(scan)) % 32).tolist()
            np.testing.assert_allclose(read.times_s, np.arange(len(scan)) * 1e-6)


@pytest.mark.parametrize(("folder", "file"), [("a_sqlite3", "a_sqlite3.db3"), ("a_mcap", "a_mcap.mcap")])
def test_the_file_in_a_folder_of_ros_2_is_read_without_its_metadata(tmp_path, folder, file):
    bag = bag_of(tmp_path / folder, street())
    alone = shutil.copy(bag / file, tmp_path)
    np.testing.assert_array_equal(read_scan(Path(alone)).points, read_scan(bag).points)


@pytest.mark.parametrize(
    ("address", "fault"),
    [
        ("", r"2 frames found; name one of a\.bag#/points@0 to a\.bag#/points@1"),
        ("#2", "no frame 2; the last is 1"),
        ("#5.2", r"expected one frame at 5\.2 s, got 0; the nearest is number 1, a\.bag#/points@5\.100000000"),
        ("#/other", r"no point clouds on topic /other; they are on /points \(2 frames\)"),
        ("#/points@first", "expected a frame number from 0 or a time in seconds, got 'first'"),
    ],
)
def test_a_frame_that_is_not_there_is_named(tmp_path, address, fault):
    bag = bag_of(tmp_path / "a.bag", street(0), street(1))
    with pytest.raises(ScanError, match=fault):
        read_scan(Path(f"{bag}{address}"))


@pytest.mark.parametrize("name", BAGS)
def test_of_two_topics_one_is_to_be_named(tmp_path, name):
    bag = write_bag(
        tmp_path / name,
        [
            (f"/{side}", SECOND, lambda types, i=i: cloud(types, rows(street(i))))
            for i, side in enumerate(("left", "top"))
        ],
    )
    with pytest.raises(ScanError, match=r"point clouds on /left \(1 frames\), /top \(1 frames\); name one topic"):
        read_scan(bag)
    np.testing.assert_array_equal(read_scan(Path(f"{bag}#/top")).points, street(1).astype(np.float32))


def test_a_bag_without_point_clouds_says_what_it_holds(tmp_path):
    bag = write_bag(tmp_path / "a.bag", [("/said", 0, lambda types: types.types["std_msgs/msg/String"]("hello"))])
    with pytest.raises(
        ScanError, match=r"expected a topic of sensor_msgs/msg/PointCloud2 .*/said \(std_msgs/msg/String\)"
    ):
        read_scan(bag)


def test_two_frames_of_one_time_are_told_apart_by_number_alone(tmp_path):
    made = [("/points", SECOND, lambda types, i=i: cloud(types, rows(street(i)))) for i in range(2)]
    bag = write_bag(tmp_path / "a.bag", made)
    for i in range(2):
        np.testing.assert_array_equal(read_scan(Path(f"{bag}#{i}")).points, street(i).astype(np.float32))
    with pytest.raises(ScanError, match="expected one frame at 1.0 s, got 2"):
        read_scan(Path(f"{bag}#1.0"))


@pytest.mark.parametrize("big_endian", [False, True])
def test_an_organised_cloud_keeps_its_order_and_its_missing_returns(tmp_path, big_endian):
    points = street()[:60]
    points[[3, 17]] = np.nan
    points[21] = 0
    made = lambda types: cloud(types, rows(points), height=4, padding=6, big_endian=big_endian)  # noqa: E731
    read = read_scan(write_bag(tmp_path / "a.bag", [("/points", 0, made)]))
    np.testing.assert_array_equal(read.points, points.astype(np.float32))


def test_float64_fields_keep_their_precision(tmp_path):
    fields = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("intensity", "u1"), ("ring", "i1"), ("t", "<f8")])
    points = street() + [635619.85, 848899.7, 406.59]
    bag = write_bag(tmp_path / "a_mcap", [("/points", 0, lambda types: cloud(types, rows(points, fields)))])
    read = read_scan(bag)
    np.testing.assert_array_equal(read.points, points)
    np.testing.assert_array_equal(read.times_s, np.arange(len(points)) * 1000)


def test_a_cloud_shorter_than_it_says_is_refused(tmp_path):
    def short(types):
        message = cloud(types, rows(street()))
        message.width = 10**9
        return message

    with pytest.raises(
        ScanError, match=r"expected 22000000000 bytes in a cloud, got .* \(1 x 1000000000 points of 22\)"
    ):
        read_scan(write_bag(tmp_path / "a.bag", [("/points", 0, short)]))


@pytest.mark.parametrize("name", ["a.bag", "a_mcap/a_mcap.mcap", "a_sqlite3/a_sqlite3.db3"])
def test_a_truncated_bag_is_refused(tmp_path, name):
    bag_of(tmp_path / Path(name).parts[0], *[street(i) for i in range(3)])
    path = tmp_path / name
    path.write_bytes(path.read_bytes()[:4000])
    with pytest.raises(ScanError, match="not a whole ROS bag"):
        read_scan(Path(f"{path}#2"))


def test_a_file_whose_name_has_a_hash_is_a_file(tmp_path):
    bag = bag_of(tmp_path / "drive#2.bag", street())
    assert address_of(bag).file == bag
    assert suffix_of(bag) == ".bag"
    assert len(read_scan(bag).points) == len(street())


def test_frames_have_names_for_their_results(tmp_path):
    bag = bag_of(tmp_path / "a.bag", street())
    assert stem_of(Path(f"{bag}#/lidar/top@3")) == "a-lidar-top-3"
    assert stem_of(Path(f"{bag}#3")) == "a-3"
    assert stem_of(bag) == "a"


def test_frames_of_a_time_are_read_without_the_others(tmp_path, monkeypatch):
    bag = bag_of(tmp_path / "a_mcap", *[street(i) for i in range(3)])
    path = frames_of(bag)[1]
    monkeypatch.setattr(rosbag, "_times_ns", lambda *_: pytest.fail("the bag was gone through"))
    assert len(read_scan(path).points) == len(street())


def test_content_of_a_frame_is_its_recording_and_its_address(tmp_path):
    bag = bag_of(tmp_path / "b_mcap", street(0), street(1))
    first, second = frames_of(bag)
    before = scan_content(first)
    assert before.sha256 != scan_content(second).sha256
    assert shutil.copytree(bag, tmp_path / "copy") and scan_content(frames_of(tmp_path / "copy")[0]) == before
    shutil.copy(bag / "metadata.yaml", bag / "more.yaml")
    assert scan_content(first) != before


@pytest.fixture
def pointing(tmp_path):
    """A dataset whose manifest points into two bags; two pairs."""
    real = bag_of(tmp_path / "real.bag", *[street(i) for i in range(3)])
    sim = bag_of(tmp_path / "sim_mcap", *[drifted(street(i)) for i in range(3)], topic="/carla/lidar")
    table = {
        "pair_id": ["a", "b"],
        "real": [f"{real.name}#0", f"{real.name}#5.2"],
        "sim": [f"{sim.name}#/carla/lidar@0", f"{sim.name}#2"],
    }
    pd.DataFrame(table).to_csv(tmp_path / "pairs.csv", index=False)
    return tmp_path


def test_a_manifest_points_into_recordings(pointing):
    pairs = read_dataset(pointing).pairs
    assert [pair.fault for pair in pairs] == [None, None]
    np.testing.assert_array_equal(read_scan(pairs[1].real).points, street(2).astype(np.float32))


def test_a_run_over_frames_gives_the_numbers_of_a_run_over_files(pointing):
    files = pointing / "files"
    for side in ("real", "sim"):
        (files / side).mkdir(parents=True)
    for pair in read_dataset(pointing).pairs:
        for side in ("real", "sim"):
            np.save(files / side / f"{pair.pair_id}.npy", read_scan(pair.path(side)).points)
    done = command("run", pointing, "--out", pointing / "frames", "--workers", 2)
    assert done.returncode == 0, done.stderr
    run(files, pointing / "copies")
    frames, copies = (pd.read_parquet(pointing / out / "metrics") for out in ("frames", "copies"))
    assert len(frames)
    pd.testing.assert_frame_equal(frames, copies)
    again = command("run", pointing, "--out", pointing / "frames", "--workers", 1)
    assert "0 jobs done" in again.stderr + again.stdout


def test_check_names_a_frame_that_is_not_there(pointing):
    manifest = pointing / "pairs.csv"
    manifest.write_text(manifest.read_text().replace("real.bag#0", "real.bag#9"))
    shown = command("check", pointing)
    assert shown.returncode == 1
    assert "no frame 9; the last is 2" in shown.stdout + shown.stderr


# Packets of a Velodyne.


@pytest.fixture
def packets(real_data):
    found = [(stamp, data) for _, stamp, data in velodyne._packets(real_data / "velodyne_vlp32c/sweeps.pcap")]
    assert len(found) == 379
    return found


def test_bags_captures_and_packets_in_bags_hold_the_same_points(real_data, packets, tmp_path):
    folder = real_data / "velodyne_vlp32c"
    turns = [packets[0:77], packets[77:153], packets[153:229]]
    made = [("/packets", i, lambda types, turn=turn: packets_message(types, turn)) for i, turn in enumerate(turns)]
    places = [folder / name for name in ("rosbag1.bag", "rosbag2_sqlite3", "rosbag2_mcap", "sweeps.pcap")]
    places += [write_bag(tmp_path / name, made) for name in BAGS]
    for i, n_points in enumerate((26710, 26335, 26317)):
        first, *others = [read_scan(Path(f"{place}#{i}")) for place in places]
        assert len(first.points) == n_points
        assert all(columns_of(other) == columns_of(first) for other in others)


def test_a_turn_of_a_capture_is_decoded_by_itself_as_in_its_stream(real_data):
    import velodyne_decoder as vd

    capture = real_data / "velodyne_vlp32c/sweeps.pcap"
    turns = [rows for _, rows in vd.read_pcap(str(capture))]
    assert len(frames_of(capture)) == len(turns) == 5
    for path, turn in reversed(list(zip(frames_of(capture), turns, strict=True))):
        np.testing.assert_array_equal(read_scan(path).points, turn[:, :3])


def test_the_cloud_of_another_decoder_lies_on_the_same_surfaces(real_data):
    """one_sweep.pcd comes from the decoder of Autoware, which corrects angles otherwise: not one point is the same."""
    from scipy.spatial import cKDTree

    folder = real_data / "velodyne_vlp32c"
    theirs, ours = (read_scan(folder / name).points for name in ("one_sweep.pcd", Path("sweeps.pcap#0")))
    distance_m, _ = cKDTree(ours).query(theirs)
    assert len(theirs) == 26216
    assert np.median(distance_m) < 0.01
    assert np.percentile(distance_m, 99) < 0.03


def test_a_capture_that_ends_in_a_packet_keeps_its_whole_turns(real_data, tmp_path):
    content = (real_data / "velodyne_vlp32c/sweeps.pcap").read_bytes()
    short = tmp_path / "short.pcap"
    short.write_bytes(content[: len(content) // 2 + 13])
    whole = frames_of(real_data / "velodyne_vlp32c/sweeps.pcap")
    assert [path.name.partition("#")[2] for path in frames_of(short)[:2]] == [
        path.name.partition("#")[2] for path in whole[:2]
    ]


@pytest.mark.parametrize("content", [b"", b"no capture at all, but text", None])
def test_a_capture_without_packets_is_refused(tmp_path, content):
    path = write_pcap(tmp_path / "a.pcap", [(1.0, bytes(100))])
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ScanError, match=r"a\.pcap: (the file is empty|not a whole capture|no data packets)"):
        read_scan(path)


def test_a_capture_by_another_writer_is_read(packets, tmp_path, real_data):
    copy = write_pcap(tmp_path / "copy.pcap", packets)
    np.testing.assert_array_equal(
        read_scan(Path(f"{copy}#4")).points, read_scan(real_data / "velodyne_vlp32c/sweeps.pcap#4").points
    )
