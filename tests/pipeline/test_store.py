import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest

from fidpipe.pipeline.storage.store import Store, file_stem, key_of
from fidpipe.pipeline.storage.tables import JobRecord
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.tables import COMMUNITIES

NAMES = ["_x", "../x", ".hidden", "a/b", "straße 5", "<script>", "x" * 300, "a.real", "%5Fx", "x~y", "", "..", "日本"]


def rows(n=5):
    return COMMUNITIES.build({"pair_id": "a", "side": "real", "point_id": np.arange(n), "community_id": np.zeros(n)})


def stored(tmp_path):
    store = Store(tmp_path)
    with store.locked():
        name, file = store.write("communities", rows(), "key", "a", "real")
        store.note_job(JobRecord("communities", "a", "real", "key", {name: file}, {"n": 1}, (("write", 0.5),)))
    with Store(tmp_path).locked():  # the next run gathers the journal
        pass
    return Store(tmp_path)


@pytest.mark.parametrize("name", [name for name in NAMES if name])
def test_any_pair_name_is_a_safe_file_name(name):
    stem = file_stem(name)
    assert stem[0].isalnum()
    assert stem.isascii()
    assert "/" not in stem
    assert len(stem) <= 120


def test_different_pairs_have_different_file_names():
    names = [*NAMES[:10], "x", "5Fx", "2Fx", "x~2fe4", "X" * 300, "x" * 299]
    assert len({file_stem(name) for name in names}) == len(names)


def test_a_key_depends_on_every_part():
    keys = {key_of(*parts) for parts in [("a", 1), ("a", 2), ("a", 1.5), ("b", 1), ("a", [1]), ("a", {"k": 1})]}
    assert len(keys) == 6
    assert key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})


def test_a_job_is_known_after_it_is_read_back(tmp_path):
    store = stored(tmp_path)
    (record,) = store.records.values()
    assert (record.key, record.facts, record.steps) == ("key", {"n": 1}, (("write", 0.5),))
    assert store.is_whole(record)


def test_a_job_noted_by_a_killed_run_is_known(tmp_path):
    store = Store(tmp_path)
    with store.locked():
        store.note_job(JobRecord("communities", "a", "real", "key", {}))
    assert len(Store(tmp_path).records) == 1


def test_the_key_and_the_schema_version_stand_in_the_footer(tmp_path):
    stored(tmp_path)
    metadata = pq.read_metadata(tmp_path / "communities" / "a.real.parquet").metadata
    assert (metadata[b"fidpipe.key"], metadata[b"fidpipe.schema_version"]) == (b"key", b"1")


@pytest.mark.parametrize("position", [4, 200, -30])
def test_a_flipped_byte_is_noticed(tmp_path, position):
    store = stored(tmp_path)
    path = tmp_path / "communities" / "a.real.parquet"
    content = bytearray(path.read_bytes())
    content[position] ^= 1
    path.write_bytes(content)
    assert not store.is_whole(next(iter(store.records.values())))


def test_a_truncated_or_missing_file_is_noticed(tmp_path):
    store = stored(tmp_path)
    record = next(iter(store.records.values()))
    path = tmp_path / "communities" / "a.real.parquet"
    path.write_bytes(path.read_bytes()[:-1])
    assert not store.is_whole(record)
    path.unlink()
    assert not store.is_whole(record)


def test_a_copied_run_is_still_whole(tmp_path):
    store = stored(tmp_path)
    path = tmp_path / "communities" / "a.real.parquet"
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)  # same content, other times
    assert store.is_whole(next(iter(store.records.values())))


def test_a_damaged_index_line_is_not_believed(tmp_path):
    stored(tmp_path)
    index = tmp_path / "index.jsonl"
    text = index.read_text()
    index.write_text(text.replace('"n":1', '"n":2'))
    assert Store(tmp_path).records == {}
    index.write_text(text + text[: len(text) // 2])  # and a torn line does no harm
    assert len(Store(tmp_path).records) == 1


def test_a_line_after_a_torn_one_is_kept(tmp_path):
    stored(tmp_path)
    index = tmp_path / "index.jsonl"
    index.write_text(index.read_text() + "0123 torn")
    store = Store(tmp_path)
    with store.locked():
        store.note_failure("b", {"reason": "why"})
    again = Store(tmp_path)
    assert (len(again.records), again.failures) == (1, {"b": {"reason": "why"}})


def test_a_second_run_is_refused_while_the_first_one_lives(tmp_path):
    with Store(tmp_path).locked(), pytest.raises(RunError, match="another fidpipe is writing here"):
        Store(tmp_path).locked().__enter__()
    with Store(tmp_path).locked():
        pass


def test_a_killed_run_leaves_no_lock(tmp_path):
    code = (
        "import os, signal; from pathlib import Path; from fidpipe.pipeline.store import Store\n"
        f"Store(Path({str(tmp_path)!r})).locked().__enter__(); os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code], check=False)
    with Store(tmp_path).locked():
        pass


def test_a_job_of_a_former_run_writes_nothing(tmp_path):
    former = Store(tmp_path)
    with former.locked():
        pass
    with Store(tmp_path).locked(), pytest.raises(RunError, match="another run has taken over"):
        former.write("communities", rows(), "old", "a", "real")
    assert not list((tmp_path / "communities").iterdir())


def test_a_file_that_changes_while_in_use_is_refused(tmp_path):
    store = stored(tmp_path)
    path = tmp_path / "communities" / "a.real.parquet"
    record = next(iter(store.records.values()))
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(RunError, match="changed while the run was using it"):
        store.read("communities", record.files["communities/a.real.parquet"], path)


def test_strays_are_found_and_others_are_left_alone(tmp_path):
    store = stored(tmp_path)
    for name in ("b.real.parquet", ".a.real.parquet.0123abcd"):
        (tmp_path / "communities" / name).touch()
    found = {path.name for path in store.strays(["communities"])}
    assert found == {"b.real.parquet", ".a.real.parquet.0123abcd"}
