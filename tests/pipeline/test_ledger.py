"""The ledger: entries are read back by this process and by another; a damaged one is not trusted."""

import gc
import resource
import sqlite3
import tracemalloc
import weakref
from concurrent.futures import ThreadPoolExecutor
from unittest import mock

import numpy as np
import pytest

from fidpipe.pipeline.storage.ledger import LEDGER, Ledger
from fidpipe.pipeline.storage.table_files import JobRecord, StoredFile
from fidpipe.schemas.errors import RunError


def record(pair_id, stage="graph", **facts):
    file = StoredFile(3, "ab", 1)
    files = {f"{stage}/{pair_id}": file}
    return JobRecord(stage, pair_id, "real", "key", files, ("read",), facts, (("graph", 0.25),), "token")


@pytest.fixture
def ledger(tmp_path):
    return Ledger(tmp_path / LEDGER, is_writable=True)


def again(tmp_path):
    """The ledger as another process reads it."""
    return Ledger(tmp_path / LEDGER, is_writable=False)


def contents(ledger):
    pair_ids = list(ledger.pair_ids())
    jobs = {name: job for pair_id in pair_ids for name, job in ledger.jobs(pair_id).items()}
    return pair_ids, jobs, {pair_id: ledger.failure(pair_id, ["key"]) for pair_id in ledger.failed_pairs()}


def test_what_was_put_is_read_again_by_this_process_and_by_another(ledger, tmp_path):
    ledger.put_job(record("b", share=0.1))
    ledger.put_job(record("a", share=np.float64(1 / 3)))
    (tmp_path / "scan").write_bytes(b"points")
    sha256 = ledger.input_hash(tmp_path / "scan")
    ledger.put_failure("c", "key", "étroit")
    ledger.commit()
    for own in (ledger, again(tmp_path)):
        assert list(own.pair_ids()) == ["a", "b"]
        assert own.jobs("a") == {("graph", "real"): record("a", share=1 / 3)}
        with mock.patch("fidpipe.pipeline.storage.ledger.hash_file", side_effect=AssertionError):
            assert own.input_hash(tmp_path / "scan") == sha256
        assert own.failed_pairs() == ["c"]
        assert (own.failure("c", ["key"]), own.failure("c", ["other"])) == ("étroit", None)


def test_the_job_of_a_file_is_found(ledger):
    ledger.put_job(record("a"))
    assert ledger.job_of_file("graph/a") == record("a")
    assert ledger.files("graph") == {"graph/a"}
    assert ledger.job_of_file("graph/b") is None
    assert ledger.files("") == ledger.files("graph/a") == ledger.files("grap") == set()


def test_entries_are_found_after_others_were_replaced_and_dropped(ledger, tmp_path):
    for pair_id in "cab":
        ledger.put_job(record(pair_id, n=1))
    ledger.put_job(record("a", "matching", n=5))
    ledger.put_job(record("a", n=2))
    ledger.drop_jobs("c", [record("c")])
    ledger.drop_failure("nobody")
    ledger.commit()
    jobs = {("graph", "real"): record("a", n=2), ("matching", "real"): record("a", "matching", n=5)}
    assert again(tmp_path).jobs("a") == jobs
    assert list(again(tmp_path).pair_ids()) == ["a", "b"]
    assert again(tmp_path).files("graph") == {"graph/a", "graph/b"}


def test_entries_are_not_kept_in_memory(ledger):
    tracemalloc.start()
    for i in range(2000):
        ledger.put_job(record(str(i), text="x" * 1000))
    gc.collect()
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 100_000
    assert len(ledger.jobs("1999")["graph", "real"].metadata["text"]) == 1000


def test_a_ledger_that_was_not_closed_in_order_says_so(ledger, tmp_path):
    assert not ledger.is_complete
    ledger.set_complete(True)
    assert again(tmp_path).is_complete
    ledger.set_complete(False)
    assert not again(tmp_path).is_complete


def test_a_reader_changes_nothing_on_disk(ledger, tmp_path):
    ledger.put_job(record("a"))
    ledger.commit()
    before = (tmp_path / LEDGER).read_bytes()
    reader = again(tmp_path)
    reader.put_job(record("b"))  # found by its footer, while the run goes on
    assert list(reader.pair_ids()) == ["a", "b"]
    reader.close()
    assert (tmp_path / LEDGER).read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {LEDGER}


def test_a_ledger_that_changed_since_it_was_closed_is_not_believed(ledger, tmp_path):
    for pair_id in "ab":
        ledger.put_job(record(pair_id, n=1))
    ledger.set_complete(True)
    ledger.close()
    path = tmp_path / LEDGER
    content = path.read_bytes()
    assert content.count(b'"n":1') == 2
    path.write_bytes(content.replace(b'"n":1', b'"n":2', 1))
    assert contents(again(tmp_path)) == ([], {}, {})
    assert not again(tmp_path).is_complete


def test_a_ledger_in_a_run_that_goes_on_is_read_as_it_was_committed(ledger, tmp_path):
    ledger.put_job(record("a"))
    ledger.commit()
    ledger.put_job(record("b"))
    assert list(again(tmp_path).pair_ids()) == ["a"]
    ledger.commit()
    assert list(again(tmp_path).pair_ids()) == ["a", "b"]


def test_a_disk_that_takes_no_more_is_one_line_and_what_was_there_stays(ledger, tmp_path):
    ledger.put_job(record("a"))
    ledger.set_complete(True)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**18, limits[1]))
    try:
        with pytest.raises(RunError, match=r"ledger\.sqlite"):
            for i in range(5000):
                ledger.put_job(record(f"b{i}", text="x" * 1000))
            ledger.commit()
        ledger.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert again(tmp_path).jobs("a")


def test_a_ledger_that_another_thread_collects_is_closed_without_a_word(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite", is_writable=True)
    (finalizer,) = (own for own in weakref.finalize._registry if own.peek() and own.peek()[0] is ledger)
    with ThreadPoolExecutor(1) as pool:
        pool.submit(finalizer).result()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        ledger.job_of_file("pairs.parquet")
