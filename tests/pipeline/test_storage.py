"""A run's folder: atomic tables, the lock, and orphaned files."""

import errno
import os
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pyarrow as pa
import pytest

from fidpipe.pipeline.storage.files import key_of, write_whole
from fidpipe.pipeline.storage.folder import RunFolder
from fidpipe.pipeline.storage.ledger import LEDGER
from fidpipe.pipeline.storage.table_files import JobRecord
from fidpipe.schemas.errors import DiskFullError, RunError
from fidpipe.schemas.tables import TABLES

JOB = JobRecord("communities", "a", "real", "key", {}, ("read",), {"n": 1}, (("louvain", 0.5),))
FILES = {"communities/a.real.parquet", "objects/a.real.parquet"}


def communities(n=5):
    return TABLES["communities"].build(
        {"pair_id": "a", "side": "real", "point_id": np.arange(n), "community_id": np.zeros(n)}
    )


def objects():
    numbers = {
        field.name: 1.0 for field in TABLES["objects"].schema if field.type == pa.float64()
    }
    return TABLES["objects"].from_rows(
        [
            {"pair_id": "a", "side": "real", "community_id": 0, "n_points": 5, "label": "car"}
            | numbers
        ]
    )


def write(folder, record=JOB):
    record = replace(record, files={})
    folder.write_job(record, {"communities": communities(), "objects": objects()})
    return record


@pytest.fixture
def written(tmp_path):
    """A folder with one finished job of two tables, in the ledger."""
    folder = RunFolder(tmp_path)
    with folder.locked():
        folder.ledger.put_job(write(folder))
    return RunFolder(tmp_path)


@pytest.mark.parametrize("table", [TABLES["pairs"], TABLES["timings"]])
def test_a_table_of_thousands_of_long_texts_is_read(tmp_path, table):
    """Runs of which very many pairs failed, or have long names: the guard against memory bombs is not for them."""
    folder = RunFolder(tmp_path)
    names = [f"drive_2026_11_22_lot{number // 100:03d}_{number:06d}" for number in range(3000)]

    def rows(some):
        if table.name == "pairs":
            return [
                {"pair_id": name, "status": "failed", "reason": f"no file /a/b/c/{name}.bin"}
                for name in some
            ]
        step = {
            "stage": "ground",
            "side": "real",
            "step": "histogram",
            "seconds": 0.1,
            "reused": False,
        }
        return [
            step | {"pair_id": name, "step": f"step {k}"} for name in some for k in range(10)
        ]

    parts = (
        table.from_rows(rows(names[start : start + 500])) for start in range(0, len(names), 500)
    )
    with folder.locked():
        path = tmp_path / f"{table.name}.parquet"
        stored = folder.write_at(path, table.name, parts, "key")
        found = folder.read(table.name, stored, path)
    assert sorted(set(found.column("pair_id").to_pylist())) == names


def test_a_key_depends_on_every_part():
    keys = {
        key_of(*parts)
        for parts in [("a", 1), ("a", 2), ("a", 1.5), ("b", 1), ("a", [1]), ("a", {"k": 1})]
    }
    assert len(keys) == 6
    assert key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})


def test_a_file_whose_writing_fails_leaves_the_one_before(tmp_path, monkeypatch):
    write_whole(tmp_path / "file", b"old")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(os, "fsync", mock.Mock(side_effect=full))
    with pytest.raises(DiskFullError, match="make room"):
        write_whole(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_device_is_written_to_and_not_replaced():
    pty = pytest.importorskip("pty")
    end, device = pty.openpty()
    write_whole(Path(os.ttyname(device)), b"rows")
    assert os.read(end, 100) == b"rows"
    assert Path(os.ttyname(device)).is_char_device()
    os.close(device)
    os.close(end)


def test_a_job_of_a_former_run_writes_nothing(tmp_path):
    former = RunFolder(tmp_path)
    with former.locked():
        pass
    with (
        RunFolder(tmp_path).locked(),
        pytest.raises(RunError, match="another run has taken over"),
    ):
        write(former)
    assert not (tmp_path / "communities").exists()


def test_strays_are_removed_and_others_are_left_alone(written, tmp_path):
    for name in (
        "communities/b.real.parquet",
        "communities/.a.real.parquet.0123abcd",
        "notes.txt",
    ):
        (tmp_path / name).touch()
    with written.locked():
        assert written.remove_strays() == 1  # half-written ones are not worth a word
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert left - {".lock", ".writer", f"{LEDGER}/a.json"} == FILES | {"notes.txt"}


def test_files_of_equal_content_are_equal_in_bytes(tmp_path):
    contents = []
    for seconds in (0.5, 0.7):
        folder = RunFolder(tmp_path)
        with folder.locked():
            record = write(folder, replace(JOB, steps=(("louvain", seconds),)))
        contents.append({name: (tmp_path / name).read_bytes() for name in record.files})
    assert contents[0] == contents[1]
