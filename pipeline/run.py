"""A run over a dataset, verb by verb: read, hash, survey, replace, make, write. The page to read first.

The list of stages is in `jobs`, the definition of a stage in `stage`, their computations in the
package `stages`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from time import perf_counter

import pyarrow as pa

from ..schemas.columns import Row
from ..schemas.errors import DatasetError
from ..schemas.record import RunHeader, RunRecord
from ..schemas.results import JsonObject
from ..schemas.settings import Settings
from .datasets.content import input_hashes
from .datasets.pairing import require_partners
from .datasets.pairs import Dataset, ScanPair, read_dataset
from .engine.engine import Machines, large_pairs_warnings, schedule_of, started_pool
from .engine.plan import PairPlan, plan_jobs, plan_pair
from .engine.progress import Reporter
from .engine.schedule import Collector
from .engine.survey import (
    InputFiles,
    Survey,
    hash_files,
    refuse_replacing,
    remove_stale,
    survey_results,
    what_changed,
)
from .jobs import stages_under
from .pair_checks import shared_files, swapped_sides
from .run_tables import JobSummary, few_of_each, records_of, summarise, write_pairs, write_timings
from .stage import Stage
from .storage.files import key_of
from .storage.folder import RunFolder, check_folder
from .storage.run_record import (
    last_results,
    library_versions,
    read_run,
    replaced_results,
    run_header,
    write_record,
)


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of a run.

    pairs : the table `pairs`
    record : content of `run.json`
    n_made, n_reused : jobs
    reported : reasons of this run's failures by pair: why it failed, or a baseline or another extra
    """

    folder: Path
    pairs: pa.Table
    record: RunRecord
    n_made: int
    n_reused: int
    reported: dict[str, str]

    @property
    def rows(self) -> list[Row]:
        """The rows of `pairs`."""
        rows: list[Row] = self.pairs.to_pylist()
        return rows

    @property
    def failures(self) -> dict[str, str]:
        """Reason of each failed pair, and of each scored pair with a failed extra."""
        rows = self.pairs.select(["pair_id", "status", "reason"]).to_pylist()
        failed = [row for row in rows if row["status"] == "failed"]
        return {row["pair_id"]: row["reason"] for row in failed} | self.reported

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
        dataset = dataset.absolute()
        out = out.absolute()
    content = read_dataset(dataset)
    require_partners(content)
    selected = select_pairs(content, pattern)
    check_folder(out, dataset)
    folder = RunFolder(out)
    stages = stages_under(settings) if stages is None else stages
    with folder.locked():
        run = Run(content, selected, folder, stages, settings, reporter)
        run.hash_files()
        run.survey_results(from_stage)
        if not (replace or from_stage):
            refuse_replacing(run.survey, folder, run.before, stages, settings)
        todo = run.survey.todo
        with started_pool(todo, folder, stages, settings, run.collector, machines) as pool:
            run.replace_stale()
            if todo:
                reporter.warn(*large_pairs_warnings(todo, run.files, settings.input))
                schedule_of(run.survey, run.plan, pool, run.collector, machines).run()
                run.n_workers = pool.n_workers
        return run.write()


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
        n_pairs = len(dataset.pairs)
        raise DatasetError(
            f"--pairs {pattern!r} matches none of the {n_pairs} pairs ({names} ...)",
        )
    return selected


class Run:
    """One run while it works: what it was asked for, what it found in the folder, and what its jobs return.

    Parameters
    ----------
    dataset : all pairs
    selected : pairs to work on
    folder : of the run, locked
    stages : under the settings

    Attributes
    ----------
    before : last record of the folder
    files, survey, hashes : contents of input files, jobs to do, and hashes by pair_id and side
    jobs : summary of the current jobs
    n_workers : 0 if none were needed
    """

    def __init__(
        self,
        dataset: Dataset,
        selected: Sequence[ScanPair],
        folder: RunFolder,
        stages: Sequence[Stage],
        settings: Settings,
        reporter: Reporter,
    ) -> None:
        self.dataset = dataset
        self.selected = {pair.pair_id for pair in selected}
        self.folder = folder
        self.stages = stages
        self.settings = settings
        self.reporter = reporter
        self.collector = Collector(folder, reporter)
        self.before = read_run(folder.folder)
        self.files = InputFiles()
        self.survey = Survey()
        self.jobs = JobSummary()
        self.hashes: dict[str, dict[str, str]] = {}
        self.n_workers = 0
        self._jobs = plan_jobs(stages, settings)
        self._versions = {stage.name: stage.version for stage in stages}
        self._last = last_results(self.before)
        self._wall_s: dict[str, float] = {}
        self._start = self._phase_start = perf_counter()

    def hash_files(self) -> None:
        """Hash the files of the selected pairs and of those with results."""
        names = {*self.selected, *self.folder.ledger.pair_ids()}
        pairs = [pair for pair in self.dataset.pairs if pair.pair_id in names]
        self.reporter.warn(*self.dataset.warnings)
        self.files = hash_files(pairs, self.folder)
        for pair_id, fault in self.files.faults.items():
            self.collector.fail(pair_id, "", fault)
        self.reporter.warn(*few_of_each(swapped_sides(pairs, self.dataset.folder)))
        for pair in self.dataset.pairs:
            contents = self.files.contents.get(pair.pair_id)
            if contents is not None:
                self.hashes[pair.pair_id] = input_hashes(pair, self.dataset.label_names, contents)
        self._end_phase("inspect")

    def survey_results(self, from_stage: str | None) -> None:
        """Find pairs with jobs to do, and results that are stale.

        Parameters
        ----------
        from_stage : recompute this stage and those after it
        """
        names = list(self._versions)
        self.survey = survey_results(
            self.dataset.pairs,
            self.files,
            self.plan,
            self.folder,
            selected=self.selected,
            redo=frozenset(names[names.index(from_stage) :] if from_stage else ()),
            complete=lambda plan: self.jobs.add(plan.pair, list(plan.records.values())),
        )

    def plan(self, pair: ScanPair) -> PairPlan:
        """The jobs of a pair under the current settings."""
        contents = self.files.contents[pair.pair_id]
        return plan_pair(self._jobs, pair, contents, self.dataset.label_names)

    def replace_stale(self) -> None:
        """Remove stale results and a finished record, if there are jobs to do or stale results."""
        if not (self.survey.todo or self.survey.stale):
            return
        self._write_record(self._header())
        changes = what_changed(self.before, self.settings, self.stages)
        remove_stale(self.survey, self.folder, self.reporter, changes)

    def write(self) -> RunOutcome:
        """Write the tables of the whole run and its record."""
        self._end_phase("stages")
        self._add_jobs()
        failures = self.collector.failures
        times_s = {pair.pair_id: pair.timestamp_s for pair in self.dataset.pairs}
        job_keys = sorted(self.jobs.keys.items())
        key = key_of(library_versions(["fidpipe"]), job_keys, failures, times_s)
        before = self.folder.ledger.jobs("").get(("pairs", ""))
        is_same = before is not None and before.key == key
        header = self._header(is_same=is_same)
        if not is_same:
            self._write_record(header)
        pairs = write_pairs(self.folder, key, self.stages, self.survey.usable, failures, self.plan)
        pair_ids = [pair.pair_id for pair in self.survey.usable]
        # where nothing was made, all rows are reused
        made_by = self.folder.token if self.collector.n_made else ""
        timings_key = key_of(key, list(self._versions), made_by)
        write_timings(self.folder, timings_key, self.stages, pair_ids)
        self._end_phase("tables")
        self._wall_s["total"] = perf_counter() - self._start
        record = summarise(
            header,
            pairs,
            self.folder,
            self.stages,
            self.settings,
            self.jobs,
            times_s=times_s,
            hashes=self.hashes,
            last=self._last if is_same else None,
            workers=self.n_workers,
            wall_s=self._wall_s,
        )
        self._write_record(record)
        n_made = self.collector.n_made
        n_reused = self.jobs.n_jobs - n_made
        return RunOutcome(self.folder.folder, pairs, record, n_made, n_reused, failures)

    def _add_jobs(self) -> None:
        """Summarise the jobs that were made, and report what inspection found."""
        jobs = self.jobs
        for pair in self.survey.usable:
            if pair.pair_id not in jobs.keys:
                records = list(records_of(self.folder, self.stages, [pair.pair_id]))
                if records:
                    jobs.add(pair, records)
        names = [pair.pair_id for pair in self.survey.usable if pair.pair_id in jobs.keys]
        warnings = shared_files({name: self.hashes[name] for name in names})
        for name in names:
            warnings += jobs.warnings.pop(name)
        self.reporter.warn(*few_of_each(warnings))

    def _header(self, *, is_same: bool = False) -> RunHeader:
        """Content of `run.json` from the start; identical results do not count as a replacement."""
        previous = replaced_results(self.before, self._last, is_same=is_same)
        return run_header(self.dataset.folder, self.settings, self._versions, previous)

    def _write_record(self, record: RunHeader) -> None:
        """Write the settings and the record, or its header."""
        out = self.folder.folder
        write_record(out, self.settings, record.as_dict(), self.folder.check_token)

    def _end_phase(self, name: str) -> None:
        now = perf_counter()
        self._wall_s[name] = now - self._phase_start
        self._phase_start = now
