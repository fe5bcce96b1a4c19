"""A run over a dataset, verb by verb: read, hash, survey, replace, make, write. The page to read first.

The list of stages is in `jobs`, the definition of a stage in `stage`, their computations in the package `stages`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any

import pyarrow as pa

from ..schemas.columns import Row, Table
from ..schemas.errors import DatasetError
from ..schemas.record import FrameSuspect, PairCounts, RunHeader, RunRecord
from ..schemas.results import JsonObject
from ..schemas.settings import Settings, preset_of
from ..schemas.tables import TABLES
from ..stages.ground import peaks_note
from .datasets.content import input_hashes
from .datasets.pairing import require_partners
from .datasets.pairs import Dataset, ScanPair, read_dataset
from .engine.engine import Machines, RunEngine, Survey
from .engine.plan import PairPlan, Planner, with_results
from .engine.progress import Reporter
from .jobs import stages_under
from .pair_checks import frame_suspect, inspection_of, pair_warnings, shared_files, swapped_sides
from .results.overview import cautions, describe_objects
from .stage import OF_PAIR, Stage
from .storage.files import key_of
from .storage.folder import RunFolder, check_folder
from .storage.run_record import (
    StageSeconds,
    last_results,
    library_versions,
    read_run,
    replaced_results,
    run_header,
    summarise_pairs,
    what_changed,
    write_record,
)
from .storage.table_files import JobRecord

_MOST_ALIKE = 10  # warnings of a kind that are written out
_PEAKS = ("ground_real_peak_m", "ground_sim_peak_m")


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of a run.

    pairs : the table `pairs`
    record : content of `run.json`
    n_made, n_reused : jobs
    failed_extras : by scored pair, the reason why a baseline or another extra failed
    reported_failures : pairs whose failure was reported, not only known from an earlier run
    """

    folder: Path
    pairs: pa.Table
    record: RunRecord
    n_made: int
    n_reused: int
    failed_extras: dict[str, str]
    reported_failures: frozenset[str] = frozenset()

    @property
    def rows(self) -> list[Row]:
        """The rows of `pairs`."""
        rows: list[Row] = self.pairs.to_pylist()
        return rows

    @property
    def failures(self) -> dict[str, str]:
        """Reason of each failed pair, and of each scored pair with a failed extra."""
        rows = self.pairs.select(["pair_id", "status", "reason"]).to_pylist()
        return {row["pair_id"]: row["reason"] for row in rows if row["status"] == "failed"} | self.failed_extras

    def as_dict(self) -> JsonObject:
        """Plain values for JSON: those of `fidpipe show --json`, with the number of jobs and the failures."""
        return {
            "folder": str(self.folder),
            "record": self.record.as_dict(),
            "pairs": [*self.rows],
            "jobs": {"made": self.n_made, "reused": self.n_reused},
            "failures": {**self.failures},
        }


def run_dataset(
    dataset: Path,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    *,
    from_stage: str | None = None,
    pattern: str | None = None,
    machines: Machines | None = None,
    stages: tuple[Stage, ...] | None = None,
    replace: bool = False,
) -> RunOutcome:
    """Evaluate a dataset: compute every table that does not exist yet under its key.

    Parameters
    ----------
    dataset, out : folders of the dataset and of the run
    settings : of all stages
    from_stage : recompute this stage and those after it
    pattern : only pairs whose name matches are worked on (shell style)
    machines : where work is done
    stages : by default those of the pipeline under these settings
    replace : whether results of a finished run may be replaced because settings differ

    Raises
    ------
    FidpipeError
        The dataset as a whole, a setting or the run's folder is invalid; before any work.
    KeyboardInterrupt
        As it came; the same command resumes the run.
    """
    machines = machines or Machines()
    if machines.scheduler:  # its workers may run in other folders
        dataset, out = dataset.absolute(), out.absolute()
    content = read_dataset(dataset)
    require_partners(content)
    selected = select_pairs(content, pattern)
    check_folder(out, dataset)
    folder = RunFolder(out)
    stages = stages_under(settings) if stages is None else stages
    with folder.locked(), RunEngine(folder, settings, machines, reporter, stages) as engine:
        run = _Run(content, stages, engine, from_stage)
        run.hash_files(selected)
        survey = run.survey(selected)
        if not (replace or from_stage):
            engine.refuse_replacing(survey, f"run {out}", run.before)
        with engine.making(survey, run.plan, run.begin, run.changes) as schedule:
            schedule.run()
        return run.write(survey)


def select_pairs(dataset: Dataset, pattern: str | None) -> tuple[ScanPair, ...]:
    """The pairs whose name matches; all without a pattern.

    Raises
    ------
    DatasetError
        No name matches.
    """
    if pattern is None:
        return dataset.pairs
    selected = tuple(pair for pair in dataset.pairs if fnmatchcase(pair.pair_id, pattern))
    if not selected:
        names = ", ".join(pair.pair_id for pair in dataset.pairs[:5])
        raise DatasetError(f"--pairs {pattern!r} matches none of the {len(dataset.pairs)} pairs ({names} ...)")
    return selected


@dataclass
class _JobSummary:
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
        if suspect := frame_suspect(frames):
            self.suspects[pair.pair_id] = suspect
        for job in records:
            self.seconds.add(job)
            for note in job.metadata.get("notes", ()):
                self.notes[pair.pair_id].append(f"{job.part} side: {note}")
        self.n_jobs += len(records)
        self.keys[pair.pair_id] = key_of(sorted(job.key for job in records if OF_PAIR in job.metadata))


def few_of_each(warnings: Sequence[str]) -> list[str]:
    """Some warnings of each kind, which is how they end, and the number of the others."""
    kinds: defaultdict[str, list[str]] = defaultdict(list)
    for text in warnings:
        kinds[text.rpartition("; ")[2]].append(text)
    lines = []
    for alike in kinds.values():
        lines += alike[:_MOST_ALIKE]
        if n_more := len(alike[_MOST_ALIKE:]):
            lines.append(f"{n_more} more like that; fidpipe check lists them")
    return lines


class _Run:
    """One run while it works."""

    def __init__(
        self,
        dataset: Dataset,
        stages: tuple[Stage, ...],
        engine: RunEngine,
        from_stage: str | None,
    ) -> None:
        self._dataset, self._stages, self._engine = dataset, stages, engine
        self._from_stage = from_stage
        self._folder, self._reporter, self._settings = engine.folder, engine.reporter, engine.settings
        self._out = engine.folder.folder
        self._planner = Planner(stages, self._settings, dataset.label_names)
        self._versions = {stage.name: stage.version for stage in stages}
        self._jobs = _JobSummary()
        self._wall_s: dict[str, float] = {}
        self._start = self._phase_start = perf_counter()
        self.before = read_run(self._out)
        self.changes = what_changed(self.before, self._settings, self._versions)
        self._last = last_results(self.before)

    def hash_files(self, selected: Iterable[ScanPair]) -> None:
        """Hash the files of the selected pairs and of those with results."""
        ledger = self._folder.ledger
        names = {pair.pair_id for pair in selected} | set(ledger.pair_ids()) | set(ledger.failed_pairs())
        pairs = [pair for pair in self._dataset.pairs if pair.pair_id in names]
        self._reporter.warn(*self._dataset.warnings)
        self._engine.hash_files(pairs)
        self._reporter.warn(*few_of_each(swapped_sides(pairs, self._dataset.folder)))
        self._hashes = {
            pair.pair_id: input_hashes(pair, self._dataset.label_names, self._engine.contents[pair.pair_id])
            for pair in self._dataset.pairs
            if pair.pair_id in self._engine.contents
        }
        self._end_phase("inspect")

    def survey(self, selected: Iterable[ScanPair]) -> Survey:
        """Find pairs with jobs to do, and results that are stale."""
        names, first = list(self._versions), self._from_stage
        redo = frozenset(names[names.index(first) :]) if first else frozenset[str]()
        chosen = {pair.pair_id for pair in selected}

        def complete(plan: PairPlan) -> None:
            self._jobs.add(plan.pair, list(plan.records.values()))

        return self._engine.survey(self._dataset.pairs, self.plan, selected=chosen, redo=redo, complete=complete)

    def begin(self) -> None:
        """Replace a finished record by the header of this run."""
        self._write_record(self._header())

    def write(self, survey: Survey) -> RunOutcome:
        """Write the tables of the whole run and its record."""
        self._end_phase("stages")
        jobs, pair_ids = self._summarise_jobs(survey.usable), [pair.pair_id for pair in survey.usable]
        times_s = {pair.pair_id: pair.timestamp_s for pair in self._dataset.pairs}
        key = key_of(library_versions(["fidpipe"]), sorted(jobs.keys.items()), self._engine.failures, times_s)
        before = self._folder.ledger.jobs("").get(("pairs", ""))
        is_same = before is not None and before.key == key
        header = self._header(is_same=is_same)
        if not is_same:
            self._write_record(header)
        pairs = self._write_table(TABLES["pairs"], key, self._pair_parts(survey))
        made_by = self._folder.token if self._engine.n_made else ""  # where nothing was made, all rows are reused
        self._write_table(TABLES["timings"], key_of(key, list(self._versions), made_by), self._timing_parts(pair_ids))
        self._end_phase("tables")
        self._wall_s["total"] = perf_counter() - self._start
        n_to_do = len({pair.pair_id for pair in self._dataset.pairs}) - pairs.num_rows
        is_scored = [status == "scored" for status in pairs["status"].to_pylist()]
        scored = pairs if all(is_scored) else pairs.filter(is_scored)  # which is a copy
        scored_ids, *peaks_m = (scored[name].to_pylist() for name in ("pair_id", *_PEAKS))
        for pair_id, real_m, sim_m in zip(scored_ids, *peaks_m, strict=True):
            if note := peaks_note(real_m, sim_m, self._settings.ground):
                jobs.notes[pair_id].append(note)
        last, by_reference = self._last, preset_of(self._settings) == "reference"
        if not (is_same and last and last.overview and last.metrics):
            of_objects = describe_objects(self._folder, scored, times_s, self._hashes, by_reference=by_reference)
        else:
            of_objects = last.findings, last.overview, last.metrics
        findings, overview, metrics = of_objects
        extras: dict[str, Any] = {}
        for stage in self._stages:
            if stage.summarise:
                own = [record for record in self._records(scored_ids) if record.stage == stage.name]
                extras |= stage.summarise(own, self._settings)
        record = RunRecord(
            **dict(header),
            workers=self._engine.n_workers,
            wall_s=self._wall_s,
            pairs=PairCounts(scored=len(scored), failed=len(pairs) - len(scored), to_do=n_to_do),
            summary=summarise_pairs(scored),
            findings=findings,
            metrics=metrics,
            seconds=jobs.seconds.result(),
            inputs=dict(sorted(self._hashes.items())),
            times_s={name: time_s for name in scored_ids if (time_s := times_s[name]) is not None},
            frames=dict(sorted(jobs.suspects.items())),
            notes=dict(sorted(jobs.notes.items())),
            **extras,
        )
        if overview:
            trust = tuple(cautions(overview, record))
            record = record.model_copy(update={"overview": overview.model_copy(update={"trust": trust})})
        self._write_record(record)
        known = set(scored_ids)
        failed_extras = {pair_id: reason for pair_id, reason in self._engine.failures.items() if pair_id in known}
        n_made, reported = self._engine.n_made, frozenset(self._engine.failures)
        return RunOutcome(self._out, pairs, record, n_made, jobs.n_jobs - n_made, failed_extras, reported)

    def _summarise_jobs(self, pairs: Iterable[ScanPair]) -> _JobSummary:
        """Summarise the current jobs of the pairs, and report what inspection found."""
        jobs = self._jobs
        for pair in pairs:
            if pair.pair_id not in jobs.keys and (records := list(self._records([pair.pair_id]))):
                jobs.add(pair, records)
        names = [pair.pair_id for pair in pairs if pair.pair_id in jobs.keys]
        hashes = {name: self._hashes[name] for name in names}
        self._reporter.warn(
            *few_of_each([*shared_files(hashes), *(text for name in names for text in jobs.warnings.pop(name))])
        )
        return jobs

    def _write_record(self, record: RunHeader) -> None:
        """Write the settings and the record, or its header."""
        write_record(self._out, self._settings, record.entries(), self._folder.check_token)

    def plan(self, pair: ScanPair) -> PairPlan:
        """The jobs of a pair under the current settings."""
        return self._planner.plan(pair, self._engine.contents[pair.pair_id])

    def _header(self, *, is_same: bool = False) -> RunHeader:
        """Content of `run.json` from the start; identical results do not count as a replacement."""
        previous = replaced_results(self.before, self._last, is_same=is_same)
        return run_header(self._dataset.folder, self._settings, self._versions, previous)

    def _records(self, pair_ids: Iterable[str]) -> Iterator[JobRecord]:
        """The current jobs of some pairs."""
        for pair_id in pair_ids:
            yield from (own for own in self._folder.ledger.jobs(pair_id).values() if own.stage in self._versions)

    def _write_table(self, table: Table, key: str, parts: Iterator[pa.Table]) -> pa.Table:
        """Write a table of the whole run, unless it exists under its key. Returns `pairs`."""
        path = self._out / f"{table.name}.parquet"
        before = self._folder.ledger.jobs("").get((table.name, ""))
        if before is None or before.key != key or self._folder.damaged_files(before):
            stored = self._folder.write_at(path, table.name, parts, key)
            before = JobRecord(table.name, "", "", key, {path.name: stored})
            self._folder.ledger.put_job(before)
        return self._folder.read(table.name, before.files[path.name], path.name) if table.name == "pairs" else None

    def _pair_parts(self, survey: Survey) -> Iterator[pa.Table]:
        """The rows of `pairs`, some pairs at a time: those with current results, and those that failed."""
        failures = self._engine.failures
        usable = {pair.pair_id: pair for pair in survey.usable}
        for names in _chunks(sorted(usable.keys() | failures.keys())):
            rows = []
            for pair_id in names:
                row = self._row(pair_id) if pair_id in usable else None
                reason = None if row else failures.get(pair_id) or self._past_failure(usable.get(pair_id))
                if row or reason:
                    rows.append(row or {"pair_id": pair_id, "status": "failed", "reason": reason})
            yield TABLES["pairs"].from_rows(rows)

    def _row(self, pair_id: str) -> Row | None:
        """The row of a scored pair; None if a stage that every run has is not done."""
        records = self._folder.ledger.jobs(pair_id)
        required = [(stage.name, part) for stage in self._stages if not stage.is_extra for part in stage.parts]
        if not all(name in records for name in required):
            return None
        row: Row = {"pair_id": pair_id, "status": "scored"}
        for name in required:
            row |= records[name].metadata.get(OF_PAIR, {})
        return row

    def _past_failure(self, pair: ScanPair | None) -> str | None:
        """Reason of a failure in an earlier run, if the same job is still to do; else None."""
        if pair is None:
            return None
        plan, _ = with_results(self.plan(pair), self._folder)
        return self._folder.ledger.failure(pair.pair_id, [plan.keys[job.name] for job in plan.todo])

    def _timing_parts(self, pair_ids: Iterable[str]) -> Iterator[pa.Table]:
        """The rows of `timings`, some pairs at a time."""
        for names in _chunks(sorted(pair_ids), 100):
            rows = [
                (record.pair_id, record.part or None, record.stage, step, seconds, record.made_by != self._folder.token)
                for record in self._records(names)
                for step, seconds in record.steps
            ]
            columns = zip(*rows, strict=True) if rows else [()] * 6
            by_name = zip(("pair_id", "side", "stage", "step", "seconds", "reused"), columns, strict=True)
            table = TABLES["timings"].build(dict(by_name))
            yield table.sort_by([(key, "ascending") for key in TABLES["timings"].keys])

    def _end_phase(self, name: str) -> None:
        now = perf_counter()
        self._wall_s[name] = now - self._phase_start
        self._phase_start = now


def _chunks(names: Iterable[str], n_names: int = 500) -> Iterator[list[str]]:
    """Some names at a time."""
    left = iter(names)
    while chunk := list(islice(left, n_names)):
        yield chunk
