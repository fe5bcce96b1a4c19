"""Files of every format: exact values, and messages on incomplete files."""

import struct
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.datasets.content import scan_content
from fidpipe.pipeline.datasets.readers import read_scan, stem_of, suffix_of
from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.schemas.errors import ScanError
from fidpipe.schemas.settings import Settings
from recordings import carla_ply
from scenes import street, write_bin

POINTS = np.array([[1.5, -2.25, 0.5], [4, 5, 6], [-7, 8, 9.125]])


def ascii_pcd(points, intensity):
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
    head += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA ascii\n"
    return head + "".join(f"{x} {y} {z} {i}\n" for (x, y, z), i in zip(points, intensity, strict=True))


def ply(points, fmt, label=False):
    head = f"ply\nformat {fmt} 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {name}\n" for name in ("x", "y", "z", "scalar_intensity"))
    head += ("property int label\n" if label else "") + "end_header\n"
    if fmt == "ascii":
        rows = "".join(f"{x} {y} {z} 7{' 4' if label else ''}\n" for x, y, z in points)
        return (head + rows).encode()
    return head.encode() + np.column_stack([points, np.full(len(points), 7)]).astype("<f4").tobytes()


@pytest.mark.parametrize(
    ("name", "suffix", "stem"),
    [
        ("000104.bin", ".bin", "000104"),
        ("n008__LIDAR.pcd.bin", ".pcd.bin", "n008__LIDAR"),
        ("a.b.PCD", ".pcd", "a.b"),
        ("notes.txt", None, "notes.txt"),
    ],
)
def test_the_stem_is_the_name_less_its_known_suffix(tmp_path, name, suffix, stem):
    assert suffix_of(tmp_path / name) == suffix
    assert stem_of(tmp_path / name) == stem


def test_other_raw_columns_can_be_named(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS, 6)
    scan = read_scan(path, ("x", "y", "z", "ring", "time", "intensity"))
    np.testing.assert_array_equal(scan.points, POINTS)


def test_a_truncated_raw_file_says_what_was_expected(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(
        ScanError, match=r"a\.bin: expected a multiple of 16 bytes \(4 float32 columns: x y z intensity\), got 45"
    ):
        read_scan(path)


#: File, content and message.
REFUSED = {
    "a row less": (
        "a.pcd",
        ascii_pcd(POINTS, [1, 2, 3]).rsplit("\n", 2)[0].encode() + b"\n",
        "2 points found, the header says 3",
    ),
    "text in a PCD": ("a.pcd", ascii_pcd(POINTS, [1, "oops", 3]).encode(), r"a\.pcd: not a whole PCD file"),
    "a short row": ("a.ply", ply(POINTS, "ascii", label=True).rsplit(b" ", 1)[0] + b"\n", "not a whole PLY file"),
    "text in a CSV": (
        "a.csv",
        b"x,y,z\n1,2,3\n4,five,6\n",
        r"a\.csv: row 2, column y: expected a number, got 'five'",
    ),
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
    path.write_text("X, Y, Z, Intensity, label\n1.5,-2.25,0.5,9,car\n4,5,6,8,tree\n")
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, POINTS[:2])
    assert (scan.intensity.tolist(), scan.labels.tolist()) == ([9, 8], ["car", "tree"])


def test_an_empty_csv_cell_is_not_finite(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y,z\n1,,3\n")
    assert np.isnan(read_scan(path).points[0, 1])


def test_parquet_is_read(tmp_path):
    path = tmp_path / "a.parquet"
    pd.DataFrame(POINTS, columns=["x", "y", "z"]).assign(label=["a", "b", "a"]).to_parquet(path)
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.labels.tolist() == ["a", "b", "a"]


def test_npy_is_read_plain_and_structured(tmp_path):
    np.save(tmp_path / "a.npy", np.column_stack([POINTS, [1, 2, 3]]))
    np.save(tmp_path / "b.npy", np.array([tuple(p) for p in POINTS], dtype=[("x", "f8"), ("y", "f8"), ("z", "f8")]))
    for name in ("a.npy", "b.npy"):
        np.testing.assert_array_equal(read_scan(tmp_path / name).points, POINTS)


@pytest.mark.parametrize(
    ("array", "fault"),
    [
        (np.zeros((3, 2)), r"got .* shape \(3, 2\)"),
        (np.zeros(3), r"got .* shape \(3,\)"),
        (np.array([["a", "b", "c"]]), "U1 array"),
        (np.array([{"x": 1}], dtype=object), r"a\.npy: not a whole \.npy array"),
        (np.ones((3, 50)), r"expected one row per point, got .*; save array\.T"),
        (np.ones((50, 7)), "name its 7 columns in input.columns"),
    ],
)
def test_an_npy_of_another_shape_or_type_is_refused(tmp_path, array, fault):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(ScanError, match=fault):
        read_scan(tmp_path / "a.npy")


def test_a_label_file_gives_names_by_its_low_bits(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS)
    np.array([4, 4 + (7 << 16), 99], dtype="<u4").tofile(tmp_path / "a.label")
    assert read_scan(path, label_names={4: "tree"}).labels.tolist() == ["tree", "tree", "99"]


def test_a_label_file_of_another_length_is_refused(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS)
    np.array([4, 4], dtype="<u4").tofile(tmp_path / "a.label")
    with pytest.raises(ScanError, match=r"a\.label: expected 12 bytes .* got 8"):
        read_scan(path)


@pytest.mark.parametrize("name", ["a.bin", "a.npy", "a.pcd", "a.ply", "a.csv", "a.parquet", "a.pcd.bin"])
def test_an_empty_file_is_refused(tmp_path, name):
    (tmp_path / name).touch()
    with pytest.raises(ScanError, match="the file is empty"):
        read_scan(tmp_path / name)


def test_a_missing_file_and_an_unknown_format_are_refused(tmp_path):
    with pytest.raises(ScanError, match="cannot be read"):
        read_scan(tmp_path / "gone.bin")
    with pytest.raises(ScanError, match="unknown format; known are"):
        read_scan(tmp_path / "a.xyz")


def test_real_labels_are_read(real_data):
    labels = read_scan(real_data / "rellis/000104.bin", label_names={4: "tree"}).labels
    assert len(labels) == 131072
    assert {"tree", "3", "17"} <= set(labels.tolist())


@pytest.mark.parametrize("n_columns", [3, 4])
def test_float64_rows_in_a_bin_are_refused_with_their_layout(tmp_path, n_columns):
    rows = np.column_stack([street(), np.zeros(len(street()))])[:, :n_columns]
    (tmp_path / "a.bin").write_bytes(rows.astype("<f8").tobytes())
    with pytest.raises(ScanError, match=f"expected float32, got float64 in rows of {n_columns} columns"):
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
    assert (scan.labels, scan.instances, scan.incidence) == (None, None, None)


def test_carla_semantic_ray_cast_has_incidence_instances_and_names_of_tags(tmp_path):
    columns = {"CosAngle": [1.0, 0.5, 0.125], "ObjIdx": [0, 4000000000, 17], "ObjTag": [1, 14, 250]}
    (tmp_path / "a.ply").write_text(carla_ply(POINTS, columns))
    scan = read_scan(tmp_path / "a.ply")
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.incidence.tolist() == [1, 0.5, 0.125]
    assert scan.labels.tolist() == ["Roads", "Car", "250"]
    assert scan.instances[0] == 0
    assert len(set(scan.instances.tolist())) == 3
    before_0_9_14 = {1: "Building", 14: "Ground"}
    assert read_scan(tmp_path / "a.ply", label_names=before_0_9_14).labels.tolist() == ["Building", "Ground", "250"]


def test_names_of_labels_hold_for_a_column_of_numbers_and_are_part_of_the_key(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply(POINTS, "ascii", label=True))
    assert read_scan(tmp_path / "a.ply").labels.tolist() == ["4"] * 3
    assert read_scan(tmp_path / "a.ply", label_names={4: "tree"}).labels.tolist() == ["tree"] * 3
    contents = [scan_content(tmp_path / "a.ply").key(names, None) for names in ({}, {4: "tree"}, {4: "car"})]
    assert len(set(contents)) == 3
    raw = scan_content(write_bin(tmp_path / "b.bin", POINTS))
    assert raw.key({}, None) == raw.key({4: "tree"}, None)


@pytest.mark.parametrize(("dtype", "times"), [("<f4", [0.5, 0.25, 2]), ("<u4", [5e-9, 10e-9, 1e-3])])
def test_times_are_seconds_or_whole_nanoseconds(tmp_path, dtype, times):
    rows = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("timestamp", dtype)])
    rows["timestamp"] = times if dtype == "<f4" else [5, 10, 1_000_000]
    np.save(tmp_path / "a.npy", rows)
    np.testing.assert_allclose(read_scan(tmp_path / "a.npy").times_s, times, rtol=1e-12)


def test_an_organised_pcd_keeps_missing_returns_in_their_places(tmp_path):
    points = np.repeat(POINTS, 4, axis=0)
    points[[1, 5]] = np.nan
    text = ascii_pcd(points, np.ones(12)).replace("WIDTH 12\nHEIGHT 1", "WIDTH 4\nHEIGHT 3")
    (tmp_path / "a.pcd").write_text(text)
    np.testing.assert_array_equal(read_scan(tmp_path / "a.pcd").points, points)


# LAS.

PROJECTED = [635619.853, 848899.704, 406.591]


def las_of(path, points, version="1.4", point_format=6, scale=0.001, offset=0.0):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = [scale] * 3, [offset] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.intensity = np.arange(len(points)) % 60000
    las.classification = np.arange(len(points)) % 3
    las.write(path)
    return path


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
@pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 6)])
@pytest.mark.parametrize("offset", [0.0, 635000.0])
def test_projected_coordinates_keep_their_millimetres(tmp_path, name, version, point_format, offset):
    points = np.round(street(), 3) + PROJECTED
    scan = read_scan(las_of(tmp_path / name, points, version, point_format, offset=offset))
    assert np.abs(scan.points - points).max() < 1e-9  # a float64 of 850 km has steps of 1e-10 m
    assert scan.intensity.tolist() == (np.arange(len(points)) % 60000).tolist()
    assert scan.labels[:3].tolist() == ["0", "unclassified", "ground"]


def test_a_projected_scan_is_named_by_check_and_not_cut_silently(tmp_path):
    for side in ("real", "sim"):
        (tmp_path / side).mkdir()
        las_of(tmp_path / side / "a.las", np.round(street(), 3) + PROJECTED)
    found = check_dataset(tmp_path, Settings())
    assert all("expected at least 8 points after cleaning, got 0 (1875 too far)" in fault for fault in found.faults)
    assert sum("are they projected?" in warning for warning in found.warnings) == 2


# Headers that promise what the file does not hold.


def promises(folder):
    """Write files of a few points whose headers promise a billion or more."""
    n = 10**9
    pcd = ascii_pcd(POINTS, [1, 2, 3]).replace("WIDTH 3", f"WIDTH {n}").replace("POINTS 3", f"POINTS {n}")
    (folder / "a.pcd").write_text(pcd)
    (folder / "b.pcd").write_bytes(pcd.replace("DATA ascii", "DATA binary").encode())
    packed = struct.pack("<II", 100, 4 * 10**9) + bytes(100)
    (folder / "c.pcd").write_bytes(pcd[: pcd.index("DATA")].encode() + b"DATA binary_compressed\n" + packed)
    for name, fmt in (("a.ply", "ascii"), ("b.ply", "binary_little_endian")):
        (folder / name).write_bytes(ply(POINTS, fmt).replace(b"vertex 3", b"vertex %d" % n))
    with (folder / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (100 * n, 3)})
        file.write(bytes(100))
    for name in ("a.las", "a.laz"):
        content = bytearray(las_of(folder / name, street()).read_bytes())
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
    shown = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True).stdout
    peaks_mb = dict(line.split() for line in shown.splitlines())
    assert set(peaks_mb) == {path.name for path in tmp_path.iterdir()}
    assert max(map(int, peaks_mb.values())) < 400


# Libraries that are not there.


@pytest.mark.parametrize(
    ("name", "library", "extra"),
    [("a.bag", "rosbags", "ros"), ("a.mcap", "rosbags", "ros"), ("a.pcap", "velodyne_decoder", "velodyne")]
    + [("a.las", "laspy", "las"), ("a.laz", "laspy", "las")],
)
def test_a_missing_extra_is_one_line_with_its_installation(tmp_path, monkeypatch, name, library, extra):
    for module in [module for module in sys.modules if module.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(sys, "meta_path", [_Hidden(library), *sys.meta_path])
    (tmp_path / name).write_bytes(b"content")
    with pytest.raises(ScanError) as fault:
        read_scan(tmp_path / name)
    assert str(fault.value).startswith(f"{tmp_path / name}: reading it needs {library}")
    assert str(fault.value).endswith(f"pip install 'fidpipe[{extra}]'")
    assert "\n" not in str(fault.value)


class _Hidden:
    """Hides a library as if it were not installed."""

    def __init__(self, library):
        self.library = library

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == self.library:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def test_no_library_of_an_extra_is_loaded_before_its_file_is_met():
    code = (
        "import sys\n"
        "from fidpipe.pipeline.cli.main import app\n"
        "from fidpipe.pipeline.datasets.readers import formats\n"
        "formats()\n"
        "print([name for name in ('rosbags', 'velodyne_decoder', 'dpkt', 'laspy', 'lazrs') if name in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "[]"
