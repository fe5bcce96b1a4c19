"""What a run does, verb by verb: inspect the files, plan the jobs, clear what is out of date, work, write.

Leaves to others: which stages there are (`run`), the order of tasks (`schedule`), keys (`plan`), files (`store`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import pyarrow as pa

from ..schemas.columns import SIDES
from ..schemas.settings import Settings, to_toml
from ..schemas.tables import PAIRS, TIMINGS
from .fanout import InProcess, Pool, start_pool
from .findings import run_findings
from .intake import ScanFacts, input_hashes, input_name, inspect_pairs, pair_warnings, recall_scan
from .plan import Stage, library_versions, plan_pair, with_whole_results
from .progress import Reporter
from .readers.dataset import Dataset, ScanPair
from .record import (
    LIBRARIES,
    RUN_JSON,
    SETTINGS_TOML,
    dumps,
    read_run,
    run_header,
    run_record,
    stage_seconds,
    summarise_pairs,
    timing_rows,
    what_changed,
)
from .schedule import Schedule
from .store import JobName, JobRecord, Store, key_of
from .task import Failure, PairTask, Report


@dataclass(frozen=True)
class RunRequest:
    """What the user asked for.

    dataset, out : folders
    workers : processes on this machine; None for one a core; 1 for none besides this one
    scheduler : address of a dask scheduler, instead of a cluster on this machine
    from_stage : this stage and those after it are made again
    pattern : only pairs whose name matches are worked on (shell style)
    """

    dataset: Path
    out: Path
    settings: Settings
    workers: int | None = None
    scheduler: str | None = None
    from_stage: str | None = None
    pattern: str | None = None


@dataclass(frozen=True)
class RunOutcome:
    """What has become of a run.

    rows : of `pairs`
    record : what `run.json` holds
    n_made, n_reused : jobs
    failed_extras : why a baseline or the like failed of a pair that is scored
    """

    folder: Path
    rows: list[dict[str, Any]]
    record: dict[str, Any]
    n_made: int
    n_reused: int
    failed_extras: dict[str, str]

    @property
    def failures(self) -> dict[str, str]:
        """Why each failed pair failed, or what was asked for besides its scores."""
        failed = {row["pair_id"]: row["reason"] for row in self.rows if row["status"] == "failed"}
        return failed | self.failed_extras


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
        self.facts: dict[str, dict[str, ScanFacts]] = {}
        self.tasks: dict[str, PairTask] = {}
        self.failures: dict[str, str] = {}
        self.unwanted: list[tuple[str, JobRecord]] = []
        self.made: set[JobName] = set()
        self._traces: set[str] = set()
        self.before = read_run(request.out)
        self.wall_s: dict[str, float] = {}
        self._start = self._phase_start = perf_counter()
        self._pool: Pool | None = None

    def inspect(self, *, note: bool = True) -> None:
        """Reads every file once that is not known yet, and names every fault; with `note` the run remembers it."""
        known = {pair_id for _, pair_id, _ in self.store.records} | self.store.failures.keys()
        wanted = self.selected | known
        pairs = [pair for pair in self.dataset.pairs if pair.pair_id in wanted]
        unknown = [pair for pair in pairs if not self._recall(pair)]
        chunk = max(1, min(32, len(unknown) // 8))
        chunks = [unknown[i : i + chunk] for i in range(0, len(unknown), chunk)]
        pool = self.pool if len(unknown) > 16 else InProcess()
        handles = {
            pool.submit(inspect_pairs, chunk, self.settings.input, self.dataset.label_names): chunk for chunk in chunks
        }
        while handles:
            handle, found = pool.next_done()
            for pair, facts in zip(handles.pop(handle), found, strict=True):
                self.facts[pair.pair_id] = facts
                for side, of in facts.items() if note else ():
                    self.store.note_input(input_name(pair, side), of.as_dict())
        if pool is not self._pool:
            pool.close()
        for text in self.dataset.warnings:
            self.reporter.warn(text)
        for pair in pairs:
            self._judge(pair)
            if note and pair.pair_id in self.failures:
                self.store.note_failure(pair.pair_id, {"key": "input", "reason": self.failures[pair.pair_id]})
        self._end_phase("inspect")

    def plan(self) -> None:
        """Finds the wanted key of every job, and which results are there under it."""
        redo = (
            frozenset(self.stage_names[self.stage_names.index(self.request.from_stage) :])
            if self.request.from_stage
            else frozenset()
        )
        for pair in self.dataset.pairs:
            facts = self.facts.get(pair.pair_id)
            if facts is None or pair.pair_id in self.failures:
                continue
            inputs = {side: facts[side].content_key(self.dataset.label_names) for side in SIDES}
            task = replace(
                plan_pair(self.stages, pair, inputs, self.settings),
                label_names=self.dataset.label_names,
                input_hashes={side: of.sha256 for side, of in facts.items()},
                folder=self.request.out,
                token=self.store.token,
            )
            task, unwanted = with_whole_results(
                task, self.store, redo if pair.pair_id in self.selected else frozenset()
            )
            self.tasks[pair.pair_id] = task
            self.unwanted += [(reason, record) for reason, records in unwanted.items() for record in records]
        dataset_ids = {pair.pair_id for pair in self.dataset.pairs}
        for record in self.store.records.values():
            if not record.pair_id:
                continue  # a table of the whole run
            if record.pair_id not in dataset_ids:
                self.unwanted.append(("no longer in the dataset", record))
            elif record.pair_id in self.failures:
                self.unwanted.append(("the input cannot be used", record))
            elif record.stage not in self.stage_names and not self._still_holds(record):
                self.unwanted.append(("out of date", record))

    def clear(self) -> None:
        """Says what will be replaced and why, and removes it."""
        reasons: dict[str, list[JobRecord]] = {}
        for reason, record in self.unwanted:
            reasons.setdefault(reason, []).append(record)
        for why, records in reasons.items():
            reason = why
            count = Counter(record.stage for record in records)
            stages = ", ".join(stage for stage in dict.fromkeys((*self.stage_names, *count)) if stage in count)
            n_pairs = len({record.pair_id for record in records})
            if reason == "out of date":
                changes = what_changed(self.before, self.settings, self.stages)
                reason += f" ({'; '.join(changes) or 'the input files changed'})"
            self.reporter.say(f"replacing {stages} of {n_pairs} pair{'s' * (n_pairs > 1)}: {reason}")
            for record in records:
                self.store.forget(record)
        for path in self.store.strays([table for stage in self.stages for table in stage.gives]):
            path.unlink()
        self.store.compact()
        self.store.replace(self.request.out / SETTINGS_TOML, to_toml(self.settings).encode())
        self.store.replace(
            self.request.out / RUN_JSON, dumps(run_header(self.request.dataset, self.settings, self.stages))
        )

    def work(self) -> None:
        """Makes what is not there."""
        todo = [
            task
            for pair_id, task in self.tasks.items()
            if pair_id in self.selected and any(not job.stored for job in task.jobs)
        ]
        if todo:
            names = [task.pair.pair_id for task in todo]
            n_raw = {pair_id: sum(of.n_raw for of in self.facts[pair_id].values()) for pair_id in names}
            n_all = Counter(job.stage for task in todo for job in task.jobs)
            n_done = Counter(job.stage for task in todo for job in task.jobs if job.stored)
            n_jobs = {name: (n_all[name], n_done[name]) for name in self.stage_names}
            pool = self.pool
            self.reporter.start(n_raw, n_jobs)
            try:
                Schedule(pool, todo, n_raw, self._take, self.reporter.objects_done, self._end_pair).run()
            finally:
                self.reporter.stop()
        self._end_phase("stages")

    def write(self) -> RunOutcome:
        """Writes the tables of the whole run and its record."""
        rows = PAIRS.from_rows(self.rows())
        key = key_of([record.key for record in self.current_records() if record.stage == "metrics"], self.failures)
        table = self.store.write_at(self.request.out / "pairs.parquet", "pairs", rows, key)
        self.store.take(JobRecord("pairs", "", "", key, {"pairs.parquet": table}))
        timings = TIMINGS.from_rows(timing_rows(self.current_records(), self.made))
        self.store.write_at(self.request.out / "timings.parquet", "timings", timings, key)
        self._end_phase("tables")
        self.wall_s["total"] = perf_counter() - self._start
        hashes = {
            pair.pair_id: input_hashes(pair, self.dataset.label_names, self.facts[pair.pair_id])
            for pair in self.dataset.pairs
            if pair.pair_id in self.facts and not any(of.fault for of in self.facts[pair.pair_id].values())
        }
        n_workers = self._pool.n_workers if self._pool else 0
        header = run_header(self.request.dataset, self.settings, self.stages)
        n_to_do = len({pair.pair_id for pair in self.dataset.pairs}) - rows.num_rows
        seconds = stage_seconds(self.current_records())
        record = run_record(
            header, hashes, rows.to_pylist(), self.wall_s, n_workers, seconds, self._findings(rows, key), n_to_do
        )
        for stage in self.stages:
            if stage.summarise:
                own = [of for of in self.current_records() if of.stage == stage.name]
                record[stage.name] = stage.summarise(own, self.settings)
        self.store.replace(self.request.out / RUN_JSON, dumps(record))
        self.store.compact()
        n_reused = len(self.current_records()) - len(self.made)
        scored = {row["pair_id"] for row in rows.to_pylist() if row["status"] == "scored"}
        failed_extras = {pair_id: reason for pair_id, reason in self.failures.items() if pair_id in scored}
        return RunOutcome(self.request.out, rows.to_pylist(), record, len(self.made), n_reused, failed_extras)

    def _findings(self, rows: pa.Table, key: str) -> dict[str, Any]:
        scored = [row for row in rows.to_pylist() if row["status"] == "scored"]
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

    def _recall(self, pair: ScanPair) -> bool:
        """Whether the facts of a pair's files are known from the last run and still hold."""
        facts = {}
        for side in SIDES:
            if pair.path(side) is None:
                continue
            known = recall_scan(self.store.inputs, pair, side, self.settings.input)
            if known is None:
                return False
            facts[side] = known
        self.facts[pair.pair_id] = facts
        return True

    def _judge(self, pair: ScanPair) -> None:
        """Names the faults and oddities of a pair's files."""
        facts = self.facts[pair.pair_id]
        faults = [pair.fault] if pair.fault else [of.fault for of in facts.values() if of.fault]
        if faults:
            self.failures[pair.pair_id] = "; ".join(faults)
            self.reporter.fail(pair.pair_id, self.failures[pair.pair_id])
        for text in pair_warnings(pair, facts):
            self.reporter.warn(f"pair {pair.pair_id}: {text}")

    def _take(self, report: Report) -> None:
        for record in report.records:
            self.store.take(record)
            self.made.add(record.name)
        self.reporter.jobs_done(report.records)
        self.tasks[report.pair_id] = self.tasks[report.pair_id].with_records(report.records)

    def _end_pair(self, pair_id: str, failure: Failure | None) -> None:
        self.reporter.pair_done(pair_id)
        if failure is None:
            self.store.drop_failure(pair_id)
            return
        where = f"stage {failure.stage}{', ' + failure.side if failure.side else ''}"
        self.failures[pair_id] = f"{where}: {failure.reason}"
        job = next(job for job in self.tasks[pair_id].jobs if (job.stage, job.side) == (failure.stage, failure.side))
        self.store.note_failure(pair_id, {"key": job.key, "reason": self.failures[pair_id]})
        self.reporter.fail(pair_id, self.failures[pair_id])
        if failure.trace and failure.trace not in self._traces:
            self._traces.add(failure.trace)
            self.reporter.say(failure.trace)

    def current_records(self) -> list[JobRecord]:
        """The finished jobs whose results are as wanted."""
        return [
            self.store.records[job.stage, pair_id, job.side]
            for pair_id, task in self.tasks.items()
            for job in task.jobs
            if job.stored
        ]

    def rows(self) -> list[dict[str, Any]]:
        """The rows of `pairs`: every pair with current results, and every pair that failed."""
        scored = {}
        for pair_id, task in self.tasks.items():
            jobs = [job for job in task.jobs if job.stage not in self.extras]
            if all(job.stored for job in jobs):
                scored[pair_id] = jobs[-1].facts["row"]
        failed = {pair_id: reason for pair_id, reason in self.failures.items() if pair_id not in scored}
        for pair_id in self.tasks.keys() - scored.keys() - failed.keys():
            past = self.store.failures.get(pair_id)
            if past and any(past["key"] == job.key for job in self.tasks[pair_id].jobs if not job.stored):
                failed[pair_id] = past["reason"]
        rows = [{"pair_id": pair_id, "status": "failed", "reason": reason} for pair_id, reason in failed.items()]
        return rows + list(scored.values())

    def _still_holds(self, record: JobRecord) -> bool:
        """Whether the result of an extra that is not asked for this time is of the current results."""
        task = self.tasks.get(record.pair_id)
        return task is not None and record.facts.get("made_from") in {job.key for job in task.jobs}

    def _end_phase(self, name: str) -> None:
        now = perf_counter()
        self.wall_s[name] = now - self._phase_start
        self._phase_start = now
