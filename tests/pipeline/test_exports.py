"""Files as the exporters of others write them: names of columns, padding, widths, and what cannot be read as it is."""

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.datasets.readers import frames_of, read_scan
from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.schemas.errors import ScanError
from fidpipe.schemas.settings import Settings, load
from recordings import rows, write_foxglove, write_las
from runs import command
from scenes import street, write_bin

POINTS = np.array([[1.5, -2.25, 0.5], [4, 5, 6], [-7, 8, 9.125]])


def write_pcd(path, columns, counts, fmt="binary"):
    """A PCD file with a header in which each name may have COUNT 0, or be padding (_)."""
    kinds = {"f": "F", "u": "U", "i": "I"}
    names = [name.rstrip("0123456789") if name.startswith("_") else name for name in columns]
    fields = zip(columns.items(), counts, strict=True)
    dtype = np.dtype(
        [
            (name, own.dtype, (n,)) if n > 1 else (name, own.dtype)
            for (name, own), n in fields
            if n
        ]
    )
    records = np.zeros(len(POINTS), dtype)
    for name in dtype.names:
        records[name] = columns[name] if records[name].ndim == 1 else 7
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(names),
        "SIZE": " ".join(str(c.dtype.itemsize) for c in columns.values()),
        "TYPE": " ".join(kinds[c.dtype.kind] for c in columns.values()),
        "COUNT": " ".join(map(str, counts)),
        "WIDTH": len(records),
        "HEIGHT": 1,
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": len(records),
        "DATA": fmt,
    }
    text = "# .PCD v0.7\n" + "".join(f"{name} {value}\n" for name, value in lines.items())
    rows = []
    for record in records.tolist():
        numbers = []
        for value in record:
            numbers += np.ravel(value).tolist()
        rows.append(" ".join(map(str, numbers)))
    content = records.tobytes() if fmt == "binary" else "\n".join(rows).encode()
    path.write_bytes(text.encode() + content)
    return path


@pytest.mark.parametrize("fmt", ["binary", "ascii"])
def test_padding_of_count_zero_takes_no_bytes(tmp_path, fmt):
    floats = {name: column.astype("<f4") for name, column in zip("xyz", POINTS.T, strict=True)}
    pad = np.zeros(3, "u1")
    columns = {
        "x": floats["x"],
        "y": floats["y"],
        "z": floats["z"],
        "_1": pad,
        "intensity": np.arange(3, dtype="<f4"),
    }
    columns |= {"_2": pad, "ring": np.arange(3, dtype="<u2"), "_3": pad}
    scan = read_scan(write_pcd(tmp_path / "a.pcd", columns, (1, 1, 1, 4, 1, 0, 1, 12), fmt))
    np.testing.assert_array_equal(scan.points, POINTS)
    assert (scan.intensity.tolist(), scan.rings.tolist()) == ([0, 1, 2], [0, 1, 2])


VELOVIEW = '"Points_m_XYZ:0","Points_m_XYZ:1","Points_m_XYZ:2",intensity,laser_id,azimuth,distance_m,timestamp'
LIVOX = "Version,Slot ID,LiDAR Index,Rsvd,Error Code,Timestamp Type,Data Type,Timestamp,X,Y,Z,Reflectivity,Tag,Ori_x"


@pytest.mark.parametrize(
    ("header", "row", "seconds", "ring"),
    [
        (VELOVIEW, "1.5,-2.25,0.5,7,3,1234,2.7,2000000", 2.0, 3),
        (VELOVIEW.replace("_m_XYZ", ""), "1.5,-2.25,0.5,7,3,1234,2.7,2000000", 2.0, 3),
        (LIVOX, "5,1,1,0,0x00000000,0,0,2000000000,1.5,-2.25,0.5,7,0,1500", 2.0, None),
        ("//X,Y,Z,Inten-sity,Time,ReturnNum", "1.5,-2.25,0.5,7,2.0,1", 2.0, None),
        ("x,y,z,intensity,laser_number,offset_ns", "1.5,-2.25,0.5,7,3,2000000000", 2.0, 3),
        ("x,y,z,intensity", "1.5,-2.25,0.5,7,", None, None),  # a comma at the end of each row
    ],
)
def test_columns_of_other_exporters_are_known(tmp_path, header, row, seconds, ring):
    path = tmp_path / "a.csv"
    path.write_text(f"{header}\n{row}\n{row}\n")
    scan = read_scan(path)
    assert scan.points.tolist() == [[1.5, -2.25, 0.5]] * 2
    assert scan.intensity.tolist() == [7, 7]
    assert (None if scan.times_s is None else scan.times_s[0]) == seconds
    assert (None if scan.rings is None else scan.rings[0]) == ring


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ("1.5,2,3,7\n4,5,6,8\n", "expected a header .* name its 4 columns in input.columns"),
        (
            "x;y;z\n1,5;2,5;3,5\n",
            "separated by commas, got x;y;z; for semicolons and decimal commas",
        ),
        ("x,y,z\n1,5,2,5,3,5\n", "expected 3 values in a row, got 6: .*decimal commas"),
        ('x,y,z\n"1,5","2,5","3,5"\n', "got '1,5'; is it a decimal comma"),
        (
            "a,b,c,d\n1,2,3,4\n",
            "missing columns x, y, z; got a, b, c, d; .* name its 4 columns in input.columns",
        ),
    ],
)
def test_a_csv_without_header_or_with_decimal_commas_is_named(tmp_path, content, fault):
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(ScanError, match=fault):
        read_scan(tmp_path / "a.csv")


@pytest.mark.parametrize("header", ["", "a,b,c,d\n"])
def test_columns_of_a_csv_can_be_named(tmp_path, header):
    (tmp_path / "a.csv").write_text(f"{header}7,1.5,-2.25,0.5\n8,4,5,6\n")
    scan = read_scan(tmp_path / "a.csv", ("intensity", "x", "y", "z"))
    np.testing.assert_array_equal(scan.points, POINTS[:2])
    assert scan.intensity.tolist() == [7, 8]


def test_argoverse_sweeps_have_rings_times_and_a_note_on_two_sensors(tmp_path):
    n = len(street())
    table = pd.DataFrame(street().astype(np.float16), columns=["x", "y", "z"])
    table = table.assign(
        intensity=np.uint8(9),
        laser_number=np.arange(n) % 64,
        offset_ns=np.arange(n, dtype=np.int32),
    )
    table.to_feather(tmp_path / "a.feather")
    scan = read_scan(tmp_path / "a.feather")
    np.testing.assert_array_equal(scan.points, street().astype(np.float16).astype(float))
    assert scan.rings.max() == 63
    assert scan.times_s[5] == pytest.approx(5e-9)
    (note,) = scan.notes
    assert "laser numbers up to 63" in note
    table.assign(laser_number=np.arange(n) % 32).to_feather(tmp_path / "b.feather")
    assert read_scan(tmp_path / "b.feather").notes == ()


@pytest.mark.parametrize("repeats", [True, False])
def test_a_line_of_livox_is_a_ring_if_it_has_one_elevation(tmp_path, repeats):
    rng = np.random.default_rng(0)
    line = np.arange(4000) % 4
    elevation = np.radians(line if repeats else rng.uniform(-20, 20, 4000))
    azimuth, range_m = rng.uniform(-np.pi, np.pi, 4000), rng.uniform(5, 50, 4000)
    flat = range_m * np.cos(elevation)
    table = pd.DataFrame(
        {
            "x": flat * np.cos(azimuth),
            "y": flat * np.sin(azimuth),
            "z": range_m * np.sin(elevation),
        }
    )
    table.assign(line=line).to_csv(tmp_path / "a.csv", index=False)
    scan = read_scan(tmp_path / "a.csv")
    assert (scan.rings is not None) == repeats


@pytest.mark.parametrize("width", [3, 5, 6, 7, 8])
@pytest.mark.parametrize("order", ["own", "shuffled"])
def test_a_bin_of_another_width_is_rejected_until_its_columns_are_named(tmp_path, width, order):
    points = np.tile(street(), (2, 1))
    points = points[: len(points) // 840 * 840]
    rng = np.random.default_rng(0)
    others = [rng.random(len(points)), np.zeros(len(points)), rng.integers(0, 32, len(points))]
    others += [np.linspace(0, 0.1, len(points)), np.full(len(points), 1.7e9)]
    content = np.column_stack([points, *others])[:, :width].astype("<f4")
    (tmp_path / "a.bin").write_bytes(
        (rng.permutation(content) if order == "shuffled" else content).tobytes()
    )
    with pytest.raises(
        ScanError, match=f"do not fit 4 float32 columns .*, but {width}: .* in input.columns"
    ):
        read_scan(tmp_path / "a.bin")
    names = ("x", "y", "z", "intensity", "a", "b", "c", "d")[:width]
    assert len(read_scan(tmp_path / "a.bin", names).points) == len(points)
    assert (
        len(read_scan(tmp_path / "a.bin", names[:3] + ("i",)).points)
        == len(points) * width // 4
    )


def test_projected_coordinates_are_named_without_a_larger_range(tmp_path):
    for side in ("real", "sim"):
        (tmp_path / side).mkdir()
    write_bin(tmp_path / "real" / "a.bin", street())
    utm = street() + [451_000, 5_430_000, 110]
    write_las(tmp_path / "sim" / "a.las", utm, offset=[451_000, 5_430_000, 0])
    found = check_dataset(tmp_path, Settings())
    (fault,) = found.faults
    assert "in the sensor's frame" in fault
    assert "max_range_m" not in fault
    assert any("are they projected" in line for line in found.warnings)


def test_foxglove_clouds_are_read_by_frame(tmp_path):
    scans = [street(seed) for seed in range(2)]
    path = write_foxglove(tmp_path / "a.mcap", [rows(scan) for scan in scans])
    assert [str(frame) for frame in frames_of(path)] == [
        f"{path}#/lidar@{time_s}.000000000" for time_s in (5, 6)
    ]
    for address, scan in zip((f"{path}#0", f"{path}#/lidar@6.0"), scans, strict=True):
        frame = read_scan(address)
        np.testing.assert_array_equal(frame.points, scan.astype(np.float32))
        assert frame.rings.tolist() == rows(scan)["ring"].tolist()


def test_other_mcap_files_are_named_with_their_topics(tmp_path):
    path = write_foxglove(tmp_path / "a.mcap", [rows(POINTS)], encoding="json")
    with pytest.raises(
        ScanError, match=r"foxglove\.PointCloud.*got /lidar \(foxglove.PointCloud, json\)"
    ):
        read_scan(path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(ScanError, match=r"a\.mcap: damaged or of another format"):
        read_scan(path)


# The files of bug reports.


def test_a_file_of_six_columns_fails_check_and_run_until_its_columns_are_named(
    real_data, tmp_path
):
    case = real_data / "reports" / "05_six_columns"
    assert (
        "do not fit 4 float32 columns (x y z intensity), but 6"
        in command("check", case, code=1).stdout
    )
    named = ["input.sim_columns=x y z intensity elongation label"]
    found = check_dataset(case, load(None, named))
    assert found.faults == []


@pytest.mark.parametrize("case", ["07_ouster_count0", "08_veloview", "13a_av2_parquet"])
def test_scans_of_bug_reports_are_those_of_the_base(real_data, case):
    (path,) = (real_data / "reports" / case).glob("sim.*")
    base = read_scan(real_data / "reports" / "00_base" / "sim.bin")
    scan = read_scan(path)
    assert scan.rings is not None
    assert np.abs(np.median(scan.points, axis=0) - np.median(base.points, axis=0)).max() < 0.3


def test_foxglove_recordings_of_bug_reports_are_read(real_data):
    for path in (real_data / "reports" / "09_foxglove").glob("*.mcap"):
        (frame,) = frames_of(path)
        scan = read_scan(frame)
        assert len(scan.points) > 7000
