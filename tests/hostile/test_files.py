"""Scan files made to break a reader are rejected at once with one line; honest extremes are read."""

import os
import shutil
import sqlite3
import struct
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fidpipe
from fidpipe.pipeline.datasets.pairs import read_dataset, read_label_names, scans_of
from fidpipe.pipeline.datasets.readers import frames_of, read_scan
from fidpipe.pipeline.datasets.readers.formats import FORMATS
from fidpipe.pipeline.datasets.readers.scan_ref import scan_ref
from fidpipe.schemas.errors import DatasetError, ScanError
from recordings import write_pcap
from runs import command
from scan_files import POINTS, WRITERS, read, velodyne_packets, write_packets
from scenes import write_dataset

PACKAGE = Path(fidpipe.__file__).parent
#: Packets of a sensor: a turn is never longer than the sensor makes it.
NOT_WRITTEN = {".pcap", ".pcapng"}


def written(folder, name, content):
    path = folder / name
    path.write_bytes(content)
    return path


def whole(folder, name):
    """The content of a valid file of a format."""
    file, write = WRITERS[name]
    write(folder / file, POINTS)
    return (folder / file).read_bytes()


def patched(content, place, value):
    return content[:place] + value + content[place + len(value) :]


def test_a_pcd_of_many_numbers_a_point_is_refused(tmp_path):
    content = whole(tmp_path, "pcd").replace(b"COUNT 1 1 1 1", b"COUNT 1 1 1 1000000000")
    path = written(tmp_path, "a.pcd", content)
    with pytest.raises(ScanError, match="1000000003"):
        read_scan(path)


def test_an_array_longer_than_its_file_is_refused(tmp_path):
    long_head = b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1)
    with pytest.raises(ScanError, match="4294967295"):
        read_scan(written(tmp_path, "b.npy", long_head))


class Rude:
    """An object that runs code when its pickle is loaded."""

    def __reduce__(self):
        return os.mkdir, ("was-run",)


def test_no_pickle_is_loaded(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("a.npy", np.array([Rude()], dtype=object), allow_pickle=True)
    with pytest.raises(ScanError, match=r"a\.npy"):
        read_scan(tmp_path / "a.npy")
    assert not Path("was-run").exists()


def test_nothing_of_ours_unpickles_or_asks_a_shell():
    """Dask, which sends tasks as pickles between a user's own machines, is known by the engine alone."""
    words = ("import pickle", "from pickle", "allow_pickle=True", "joblib")
    words += ("shell=True", "os.system", "yaml.load(", "eval(")
    found = [
        (path.name, word)
        for path in PACKAGE.rglob("*.py")
        if not {"tests", "tools", "benchmarks", ".venv", "build"}
        & set(path.relative_to(PACKAGE).parts)
        for word in words
        if word in path.read_text(encoding="utf-8")
    ]
    assert found == []


def test_a_las_of_four_billion_records_is_refused_at_once(tmp_path):
    path = written(
        tmp_path, "a.las", patched(whole(tmp_path, "las"), 100, struct.pack("<I", 2**32 - 1))
    )
    with pytest.raises(ScanError, match="4294967295"):
        read_scan(path)


def test_extended_records_of_a_las_are_not_read(tmp_path):
    content = whole(tmp_path, "las")
    path = written(
        tmp_path, "a.las", patched(content, 235, struct.pack("<QI", len(content), 2**32 - 1))
    )
    assert len(read_scan(path).points) == len(POINTS)


def test_a_panic_of_a_library_in_rust_is_one_line(tmp_path, monkeypatch):
    class PanicException(BaseException):
        """As pyo3 raises it."""

    def panic(*_, **__):
        raise PanicException("index out of bounds")

    path = written(tmp_path, "a.laz", whole(tmp_path, "laz"))
    monkeypatch.setattr("laspy.open", panic)
    with pytest.raises(ScanError, match=r"a\.laz"):
        read_scan(path)


@pytest.mark.parametrize("time", ["NULL", "'soon'", "-1", "1.5"])
def test_a_frame_of_a_bag_without_a_time_is_refused(tmp_path, time):
    WRITERS["db3"][1](tmp_path / "a_sql", POINTS)
    path = tmp_path / "a_sql" / "a_sql.db3"
    with closing(sqlite3.connect(path)) as db, db:
        db.executescript(
            "ALTER TABLE messages RENAME TO old; CREATE TABLE messages(id, topic_id, timestamp, data);"
            f"INSERT INTO messages SELECT id, topic_id, {time}, data FROM old;"
        )
    db.close()
    with pytest.raises(ScanError, match=r"a_sql\.db3"):
        frames_of(path)


def test_a_message_is_one_line_whatever_a_topic_is_called(tmp_path):
    content = whole(tmp_path, "bag").replace(
        b"sensor_msgs/PointCloud2", b"sensor_msgs\n\x0bPointCloud2"[:23]
    )
    path = written(tmp_path, "a.bag", content)
    with pytest.raises(ScanError) as refused:
        frames_of(path)
    assert len(str(refused.value).splitlines()) == 1


def test_a_bag_names_files_of_its_own_folder_alone(tmp_path):
    bag = tmp_path / "a_sql"
    WRITERS["db3"][1](bag, POINTS)
    shutil.move(bag / "a_sql.db3", tmp_path / "outside.db3")
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("a_sql.db3", "../outside.db3"))
    with pytest.raises(ScanError, match="missing"):
        frames_of(bag)


def test_the_address_of_a_database_is_not_read_from_its_name(tmp_path):
    WRITERS["db3"][1](tmp_path / "a_sql", POINTS)
    content = (tmp_path / "a_sql" / "a_sql.db3").read_bytes()
    written(tmp_path, "secret.db3", content)
    with pytest.raises(ScanError, match="%2fsecret"):
        frames_of(written(tmp_path / "a_sql", "..%2fsecret.db3", content))


def test_a_capture_in_the_newer_format_has_the_same_points(tmp_path):
    write_packets(tmp_path / "a.pcap")
    write_packets(tmp_path / "b.pcapng")
    np.testing.assert_array_equal(
        read_scan(tmp_path / "a.pcap").points, read_scan(tmp_path / "b.pcapng").points
    )


def test_a_sensor_whose_packets_lack_their_calibration_is_not_read_as_another(tmp_path):
    packets = []
    for number, (stamp, data) in enumerate(4 * velodyne_packets()):
        packets.append((stamp, data[:-1] + bytes([0x22 + number])))
    with pytest.raises(ScanError, match="metadata"):
        read(write_pcap(tmp_path / "a.pcap", packets))


def test_a_table_of_text_is_bounded(tmp_path):
    wide = "x,y,z" + ",a" * 2000 + "\n" + "1,2,3" + ",0" * 2000 + "\n"
    with pytest.raises(ScanError, match="2003"):
        read_scan(written(tmp_path, "wide.csv", wide.encode()))
    with pytest.raises(ScanError, match="label.*300"):
        read_scan(
            written(tmp_path, "label.csv", b"x,y,z,label\n1,2,3,a\n1,2,3," + b"b" * 300 + b"\n")
        )
    big = written(tmp_path, "big.csv", b"x,y,z,ring\n1,2,3,4\n1,2,3," + b"9" * 400 + b"\n")
    if pd.__version__.startswith("2."):  # to which it is infinite
        assert len(read_scan(big).points) == 2
    else:
        with pytest.raises(ScanError, match="row 2, column ring"):
            read_scan(big)


def test_a_class_name_is_not_a_book(tmp_path):
    (tmp_path / "labels.toml").write_text(f'1 = "{"a" * 1000}"\n')
    with pytest.raises(DatasetError, match="1000"):
        read_label_names(tmp_path)


def test_a_name_that_no_file_can_have_is_a_fault_of_its_pair(tmp_path):
    write_dataset(tmp_path, 1)
    (tmp_path / "pairs.csv").write_text(
        f"pair_id,real,sim\na,{'x' * 400},sim/000.bin\nb,real/000.bin,sim/000.bin\n"
    )
    long, whole_pair = read_dataset(tmp_path).pairs
    assert long.fault
    assert whole_pair.fault is None


@pytest.mark.skipif(sys.platform == "darwin", reason="its file systems take no such names")
def test_a_file_name_that_is_no_text_is_named(tmp_path):
    for side in ("real", "sim"):
        (tmp_path / side).mkdir()
        Path(os.fsdecode(os.fsencode(tmp_path / side) + b"/\xff.bin")).write_bytes(bytes(160))
    with pytest.raises(DatasetError, match="UTF-8"):
        read_dataset(tmp_path)
    done = command("check", tmp_path, code=1)
    assert "Traceback" not in done.stderr


def repeated(n):
    """Rows of metres and whole intensities; a thousand different ones again and again."""
    rng = np.random.default_rng(3)
    rows = np.column_stack(
        [rng.uniform(-80, 80, (1000, 3)).round(3), rng.integers(0, 255, 1000)]
    )
    return np.tile(rows, (n // 1000, 1)).astype("<f4")


def test_each_format_is_among_them(tmp_path):
    written = set()
    for name, (file, write) in WRITERS.items():
        (tmp_path / name).mkdir()
        write(tmp_path / name / file, np.ones((1, 4), "<f4"))
        files = [tmp_path / name / file, *(tmp_path / name).rglob("*")]
        written |= {scan_ref(path).suffix for path in files}
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


@pytest.mark.parametrize(
    "name", ["bin", "npy", "pcd", "packed pcd", "ply", "parquet", "las", "laz"]
)
def test_a_file_that_is_cut_off_is_refused(tmp_path, name):
    file, write = WRITERS[name]
    write(tmp_path / file, repeated(1000))
    (tmp_path / file).write_bytes((tmp_path / file).read_bytes()[:-5])
    with pytest.raises(ScanError, match=file):
        read(tmp_path / file)


def test_each_real_scan_is_read(real_data):
    files = [
        path
        for path in sorted(real_data.rglob("*"))
        if scan_ref(path).suffix
        and not path.parent.name.startswith("rosbag2")
        and path.name != "pairs.csv"
        and path.parent.name != "05_six_columns"
    ]
    assert len(files) > 20
    for path in files:
        columns = ("x", "y", "z") if "lumpi" in path.parts else None
        assert all(len(read_scan(frame, columns).points) > 500 for frame in scans_of(path)), (
            path
        )
