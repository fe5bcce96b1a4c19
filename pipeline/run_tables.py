"""The tables of a whole run, pairs and timings, and its record."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import pyarrow as pa

from ..schemas.columns import Row
from ..schemas.record import FrameSuspect, PairCounts, RunHeader, RunRecord
from ..schemas.settings import Settings, preset_of
from ..schemas.tables import TABLES
from ..stages.ground import peaks_note
from .datasets.pairs import ScanPair
from .engine.plan import PairPlan, with_results
from .pair_checks import frame_suspect, inspection_of, pair_warnings
from .results.overview import cautions, describe_objects
from .stage import OF_PAIR, Stage
from .storage.files import key_of
from .storage.folder import RunFolder
from .storage.run_record import StageSeconds, summarise_pairs
from .storage.table_files import JobRecord

_MOST_ALIKE = 10  # warnings of a kind that are written out
_PAIRS_AT_ONCE = 500
_PAIRS_OF_TIMINGS_AT_ONCE = 100
_TIMINGS = ("pair_id", "side", "stage", "step", "seconds", "reused")


@dataclass
class JobSummary:
    """Summary of the current jobs of a run.

    keys : by pair, a hash of the keys that its row of `pairs` depends on
    notes, suspects : see `run_record`; by pair
    warnings : of the inspection, by pair
    """

    seconds: StageSeconds = field(default_factory=StageSeconds)
    keys: dict[str, str] = field(default_factory=dict)
    n_jobs: int = 0
    notes: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    suspects: dict[str, FrameSuspect] = field(default_factory=dict)
    warnings: dict[str, list[str]] = field(default_factory=dict)

    def add(self, pair: ScanPair, records: Sequence[JobRecord]) -> None:
        """Add the jobs of a pair that has any."""
        sides, frames = inspection_of(records)
        self.warnings[pair.pair_id] = pair_warnings(pair, sides, frames)
        suspect = frame_suspect(frames)
        if suspect:
            self.suspects[pair.pair_id] = suspect
        for job in records:
            self.seconds.add(job)
            for note in job.metadata.get("notes", ()):
                self.notes[pair.pair_id].append(f"{job.part} side: {note}")
        self.n_jobs += len(records)
        keys = [job.key for job in records if OF_PAIR in job.metadata]
        self.keys[pair.pair_id] = key_of(sorted(keys))


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
    usable: Iterable[ScanPair],
    failures: Mapping[str, str],
    plan_pair: Callable[[ScanPair], PairPlan],
) -> pa.Table:
    """Write the table `pairs`, unless it exists under its key, and return it.

    Its rows are the pairs with current results, and those that failed, now or in an earlier run.

    Parameters
    ----------
    usable : pairs whose files exist
    failures : reasons by pair_id
    plan_pair : returns the plan of a pair
    """
    pairs = {pair.pair_id: pair for pair in usable}

    def past_failure(pair: ScanPair) -> str | None:
        """Reason of a failure in an earlier run, if the same job is still to do."""
        plan, _ = with_results(plan_pair(pair), folder)
        return folder.ledger.failure(pair.pair_id, [plan.keys[job.name] for job in plan.todo])

    def row_of(pair_id: str) -> Row | None:
        row = _scored_row(folder, stages, pair_id) if pair_id in pairs else None
        if row is not None:
            return row
        reason = failures.get(pair_id)
        if reason is None and pair_id in pairs:
            reason = past_failure(pairs[pair_id])
        if not reason:
            return None
        return {"pair_id": pair_id, "status": "failed", "reason": reason}

    def parts() -> Iterator[pa.Table]:
        for pair_ids in _chunks(sorted(pairs.keys() | failures.keys()), _PAIRS_AT_ONCE):
            rows = [row_of(pair_id) for pair_id in pair_ids]
            yield TABLES["pairs"].from_rows([row for row in rows if row is not None])

    record = _write_table(folder, "pairs", key, parts())
    (name,) = record.files
    return folder.read("pairs", record.files[name], name)


def _scored_row(folder: RunFolder, stages: Sequence[Stage], pair_id: str) -> Row | None:
    """The row of a scored pair; None if a stage that every run has is not done."""
    records = folder.ledger.jobs(pair_id)
    row: Row = {"pair_id": pair_id, "status": "scored"}
    for stage in stages:
        if stage.is_extra:
            continue
        for part in stage.parts:
            if (stage.name, part) not in records:
                return None
            row |= records[stage.name, part].metadata.get(OF_PAIR, {})
    return row


def write_timings(
    folder: RunFolder,
    key: str,
    stages: Sequence[Stage],
    pair_ids: Iterable[str],
) -> None:
    """Write the table `timings`, unless it exists under its key."""
    schema = TABLES["timings"]
    order = [(name, "ascending") for name in schema.keys]

    def parts() -> Iterator[pa.Table]:
        for names in _chunks(sorted(pair_ids), _PAIRS_OF_TIMINGS_AT_ONCE):
            columns: dict[str, list[Any]] = {name: [] for name in _TIMINGS}
            for record in records_of(folder, stages, names):
                is_reused = record.made_by != folder.token
                for step, seconds in record.steps:
                    side = record.part or None
                    row = (record.pair_id, side, record.stage, step, seconds, is_reused)
                    for column, value in zip(columns.values(), row, strict=True):
                        column.append(value)
            yield schema.build(columns).sort_by(order)

    _write_table(folder, "timings", key, parts())


def _write_table(folder: RunFolder, name: str, key: str, parts: Iterator[pa.Table]) -> JobRecord:
    """Write a table of the whole run, unless it exists under its key; returns its entry in the ledger."""
    record = folder.ledger.jobs("").get((name, ""))
    if record is None or record.key != key or folder.damaged_files(record):
        path = folder.folder / f"{name}.parquet"
        record = JobRecord(name, "", "", key, {path.name: folder.write_at(path, name, parts, key)})
        folder.ledger.put_job(record)
    return record


def summarise(
    header: RunHeader,
    pairs: pa.Table,
    folder: RunFolder,
    stages: Sequence[Stage],
    settings: Settings,
    jobs: JobSummary,
    *,
    times_s: Mapping[str, float | None],
    hashes: Mapping[str, dict[str, str]],
    last: RunRecord | None,
    workers: int,
    wall_s: dict[str, float],
) -> RunRecord:
    """The record of a run that has ended.

    Parameters
    ----------
    pairs : the table
    times_s, hashes : of all pairs, by pair_id
    last : record of the same results, whose findings are kept; None if results have changed
    """
    scored = _scored(pairs)
    _add_peaks(scored, jobs, settings)
    described: tuple[Any, Any, Any]
    if last is not None and last.overview and last.metrics:
        described = last.findings, last.overview, last.metrics
    else:
        by_reference = preset_of(settings) == "reference"
        described = describe_objects(folder, scored, times_s, hashes, by_reference=by_reference)
    findings, overview, metrics = described
    scored_ids = scored["pair_id"].to_pylist()
    record = RunRecord(
        **dict(header),
        workers=workers,
        wall_s=wall_s,
        pairs=PairCounts(
            scored=len(scored),
            failed=len(pairs) - len(scored),
            to_do=len(times_s) - len(pairs),
        ),
        summary=summarise_pairs(scored),
        findings=findings,
        metrics=metrics,
        seconds=jobs.seconds.result(),
        inputs=dict(sorted(hashes.items())),
        times_s={name: times_s[name] for name in scored_ids if times_s[name] is not None},
        frames=dict(sorted(jobs.suspects.items())),
        notes=dict(sorted(jobs.notes.items())),
        **_extras(folder, stages, settings, scored_ids),
    )
    if not overview:
        return record
    overview = overview.model_copy(update={"trust": tuple(cautions(overview, record))})
    return record.model_copy(update={"overview": overview})


def _scored(pairs: pa.Table) -> pa.Table:
    """The rows of scored pairs; the table itself, without a copy, if all are."""
    is_scored = [status == "scored" for status in pairs["status"].to_pylist()]
    return pairs if all(is_scored) else pairs.filter(is_scored)


def _extras(
    folder: RunFolder, stages: Sequence[Stage], settings: Settings, pair_ids: Sequence[str]
) -> dict[str, Any]:
    """Entries of the record about stages that summarise their jobs."""
    extras: dict[str, Any] = {}
    for stage in stages:
        if stage.summarise:
            extras |= stage.summarise(list(records_of(folder, [stage], pair_ids)), settings)
    return extras


def _add_peaks(scored: pa.Table, jobs: JobSummary, settings: Settings) -> None:
    """Note the pairs in which the heights of the ground are doubtful."""
    names = ("pair_id", "ground_real_peak_m", "ground_sim_peak_m")
    rows = zip(*(scored[name].to_pylist() for name in names), strict=True)
    for pair_id, real_m, sim_m in rows:
        note = peaks_note(real_m, sim_m, settings.ground)
        if note:
            jobs.notes[pair_id].append(note)


def _chunks(names: Iterable[str], n_names: int) -> Iterator[list[str]]:
    """Some names at a time."""
    left = iter(names)
    while chunk := list(islice(left, n_names)):
        yield chunk
