"""Files and recordings of every format: exact values, addresses of frames, and messages on incomplete files."""

import shutil
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.datasets.content import scan_content
from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import frames_of, read_scan, rosbag, velodyne
from fidpipe.pipeline.datasets.readers.scan_ref import scan_ref
from fidpipe.schemas.errors import ScanError
from recordings import carla_ply, cloud, columns_of, packets_message, rows, write_bag, write_las
from runs import command, run
from scenes import drifted, street, write_bin

POINTS = np.array([[1.5, -2.25, 0.5], [4, 5, 6], [-7, 8, 9.125]])


def ascii_pcd(points, intensity):
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
    head += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA ascii\n"
    return head + "".join(
        f"{x} {y} {z} {i}\n" for (x, y, z), i in zip(points, intensity, strict=True)
    )


def ply(points, fmt, label=False):
    head = f"ply\nformat {fmt} 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {name}\n" for name in ("x", "y", "z", "scalar_intensity"))
    head += ("property int label\n" if label else "") + "end_header\n"
    if fmt == "ascii":
        rows = "".join(f"{x} {y} {z} 7{' 4' if label else ''}\n" for x, y, z in points)
        return (head + rows).encode()
    return (
        head.encode()
        + np.column_stack([points, np.full(len(points), 7)]).astype("<f4").tobytes()
    )


@pytest.mark.parametrize(
    ("name", "suffix", "stem"),
    [
        ("000104.bin", ".bin", "000104"),
        ("n008__LIDAR.pcd.bin", ".pcd.bin", "n008__LIDAR"),
        ("a.b.PCD", ".pcd", "a.b"),
        ("notes.txt", "", "notes.txt"),
        ("a.bag#/lidar/top@3", ".bag", "a-lidar-top-3"),
        ("a.bag#3", ".bag", "a-3"),
    ],
)
def test_the_stem_is_the_name_less_its_known_suffix(tmp_path, name, suffix, stem):
    scan = scan_ref(tmp_path / name)
    assert (scan.suffix, scan.stem) == (suffix, stem)


#: File, content and message.
REFUSED = {
    "a row less": (
        "a.pcd",
        ascii_pcd(POINTS, [1, 2, 3]).rsplit("\n", 2)[0].encode() + b"\n",
        "2 points",
    ),
    "a short row": (
        "a.ply",
        ply(POINTS, "ascii", label=True).rsplit(b" ", 1)[0] + b"\n",
        r"a\.ply",
    ),
    "text in a CSV": ("a.csv", b"x,y,z\n1,2,3\n4,five,6\n", "row 2, column y: .*'five'"),
    "a column less": ("a.csv", b"x,y\n1,2\n", "missing columns z; got x, y"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_file_that_is_not_whole_is_refused_by_its_fault(tmp_path, kind):
    name, content, fault = REFUSED[kind]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ScanError, match=fault):
        read_scan(tmp_path / name)


def test_csv_is_read_whatever_the_case_of_its_header(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("X, Y, Z, Intensity, label\n1.5,-2.25,0.5,9,car\n4,5,6,8,tree\n1,,3,0,\n")
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points[:2], POINTS[:2])
    assert np.isnan(scan.points[2, 1])
    assert (scan.intensity.tolist(), scan.labels.tolist()[:2]) == ([9, 8, 0], ["car", "tree"])


@pytest.mark.parametrize("header", ["x,y,z,time,time", "x,y,z,,"])
def test_columns_of_a_csv_that_are_not_used_may_share_a_name(tmp_path, header):
    path = tmp_path / "a.csv"
    path.write_text(f"{header}\n1.5,-2.25,0.5,9,7\n4,5,6,8,7\n")
    np.testing.assert_array_equal(read_scan(path).points, POINTS[:2])


@pytest.mark.parametrize(
    ("array", "fault"),
    [
        (np.zeros((3, 2)), r"got .* shape \(3, 2\)"),
        (np.zeros(3), r"got .* shape \(3,\)"),
        (np.array([["a", "b", "c"]]), "U1 array"),
        (np.ones((3, 50)), r"array\.T"),
        (np.ones((50, 7)), "name the columns in input.columns"),
    ],
)
def test_an_npy_of_another_shape_or_type_is_refused(tmp_path, array, fault):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(ScanError, match=fault):
        read_scan(tmp_path / "a.npy")


def test_a_label_file_of_another_length_is_refused(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS)
    np.array([4, 4], dtype="<u4").tofile(tmp_path / "a.label")
    with pytest.raises(ScanError, match=r"a\.label: "):
        read_scan(path)


def test_a_missing_file_and_an_unknown_format_are_refused(tmp_path):
    with pytest.raises(ScanError, match="gone.bin"):
        read_scan(tmp_path / "gone.bin")
    with pytest.raises(ScanError, match="gone.xyz"):
        read_scan(tmp_path / "gone.xyz")
    (tmp_path / "a.xyz").write_text("1 2 3")
    with pytest.raises(ScanError, match="a.xyz: unknown format"):
        read_scan(tmp_path / "a.xyz")


@pytest.mark.parametrize("n_columns", [3, 4])
def test_float64_rows_in_a_bin_are_refused(tmp_path, n_columns):
    rows = np.column_stack([street(), np.zeros(len(street()))])[:, :n_columns]
    (tmp_path / "a.bin").write_bytes(rows.astype("<f8").tobytes())
    with pytest.raises(ScanError, match="got float64; convert it"):
        read_scan(tmp_path / "a.bin")
    assert len(read_scan(write_bin(tmp_path / "b.bin", street())).points) == len(street())


def test_columns_of_an_npy_can_be_named(tmp_path):
    np.save(tmp_path / "a.npy", np.column_stack([[9, 8, 7], [0, 0, 0], POINTS]))
    scan = read_scan(tmp_path / "a.npy", ("intensity", "ring", "x", "y", "z"))
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.intensity.tolist() == [9, 8, 7]


# Columns of others.


def test_carla_ray_cast_has_its_intensity(tmp_path):
    (tmp_path / "a.ply").write_text(carla_ply(POINTS, {"I": [0.25, 0.5, 0.875]}))
    scan = read_scan(tmp_path / "a.ply")
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.intensity.tolist() == [0.25, 0.5, 0.875]
    assert (scan.labels, scan.instances) == (None, None)


def test_carla_semantic_ray_cast_has_instances_and_names_of_tags(tmp_path):
    columns = {
        "CosAngle": [1.0, 0.5, 0.125],
        "ObjIdx": [0, 4000000000, 17],
        "ObjTag": [1, 14, 250],
    }
    (tmp_path / "a.ply").write_text(carla_ply(POINTS, columns))
    scan = read_scan(tmp_path / "a.ply")
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.labels.tolist() == ["Roads", "Car", "250"]
    assert scan.instances[0] == 0
    assert len(set(scan.instances.tolist())) == 3
    before_0_9_14 = {1: "Building", 14: "Ground"}
    assert read_scan(tmp_path / "a.ply", label_names=before_0_9_14).labels.tolist() == [
        "Building",
        "Ground",
        "250",
    ]


def test_names_of_labels_hold_for_a_column_of_numbers_and_are_part_of_the_key(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply(POINTS, "ascii", label=True))
    assert read_scan(tmp_path / "a.ply").labels.tolist() == ["4"] * 3
    assert (
        read_scan(tmp_path / "a.ply", label_names={4: "tree"}).labels.tolist() == ["tree"] * 3
    )
    contents = [
        scan_content(tmp_path / "a.ply").key(names, None)
        for names in ({}, {4: "tree"}, {4: "car"})
    ]
    assert len(set(contents)) == 3
    raw = scan_content(write_bin(tmp_path / "b.bin", POINTS))
    assert raw.key({}, None) == raw.key({4: "tree"}, None)


@pytest.mark.parametrize(
    ("dtype", "times"), [("<f4", [0.5, 0.25, 2]), ("<u4", [5e-9, 10e-9, 1e-3])]
)
def test_times_are_seconds_or_whole_nanoseconds(tmp_path, dtype, times):
    rows = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("timestamp", dtype)])
    rows["timestamp"] = times if dtype == "<f4" else [5, 10, 1_000_000]
    np.save(tmp_path / "a.npy", rows)
    np.testing.assert_allclose(read_scan(tmp_path / "a.npy").times_s, times, rtol=1e-12)


def test_a_pcd_without_counts_has_one_number_per_field(tmp_path):
    (tmp_path / "a.pcd").write_text(ascii_pcd(POINTS, [1, 2, 3]).replace("COUNT 1 1 1 1\n", ""))
    np.testing.assert_array_equal(read_scan(tmp_path / "a.pcd").points, POINTS)


def test_an_organised_pcd_keeps_missing_returns_in_their_places(tmp_path):
    points = np.repeat(POINTS, 4, axis=0)
    points[[1, 5]] = np.nan
    text = ascii_pcd(points, np.ones(12)).replace("WIDTH 12\nHEIGHT 1", "WIDTH 4\nHEIGHT 3")
    (tmp_path / "a.pcd").write_text(text)
    np.testing.assert_array_equal(read_scan(tmp_path / "a.pcd").points, points)


# LAS.

PROJECTED = [635619.853, 848899.704, 406.591]


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
@pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 6)])
def test_projected_coordinates_keep_their_millimetres(tmp_path, name, version, point_format):
    points = np.round(street(), 3) + PROJECTED
    rows = np.arange(len(points))
    options = {"version": version, "point_format": point_format, "offset": 635000.0}
    scan = read_scan(write_las(tmp_path / name, points, rows, rows % 3, **options))
    assert np.abs(scan.points - points).max() < 1e-9  # a float64 of 850 km has steps of 1e-10 m
    assert scan.intensity.tolist() == rows.tolist()
    assert scan.labels[:3].tolist() == ["0", "unclassified", "ground"]


# Headers that promise what the file does not hold.


def promises(folder):
    """Write files of a few points whose headers promise a billion or more."""
    n = 10**9
    pcd = (
        ascii_pcd(POINTS, [1, 2, 3])
        .replace("WIDTH 3", f"WIDTH {n}")
        .replace("POINTS 3", f"POINTS {n}")
    )
    (folder / "a.pcd").write_text(pcd)
    (folder / "b.pcd").write_bytes(pcd.replace("DATA ascii", "DATA binary").encode())
    packed = struct.pack("<II", 100, 4 * 10**9) + bytes(100)
    (folder / "c.pcd").write_bytes(
        pcd[: pcd.index("DATA")].encode() + b"DATA binary_compressed\n" + packed
    )
    for name, fmt in (("a.ply", "ascii"), ("b.ply", "binary_little_endian")):
        (folder / name).write_bytes(ply(POINTS, fmt).replace(b"vertex 3", b"vertex %d" % n))
    with (folder / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f8", "fortran_order": False, "shape": (100 * n, 3)}
        )
        file.write(bytes(100))
    for name in ("a.las", "a.laz"):
        content = bytearray(write_las(folder / name, street()).read_bytes())
        content[247:255] = struct.pack("<Q", n)  # LAS 1.4, number of point records
        (folder / name).write_bytes(content)


def test_a_header_that_promises_a_billion_points_takes_no_memory(tmp_path):
    promises(tmp_path)
    code = (
        "import re, sys\n"
        "from pathlib import Path\n"
        "from fidpipe.pipeline.datasets.readers import read_scan\n"
        "from fidpipe.schemas.errors import ScanError\n"
        "for path in sorted(Path(sys.argv[1]).iterdir()):\n"
        "    try:\n"
        "        read_scan(path)\n"
        "    except ScanError:\n"
        "        peak = re.search(r'VmHWM:\\s*(\\d+)', Path('/proc/self/status').read_text())\n"
        "        print(path.name, int(peak[1]) // 1024)\n"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True
    ).stdout
    peaks_mb = dict(line.split() for line in shown.splitlines())
    assert set(peaks_mb) == {path.name for path in tmp_path.iterdir()}
    assert max(map(int, peaks_mb.values())) < 400


# Libraries that are not there.


@pytest.mark.parametrize(
    ("name", "library", "extra"),
    [
        ("a.bag", "rosbags", "ros"),
        ("a.mcap", "rosbags", "ros"),
        ("a.pcap", "velodyne_decoder", "velodyne"),
    ]
    + [("a.las", "laspy", "las"), ("a.laz", "laspy", "las")],
)
def test_a_missing_extra_is_one_line_with_its_installation(
    tmp_path, monkeypatch, name, library, extra
):
    for module in {
        library,
        *(module for module in sys.modules if module.partition(".")[0] == library),
    }:
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"content")
    with pytest.raises(ScanError) as fault:
        read_scan(tmp_path / name)
    assert str(tmp_path / name) in str(fault.value)
    assert str(fault.value).endswith(f"pip install 'fidpipe[{extra}]'")


BAGS = ("a.bag", "a_sqlite3", "a_mcap")
SECOND = 10**9


def bag_of(path, *scans, topic="/points"):
    """Frames at 5.0 s, 5.1 s, ..."""
    made = [
        (
            topic,
            5 * SECOND + i * SECOND // 10,
            lambda types, scan=scan: cloud(types, rows(scan)),
        )
        for i, scan in enumerate(scans)
    ]
    return write_bag(path, made)


@pytest.mark.parametrize("name", BAGS)
def test_a_frame_of_a_bag_is_read_by_number_and_by_time(tmp_path, name):
    scans = [street(seed) for seed in range(3)]
    bag = bag_of(tmp_path / name, *scans)
    assert [str(frame) for frame in frames_of(bag)] == [
        f"{bag}#/points@5.{i}00000000" for i in range(3)
    ]
    for i, scan in enumerate(scans):
        for path in (f"{bag}#{i}", f"{bag}#5.{i}", f"{bag}#/points@{i}", frames_of(bag)[i]):
            read = read_scan(path)
            np.testing.assert_array_equal(read.points, scan.astype(np.float32))
            assert read.intensity.tolist() == (np.arange(len(scan)) % 256).tolist()
            assert read.rings.tolist() == (np.arange(len(scan)) % 32).tolist()
            np.testing.assert_allclose(read.times_s, np.arange(len(scan)) * 1e-6)


@pytest.mark.parametrize(
    ("folder", "file"), [("a_sqlite3", "a_sqlite3.db3"), ("a_mcap", "a_mcap.mcap")]
)
def test_the_file_in_a_folder_of_ros_2_is_read_without_its_metadata(tmp_path, folder, file):
    bag = bag_of(tmp_path / folder, street())
    alone = shutil.copy(bag / file, tmp_path)
    np.testing.assert_array_equal(read_scan(Path(alone)).points, read_scan(bag).points)


@pytest.mark.parametrize(
    ("address", "fault"),
    [
        ("", r"expected one frame, got 2 of 2 .*; name one .*/a\.bag#/points@0"),
        ("#2", "@2: expected one frame, got 0 of 2"),
        ("#5.2", r"@5\.2: expected one frame, got 0 of 2 .* 5\.100000000"),
        ("#/other", r"expected /other of .*, got /points \(sensor_msgs"),
        ("#/points@first", "got 'first'"),
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
    with pytest.raises(ScanError, match="/left, /top; "):
        read_scan(bag)
    np.testing.assert_array_equal(
        read_scan(Path(f"{bag}#/top")).points, street(1).astype(np.float32)
    )


def test_a_bag_without_point_clouds_says_what_it_holds(tmp_path):
    bag = write_bag(
        tmp_path / "a.bag",
        [("/said", 0, lambda types: types.types["std_msgs/msg/String"]("hello"))],
    )
    with pytest.raises(ScanError, match=r"/said \(std_msgs/msg/String\)"):
        read_scan(bag)


def test_two_frames_of_one_time_are_told_apart_by_number_alone(tmp_path):
    made = [
        ("/points", SECOND, lambda types, i=i: cloud(types, rows(street(i)))) for i in range(2)
    ]
    bag = write_bag(tmp_path / "a.bag", made)
    for i in range(2):
        np.testing.assert_array_equal(
            read_scan(Path(f"{bag}#{i}")).points, street(i).astype(np.float32)
        )
    with pytest.raises(ScanError, match="@1.0: expected one frame, got 2 of 2"):
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
    fields = np.dtype(
        [
            ("x", "<f8"),
            ("y", "<f8"),
            ("z", "<f8"),
            ("intensity", "u1"),
            ("ring", "i1"),
            ("t", "<f8"),
        ]
    )
    points = street() + [635619.85, 848899.7, 406.59]
    bag = write_bag(
        tmp_path / "a_mcap", [("/points", 0, lambda types: cloud(types, rows(points, fields)))]
    )
    read = read_scan(bag)
    np.testing.assert_array_equal(read.points, points)
    np.testing.assert_array_equal(read.times_s, np.arange(len(points)) * 1000)


def test_a_cloud_shorter_than_it_says_is_refused(tmp_path):
    def short(types):
        message = cloud(types, rows(street()))
        message.width = 10**9
        return message

    with pytest.raises(ScanError, match="22000000000 bytes"):
        read_scan(write_bag(tmp_path / "a.bag", [("/points", 0, short)]))


@pytest.mark.parametrize(
    "text", ["a.bin", "a.bag", "a.bag#3", "a.bag#/top", "a.bag#/top@3", "a.bag#/top@5.25"]
)
def test_the_text_of_a_scan_names_it(text):
    assert str(scan_ref(text)) == text
    assert scan_ref(scan_ref(text)) == scan_ref(text)


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
    assert (
        shutil.copytree(bag, tmp_path / "copy")
        and scan_content(frames_of(tmp_path / "copy")[0]) == before
    )
    shutil.copy(bag / "metadata.yaml", bag / "more.yaml")
    assert scan_content(first) != before


@pytest.fixture
def pointing(tmp_path):
    """A dataset whose manifest points into two bags; two pairs."""
    real = bag_of(tmp_path / "real.bag", *[street(i) for i in range(3)])
    sim = bag_of(
        tmp_path / "sim_mcap", *[drifted(street(i)) for i in range(3)], topic="/carla/lidar"
    )
    table = {
        "pair_id": ["a", "b"],
        "real": [f"{real.name}#0", f"{real.name}#5.2"],
        "sim": [f"{sim.name}#/carla/lidar@0", f"{sim.name}#2"],
    }
    pd.DataFrame(table).to_csv(tmp_path / "pairs.csv", index=False)
    return tmp_path


def test_a_run_over_frames_gives_the_numbers_of_a_run_over_files(pointing):
    files = pointing / "files"
    for side in ("real", "sim"):
        (files / side).mkdir(parents=True)
    for pair in read_dataset(pointing).pairs:
        for side in ("real", "sim"):
            np.save(files / side / f"{pair.pair_id}.npy", read_scan(pair.scans[side]).points)
    command("run", pointing, "--out", pointing / "frames", "--workers", 2, code=0)
    run(files, pointing / "copies")
    frames = pd.read_parquet(pointing / "frames" / "metrics")
    copies = pd.read_parquet(pointing / "copies" / "metrics")
    assert len(frames)
    pd.testing.assert_frame_equal(frames, copies)
    again = command("run", pointing, "--out", pointing / "frames", "--workers", 1)
    assert "0 jobs done" in again.stderr + again.stdout


# Packets of a Velodyne.


@pytest.fixture
def packets(real_data):
    found = [
        (stamp, data)
        for _, stamp, data in velodyne._packets(real_data / "velodyne_vlp32c/sweeps.pcap")
    ]
    assert len(found) == 379
    return found


def test_bags_captures_and_packets_in_bags_hold_the_same_points(real_data, packets, tmp_path):
    folder = real_data / "velodyne_vlp32c"
    turns = [packets[0:77], packets[77:153], packets[153:229]]
    made = [
        ("/packets", i, lambda types, turn=turn: packets_message(types, turn))
        for i, turn in enumerate(turns)
    ]
    places = [
        folder / name
        for name in ("rosbag1.bag", "rosbag2_sqlite3", "rosbag2_mcap", "sweeps.pcap")
    ]
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


def test_a_capture_that_ends_in_a_packet_keeps_its_whole_turns(real_data, tmp_path):
    content = (real_data / "velodyne_vlp32c/sweeps.pcap").read_bytes()
    short = tmp_path / "short.pcap"
    short.write_bytes(content[: len(content) // 2 + 13])
    whole = frames_of(real_data / "velodyne_vlp32c/sweeps.pcap")
    assert [scan.frame for scan in frames_of(short)[:2]] == [scan.frame for scan in whole[:2]]
