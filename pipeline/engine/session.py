"""What a run does, verb by verb: inspect the files, plan the jobs, clear what is out of date, work, write.

Leaves to others: which stages there are (`run`), the order of tasks (`schedule`), keys (`plan`), files (`store`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from time import perf_counter
from typing import Any

from ...schemas.results import Findings
from ...schemas.settings import to_toml
from ...schemas.tables import PAIRS, TIMINGS
from ..datasets.pairs import Dataset, ScanPair
from ..datasets.scan_checks import input_hashes
from ..results.findings import run_findings
from ..storage.ledger import JobName, JobRecord
from ..storage.record import (
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
from ..storage.store import Store, key_of
from .cluster import start_pool
from .inspection import Inspection
from .plan import Stage, library_versions
from .pool import InProcess, Pool
from .progress import Reporter
from .request import RunOutcome, RunRequest
from .schedule import Schedule
from .standing import Standing
from .task import Failure, Report

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
        self.dataset = dataset
        self.store = store
        self.reporter = reporter
        self.settings = request.settings
        self.selected = {pair.pair_id for pair in selected}
        self.failures: dict[str, str] = {}
        self.standing = Standing(request, stages, dataset, self.selected, store, self.failures)
        self.made: set[JobName] = set()
        self.wall_s: dict[str, float] = {}
        self.before = {name: of for name, of in read_run(request.out).items() if name in _KEPT_OF_BEFORE}
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
        self.standing.contents = inspection.contents
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
        self.standing.compare()

    def clear(self) -> None:
        """Says what will be replaced and why, and removes it."""
        reasons: dict[str, list[JobName]] = {}
        for name, why in self.standing.unwanted.items():
            reasons.setdefault(why, []).append(name)
        for why, names in reasons.items():
            reason = why
            count = Counter(stage for stage, _, _ in names)
            stages = ", ".join(stage for stage in dict.fromkeys((*self.standing.stage_names, *count)) if stage in count)
            n_pairs = len({pair_id for _, pair_id, _ in names})
            if reason == "out of date":
                changes = what_changed(self.before, self.settings, self.standing.stages)
                reason += f" ({'; '.join(changes) or 'the input files changed'})"
            self.reporter.say(f"replacing {stages} of {n_pairs} pair{'s' * (n_pairs > 1)}: {reason}")
            for name in names:
                self.store.forget(self.store.records[name])
        self.standing.unwanted.clear()
        for path in self.store.strays([table for stage in self.standing.stages for table in stage.gives]):
            path.unlink()
        self.store.compact()
        self.store.replace(self.request.out / SETTINGS_TOML, to_toml(self.settings).encode())
        self.store.replace(
            self.request.out / RUN_JSON, dumps(run_header(self.request.dataset, self.settings, self.standing.stages))
        )

    def work(self) -> None:
        """Makes what is not there."""
        if self.standing.todo:
            names = [pair.pair_id for pair in self.standing.todo]
            n_raw = {pair_id: sum(of.n_raw for of in self.standing.contents[pair_id].values()) for pair_id in names}
            n_jobs = {
                of.name: (len(of.sides) * len(names), self.standing.n_stored[of.name]) for of in self.standing.stages
            }
            pool = self.pool
            self.reporter.start(n_raw, n_jobs)
            try:
                Schedule(
                    pool, self.standing.tasks(), n_raw, self._take, self.reporter.objects_done, self._end_pair
                ).run()
            finally:
                self.reporter.stop()
        self._end_phase("stages")

    def write(self) -> RunOutcome:
        """Writes the tables of the whole run and its record."""
        pairs = PAIRS.from_rows(self.standing.rows())
        key = key_of([record.key for record in self.standing.records("metrics")], self.failures)
        table = self.store.write_at(self.request.out / "pairs.parquet", "pairs", pairs, key)
        self.store.take(JobRecord("pairs", "", "", key, {"pairs.parquet": table}))
        seconds = StageSeconds()
        timings = TIMINGS.from_rows(timing_rows(seconds.count(self.standing.records()), self.made))
        self.store.write_at(self.request.out / "timings.parquet", "timings", timings, key)
        self._end_phase("tables")
        self.wall_s["total"] = perf_counter() - self._start
        hashes = {
            pair.pair_id: input_hashes(pair, self.dataset.label_names, self.standing.contents[pair.pair_id])
            for pair in self.dataset.pairs
            if pair.pair_id in self.standing.contents
        }
        n_workers = self._pool.n_workers if self._pool else 0
        header = run_header(self.request.dataset, self.settings, self.standing.stages)
        n_to_do = len({pair.pair_id for pair in self.dataset.pairs}) - pairs.num_rows
        rows = pairs.select(["pair_id", "status", *DATASET_VALUES]).to_pylist()
        scored = [row for row in rows if row["status"] == "scored"]
        findings = self._findings(scored, key)
        record = run_record(header, hashes, rows, self.wall_s, n_workers, seconds.as_dict(), findings, n_to_do)
        for stage in self.standing.stages:
            if stage.summarise:
                record[stage.name] = stage.summarise(list(self.standing.records(stage.name)), self.settings)
        self.store.replace_by(self.request.out / RUN_JSON, json_parts(record))
        self.store.compact()
        n_reused = sum(1 for _ in self.standing.names()) - len(self.made)
        scored_ids = {row["pair_id"] for row in scored}
        failed_extras = {pair_id: reason for pair_id, reason in self.failures.items() if pair_id in scored_ids}
        return RunOutcome(self.request.out, pairs, record, len(self.made), n_reused, failed_extras)

    def _findings(self, scored: list[dict[str, Any]], key: str) -> Findings | None:
        times = {pair.pair_id: pair.timestamp_s for pair in self.dataset.pairs}
        before = Findings.recorded(self.before.get("findings"))
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
        task = self.standing.task(pair_id)
        jobs = task.jobs if task else ()
        key = next(job.key for job in jobs if (job.stage, job.side) == (failure.stage, failure.side))
        self.store.note_failure(pair_id, {"key": key, "reason": self.failures[pair_id]})
        self.reporter.fail(pair_id, self.failures[pair_id])
        if failure.trace and failure.trace not in self._traces:
            self._traces.add(failure.trace)
            self.reporter.say(failure.trace)

    def _end_phase(self, name: str) -> None:
        now = perf_counter()
        self.wall_s[name] = now - self._phase_start
        self._phase_start = now
