"""The tables of a whole run, pairs and timings, and some entries of its record."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import pyarrow as pa

from ..schemas.columns import Row
from ..schemas.settings import Settings
from ..schemas.tables import TABLES
from ..stages.ground import peaks_note
from .stage import OF_PAIR, Stage
from .storage.folder import RunFolder
from .storage.table_files import JobRecord

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


def write_pairs(
    folder: RunFolder,
    key: str,
    stages: Sequence[Stage],
    pair_ids: Iterable[str],
    failures: Mapping[str, str],
) -> pa.Table:
    """Write the table `pairs`, unless it exists under its key, and return it.

    Its rows are the pairs with current results, and those that failed, now or in an earlier run.

    Parameters
    ----------
    pair_ids : that may have a row
    failures : reasons by pair_id
    """

    def part(names: Sequence[str]) -> pa.Table:
        rows = []
        for pair_id in names:
            row = _scored_row(folder, stages, pair_id)
            if row is None and pair_id in failures:
                row = {"pair_id": pair_id, "status": "failed", "reason": failures[pair_id]}
            if row is not None:
                rows.append(row)
        return TABLES["pairs"].from_rows(rows)

    record = _write_table(folder, "pairs", key, pair_ids, part)
    (name,) = record.files
    return folder.read("pairs", record.files[name], name)


def _scored_row(folder: RunFolder, stages: Sequence[Stage], pair_id: str) -> Row | None:
    """The row of a scored pair; None if a stage that every run has is not done."""
    records = folder.ledger.jobs(pair_id)
    row: Row = {"pair_id": pair_id, "status": "scored"}
    for stage in stages:
        if stage.is_extra:
            continue
        for side in stage.parts:
            if (stage.name, side) not in records:
                return None
            row |= records[stage.name, side].metadata.get(OF_PAIR, {})
    return row


def write_timings(
    folder: RunFolder,
    key: str,
    stages: Sequence[Stage],
    pair_ids: Iterable[str],
) -> None:
    """Write the table `timings`, unless it exists under its key."""

    def part(names: Sequence[str]) -> pa.Table:
        rows = []
        for record in records_of(folder, stages, names):
            job: Row = {
                "pair_id": record.pair_id,
                "side": record.part or None,
                "stage": record.stage,
                "reused": record.made_by != folder.token,
            }
            rows += [job | {"step": step, "seconds": seconds} for step, seconds in record.steps]
        return TABLES["timings"].from_rows(rows)

    _write_table(folder, "timings", key, pair_ids, part)


def _write_table(
    folder: RunFolder,
    name: str,
    key: str,
    pair_ids: Iterable[str],
    part: Callable[[Sequence[str]], pa.Table],
) -> JobRecord:
    """Write a table of the whole run, unless it exists under its key; returns its entry in the ledger.

    Parameters
    ----------
    part : returns the rows of some pairs
    """
    record = folder.ledger.jobs("").get((name, ""))
    if record is None or record.key != key or folder.damaged_files(record):
        path = folder.folder / f"{name}.parquet"
        names = sorted(pair_ids)
        starts = range(0, len(names), _PAIRS_AT_ONCE)
        parts = (part(names[start : start + _PAIRS_AT_ONCE]) for start in starts)
        record = JobRecord(name, "", "", key, {path.name: folder.write_at(path, name, parts, key)})
        folder.ledger.put_job(record)
    return record


def extra_entries(
    folder: RunFolder, stages: Sequence[Stage], settings: Settings, pair_ids: Sequence[str]
) -> dict[str, Any]:
    """Entries of the record about stages that summarise their jobs."""
    extras: dict[str, Any] = {}
    for stage in stages:
        if stage.summarise:
            extras |= stage.summarise(list(records_of(folder, [stage], pair_ids)), settings)
    return extras


def peaks_notes(scored: pa.Table, settings: Settings) -> Iterator[tuple[str, str]]:
    """Name and note of the pairs in which the heights of the ground are doubtful."""
    names = ("pair_id", "ground_real_peak_m", "ground_sim_peak_m")
    for row in scored.select(names).to_pylist():
        pair_id, real_m, sim_m = row.values()
        if note := peaks_note(real_m, sim_m, settings.ground):
            yield pair_id, note
