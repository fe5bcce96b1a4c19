"""What a run does, verb by verb: inspect the files, plan the jobs, clear what is out of date, work, write.

Leaves to others: which stages there are (`run`), the order of tasks (`schedule`), keys (`plan`), files (`store`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from time import perf_counter
from typing import Any

from ..schemas.columns import SIDES
from ..schemas.settings import to_toml
from ..schemas.tables import PAIRS, TIMINGS
from .fanout import start_pool
from .findings import run_findings
from .index import JobName, JobRecord
from .inspection import Inspection
from .intake import ScanContent, input_hashes
from .plan import Stage, library_versions, plan_pair, with_whole_results
from .pool import InProcess, Pool
from .progress import Reporter
from .readers.dataset import Dataset, ScanPair
from .record import (
    DATASET_VALUES,
    LIBRARIES,
    RUN_JSON,
    SETTINGS_TOML,
    StageSeconds,
    dumps,
    json_parts,
    read_run,
    run_header,
    run_record,
    summarise_pairs,
    timing_rows,
    what_changed,
)
from .request import RunOutcome, RunRequest
from .schedule import Schedule
from .store import Store, key_of
from .task import Failure, PairTask, Report

#: Of the record of the last run, what is needed of it.
_KEPT_OF_BEFORE = ("settings", "libraries", "stages", "findings")
_FEW_PAIRS = 16  # whose files are read in this process


class Session:
    """One run over a dataset, verb by verb."""

    def __init__(
        self,
        request: RunRequest,
        stages: tuple[Stage, ...],
        dataset: Dataset,
        selected: Iterable[ScanPair],
        store: Store,
        reporter: Reporter,
    ) -> None:
        self.request = request
        self.stages = stages
        self.stage_names = tuple(stage.name for stage in stages)
        self.extras = {stage.name for stage in stages if stage.is_wanted}
        self.dataset = dataset
        self.store = store
        self.reporter = reporter
        self.settings = request.settings
        self.selected = {pair.pair_id for pair in selected}
        self.contents: dict[str, dict[str, ScanContent]] = {}
        self.usable: dict[str, ScanPair] = {}
        self.todo: list[ScanPair] = []
        self.failures: dict[str, str] = {}
        self.unwanted: dict[JobName, str] = {}
        self.made: set[JobName] = set()
        self.wall_s: dict[str, float] = {}
        self.before = {name: of for name, of in read_run(request.out).items() if name in _KEPT_OF_BEFORE}
        self._redo = frozenset[str]()
        if request.from_stage:
            self._redo = frozenset(self.stage_names[self.stage_names.index(request.from_stage) :])
        self._n_stored = Counter[str]()
        self._traces: set[str] = set()
        self._start = self._phase_start = perf_counter()
        self._pool: Pool | None = None

    def inspect(self, *, note: bool = True) -> None:
        """Reads every file once that is not known yet, and names every fault; with `note` the run remembers it."""
        known = {pair_id for _, pair_id, _ in self.store.records} | set(self.store.failures)
        wanted = self.selected | known
        pairs = [pair for pair in self.dataset.pairs if pair.pair_id in wanted]
        inspection = Inspection(pairs, self.settings.input, self.dataset.label_names, self.store)
        pool = self.pool if len(inspection.unknown) > _FEW_PAIRS else InProcess()
        inspection.read(pool, note=note)
        if pool is not self._pool:
            pool.close()
        self.contents = inspection.contents
        for text in self.dataset.warnings:
            self.reporter.warn(text)
        for pair_id in (pair.pair_id for pair in pairs):
            if fault := inspection.faults.get(pair_id):
                self.failures[pair_id] = fault
                self.reporter.fail(pair_id, fault)
                if note:
                    self.store.note_failure(pair_id, {"key": "input", "reason": fault})
            for text in inspection.warnings.get(pair_id, ()):
                self.reporter.warn(f"pair {pair_id}: {text}")
        self._end_phase("inspect")

    def plan(self) -> None:
        """Finds which pairs have jobs to be made, and which results are not those that are wanted."""
        for pair in self.dataset.pairs:
            if pair.pair_id not in self.contents or pair.pair_id in self.failures:
                continue
            self.usable[pair.pair_id] = pair
            n_stored = Counter[str]()
            if any(name in self.store.records for name in self._names(pair.pair_id)):
                task, unwanted = self._planned(pair)
                self.unwanted |= unwanted
                n_stored = Counter(job.stage for job in task.jobs if job.stored)
            if pair.pair_id in self.selected and n_stored.total() < len(self._names(pair.pair_id)):
                self.todo.append(pair)
                self._n_stored += n_stored
        dataset_ids = {pair.pair_id for pair in self.dataset.pairs}
        for name in self.store.records:
            stage, pair_id, _ = name
            if not pair_id:
                continue  # a table of the whole run
            if pair_id not in dataset_ids:
                self.unwanted[name] = "no longer in the dataset"
            elif pair_id in self.failures:
                self.unwanted[name] = "the input cannot be used"
            elif stage not in self.stage_names and not self._still_holds(name):
                self.unwanted[name] = "out of date"

    def clear(self) -> None:
        """Says what will be replaced and why, and removes it."""
        reasons: dict[str, list[JobName]] = {}
        for name, why in self.unwanted.items():
            reasons.setdefault(why, []).append(name)
        for why, names in reasons.items():
            reason = why
            count = Counter(stage for stage, _, _ in names)
            stages = ", ".join(stage for stage in dict.fromkeys((*self.stage_names, *count)) if stage in count)
            n_pairs = len({pair_id for _, pair_id, _ in names})
            if reason == "out of date":
                changes = what_changed(self.before, self.settings, self.stages)
                reason += f" ({'; '.join(changes) or 'the input files changed'})"
            self.reporter.say(f"replacing {stages} of {n_pairs} pair{'s' * (n_pairs > 1)}: {reason}")
            for name in names:
                self.store.forget(self.store.records[name])
        self.unwanted.clear()
        for path in self.store.strays([table for stage in self.stages for table in stage.gives]):
            path.unlink()
        self.store.compact()
        self.store.replace(self.request.out / SETTINGS_TOML, to_toml(self.settings).encode())
        self.store.replace(
            self.request.out / RUN_JSON, dumps(run_header(self.request.dataset, self.settings, self.stages))
        )

    def work(self) -> None:
        """Makes what is not there."""
        if self.todo:
            names = [pair.pair_id for pair in self.todo]
            n_raw = {pair_id: sum(of.n_raw for of in self.contents[pair_id].values()) for pair_id in names}
            n_jobs = {of.name: (len(of.sides) * len(names), self._n_stored[of.name]) for of in self.stages}
            tasks = (self._planned(pair)[0] for pair in self.todo)
            pool = self.pool
            self.reporter.start(n_raw, n_jobs)
            try:
                Schedule(pool, tasks, n_raw, self._take, self.reporter.objects_done, self._end_pair).run()
            finally:
                self.reporter.stop()
        self._end_phase("stages")

    def write(self) -> RunOutcome:
        """Writes the tables of the whole run and its record."""
        pairs = PAIRS.from_rows(self.rows())
        key = key_of([record.key for record in self.current_records("metrics")], self.failures)
        table = self.store.write_at(self.request.out / "pairs.parquet", "pairs", pairs, key)
        self.store.take(JobRecord("pairs", "", "", key, {"pairs.parquet": table}))
        seconds = StageSeconds()
        timings = TIMINGS.from_rows(timing_rows(seconds.count(self.current_records()), self.made))
        self.store.write_at(self.request.out / "timings.parquet", "timings", timings, key)
        self._end_phase("tables")
        self.wall_s["total"] = perf_counter() - self._start
        hashes = {
            pair.pair_id: input_hashes(pair, self.dataset.label_names, self.contents[pair.pair_id])
            for pair in self.dataset.pairs
            if pair.pair_id in self.contents
        }
        n_workers = self._pool.n_workers if self._pool else 0
        header = run_header(self.request.dataset, self.settings, self.stages)
        n_to_do = len({pair.pair_id for pair in self.dataset.pairs}) - pairs.num_rows
        rows = pairs.select(["pair_id", "status", *DATASET_VALUES]).to_pylist()
        scored = [row for row in rows if row["status"] == "scored"]
        findings = self._findings(scored, key)
        record = run_record(header, hashes, rows, self.wall_s, n_workers, seconds.as_dict(), findings, n_to_do)
        for stage in self.stages:
            if stage.summarise:
                record[stage.name] = stage.summarise(list(self.current_records(stage.name)), self.settings)
        self.store.replace_by(self.request.out / RUN_JSON, json_parts(record))
        self.store.compact()
        n_reused = sum(1 for _ in self._current()) - len(self.made)
        scored_ids = {row["pair_id"] for row in scored}
        failed_extras = {pair_id: reason for pair_id, reason in self.failures.items() if pair_id in scored_ids}
        return RunOutcome(self.request.out, pairs, record, len(self.made), n_reused, failed_extras)

    def _findings(self, scored: list[dict[str, Any]], key: str) -> dict[str, Any]:
        times = {pair.pair_id: pair.timestamp_s for pair in self.dataset.pairs}
        before = self.before.get("findings", {})
        return run_findings(self.store, [row["pair_id"] for row in scored], times, summarise_pairs(scored), key, before)

    def close(self) -> None:
        """Ends the pool, whatever it is doing."""
        if self._pool is not None:
            self._pool.close(now=True)

    @property
    def pool(self) -> Pool:
        """Where tasks run; started when first needed."""
        if self._pool is None:
            self._pool = start_pool(
                self.request.workers,
                self.request.scheduler,
                self.settings.machine.memory_gib,
                self.store.token_path,
                library_versions(LIBRARIES),
            )
        return self._pool

    def task(self, pair_id: str) -> PairTask | None:
        """The jobs of a pair, those done and those not; None if its files cannot be used."""
        return self._planned(self.usable[pair_id])[0] if pair_id in self.usable else None

    def current_records(self, stage: str | None = None) -> Iterator[JobRecord]:
        """The finished jobs whose results are as wanted; all, or those of one stage."""
        return (self.store.records[name] for name in self._current() if stage in (None, name[0]))

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows of `pairs`: every pair with current results, and every pair that failed."""
        open_ids = []
        for pair_id in self.usable:
            names = [name for name in self._names(pair_id) if name[0] not in self.extras]
            if all(self._is_current(name) for name in names):
                yield self.store.records[names[-1]].facts["row"]
            elif pair_id not in self.failures:
                open_ids.append(pair_id)
            else:
                yield _failed_row(pair_id, self.failures[pair_id])
        for pair_id in self.failures.keys() - self.usable.keys():
            yield _failed_row(pair_id, self.failures[pair_id])
        for pair_id in open_ids:
            past, task = self.store.failures.get(pair_id), self.task(pair_id)
            if past and task and any(past["key"] == job.key for job in task.jobs if not job.stored):
                yield _failed_row(pair_id, past["reason"])

    def _names(self, pair_id: str) -> list[JobName]:
        """What the jobs of a pair are called, in their order."""
        return [(stage.name, pair_id, side) for stage in self.stages for side in stage.sides]

    def _is_current(self, name: JobName) -> bool:
        return name in self.store.records and name not in self.unwanted

    def _current(self) -> Iterator[JobName]:
        return (name for pair_id in self.usable for name in self._names(pair_id) if self._is_current(name))

    def _planned(self, pair: ScanPair) -> tuple[PairTask, dict[JobName, str]]:
        """The jobs of a pair with their wanted keys, and why results that are there are not those."""
        contents = self.contents[pair.pair_id]
        inputs = {side: contents[side].key(self.dataset.label_names) for side in SIDES}
        task = replace(
            plan_pair(self.stages, pair, inputs, self.settings),
            label_names=self.dataset.label_names,
            input_hashes={side: of.sha256 for side, of in contents.items()},
            folder=self.request.out,
            token=self.store.token,
        )
        return with_whole_results(task, self.store, self._redo if pair.pair_id in self.selected else frozenset())

    def _take(self, report: Report) -> None:
        self.made.update(self.store.take(record) for record in report.records)
        self.reporter.jobs_done(report.records)

    def _end_pair(self, pair_id: str, failure: Failure | None) -> None:
        self.reporter.pair_done(pair_id)
        if failure is None:
            self.store.drop_failure(pair_id)
            return
        where = f"stage {failure.stage}{', ' + failure.side if failure.side else ''}"
        self.failures[pair_id] = f"{where}: {failure.reason}"
        task, _ = self._planned(self.usable[pair_id])
        job = next(job for job in task.jobs if (job.stage, job.side) == (failure.stage, failure.side))
        self.store.note_failure(pair_id, {"key": job.key, "reason": self.failures[pair_id]})
        self.reporter.fail(pair_id, self.failures[pair_id])
        if failure.trace and failure.trace not in self._traces:
            self._traces.add(failure.trace)
            self.reporter.say(failure.trace)

    def _still_holds(self, name: JobName) -> bool:
        """Whether the result of an extra that is not asked for this time is of the current results."""
        task = self.task(name[1])
        return task is not None and self.store.records[name].facts.get("made_from") in {job.key for job in task.jobs}

    def _end_phase(self, name: str) -> None:
        now = perf_counter()
        self.wall_s[name] = now - self._phase_start
        self._phase_start = now


def _failed_row(pair_id: str, reason: str) -> dict[str, Any]:
    return {"pair_id": pair_id, "status": "failed", "reason": reason}
