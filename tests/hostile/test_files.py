"""Scan files made to break a reader: each is refused at once with one line, or read."""

import io
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rosbags.highlevel import AnyReader

from campaign import campaign
from fidpipe.pipeline.datasets.pairs import read_dataset, read_label_names
from fidpipe.pipeline.datasets.readers import frames_of, las, read_scan
from fidpipe.pipeline.storage import bounds
from fidpipe.schemas.errors import DatasetError, OversizeError, ScanError
from recordings import CLOUD, cloud, typestore
from seeds import _ROWS, POINTS, scan_files
from targets import TARGETS

PACKAGE = Path(bounds.__file__).resolve().parents[2]
#: Inputs a reader in the short form, fewer where one takes long; `make fuzz` has the long form.
N_INPUTS, SLOW = 100, {"run folder": 20}


@pytest.mark.parametrize("name", TARGETS)
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


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_a_pcd_that_promises_a_billion_points_is_refused_before_memory_is_taken(tmp_path, encoding):
    content = next(
        files["a.pcd"] for files in TARGETS["pcd"].inputs() if f"DATA {encoding}\n".encode() in files["a.pcd"]
    )
    path = written(tmp_path, "a.pcd", content.replace(b"POINTS 5", b"POINTS 1000000000"))
    with pytest.raises(ScanError, match="1000000000 points"):
        read_scan(path)


def test_a_pcd_of_many_numbers_a_point_is_refused(tmp_path):
    path = written(tmp_path, "a.pcd", whole("pcd").replace(b"COUNT 1 1 1 1", b"COUNT 1 1 1 1000000000"))
    with pytest.raises(ScanError, match="1000000003 numbers a point found, at most 1000 are read"):
        read_scan(path)


def test_a_text_pcd_of_one_point_is_read(tmp_path):
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    path = tmp_path / "a.pcd"
    path.write_text(head + "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA ascii\n1 2 3\n")
    assert read_scan(path).points.tolist() == [[1, 2, 3]]


def test_an_array_longer_than_its_file_is_refused(tmp_path):
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)})
    with pytest.raises(ScanError, match="not a whole"):
        read_scan(written(tmp_path, "a.npy", head.getvalue()))
    long_head = b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1)
    with pytest.raises(ScanError, match="a head of 4294967295 bytes found"):
        read_scan(written(tmp_path, "b.npy", long_head))


class Rude:
    """What runs code where a pickle of it is loaded."""

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


def test_a_laz_whose_points_are_packed_otherwise_is_refused(tmp_path):
    content = whole("laz")
    record, _ = laz_parts(content)
    path = written(tmp_path, "a.laz", patched(content, record + 36, struct.pack("<H", 60000)))
    with pytest.raises(ScanError, match="points of 20 bytes are packed as of 60000"):
        read_scan(path)


def test_a_laz_of_more_chunks_than_bytes_is_refused(tmp_path):
    content = whole("laz")
    (table,) = struct.unpack_from("<q", content, laz_parts(content)[1] - 8)
    path = written(tmp_path, "a.laz", patched(content, table + 4, struct.pack("<I", 2**31)))
    with pytest.raises(ScanError, match="2147483648 chunks of 5 points found"):
        read_scan(path)


@pytest.mark.parametrize("number", [9711, 25847, 63252])
def test_points_of_a_laz_packed_as_no_laz_packs_them_are_refused(number):
    """Items of other sizes than their kinds, chunks of no point, layers in what has none: lazrs ends the process."""
    assert campaign("laz", 1, first=number)[0] == []


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


def test_a_laz_of_fewer_chunks_than_its_points_fill_is_refused(tmp_path, monkeypatch):
    assert len(read_scan(written(tmp_path, "a.laz", chunked_laz(3, 3))).points) == 3
    path = written(tmp_path, "b.laz", chunked_laz(3, 1))
    with pytest.raises(ScanError, match="1 chunks of 1 points found"):
        read_scan(path)
    monkeypatch.setattr(las, "_check_packing", lambda *_: None)
    with pytest.raises(ScanError, match="not a whole LAS file .index out of bounds"):
        read_scan(path)


def test_a_laz_layer_longer_than_the_file_is_refused(tmp_path):
    content = whole("laz", 2)  # point format 6, in layers
    _, chunk = laz_parts(content)
    path = written(tmp_path, "a.laz", patched(content, chunk + 30 + 4, struct.pack("<I", 2**32 - 1)))
    with pytest.raises(ScanError, match="a chunk that ends at byte"):
        read_scan(path)


def test_runs_of_equal_values_in_parquet_are_bounded(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    column = pa.array(np.zeros(3_000_000))
    pq.write_table(pa.table(dict.fromkeys("xyz", column)), tmp_path / "a.parquet")
    assert (tmp_path / "a.parquet").stat().st_size < 50_000
    with pytest.raises(OversizeError, match=r"would unpack to \d+ or more"):
        read_scan(tmp_path / "a.parquet")


@pytest.mark.parametrize("repeated", [1, 1_000_000])
def test_a_long_text_that_is_stored_once_counts_as_often_as_it_occurs(tmp_path, repeated):
    import pyarrow as pa
    import pyarrow.parquet as pq

    n_rows = 1_000_000
    texts = pa.array(["car", "x" * 100_000])
    chosen = pa.array((np.arange(n_rows) < repeated).astype(np.int32))
    columns = dict.fromkeys("xyz", np.random.default_rng(0).random(n_rows))
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({**columns, "label": pa.DictionaryArray.from_arrays(chosen, texts)}), path)
    with path.open("rb") as stream:
        if repeated == 1:
            bounds.check_pages(path, stream)
        else:
            with pytest.raises(OversizeError, match=r"would unpack to 1000\d{8} or more"):
                bounds.check_pages(path, stream)


def test_a_page_that_claims_gigabytes_is_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = io.BytesIO()
    columns = {name: pa.array(column) for name, column in zip("xyz", POINTS.T, strict=True)}
    pq.write_table(pa.table(columns), content, compression="none", use_dictionary=False)
    page = b"\x15\x00\x15" + bytes([len(POINTS) * 8 * 2 + 12])  # a page's head: kind 0, then its unpacked length
    whole_file = content.getvalue()
    place = 4
    assert whole_file[place : place + 3] == page[:3]
    huge = bytes([0xFE, 0xFF, 0xFF, 0xFF, 0x0F])  # 2^31 - 1
    end = place + 3
    while whole_file[end] & 0x80:
        end += 1
    with pytest.raises(OversizeError):
        bounds.check_pages(tmp_path, *[io.BytesIO(whole_file[: place + 3] + huge + whole_file[end + 1 :])])


@pytest.mark.parametrize("number", [35765, 35939, 40680])
def test_a_damaged_footer_of_parquet_does_not_end_the_process(number):
    assert campaign("parquet", 1, first=number)[0] == []


@pytest.fixture
def narrow(monkeypatch):
    """Bounds so narrow that a small file passes them."""
    monkeypatch.setattr(bounds, "MOST_UNPACKED_BYTES", 2**16)


def chunks_of_nothing(path, kind):
    """A bag whose chunk unpacks to a thousand times its length."""
    types = typestore(is_ros1=path.suffix == ".bag")
    rows = np.zeros(50_000, _ROWS.dtype)
    if path.suffix == ".bag":
        from rosbags.rosbag1 import Writer

        bag, serialize = Writer(path), types.serialize_ros1
        bag.set_compression(Writer.CompressionFormat[kind])
    else:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        bag, serialize = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP), types.serialize_cdr
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat[kind])
    with bag:
        connection = bag.add_connection("/points", CLOUD, typestore=types)
        bag.write(connection, 10**9, serialize(cloud(types, rows), CLOUD))
    return path


@pytest.mark.parametrize(("name", "kind"), [("a.bag", "BZ2"), ("a.bag", "LZ4"), ("a_mcap", "ZSTD")])
def test_a_chunk_that_unpacks_to_very_much_is_refused(tmp_path, narrow, name, kind):
    path = chunks_of_nothing(tmp_path / name, kind)
    with pytest.raises(ScanError, match="would unpack to"):
        read_scan(path)
    with AnyReader([path], default_typestore=typestore(is_ros1=name == "a.bag")) as bag:  # as others in this process do
        assert len(list(bag.messages())) == 1


def test_a_bag_s_database_runs_nothing_of_its_own(tmp_path):
    path = written(tmp_path, "a.db3", whole("db3"))
    with closing(sqlite3.connect(path)) as db, db:
        db.executescript(
            "DROP TABLE message_definitions; CREATE VIEW message_definitions AS WITH RECURSIVE n(i) AS "
            "(SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 'a' AS topic_type, 'ros2msg' AS encoding, "
            "'' AS encoded_message_definition, '' AS type_description_hash FROM n;"
        )
    db.close()
    with pytest.raises(ScanError, match="not a whole ROS bag"):
        frames_of(path)


@pytest.mark.parametrize("time", ["NULL", "'soon'", "-1", "1.5"])
def test_a_frame_of_a_bag_without_a_time_is_refused(tmp_path, time):
    path = written(tmp_path, "a.db3", whole("db3"))
    with closing(sqlite3.connect(path)) as db, db:
        db.executescript(
            "ALTER TABLE messages RENAME TO old; CREATE TABLE messages(id, topic_id, timestamp, data);"
            f"INSERT INTO messages SELECT id, topic_id, {time}, data FROM old;"
        )
    db.close()
    with pytest.raises(ScanError, match="a frame without a time found|not a whole ROS bag"):
        frames_of(path)


def test_a_message_is_one_line_whatever_a_topic_is_called(tmp_path):
    path = written(
        tmp_path, "a.bag", whole("bag").replace(b"sensor_msgs/PointCloud2", b"sensor_msgs\n\x0bPointCloud2"[:23])
    )
    with pytest.raises(ScanError) as refused:
        frames_of(path)
    assert len(str(refused.value).splitlines()) == 1


def test_a_column_of_a_bag_that_makes_its_own_values_takes_no_memory(tmp_path):
    path = written(tmp_path, "a.db3", whole("db3"))
    with closing(sqlite3.connect(path)) as db, db:
        db.executescript(
            "ALTER TABLE messages RENAME TO old; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
            "timestamp INTEGER, data BLOB AS (zeroblob(1000000000)));"
            "INSERT INTO messages(topic_id, timestamp) SELECT topic_id, timestamp FROM old;"
        )
    db.close()
    with pytest.raises(ScanError, match="not a whole ROS bag"):
        read_scan(Path(f"{path}#0"))


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
    with pytest.raises(ScanError, match="a path without %"):
        frames_of(path)


def test_a_capture_in_the_newer_format_has_the_same_points(tmp_path):
    old, new = written(tmp_path, "a.pcap", whole("pcap")), written(tmp_path, "b.pcapng", whole("pcapng"))
    np.testing.assert_array_equal(read_scan(old).points, read_scan(new).points)


def test_a_table_of_text_is_bounded(tmp_path):
    wide = "x,y,z" + ",a" * 2000 + "\n" + "1,2,3" + ",0" * 2000 + "\n"
    with pytest.raises(ScanError, match="2003 columns found, at most 1000 are read"):
        read_scan(written(tmp_path, "wide.csv", wide.encode()))
    with pytest.raises(ScanError, match="a label of 300 characters found"):
        read_scan(written(tmp_path, "label.csv", b"x,y,z,label\n1,2,3,a\n1,2,3," + b"b" * 300 + b"\n"))
    big = written(tmp_path, "big.csv", b"x,y,z,ring\n1,2,3,4\n1,2,3," + b"9" * 400 + b"\n")
    if pd.__version__.startswith("2."):  # to which it is infinite
        assert len(read_scan(big).points) == 2
    else:
        with pytest.raises(ScanError, match="row 2, column ring: 9999"):
            read_scan(big)


def test_a_class_name_is_not_a_book(tmp_path):
    (tmp_path / "labels.toml").write_text(f'1 = "{"a" * 1000}"\n')
    with pytest.raises(DatasetError, match="a name of 1000 characters found"):
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
    with pytest.raises(DatasetError, match="UTF-8 is wanted"):
        read_dataset(tmp_path)
    command = [Path(sys.executable).with_name("fidpipe"), "check", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
