"""Scan files made to break a reader: each is rejected at once with one line, or read."""

import io
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
from campaign import campaign
from fidpipe.pipeline.datasets.pairs import read_dataset, read_label_names
from fidpipe.pipeline.datasets.readers import frames_of, read_scan
from fidpipe.schemas.errors import DatasetError, ScanError
from runs import command, some_of
from seeds import POINTS, scan_files
from targets import TARGETS

PACKAGE = Path(fidpipe.__file__).parent
#: Inputs per reader in the short form, fewer for slow readers; `make fuzz` has the long form.
N_INPUTS, SLOW = 100, {"run folder": 20}
#: Those in `make test`: a parser of text and one of bytes, tables, a manifest, and what the command itself reads.
FEW = ["pcd", "laz", "parquet", "pairs.csv", "run folder", "recipe"]


@pytest.mark.parametrize("name", some_of(TARGETS, FEW))
def test_no_input_of_a_short_campaign_breaks_a_reader(name):
    n_inputs = SLOW.get(name, N_INPUTS)
    findings, sums = campaign(name, n_inputs)
    assert findings == []
    assert sums["inputs"] == n_inputs
    assert sums["read"] >= 1, "not even a whole input is read"
    assert sums["refused"] >= 1


def whole(name, which=0):
    """A whole file of a format."""
    return next(iter(TARGETS[name].inputs()[which].values()))


def written(folder, name, content):
    path = folder / name
    path.write_bytes(content)
    return path


def patched(content, place, value):
    return content[:place] + value + content[place + len(value) :]


def test_a_pcd_of_many_numbers_a_point_is_refused(tmp_path):
    path = written(tmp_path, "a.pcd", whole("pcd").replace(b"COUNT 1 1 1 1", b"COUNT 1 1 1 1000000000"))
    with pytest.raises(ScanError, match="1000000003 numbers a point found, at most 1000 are read"):
        read_scan(path)


def test_an_array_longer_than_its_file_is_refused(tmp_path):
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)})
    with pytest.raises(ScanError, match="not a whole"):
        read_scan(written(tmp_path, "a.npy", head.getvalue()))
    long_head = b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1)
    with pytest.raises(ScanError, match="a head of 4294967295 bytes found"):
        read_scan(written(tmp_path, "b.npy", long_head))


class Rude:
    """An object that runs code when its pickle is loaded."""

    def __reduce__(self):
        return os.mkdir, ("was-run",)


def test_no_pickle_is_loaded(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("a.npy", np.array([Rude()], dtype=object), allow_pickle=True)
    with pytest.raises(ScanError, match="not a whole"):
        read_scan(tmp_path / "a.npy")
    assert not Path("was-run").exists()


def test_nothing_of_ours_unpickles_or_asks_a_shell():
    """Dask, which sends tasks as pickles between a user's own machines, is known by the engine alone."""
    words = (
        "import pickle",
        "from pickle",
        "allow_pickle=True",
        "joblib",
        "shell=True",
        "os.system",
        "yaml.load(",
        "eval(",
    )
    found = [
        (path.name, word)
        for path in PACKAGE.rglob("*.py")
        if not {"tests", "tools", "benchmarks", ".venv", "build"} & set(path.relative_to(PACKAGE).parts)
        for word in words
        if word in path.read_text(encoding="utf-8")
    ]
    assert found == []


def test_a_las_of_four_billion_records_is_refused_at_once(tmp_path):
    path = written(tmp_path, "a.las", patched(whole("las"), 100, struct.pack("<I", 2**32 - 1)))
    with pytest.raises(ScanError, match="4294967295 variable length records"):
        read_scan(path)


def test_extended_records_of_a_las_are_not_read(tmp_path):
    content = whole("las", 2)  # version 1.4
    path = written(tmp_path, "a.las", patched(content, 235, struct.pack("<QI", len(content), 2**32 - 1)))
    assert len(read_scan(path).points) == len(POINTS)


def laz_parts(content):
    """Places of the laszip record and of the first chunk of a LAZ file."""
    (start,) = struct.unpack_from("<I", content, 96)
    return content.index(b"laszip encoded") - 2 + 54, start + 8


def test_a_laz_in_one_piece_is_read(tmp_path):
    """The first kind of compressor has no chunks, and no table of them."""
    content = whole("laz")
    record, chunk = laz_parts(content)
    (table,) = struct.unpack_from("<q", content, chunk - 8)
    pieceless = patched(content, record, struct.pack("<H", 1))
    path = written(tmp_path, "a.laz", pieceless[: chunk - 8] + pieceless[chunk:table])
    assert read_scan(path).points == pytest.approx(POINTS)


def chunked_laz(n_chunks, n_listed):
    """A LAZ file of chunks of one point each, with a table that has less or more of them."""
    import lazrs

    content = whole("laz")
    record, chunk = laz_parts(content)
    packing = patched(content, record + 12, struct.pack("<I", 2**32 - 1))[: chunk - 8]
    vlr = lazrs.LazVlr(packing[record : record + 34 + 6])
    out = io.BytesIO(packing)
    out.seek(0, 2)
    compressor = lazrs.LasZipCompressor(out, vlr)
    for _ in range(n_chunks):
        compressor.compress_many(bytes(20))
        compressor.finish_current_chunk()
    compressor.done()
    made = out.getvalue()
    (table,) = struct.unpack_from("<q", made, chunk - 8)
    made = patched(made, 107, struct.pack("<I", n_chunks))
    return patched(made, table + 4, struct.pack("<I", n_listed))


def test_a_panic_of_a_library_in_rust_is_one_line(tmp_path):
    assert len(read_scan(written(tmp_path, "a.laz", chunked_laz(3, 3))).points) == 3
    path = written(tmp_path, "b.laz", chunked_laz(3, 1))
    with pytest.raises(ScanError, match="not a whole LAS file .index out of bounds"):
        read_scan(path)


@pytest.mark.parametrize("time", ["NULL", "'soon'", "-1", "1.5"])
def test_a_frame_of_a_bag_without_a_time_is_refused(tmp_path, time):
    path = written(tmp_path, "a.db3", whole("db3"))
    with closing(sqlite3.connect(path)) as db, db:
        db.executescript(
            "ALTER TABLE messages RENAME TO old; CREATE TABLE messages(id, topic_id, timestamp, data);"
            f"INSERT INTO messages SELECT id, topic_id, {time}, data FROM old;"
        )
    db.close()
    with pytest.raises(ScanError, match="expected a time in nanoseconds for each frame|not a whole ROS bag"):
        frames_of(path)


def test_a_message_is_one_line_whatever_a_topic_is_called(tmp_path):
    path = written(
        tmp_path, "a.bag", whole("bag").replace(b"sensor_msgs/PointCloud2", b"sensor_msgs\n\x0bPointCloud2"[:23])
    )
    with pytest.raises(ScanError) as refused:
        frames_of(path)
    assert len(str(refused.value).splitlines()) == 1


def test_a_bag_names_files_of_its_own_folder_alone(tmp_path):
    files = TARGETS["metadata.yaml"].inputs()[1]
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (database,) = (tmp_path / "bag").glob("*.db3")
    shutil.move(database, tmp_path / "outside.db3")
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(database.name, "../outside.db3"))
    with pytest.raises(ScanError, match="missing"):
        frames_of(tmp_path / "bag")


def test_the_address_of_a_database_is_not_read_from_its_name(tmp_path):
    written(tmp_path, "secret.db3", whole("db3"))
    (tmp_path / "in").mkdir()
    path = written(tmp_path / "in", "..%2fsecret.db3", whole("db3"))
    with pytest.raises(ScanError, match="expected a path without %"):
        frames_of(path)


def test_a_capture_in_the_newer_format_has_the_same_points(tmp_path):
    old, new = written(tmp_path, "a.pcap", whole("pcap")), written(tmp_path, "b.pcapng", whole("pcapng"))
    np.testing.assert_array_equal(read_scan(old).points, read_scan(new).points)


def test_a_table_of_text_is_bounded(tmp_path):
    wide = "x,y,z" + ",a" * 2000 + "\n" + "1,2,3" + ",0" * 2000 + "\n"
    with pytest.raises(ScanError, match="2003 columns found, at most 1000 are read"):
        read_scan(written(tmp_path, "wide.csv", wide.encode()))
    with pytest.raises(ScanError, match="got one of 300"):
        read_scan(written(tmp_path, "label.csv", b"x,y,z,label\n1,2,3,a\n1,2,3," + b"b" * 300 + b"\n"))
    big = written(tmp_path, "big.csv", b"x,y,z,ring\n1,2,3,4\n1,2,3," + b"9" * 400 + b"\n")
    if pd.__version__.startswith("2."):  # to which it is infinite
        assert len(read_scan(big).points) == 2
    else:
        with pytest.raises(ScanError, match="row 2, column ring: expected a number, got 9999"):
            read_scan(big)


def test_a_class_name_is_not_a_book(tmp_path):
    (tmp_path / "labels.toml").write_text(f'1 = "{"a" * 1000}"\n')
    with pytest.raises(DatasetError, match="got one of 1000"):
        read_label_names(tmp_path)


def test_a_name_that_no_file_can_have_is_a_fault_of_its_pair(tmp_path):
    for name, content in scan_files().items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (tmp_path / "pairs.csv").write_text(f"pair_id,real,sim\na,{'x' * 400},sim/0.bin\nb,real/0.bin,sim/0.bin\n")
    long, whole_pair = read_dataset(tmp_path).pairs
    assert "File name too long" in long.fault
    assert whole_pair.fault is None


@pytest.mark.skipif(sys.platform == "darwin", reason="its file systems take no such names")
def test_a_file_name_that_is_no_text_is_named(tmp_path):
    for side in ("real", "sim"):
        (tmp_path / side).mkdir()
        Path(os.fsdecode(os.fsencode(tmp_path / side) + b"/\xff.bin")).write_bytes(bytes(160))
    with pytest.raises(DatasetError, match="the name is not UTF-8"):
        read_dataset(tmp_path)
    done = command("check", tmp_path)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
