"""A run's folder that was damaged between two runs: tables, ledger and record cut off, emptied, deleted, a bit flipped.

A changed file has other times; a bit that a failing disk flips changes none, so one test lets the ledger have the
times of the damaged file.
"""

import json
import random
import re
from dataclasses import replace

import pyarrow as pa
import pytest

from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.status import run_status
from fidpipe.pipeline.storage.folder import RunFolder
from fidpipe.pipeline.storage.ledger import INPUT_HASHES, LEDGER
from fidpipe.schemas.errors import RunError
from runs import (
    FOLDERS,
    assert_same_tables,
    changed_files,
    command,
    flip,
    job_of_file,
    marks,
    rewrite,
    run,
    some_of,
    temporary_files,
)
from tries import assert_resumes

WHOLE_RUN = ["pairs", "timings"]
N_FLIPS = 5  # of each table


def tables_of(out, table):
    return (
        [out / f"{table}.parquet"]
        if table in WHOLE_RUN
        else sorted((out / table).glob("*.parquet"))
    )


def truncate(path, rng):
    content = path.read_bytes()
    path.write_bytes(content[: rng.randrange(1, len(content))])


def zero_the_end(path, rng):
    """As a crash of the machine may leave a file that was not flushed."""
    content = path.read_bytes()
    start = rng.randrange(len(content) // 2)
    path.write_bytes(content[:start] + bytes(len(content) - start))


def flip_bit(path, rng):
    flip(path, rng.randrange(path.stat().st_size), rng.randrange(8))


HARMS = {"truncated": truncate, "zeroed": zero_the_end, "flipped": flip_bit}
HARMS |= {
    "deleted": lambda path, rng: path.unlink(),
    "emptied": lambda path, rng: path.write_bytes(b""),
}


ALL_TABLES = [*FOLDERS, *WHOLE_RUN]
FEW = [("metrics", "flipped"), ("communities", "truncated"), ("pairs", "zeroed")]


@pytest.mark.parametrize(
    ("table", "harm"), some_of([(table, harm) for table in ALL_TABLES for harm in HARMS], FEW)
)
def test_a_damaged_table_is_seen_and_it_alone_is_made_again(
    again, finished, dataset, table, harm
):
    rng = random.Random(f"{table} {harm}")
    for _ in range(N_FLIPS if harm == "flipped" else 1):
        path = rng.choice(tables_of(again, table))
        before = marks(again)
        HARMS[harm](path, rng)
        status = run_status(again)
        assert status.damaged == [str(path.relative_to(again))]
        if table in FOLDERS:
            assert sum(counts["stale"] for counts in status.stages.values()) == 1
        outcome = run(dataset, again)
        assert outcome.n_made == (table not in WHOLE_RUN)
        assert {name.rpartition("/")[2] for name in changed_files(again, before)} <= {path.name}
        assert_same_tables(again, finished)
        assert temporary_files(again) == []


FLIPS = [("flipped", seed) for seed in range(50)]
OTHERS = [(harm, 0) for harm in HARMS if harm != "flipped"]


@pytest.mark.parametrize(("harm", "seed"), some_of([*FLIPS, *OTHERS], [*FLIPS[:2], *OTHERS]))
def test_a_damaged_ledger_changes_no_result(again, finished, dataset, harm, seed):
    """The jobs of the pair, or the hashes of the input files, are computed again."""
    rng = random.Random(seed)
    path = rng.choice(
        sorted((again / LEDGER).glob("[!_]*.json")) + [again / LEDGER / INPUT_HASHES]
    )
    HARMS[harm](path, rng)
    assert FinishedRun(again).rows == FinishedRun(finished).rows
    outcome = run(dataset, again)
    assert outcome.failures == {}
    assert_same_tables(again, finished)
    assert temporary_files(again) == []
    assert run(dataset, again).n_made == 0


@pytest.mark.parametrize("harm", some_of(HARMS, ["flipped", "truncated"]))
def test_a_damaged_record_is_named_and_made_again(again, finished, dataset, harm):
    for seed in range(N_FLIPS if harm == "flipped" else 1):
        before = (again / "run.json").read_bytes()
        HARMS[harm](again / "run.json", random.Random(f"{harm} {seed}"))
        try:
            believed = FinishedRun(again).record
        except RunError as error:
            if harm != "deleted":
                assert "run.json" in str(error)
        else:
            (again / "run.json").write_bytes(before)
            assert believed == FinishedRun(again).record
        run(dataset, again)
        assert FinishedRun(again).record.summary == FinishedRun(finished).record.summary
        assert_same_tables(again, finished)


@pytest.mark.parametrize("table", some_of([*FOLDERS, "pairs"], ["metrics"]))
def test_a_bit_that_the_disk_loses_is_seen_though_no_time_changes(
    again, finished, dataset, table
):
    path = tables_of(again, table)[0]
    name = str(path.relative_to(again))
    flip_bit(path, random.Random(table))
    store = RunFolder(again)
    status = path.stat()
    with store.locked():
        record = job_of_file(store, name)
        stored = record.files[name]
        record.files[name] = replace(stored, mtime_ns=status.st_mtime_ns)
        store.ledger.put_job(record)
    with pytest.raises(RunError, match=re.escape(name)):
        read_all(again)
    told = assert_resumes(dataset, again, finished)
    assert table == "pairs" or re.search("replacing .* of 1 pair: damaged or gone", told)
    read_all(again)


def read_all(out):
    """Reads every table of a finished run as readers do."""
    finished = FinishedRun(out)
    for row in finished.scored:
        finished.pair(row["pair_id"])
    for name in FOLDERS:
        finished.table(name)


def test_a_cause_that_the_catalogue_does_not_have_is_ignored(again, finished):
    """As an edit by hand leaves it: in the tables whose hashes agree, and in the record."""

    def rename(rows):
        index = rows.schema.get_field_index("cause")
        names = ["phase of the moon", *rows["cause"].to_pylist()[1:]]
        return rows.set_column(
            index, rows.schema.field(index), pa.array(names, rows["cause"].type)
        )

    for path in tables_of(again, "causes"):
        rewrite(again, f"causes/{path.name}", rename)
    record = json.loads((again / "run.json").read_text())
    del record["sha256"]
    for cause in record["overview"]["causes"]:
        cause["name"] = "phase of the moon"
    (again / "run.json").write_text(json.dumps(record))
    for words in (
        ("show", again),
        ("show", again, "000"),
        ("report", again),
        ("compare", finished, again),
    ):
        assert "Traceback" not in command(*words, code=0).stderr
