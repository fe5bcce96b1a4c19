from pathlib import Path

import numpy as np
import pytest

from fidpipe.pipeline.storage.ledger import INDEX, Index, JobRecord, StoredFile, note_job


def record(pair_id, **facts):
    file = StoredFile(3, "ab", 1, 2)
    return JobRecord("graph", pair_id, "real", "key", {f"graph/{pair_id}": file}, facts, (("graph", 0.25),))


def replace(path, parts):
    whole = b"".join(parts)
    path.unlink(missing_ok=True)
    path.write_bytes(whole)


@pytest.fixture
def index(tmp_path):
    index = Index(tmp_path)
    index.compact(replace)
    return index


def contents(index):
    return dict(index.jobs), dict(index.inputs), dict(index.failures)


def test_what_was_put_is_read_again_by_this_process_and_by_another(index, tmp_path):
    index.put_job(record("b", share=0.1))
    index.put_job(record("a", share=np.float64(1 / 3)))
    index.put_input("a real", {"n_raw": 5})
    index.put_failure("c", {"reason": "étroit"})
    jobs, inputs, failures = contents(index)
    assert jobs["graph", "a", "real"] == record("a", share=1 / 3)
    assert (inputs, failures) == ({"a real": {"n_raw": 5}}, {"c": {"reason": "étroit"}})
    assert contents(Index(tmp_path)) == (jobs, inputs, failures)


def test_only_places_are_kept_in_memory(index):
    name = index.put_job(record("a", text="x" * 1000))
    index.compact(replace)
    assert index.jobs.places == {name: 0}
    assert index.jobs[name] is not index.jobs[name]


def test_entries_are_found_after_others_were_replaced_dropped_and_compacted(index, tmp_path):
    for pair_id in "cab":
        index.put_job(record(pair_id, n=1))
    index.put_job(record("a", n=2))
    index.drop_job(("graph", "c", "real"))
    before = contents(index)
    index.compact(replace)
    assert contents(index) == before == contents(Index(tmp_path))
    assert [of.facts["n"] for of in index.jobs.values()] == [2, 1]
    assert len((tmp_path / INDEX).read_bytes().splitlines()) == 2
    index.put_job(record("d", n=3))
    assert index.jobs["graph", "d", "real"].facts == {"n": 3}


def test_journals_are_read_and_gathered(index, tmp_path):
    note_job(tmp_path, "token", record("a", n=1))
    assert not index.is_as_loaded()
    index.load()
    assert index.jobs["graph", "a", "real"] == record("a", n=1)
    index.compact(replace)
    assert not list((tmp_path / ".journal").iterdir())
    assert contents(Index(tmp_path)) == contents(index)


def test_an_index_that_may_only_be_read_is_read(index, tmp_path, monkeypatch):
    index.put_job(record("a", n=1))
    whole_open = Path.open

    def read_only(path, mode="r", *args, **options):
        if mode not in ("r", "rb"):
            raise PermissionError(13, "Permission denied", str(path))
        return whole_open(path, mode, *args, **options)

    monkeypatch.setattr(Path, "open", read_only)
    other = Index(tmp_path)
    assert other.jobs["graph", "a", "real"].facts == {"n": 1}
    with pytest.raises(OSError, match="not writable|write"):
        other.put_failure("a", {"reason": "why"})
