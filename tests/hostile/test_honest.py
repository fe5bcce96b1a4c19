"""Honest extremes: files that are large, empty of variety or oddly shaped are read, or the message says what to do."""

import struct

import numpy as np
import pytest

from fidpipe.pipeline.datasets.readers import FORMATS, frames_of, holds_frames, read_scan, suffix_of
from fidpipe.schemas.errors import ScanError
from recordings import CLOUD, cloud, typestore, write_bag

MANY = 2_000_000
COLUMNS = ("x", "y", "z", "intensity")


def structured(rows):
    """The rows as records of four float32, as messages and PCD have them."""
    return np.ascontiguousarray(rows, "<f4").view([(name, "<f4") for name in COLUMNS]).ravel()


def text_of(rows, between):
    """The rows in decimal; what repeats is written once."""
    head = rows[:1000]
    lines = [between.join(map(repr, row)) + "\n" for row in head.astype(float).tolist()]
    if len(rows) > 1000:
        assert np.array_equal(rows.reshape(-1, 1000, 4)[-1], head)
    return "".join(lines) * max(len(rows) // 1000, 1)


def write_pcd(path, rows, encoding, height=1):
    head = (
        f"VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {len(rows) // height}\n"
    )
    head += f"HEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA {encoding}\n"
    if encoding == "ascii":
        body = text_of(rows, " ").encode()
    elif encoding == "binary":
        body = rows.astype("<f4").tobytes()
    else:
        import lzf

        columns = rows.astype("<f4").T.tobytes()
        if (packed := lzf.compress(columns)) is None:
            write_pcd(path, rows, "binary", height)  # as pypcd4 does with what becomes no shorter
            return
        body = struct.pack("<II", len(packed), len(columns)) + packed
    path.write_bytes(head.encode() + body)


def write_ply(path, rows, encoding):
    properties = "".join(f"property float {name}\n" for name in COLUMNS)
    head = f"ply\nformat {encoding} 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    body = text_of(rows, " ").encode() if encoding == "ascii" else rows.astype("<f4").tobytes()
    path.write_bytes(head.encode() + body)


def write_las(path, rows):
    import laspy

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = [0.0001] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = rows[:, :3].T.astype(float)
    las.intensity = rows[:, 3].astype(np.uint16)
    las.write(str(path))


def write_parquet(path, rows):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(dict(zip(COLUMNS, rows.T, strict=True))), path, compression="zstd")


def write_frame(path, rows, height=1):
    write_bag(path, [("/points", 10**9, lambda types: cloud(types, structured(rows), height=height))])


def write_packed_frame(path, rows):
    """A bag whose chunks are compressed: lz4 in ROS 1, zstd in ROS 2."""
    from rosbags.rosbag1 import Writer as Ros1Writer
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Ros2Writer

    types = typestore(is_ros1=path.suffix == ".bag")
    message = cloud(types, structured(rows))
    if path.suffix == ".bag":
        bag = Ros1Writer(path)
        bag.set_compression(Ros1Writer.CompressionFormat.LZ4)
        content = types.serialize_ros1(message, CLOUD)
    else:
        bag = Ros2Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        content = types.serialize_cdr(message, CLOUD)
    with bag:
        bag.write(bag.add_connection("/points", CLOUD, typestore=types), 10**9, content)


#: By name: the file, and what writes rows of x, y, z and intensity into it.
WRITERS = {
    "bin": ("a.bin", lambda path, rows: rows.astype("<f4").tofile(path)),
    "pcd.bin": ("a.pcd.bin", lambda path, rows: rows[:, [0, 1, 2, 3, 3]].astype("<f4").tofile(path)),
    "npy": ("a.npy", np.save),
    "pcd as text": ("a.pcd", lambda path, rows: write_pcd(path, rows, "ascii")),
    "pcd": ("a.pcd", lambda path, rows: write_pcd(path, rows, "binary")),
    "packed pcd": ("a.pcd", lambda path, rows: write_pcd(path, rows, "binary_compressed")),
    "ply as text": ("a.ply", lambda path, rows: write_ply(path, rows, "ascii")),
    "ply": ("a.ply", lambda path, rows: write_ply(path, rows, "binary_little_endian")),
    "csv": ("a.csv", lambda path, rows: path.write_text(",".join(COLUMNS) + "\n" + text_of(rows, ","))),
    "parquet": ("a.parquet", write_parquet),
    "las": ("a.las", write_las),
    "laz": ("a.laz", write_las),
    "bag": ("a.bag", write_frame),
    "packed bag": ("a.bag", write_packed_frame),
    "mcap": ("a_mcap", write_frame),
    "packed mcap": ("a_mcap", write_packed_frame),
    "db3": ("a_sql", write_frame),
}
#: Packets of a sensor: a turn is never longer than the sensor makes it.
NOT_WRITTEN = {".pcap", ".pcapng"}


def read(path):
    if holds_frames(path):
        (path,) = frames_of(path)
    return read_scan(path)


def repeated(n):
    """Rows of metres and whole intensities; a thousand different ones again and again."""
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.uniform(-80, 80, (1000, 3)).round(3), rng.integers(0, 255, 1000)])
    return np.tile(rows, (n // 1000, 1)).astype("<f4")


def test_each_format_is_among_them(tmp_path):
    written = set()
    for name, (file, write) in WRITERS.items():
        (tmp_path / name).mkdir()
        write(tmp_path / name / file, np.ones((1, 4), "<f4"))
        files = [tmp_path / name / file, *(tmp_path / name).rglob("*")]
        written |= {suffix_of(path) for path in files}
    assert set(FORMATS) - written == NOT_WRITTEN


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("n", [1, 3])
def test_a_few_points_are_read_to_the_last_bit(tmp_path, name, n):
    file, write = WRITERS[name]
    rows = np.array([[1.5, -2.25, 0.5, 7], [4, 5, 6, 8], [-7, 8, 9.125, 9]][:n], "<f4")
    write(tmp_path / file, rows)
    scan = read(tmp_path / file)
    np.testing.assert_array_equal(scan.points, rows[:, :3])
    assert scan.points.dtype == np.float64
    assert scan.intensity.tolist() == rows[:, 3].tolist()


@pytest.mark.parametrize("cut", [5, 40])
@pytest.mark.parametrize("name", ["bin", "npy", "pcd", "packed pcd", "ply", "parquet", "las", "laz"])
def test_a_file_that_is_cut_off_is_refused(tmp_path, name, cut):
    file, write = WRITERS[name]
    write(tmp_path / file, repeated(1000))
    (tmp_path / file).write_bytes((tmp_path / file).read_bytes()[:-cut])
    with pytest.raises(ScanError, match=file):
        read(tmp_path / file)


@pytest.mark.exhaustive
@pytest.mark.parametrize("different", [1000, 1])
@pytest.mark.parametrize("name", WRITERS)
def test_two_million_points_are_read(tmp_path, name, different):
    """Packed, equal points are a thousandth of their length."""
    file, write = WRITERS[name]
    rows = np.tile(repeated(1000)[:different], (MANY // different, 1))
    write(tmp_path / file, rows)
    scan = read(tmp_path / file)
    assert len(scan.points) == MANY
    assert scan.points[-1000:] == pytest.approx(rows[-1000:, :3].astype(float), abs=1e-4)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["pcd", "packed pcd", "mcap"])
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_an_organised_cloud_of_65536_columns_with_nan_is_read(tmp_path, name, share):
    """A sensor that looks into the sky writes its rows and columns all the same."""
    rows = np.random.default_rng(4).uniform(-50, 50, (32 * 65536, 4)).astype("<f4")
    rows[: round(share * len(rows)), :3] = np.nan
    path = tmp_path / WRITERS[name][0]
    if name == "mcap":
        write_frame(path, rows, height=32)
    else:
        write_pcd(path, rows, "binary" if name == "pcd" else "binary_compressed", height=32)
    scan = read(path)
    assert np.array_equal(scan.points, rows[:, :3].astype(float), equal_nan=True)


def test_what_unpacks_to_too_much_can_be_written_unpacked(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: np.full(3 * MANY // 2, 7.0) for name in COLUMNS[:3]})
    pq.write_table(table, tmp_path / "packed.parquet")
    with pytest.raises(ScanError, match="if it is right, write it without compression"):
        read_scan(tmp_path / "packed.parquet")
    pq.write_table(table, tmp_path / "plain.parquet", compression="none", use_dictionary=False)
    assert len(read_scan(tmp_path / "plain.parquet").points) == len(table)


def test_each_real_scan_is_read(real_data):
    files = [
        path for path in sorted(real_data.rglob("*")) if suffix_of(path) and not path.parent.name.startswith("rosbag2")
    ]
    assert len(files) > 20
    for path in files:
        frames = frames_of(path) if holds_frames(path) else [path]
        columns = ("x", "y", "z") if "lumpi" in path.parts else None
        assert all(len(read_scan(frame, columns).points) > 500 for frame in frames), path
