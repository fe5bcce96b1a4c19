"""Valid files of every format from rows of x, y, z and intensity."""

import io
import struct

import dpkt
import numpy as np
import pandas as pd
from pypcd4 import Encoding, PointCloud

from fidpipe.pipeline.datasets.pairs import scans_of
from fidpipe.pipeline.datasets.readers import read_scan
from recordings import cloud, write_bag, write_las, write_pcap

COLUMNS = ("x", "y", "z", "intensity")
#: A few points that every format holds without rounding.
POINTS = np.array(
    [[1.5, -2.25, 0.5, 7], [4, 5, 6, 8], [-7, 8, 9.125, 9], [3, 3, 3, 1], [10, 0, -1.5, 2]],
    "<f4",
)


def write_pcd(path, rows, encoding, height=1):
    made = PointCloud.from_points(rows, COLUMNS, [np.float32] * 4)
    made.metadata.width = len(rows) // height
    made.metadata.height = height
    made.save(path, Encoding(encoding))


def write_ply(path, rows, encoding):
    properties = "".join(f"property float {name}\n" for name in COLUMNS)
    head = f"ply\nformat {encoding} 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    with path.open("wb") as file:
        file.write(head.encode())
        if encoding == "ascii":
            np.savetxt(file, rows, "%.9g")
        else:
            file.write(rows.astype("<f4").tobytes())


def write_frame(path, rows, height=1, packed=None):
    records = (
        np.ascontiguousarray(rows, "<f4").view([(name, "<f4") for name in COLUMNS]).ravel()
    )
    write_bag(
        path, [("/points", 10**9, lambda types: cloud(types, records, height=height))], packed
    )


def write_las_rows(path, rows):
    write_las(path, rows[:, :3].astype(float), rows[:, 3].astype(np.uint16), scale=0.0001)


#: By name: the file or folder, and what writes rows into it.
WRITERS = {
    "bin": ("a.bin", lambda path, rows: rows.astype("<f4").tofile(path)),
    "pcd.bin": (
        "a.pcd.bin",
        lambda path, rows: rows[:, [0, 1, 2, 3, 3]].astype("<f4").tofile(path),
    ),
    "npy": ("a.npy", np.save),
    "pcd as text": ("a.pcd", lambda path, rows: write_pcd(path, rows, "ascii")),
    "pcd": ("a.pcd", lambda path, rows: write_pcd(path, rows, "binary")),
    "packed pcd": ("a.pcd", lambda path, rows: write_pcd(path, rows, "binary_compressed")),
    "ply as text": ("a.ply", lambda path, rows: write_ply(path, rows, "ascii")),
    "ply": ("a.ply", lambda path, rows: write_ply(path, rows, "binary_little_endian")),
    "csv": (
        "a.csv",
        lambda path, rows: np.savetxt(
            path, rows, "%.9g", ",", header=",".join(COLUMNS), comments=""
        ),
    ),
    "parquet": (
        "a.parquet",
        lambda path, rows: pd.DataFrame(rows, columns=COLUMNS).to_parquet(path),
    ),
    "feather": (
        "a.feather",
        lambda path, rows: pd.DataFrame(rows, columns=COLUMNS).to_feather(path),
    ),
    "las": ("a.las", write_las_rows),
    "laz": ("a.laz", write_las_rows),
    "bag": ("a.bag", write_frame),
    "packed bag": ("a.bag", lambda path, rows: write_frame(path, rows, packed="LZ4")),
    "mcap": ("a_mcap", write_frame),
    "packed mcap": ("a_mcap", lambda path, rows: write_frame(path, rows, packed="ZSTD")),
    "db3": ("a_sql", write_frame),
}


def velodyne_packets():
    """Two packets of a VLP-16 with their times."""
    packets = []
    for number in range(2):
        blocks = b""
        for block in range(12):
            azimuth = (number * 12 + block) * 40
            returns = struct.pack("<HB", 2000 + block, 10) * 32
            blocks += struct.pack("<HH", 0xEEFF, azimuth) + returns
        footer = struct.pack("<IBB", 1000 * number, 0x37, 0x22)
        packets.append((100 + number * 0.001, blocks + footer))
    return packets


def write_packets(path):
    """A capture of these packets: .pcap, or .pcapng by its suffix."""
    capture = write_pcap(path, velodyne_packets()).read_bytes()
    if path.suffix == ".pcapng":
        with path.open("wb") as file:
            writer = dpkt.pcapng.Writer(file)
            for stamp, packet in dpkt.pcap.Reader(io.BytesIO(capture)):
                writer.writepkt(packet, ts=stamp)


def read(path):
    """The points of a scan file, or of the first frame of a recording."""
    return read_scan(scans_of(path)[0])
