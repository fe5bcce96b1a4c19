"""Readers of scans and recordings that are attacked, each with small whole inputs, from which hostile ones are made."""

import io
import struct
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from recordings import carla_ply, cloud, packets_message, write_bag, write_las, write_pcap

POINTS = np.array([[1.5, -2.25, 0.5], [4, 5, 6], [-7, 8, 9.125], [3, 3, 3], [10, 0, -1.5]])
_ROWS = np.zeros(5, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("t", "<u4")])
for _name, _column in zip("xyz", POINTS.T, strict=True):
    _ROWS[_name] = _column


class Target(NamedTuple):
    """A reader under attack.

    inputs : gives whole inputs: files by name; that one is changed whose name begins with the target's `hot`
    read : what is called with the folder of an input
    hot : beginning of the names of the files that are changed; of several one at a time
    words : of the format
    in_worker : whether runs read it in workers under a limit on memory: an input may then end the process, or run into
        the limit; the run names its pair
    """

    inputs: Callable[[], list[dict[str, bytes]]]
    read: Callable[[Path], object]
    hot: str = "a."
    words: tuple[bytes, ...] = ()
    in_worker: bool = False


def _scan(name):
    def read(folder):
        from fidpipe.pipeline.datasets.readers import read_scan

        return read_scan(folder / name)

    return read


def _recording(name):
    """The frames of a recording, then the first one and one by its number."""

    def read(folder):
        from fidpipe.pipeline.datasets.readers import frames_of, read_scan
        from fidpipe.schemas.errors import FidpipeError

        with suppress(FidpipeError):
            read_scan(folder / f"{name}#0")
        return [read_scan(frame) for frame in frames_of(folder / name)[:1]]

    return read


def files_written(write, *names):
    """What a function writes into a folder, as contents by name."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(Path(folder).rglob("*"))
            if path.is_file() and (not names or path.name in names)
        }


def _raw(name, columns):
    rows = np.zeros((5, columns), "<f4")
    rows[:, :3] = POINTS
    return lambda: [{name: rows.tobytes()}, {name: rows.astype("<f8").tobytes()}]


def _npy():
    structured = _ROWS
    arrays = [POINTS, POINTS.astype("f4"), structured, np.zeros((5, 4), ">f4"), np.asfortranarray(POINTS)]
    found = []
    for array in arrays:
        content = io.BytesIO()
        np.save(content, array)
        found.append({"a.npy": content.getvalue()})
    content = io.BytesIO()
    np.lib.format.write_array(content, POINTS, version=(3, 0))
    return [*found, {"a.npy": content.getvalue()}]


def _pcd():
    from pypcd4 import Encoding, PointCloud

    found = []
    for encoding in ("ascii", "binary", "binary_compressed"):
        for columns in (("x", "y", "z", "intensity"), ("x", "y", "z", "ring")):
            made = PointCloud.from_points([*POINTS.T, np.arange(5)], columns, [np.float32] * 3 + [np.uint16])
            content = io.BytesIO()
            made.save(content, Encoding(encoding))
            found.append({"a.pcd": content.getvalue()})
    return found


def _ply():
    text = "".join(f"{x} {y} {z} 7 {i}\n" for i, (x, y, z) in enumerate(POINTS))
    properties = "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity")) + "property int label\n"
    head = "ply\nformat {} 1.0\ncomment made\nelement vertex 5\n" + properties
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    rows = np.zeros(5, [*((name, "<f4") for name in "xyz"), ("intensity", "<f4"), ("label", "<i4")])
    for name, column in zip("xyz", POINTS.T, strict=True):
        rows[name] = column
    end, face = "end_header\n", struct.pack("<B3i", 3, 0, 1, 2)
    swapped = rows.astype(rows.dtype.newbyteorder(">")).tobytes()
    little, big = head.format("binary_little_endian"), head.format("binary_big_endian")
    contents = [
        (head.format("ascii") + end + text).encode(),
        (head.format("ascii") + faces + end + text + "3 0 1 2\n").encode(),
        (little + end).encode() + rows.tobytes(),
        (little + faces + end).encode() + rows.tobytes() + face,
        (big + end).encode() + swapped,
        carla_ply(POINTS, {"CosAngle": np.ones(5), "ObjIdx": np.arange(5), "ObjTag": np.arange(5)}).encode(),
    ]
    return [{"a.ply": content} for content in contents]


def _csv():
    rows = "".join(f"{x},{y},{z},9,car\n" for x, y, z in POINTS)
    numbers = "".join(f"{x},{y},{z},0.5,3,12,0.25\n" for x, y, z in POINTS)
    return [
        {"a.csv": f"X, Y, Z, Intensity, label\n{rows}".encode()},
        {"a.csv": f"x,y,z,i,ring,instance,time\n{numbers}".encode()},
        {"a.csv": f"x,y,z\r\n1,2,\r\n{rows}".encode()},
    ]


def _parquet():
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {name: pa.array(column) for name, column in zip("xyz", POINTS.T, strict=True)}
    table = pa.table(columns | {"label": ["a", "b", None, "a", "b"], "ring": pa.array([1, 2, None, 4, 5], pa.int32())})
    found = []
    for options in (
        {"compression": "none"},
        {"compression": "zstd"},
        {"compression": "snappy", "use_dictionary": False},
        {"compression": "gzip", "data_page_version": "2.0"},
        {"compression": "none", "write_statistics": False, "store_schema": False, "row_group_size": 2},
    ):
        content = io.BytesIO()
        pq.write_table(table, content, **options)
        found.append({"a.parquet": content.getvalue()})
    return found


def _las(name):
    def made(folder, point_format):
        write_las(
            folder / name,
            POINTS,
            0,
            np.arange(5),
            version="1.4" if point_format == 6 else "1.2",
            point_format=point_format,
        )

    return lambda: [files_written(partial(made, point_format=own)) for own in (0, 3, 6)]


def _clouds(path, packed=None, n=2):
    return write_bag(path, [("/points", 5 * 10**9 + i, lambda types: cloud(types, _ROWS)) for i in range(n)], packed)


def _packets():
    """Two packets of a VLP-16 as they come."""
    packets = []
    for i in range(2):
        blocks = b""
        for block in range(12):
            azimuth = (i * 12 + block) * 40 % 36000
            blocks += struct.pack("<HH", 0xEEFF, azimuth) + struct.pack("<HB", 2000 + block, 10) * 32
        packets.append((100.0 + i * 0.001, blocks + struct.pack("<IBB", 1000 * i, 0x37, 0x22)))
    return packets


def _bag():
    found = [
        files_written(lambda folder, packed=own: _clouds(folder / "a.bag", packed)) for own in (None, "BZ2", "LZ4")
    ]
    message = [("/packets", 10**9, lambda types: packets_message(types, _packets()[:1]))]
    return [*found, files_written(lambda folder: write_bag(folder / "a.bag", message))]


def _ros2_bags(name):
    """Folders of a bag, MCAP or SQLite by the name; the second one's chunks are compressed, the third's by lz4."""
    found = [files_written(lambda folder: _clouds(folder / name))]
    for packed in ("ZSTD", "LZ4") if "mcap" in name else ():
        with suppress(KeyError):
            found.append(files_written(lambda folder, packed=packed: _clouds(folder / name, packed, 1)))
    return found


def _mcap():
    return [{"a.mcap": files["a_mcap/a_mcap.mcap"]} for files in _ros2_bags("a_mcap")]


def _db3():
    return [{"a.db3": files["a_sql/a_sql.db3"]} for files in _ros2_bags("a_sql")]


def _metadata():
    folders = [*_ros2_bags("a_mcap")[:1], *_ros2_bags("a_sql")]
    return [{f"bag/{Path(name).name}": content for name, content in files.items()} for files in folders]


def _pcap():
    return [files_written(lambda folder: write_pcap(folder / "a.pcap", _packets()))]


def _pcapng():
    import dpkt

    content = io.BytesIO()
    writer = dpkt.pcapng.Writer(content)
    capture = _pcap()[0]["a.pcap"]
    for stamp, packet in dpkt.pcap.Reader(io.BytesIO(capture)):
        writer.writepkt(packet, ts=stamp)
    return [{"a.pcapng": content.getvalue()}]


def _labels():
    scan = {"scan.bin": np.zeros((5, 4), "<f4").tobytes(), "labels.toml": b'1 = "car"\n'}
    return [scan | {"scan.label": np.arange(5, dtype="<u4").tobytes()}]


def scan_files():
    points = np.zeros((5, 4), "<f4")
    points[:, :3] = POINTS
    return {f"{side}/{name}.bin": points.tobytes() for side in ("real", "sim") for name in ("0", "1", "2")}


_PLY_WORDS = (
    b"element vertex 5\n",
    b"property list uchar int a\n",
    b"property double x\n",
    b"end_header\n",
    b"\nformat ",
)
_PCD_WORDS = (b"COUNT 1 1 1 1000000", b"POINTS 1000000000", b"DATA ascii", b"DATA binary_compressed", b"SIZE 8 8 8 8")
_BAG_WORDS = (b"compression=lz4", b"compression=bz2", b"chunk_count=")
_SQL_WORDS = (b"CREATE TABLE", b"CREATE VIEW", b"messages", b"topics")
_YAML_WORDS = (b"- &a [*a, *a]\n", b"!!python/object:os.system", b"compression_mode: FILE\n", b"- ../../a.db3\n", b"? ")

#: By name; each reads the file whose name begins with `a.`, or as `hot` says.
SCANS = {
    "bin": Target(_raw("a.bin", 4), _scan("a.bin")),
    "pcd.bin": Target(_raw("a.pcd.bin", 5), _scan("a.pcd.bin")),
    "npy": Target(_npy, _scan("a.npy"), words=(b"'O'", b"'|V0'", b"'M8[s]'", b"(5,)<f4", b"'fortran_order': True")),
    "pcd": Target(_pcd, _scan("a.pcd"), words=_PCD_WORDS),
    "ply": Target(_ply, _scan("a.ply"), words=_PLY_WORDS),
    "csv": Target(_csv, _scan("a.csv"), words=(b"x,y,z\n", b"NA", b"True", b"1j", b"2020-01-01", b'"\n"', b"x,x,x")),
    "parquet": Target(_parquet, _scan("a.parquet"), in_worker=True),
    "las": Target(_las("a.las"), _scan("a.las"), words=(b"LASF_Spec", b"laszip encoded")),
    "laz": Target(_las("a.laz"), _scan("a.laz"), words=(b"LASF_Spec", b"laszip encoded"), in_worker=True),
    "bag": Target(_bag, _recording("a.bag"), words=_BAG_WORDS, in_worker=True),
    "mcap": Target(_mcap, _recording("a.mcap"), words=(b"zstd", b"lz4", b"\x89MCAP0\r\n"), in_worker=True),
    "db3": Target(_db3, _recording("a.db3"), words=_SQL_WORDS, in_worker=True),
    "metadata.yaml": Target(_metadata, _recording("bag"), hot="bag/metadata", words=_YAML_WORDS, in_worker=True),
    "pcap": Target(_pcap, _recording("a.pcap")),
    "pcapng": Target(_pcapng, _recording("a.pcapng")),
    "label": Target(_labels, _scan("scan.bin"), hot="scan.label"),
}
