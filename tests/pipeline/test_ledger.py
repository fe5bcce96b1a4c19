"""The ledger: entries are read back by this process and by another; a damaged one counts as absent."""

import gc
import tracemalloc
from unittest import mock

import numpy as np
import pytest

from fidpipe.pipeline.storage.ledger import LEDGER, Ledger
from fidpipe.pipeline.storage.table_files import JobRecord, StoredFile

LONG = "a pair / of " + 30 * "very " + "long name"


def record(pair_id, stage="graph", **facts):
    files = {f"{stage}/{len(pair_id)}{pair_id[:1]}.parquet": StoredFile(3, "ab", 1)}
    return JobRecord(
        stage, pair_id, "real", "key", files, ("read",), facts, (("graph", 0.25),), "token"
    )


@pytest.fixture
def ledger(tmp_path):
    return Ledger(tmp_path)


def test_what_was_put_is_read_again_by_this_process_and_by_another(ledger, tmp_path):
    ledger.put_job(record("b", share=0.1))
    ledger.put_job(record("a", share=np.float64(1 / 3)))
    ledger.put_job(record(LONG))
    ledger.put_job(record("", "pairs"))
    (tmp_path / "scan").write_bytes(b"points")
    sha256 = ledger.input_hash(tmp_path / "scan")
    ledger.put_failure("street 5", "key", "étroit")
    ledger.save_hashes()
    for known in (ledger, Ledger(tmp_path)):
        assert known.pair_ids() == sorted(["a", "b", LONG, "street 5"])
        assert known.jobs("a") == {("graph", "real"): record("a", share=1 / 3)}
        assert known.jobs("") == {("pairs", "real"): record("", "pairs")}
        names = {
            "graph/1a.parquet",
            "graph/1b.parquet",
            f"graph/{len(LONG)}a.parquet",
            "pairs/0.parquet",
        }
        assert known.files() == names
        with mock.patch(
            "fidpipe.pipeline.storage.ledger.hash_file", side_effect=AssertionError
        ):
            assert known.input_hash(tmp_path / "scan") == sha256
        assert known.jobs("street 5") == {}
        assert known.failure("street 5", ["key"]) == "étroit"
        assert known.failure("street 5", ["other"]) is None


def test_entries_are_found_after_others_were_replaced_and_dropped(ledger, tmp_path):
    for pair_id in "cab":
        ledger.put_job(record(pair_id, n=1))
    ledger.put_job(record("a", "matching", n=5))
    ledger.put_job(record("a", n=2))
    ledger.put_failure("b", "key", "reason")
    ledger.put_job(record("b", n=3))  # the failure is of an earlier try
    assert ledger.failure("b", ["key"]) is None
    for pair_id in "bc":
        ledger.drop_jobs(pair_id, [record(pair_id)])
    jobs = {
        ("graph", "real"): record("a", n=2),
        ("matching", "real"): record("a", "matching", n=5),
    }
    assert Ledger(tmp_path).jobs("a") == jobs
    assert Ledger(tmp_path).pair_ids() == ["a"]
    assert [path.name for path in (tmp_path / LEDGER).iterdir()] == ["a.json"]


def test_entries_are_not_kept_in_memory(ledger):
    tracemalloc.start()
    for i in range(200):
        ledger.put_job(record(str(i), text="x" * 10_000))
    gc.collect()
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 100_000
    assert len(ledger.jobs("199")["graph", "real"].metadata["text"]) == 10_000


@pytest.mark.parametrize(
    "change", [(b'"n":1', b'"n":2'), (b'"a"', b'"b"'), (b"}", b""), (b"\n", b"")]
)
def test_an_entry_that_has_changed_counts_as_absent(ledger, tmp_path, change):
    ledger.put_job(record("a", n=1))
    ledger.put_job(record("b", n=1))
    path = tmp_path / LEDGER / "a.json"
    path.write_bytes(path.read_bytes().replace(*change, 1))
    assert ledger.jobs("a") == {}
    assert ledger.jobs("b") == {("graph", "real"): record("b", n=1)}
    (tmp_path / LEDGER / "b.json").rename(path)
    assert ledger.jobs("a") == {}, "the entry of another pair"


def test_a_folder_without_a_ledger_has_no_entries_and_gets_none_by_reading(ledger, tmp_path):
    assert (ledger.pair_ids(), ledger.files(), ledger.jobs("a")) == ([], set(), {})
    assert list(tmp_path.iterdir()) == []
