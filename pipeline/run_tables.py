"""The tables of a whole run, pairs and timings, and some entries of its record."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import pyarrow as pa

from ..schemas.columns import Row
from ..schemas.settings import Settings
from ..schemas.tables import TABLES
from .engine.plan import Job
from .stage import OF_PAIR, Stage
from .storage.folder import RunFolder
from .storage.table_files import JobId, JobRecord

_MOST_ALIKE = 10  # warnings of a kind that are written out
_PAIRS_AT_ONCE = 200


def few_of_each(warnings: Sequence[str]) -> list[str]:
    """Some warnings of each kind, which is how they end, and the number of the others."""
    kinds: defaultdict[str, list[str]] = defaultdict(list)
    for text in warnings:
        kinds[text.rpartition("; ")[2]].append(text)
    lines = []
    for alike in kinds.values():
        lines += alike[:_MOST_ALIKE]
        n_more = len(alike) - _MOST_ALIKE
        if n_more > 0:
            lines.append(f"{n_more} more like that; fidpipe check lists them")
    return lines


def records_of(
    folder: RunFolder,
    stages: Sequence[Stage],
    pair_ids: Iterable[str],
) -> Iterator[JobRecord]:
    """The finished jobs of some pairs that are of some stages."""
    names = {stage.name for stage in stages}
    for pair_id in pair_ids:
        for record in folder.ledger.jobs(pair_id).values():
            if record.stage in names:
                yield record


def pair_rows(
    folder: RunFolder, jobs: Mapping[JobId, Job], failures: Mapping[str, str], pair_id: str
) -> list[Row]:
    """The row of `pairs` of a scored or failed pair; none of one that is neither.

    Parameters
    ----------
    jobs : of any pair
    failures : reasons by pair_id, now or in an earlier run
    """
    records = folder.ledger.jobs(pair_id)
    required = [name for name, job in jobs.items() if not job.stage.is_extra]
    if records.keys() >= set(required):
        row: Row = {"pair_id": pair_id, "status": "scored"}
        for name in required:
            row |= records[name].metadata.get(OF_PAIR, {})
        return [row]
    if pair_id in failures:
        return [{"pair_id": pair_id, "status": "failed", "reason": failures[pair_id]}]
    return []


def timing_rows(folder: RunFolder, stages: Sequence[Stage], pair_id: str) -> list[Row]:
    """The rows of `timings` of a pair."""
    rows = []
    for record in records_of(folder, stages, [pair_id]):
        job: Row = {
            "pair_id": record.pair_id,
            "side": record.part or None,
            "stage": record.stage,
            "reused": record.made_by != folder.token,
        }
        rows += [job | {"step": step, "seconds": seconds} for step, seconds in record.steps]
    return rows


def parts_of_table(
    name: str, pair_ids: Iterable[str], rows_of: Callable[[str], list[Row]]
) -> Iterator[pa.Table]:
    """A table of the whole run in parts of some pairs each.

    Parameters
    ----------
    rows_of : returns the rows of a pair
    """
    names = sorted(pair_ids)
    for i in range(0, len(names), _PAIRS_AT_ONCE):
        group = names[i : i + _PAIRS_AT_ONCE]
        yield TABLES[name].from_rows(chain.from_iterable(map(rows_of, group)))


def write_table(
    folder: RunFolder, name: str, key: str, rows: pa.Table | Iterable[pa.Table]
) -> pa.Table:
    """Write a table of the whole run, or its parts, unless it exists under its key, and return it."""
    record = folder.ledger.jobs("").get((name, ""))
    if record is None or record.key != key or folder.damaged_files(record):
        folder.write_table(name, rows, key)
    return folder.read_table(name)


def extra_entries(
    folder: RunFolder, stages: Sequence[Stage], settings: Settings, pair_ids: Sequence[str]
) -> dict[str, Any]:
    """Entries of the record about stages that summarise their jobs."""
    extras: dict[str, Any] = {}
    for stage in stages:
        if stage.summarise:
            extras |= stage.summarise(list(records_of(folder, [stage], pair_ids)), settings)
    return extras
