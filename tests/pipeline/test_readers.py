import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.datasets.readers import read_scan, stem_of, suffix_of
from fidpipe.schemas.errors import ScanError
from scenes import street, write_bin

POINTS = np.array([[1.5, -2.25, 0.5], [4, 5, 6], [-7, 8, 9.125]])


def ascii_pcd(points, intensity):
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
    head += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA ascii\n"
    return head + "".join(f"{x} {y} {z} {i}\n" for (x, y, z), i in zip(points, intensity, strict=True))


def write_pcd(path, encoding):
    from pypcd4 import Encoding, PointCloud

    cloud = PointCloud.from_xyzi_points(np.column_stack([POINTS, [1, 2, 3]]).astype(np.float32))
    cloud.save(path, encoding=Encoding(encoding))


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


@pytest.mark.parametrize(("name", "columns"), [("a.bin", 4), ("a.pcd.bin", 5)])
def test_raw_float32_rows_are_read(tmp_path, name, columns):
    scan = read_scan(write_bin(tmp_path / name, POINTS, columns))
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.points.dtype == np.float64
    assert scan.intensity.tolist() == [0, 0, 0]


def test_other_raw_columns_can_be_named(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS, 6)
    scan = read_scan(path, ("x", "y", "z", "ring", "time", "intensity"))
    np.testing.assert_array_equal(scan.points, POINTS)


def test_a_truncated_raw_file_says_what_was_expected(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(
        ScanError, match=r"a\.bin: 45 bytes found, a multiple of 16 wanted \(4 float32 columns: x y z intensity\)"
    ):
        read_scan(path)


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd_files_are_read(tmp_path, encoding):
    path = tmp_path / "a.pcd"
    write_pcd(path, encoding)
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.intensity.tolist() == [1, 2, 3]


@pytest.mark.parametrize("encoding", ["binary", "binary_compressed"])
def test_a_truncated_pcd_is_refused(tmp_path, encoding):
    path = tmp_path / "a.pcd"
    write_pcd(path, encoding)
    path.write_bytes(path.read_bytes()[:-6])
    with pytest.raises(ScanError, match=r"a\.pcd: "):
        read_scan(path)


def test_a_short_ascii_pcd_is_refused(tmp_path):
    path = tmp_path / "a.pcd"
    path.write_text(ascii_pcd(POINTS, [1, 2, 3]).rsplit("\n", 2)[0] + "\n")
    with pytest.raises(ScanError, match="2 points found, the header says 3"):
        read_scan(path)


def test_text_in_an_ascii_pcd_is_refused(tmp_path):
    path = tmp_path / "a.pcd"
    path.write_text(ascii_pcd(POINTS, [1, "oops", 3]))
    with pytest.raises(ScanError, match=r"a\.pcd: not a whole PCD file"):
        read_scan(path)


@pytest.mark.parametrize("fmt", ["ascii", "binary_little_endian"])
def test_ply_files_are_read(tmp_path, fmt):
    path = tmp_path / "a.ply"
    path.write_bytes(ply(POINTS, fmt))
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.intensity.tolist() == [7, 7, 7]


def test_a_ply_label_column_becomes_text(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(ply(POINTS, "ascii", label=True))
    assert read_scan(path).labels.tolist() == ["4", "4", "4"]


@pytest.mark.parametrize("cut", [5, 40, 100])
def test_a_truncated_ply_is_refused(tmp_path, cut):
    path = tmp_path / "a.ply"
    path.write_bytes(ply(POINTS, "binary_little_endian")[:-cut])
    with pytest.raises(ScanError, match=r"a\.ply: not a whole PLY file"):
        read_scan(path)


def test_a_short_last_row_of_an_ascii_ply_is_refused(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(ply(POINTS, "ascii", label=True).rsplit(b" ", 1)[0] + b"\n")
    with pytest.raises(ScanError, match="not a whole PLY file"):
        read_scan(path)


def test_csv_is_read_whatever_the_case_of_its_header(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("X, Y, Z, Intensity, label\n1.5,-2.25,0.5,9,car\n4,5,6,8,tree\n")
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, POINTS[:2])
    assert (scan.intensity.tolist(), scan.labels.tolist()) == ([9, 8], ["car", "tree"])


def test_text_in_a_number_is_named_with_row_and_column(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y,z\n1,2,3\n4,five,6\n")
    with pytest.raises(ScanError, match=r"a\.csv: row 2, column y: 'five' found, a number wanted"):
        read_scan(path)


def test_a_missing_column_is_named(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y\n1,2\n")
    with pytest.raises(ScanError, match="columns x, y found; z wanted as well"):
        read_scan(path)


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


def test_a_truncated_parquet_is_refused(tmp_path):
    path = tmp_path / "a.parquet"
    pd.DataFrame(POINTS, columns=["x", "y", "z"]).to_parquet(path)
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ScanError, match="not a whole Parquet file"):
        read_scan(path)


def test_npy_is_read_plain_and_structured(tmp_path):
    np.save(tmp_path / "a.npy", np.column_stack([POINTS, [1, 2, 3]]))
    np.save(tmp_path / "b.npy", np.array([tuple(p) for p in POINTS], dtype=[("x", "f8"), ("y", "f8"), ("z", "f8")]))
    for name in ("a.npy", "b.npy"):
        np.testing.assert_array_equal(read_scan(tmp_path / name).points, POINTS)


@pytest.mark.parametrize(
    ("array", "fault"),
    [
        (np.zeros((3, 2)), r"shape \(3, 2\) found"),
        (np.zeros(3), r"shape \(3,\) found"),
        (np.array([["a", "b", "c"]]), "U1 array"),
    ],
)
def test_an_npy_of_another_shape_is_refused(tmp_path, array, fault):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(ScanError, match=fault):
        read_scan(tmp_path / "a.npy")


def test_a_pickle_in_an_npy_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{"x": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ScanError, match=r"a\.npy: not a whole \.npy array"):
        read_scan(tmp_path / "a.npy")


def test_a_label_file_gives_names_by_its_low_bits(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS)
    np.array([4, 4 + (7 << 16), 99], dtype="<u4").tofile(tmp_path / "a.label")
    assert read_scan(path, label_names={4: "tree"}).labels.tolist() == ["tree", "tree", "99"]


def test_a_label_file_of_another_length_is_refused(tmp_path):
    path = write_bin(tmp_path / "a.bin", POINTS)
    np.array([4, 4], dtype="<u4").tofile(tmp_path / "a.label")
    with pytest.raises(ScanError, match=r"a\.label: 8 bytes found, 12 wanted"):
        read_scan(path)


@pytest.mark.parametrize("name", ["a.bin", "a.npy", "a.pcd", "a.ply", "a.csv", "a.parquet", "a.pcd.bin"])
def test_an_empty_file_is_refused(tmp_path, name):
    (tmp_path / name).touch()
    with pytest.raises(ScanError, match="the file is empty"):
        read_scan(tmp_path / name)


@pytest.mark.parametrize("name", ["a.npy", "a.pcd", "a.ply", "a.parquet", "a.csv"])
def test_a_file_of_noise_is_refused_in_one_line(tmp_path, name, rng):
    (tmp_path / name).write_bytes(rng.bytes(1000))
    with pytest.raises(ScanError) as error:
        read_scan(tmp_path / name)
    assert str(error.value).startswith(str(tmp_path / name))
    assert "\n" not in str(error.value)


def test_a_missing_file_and_an_unknown_format_are_refused(tmp_path):
    with pytest.raises(ScanError, match="cannot be read"):
        read_scan(tmp_path / "gone.bin")
    with pytest.raises(ScanError, match="unknown format; known are"):
        read_scan(tmp_path / "a.xyz")


@pytest.mark.real_data
def test_real_scans_of_every_format_are_read(real_data):
    expected = {
        "rellis/vel000104.bin": 37334,
        "velodyne_vlp32c/one_sweep.pcd": 26216,
        "registration/source.ply": 69792,
        "nuscenes/n008-2018-08-01-15-16-36-0400__LIDAR_TOP__1533151603597909.pcd.bin": 34752,
    }
    assert {name: len(read_scan(real_data / name).points) for name in expected} == expected


@pytest.mark.real_data
def test_real_labels_are_read(real_data):
    labels = read_scan(real_data / "rellis/000104.bin", label_names={4: "tree"}).labels
    assert len(labels) == 131072
    assert {"tree", "3", "17"} <= set(labels.tolist())


@pytest.mark.parametrize("n_columns", [3, 4])
def test_float64_rows_in_a_bin_are_refused_with_their_layout(tmp_path, n_columns):
    rows = np.column_stack([street(), np.zeros(len(street()))])[:, :n_columns]
    (tmp_path / "a.bin").write_bytes(rows.astype("<f8").tobytes())
    with pytest.raises(ScanError, match=f"holds float64 rows of {n_columns} columns, float32 is wanted"):
        read_scan(tmp_path / "a.bin")
    assert len(read_scan(write_bin(tmp_path / "b.bin", street())).points) == len(street())


@pytest.mark.parametrize(
    ("shape", "fault"),
    [((3, 50), r"one row per point is wanted; save array\.T"), ((50, 7), "name its 7 columns in input.columns")],
)
def test_an_npy_whose_columns_are_not_known_is_refused(tmp_path, shape, fault):
    np.save(tmp_path / "a.npy", np.ones(shape))
    with pytest.raises(ScanError, match=fault):
        read_scan(tmp_path / "a.npy")


def test_columns_of_an_npy_can_be_named(tmp_path):
    np.save(tmp_path / "a.npy", np.column_stack([[9, 8, 7], [0, 0, 0], POINTS]))
    scan = read_scan(tmp_path / "a.npy", ("intensity", "ring", "x", "y", "z"))
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.intensity.tolist() == [9, 8, 7]
