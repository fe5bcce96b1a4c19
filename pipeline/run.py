"""A run over a dataset, verb by verb: read, hash, survey, replace, make, write. The page to read first.

The list of stages is in `jobs`, the definition of a stage in `stage`, their computations in the
package `stages`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path

import pyarrow as pa

from ..schemas.columns import Row
from ..schemas.errors import DatasetError
from ..schemas.record import FrameSuspect, PairCounts, RunHeader, RunRecord
from ..schemas.settings import Settings, preset_of
from ..stages.ground import peaks_note
from .datasets.content import input_hashes
from .datasets.pairing import require_partners
from .datasets.pairs import Dataset, ScanPair, read_dataset
from .engine.engine import Machines, large_pairs_warnings, started_schedule
from .engine.plan import OUT_OF_DATE, PairPlan, plan_jobs, plan_pair, with_results
from .engine.progress import Reporter
from .engine.schedule import Collector, Schedule
from .engine.survey import (
    Contents,
    hash_files,
    jobs_in_words,
    remove_stale,
    what_changed,
)
from .jobs import stages_under
from .pair_checks import (
    frame_suspect,
    inspection_of,
    pair_warnings,
    shared_files,
    swapped_sides,
)
from .results.overview import cautions, describe_objects
from .run_tables import (
    extra_entries,
    few_of_each,
    pair_rows,
    parts_of_table,
    records_of,
    timing_rows,
    write_table,
)
from .stage import OF_PAIR, Stage, Steps
from .storage.files import key_of
from .storage.folder import RunFolder, check_folder, refuse_overwrite
from .storage.run_record import (
    has_ended,
    last_results,
    library_versions,
    read_run,
    run_header,
    summarise_pairs,
    write_record,
)
from .storage.table_files import JobName, JobRecord

_PEAKS = ("pair_id", "ground_real_peak_m", "ground_sim_peak_m")


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
        return self.pairs.to_pylist()

    @property
    def failures(self) -> dict[str, str]:
        """Reason of each failed pair, and of each scored pair with a failed extra."""
        failed = [row for row in self.rows if row["status"] == "failed"]
        return {row["pair_id"]: row["reason"] for row in failed} | self.reported


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
    selected = {pair.pair_id for pair in select_pairs(content, pattern)}
    check_folder(out, dataset)
    folder = RunFolder(out)
    stages = stages_under(settings) if stages is None else stages
    with folder.locked():
        run = Run(content, selected, folder, stages, settings, reporter)
        run.survey_results(from_stage, replace=replace)
        with run.schedule(machines) as schedule:
            schedule.run()
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
        raise DatasetError(
            f"--pairs {pattern!r} matches none of the {len(dataset.pairs)} pairs ({names} ...)",
        )
    return selected


@dataclass
class Run:
    """One run while it works: what it was asked for, what it found in the folder, and what its jobs return.

    Parameters
    ----------
    dataset : all pairs
    selected : names of the pairs to work on
    folder : of the run, locked
    stages : under the settings

    Attributes
    ----------
    before : last record of the folder
    contents, faults : of input files, see `hash_files`
    hashes : of input files by pair_id and side
    usable, todo : pairs whose files exist, and the selected ones among them that have jobs to do
    n_todo : number of these jobs
    stale : finished jobs whose results are no longer needed, each with the reason
    past_failures : reasons by pair_id of pairs that failed in an earlier run, and are not selected
    n_jobs : current jobs
    keys : by pair, a hash of the keys that its row of `pairs` depends on
    notes, suspects : see `run_record`; by pair
    n_workers : 0 if none were needed
    """

    dataset: Dataset
    selected: set[str]
    folder: RunFolder
    stages: Sequence[Stage]
    settings: Settings
    reporter: Reporter

    def __post_init__(self) -> None:
        self.collector = Collector(self.folder, self.reporter)
        self.before = read_run(self.folder.folder)
        self.contents: Contents = {}
        self.faults: dict[str, str] = {}
        self.usable: list[ScanPair] = []
        self.todo: list[ScanPair] = []
        self.n_todo = 0
        self.stale: dict[JobName, str] = {}
        self.past_failures: dict[str, str] = {}
        self.hashes: dict[str, dict[str, str]] = {}
        self.n_jobs = 0
        self.keys: dict[str, str] = {}
        self.notes: defaultdict[str, list[str]] = defaultdict(list)
        self.suspects: dict[str, FrameSuspect] = {}
        self._warnings: dict[str, list[str]] = {}
        self._phases = Steps()
        self.n_workers = 0
        self._jobs = plan_jobs(self.stages, self.settings)
        self._versions = {stage.name: stage.version for stage in self.stages}
        self._times_s = {pair.pair_id: pair.timestamp_s for pair in self.dataset.pairs}

    @property
    def wall_s(self) -> dict[str, float]:
        """Seconds of each phase, and their total."""
        phases = dict(self._phases.total())
        return phases | {"total": sum(phases.values())}

    def survey_results(self, from_stage: str | None = None, *, replace: bool = False) -> None:
        """Find out what there is to do; the parameters are those of `run_dataset`."""
        with self._phases("inspect"):
            self._hash_files()
            self._survey_results(from_stage)
        if not (replace or from_stage):
            self._refuse_replacing()

    @contextmanager
    def schedule(self, machines: Machines) -> Iterator[Schedule]:
        """Context with the jobs to do, for which workers run; stale results are removed first."""
        with (
            self._phases("stages"),
            started_schedule(
                self.todo,
                self.n_todo,
                self._plan,
                self.collector,
                self.stages,
                self.settings,
                machines,
            ) as schedule,
        ):
            if self.todo or self.stale:
                self._write_record(self._header())
                changes = what_changed(self.before, self.settings, self.stages)
                remove_stale(self.stale, self.folder, self.reporter, changes)
            if self.todo:
                self.n_workers = schedule.pool.n_workers
            self.reporter.warn(
                *large_pairs_warnings(self.todo, self.contents, self.settings.input)
            )
            yield schedule

    def _hash_files(self) -> None:
        """Hash the files of the selected pairs and of those with results."""
        names = {*self.selected, *self.folder.ledger.pair_ids()}
        pairs = [pair for pair in self.dataset.pairs if pair.pair_id in names]
        self.reporter.warn(*self.dataset.warnings)
        self.contents, self.faults = hash_files(pairs, self.folder)
        for pair_id, fault in self.faults.items():
            self.collector.fail(pair_id, "", fault)
        self.reporter.warn(*few_of_each(swapped_sides(pairs, self.dataset.folder)))
        for pair in self.dataset.pairs:
            contents = self.contents.get(pair.pair_id)
            if contents is not None:
                self.hashes[pair.pair_id] = input_hashes(
                    pair, self.dataset.label_names, contents
                )

    def _survey_results(self, from_stage: str | None) -> None:
        """Find pairs with jobs to do, and results that are stale.

        Parameters
        ----------
        from_stage : recompute this stage and those after it
        """
        names = list(self._versions)
        redo = frozenset(names[names.index(from_stage) :] if from_stage else ())
        reasons = dict.fromkeys(self.folder.ledger.pair_ids(), "no longer in the dataset")
        for pair in self.dataset.pairs:
            name = pair.pair_id
            reasons.pop(name, None)
            if name in self.faults:
                reasons[name] = "the input cannot be used"
            elif name in self.contents:
                self.usable.append(pair)
                redone = redo if name in self.selected else frozenset[str]()
                plan, stale = with_results(self._plan(pair), self.folder, redone)
                self.stale |= stale
                if not plan.todo:
                    self._add_jobs(pair, list(plan.records.values()))
                elif name in self.selected:
                    self.todo.append(pair)
                    self.n_todo += len(plan.todo)
                else:
                    keys = [plan.keys[job.name] for job in plan.todo]
                    if reason := self.folder.ledger.failure(name, keys):
                        self.past_failures[name] = reason
        for name, reason in reasons.items():
            for record in self.folder.ledger.jobs(name).values():
                self.stale[record.name] = reason

    def _refuse_replacing(self) -> None:
        """Raise `RunError` if finished results would be replaced because of settings or version.

        Those recomputed because of other input files or libraries are replaced too.
        """
        lost = [name for name, reason in self.stale.items() if reason == OUT_OF_DATE]
        if lost and has_ended(self.before):
            names = {stage for stage, _, _ in lost}
            stages = [stage for stage in self.stages if stage.name in names]
            why = what_changed(self.before, self.settings, stages)
            if why:
                refuse_overwrite(f"run {self.folder.folder}", jobs_in_words(lost), why)

    def _plan(self, pair: ScanPair) -> PairPlan:
        """The jobs of a pair under the current settings."""
        contents = self.contents[pair.pair_id]
        return plan_pair(self._jobs, pair, contents, self.dataset.label_names)

    def write(self) -> RunOutcome:
        """Write the tables of the whole run and its record."""
        with self._phases("tables"):
            self._summarise_jobs()
        failures = self.past_failures | self.collector.failures
        job_keys = sorted(self.keys.items())
        key = key_of(library_versions(["fidpipe"]), job_keys, failures, self._times_s)
        before = self.folder.ledger.jobs("").get(("pairs", ""))
        is_same = before is not None and before.key == key
        header = self._header()
        if not is_same:
            self._write_record(header)
        pair_ids = {pair.pair_id for pair in self.usable}
        # where nothing was made, all rows are reused
        made_by = self.folder.token if self.collector.n_made else ""
        timings_key = key_of(key, list(self._versions), made_by)
        rows_of = partial(pair_rows, self.folder, self._jobs, failures)
        timings_of = partial(timing_rows, self.folder, self.stages)
        with self._phases("tables"):
            parts = parts_of_table("pairs", pair_ids | failures.keys(), rows_of)
            pairs = write_table(self.folder, "pairs", key, parts)
            parts = parts_of_table("timings", pair_ids, timings_of)
            write_table(self.folder, "timings", timings_key, parts)
        record = self._record(header, pairs, last_results(self.before) if is_same else None)
        self._write_record(record)
        n_made = self.collector.n_made
        return RunOutcome(
            folder=self.folder.folder,
            pairs=pairs,
            record=record,
            n_made=n_made,
            n_reused=self.n_jobs - n_made,
            reported=self.collector.failures,
        )

    def _record(self, header: RunHeader, pairs: pa.Table, last: RunRecord | None) -> RunRecord:
        """The record of a run that has ended.

        Parameters
        ----------
        pairs : the table
        last : record of the same results, whose findings are kept; None if results have changed
        """
        is_scored = [status == "scored" for status in pairs["status"].to_pylist()]
        # Filtering would import pyarrow.compute, a tenth of the time of a run with nothing to do.
        scored = pairs if all(is_scored) else pairs.filter(is_scored)
        for row in scored.select(_PEAKS).to_pylist():
            pair_id, real_m, sim_m = row.values()
            if note := peaks_note(real_m, sim_m, self.settings.ground):
                self.notes[pair_id].append(note)
        if last is None or not last.overview:
            by_reference = preset_of(self.settings) == "reference"
            findings, overview = describe_objects(
                self.folder, scored, self._times_s, self.hashes, by_reference=by_reference
            )
        else:
            findings, overview = last.findings, last.overview
        scored_ids = scored["pair_id"].to_pylist()
        times_s = {name: self._times_s[name] for name in scored_ids}
        record = RunRecord(
            **dict(header),
            workers=self.n_workers,
            wall_s=self.wall_s,
            pairs=PairCounts(
                scored=len(scored),
                failed=len(pairs) - len(scored),
                to_do=len(self._times_s) - len(pairs),
            ),
            summary=summarise_pairs(scored),
            findings=findings,
            inputs=dict(sorted(self.hashes.items())),
            times_s={name: time_s for name, time_s in times_s.items() if time_s is not None},
            frames=dict(sorted(self.suspects.items())),
            notes=dict(sorted(self.notes.items())),
            **extra_entries(self.folder, self.stages, self.settings, scored_ids),
        )
        if not overview:
            return record
        overview = overview.model_copy(update={"trust": tuple(cautions(overview, record))})
        return record.model_copy(update={"overview": overview})

    def _summarise_jobs(self) -> None:
        """Add the jobs that were made, and report what inspection found."""
        for pair in self.usable:
            if pair.pair_id not in self.keys:
                records = list(records_of(self.folder, self.stages, [pair.pair_id]))
                if records:
                    self._add_jobs(pair, records)
        names = [pair.pair_id for pair in self.usable if pair.pair_id in self.keys]
        warnings = shared_files({name: self.hashes[name] for name in names})
        for name in names:
            warnings += self._warnings[name]
        self.reporter.warn(*few_of_each(warnings))

    def _add_jobs(self, pair: ScanPair, records: Sequence[JobRecord]) -> None:
        """Add the jobs of a pair to what the record says of all."""
        sides, frames = inspection_of(records)
        self._warnings[pair.pair_id] = pair_warnings(pair, sides, frames)
        suspect = frame_suspect(frames)
        if suspect:
            self.suspects[pair.pair_id] = suspect
        for job in records:
            for note in job.metadata.get("notes", ()):
                self.notes[pair.pair_id].append(f"{job.part} side: {note}")
        self.n_jobs += len(records)
        keys = [job.key for job in records if OF_PAIR in job.metadata]
        self.keys[pair.pair_id] = key_of(sorted(keys))

    def _header(self) -> RunHeader:
        """Content of `run.json` from the start."""
        return run_header(self.dataset.folder, self.settings, self._versions)

    def _write_record(self, record: RunHeader) -> None:
        """Write the settings and the record, or its header."""
        write_record(self.folder, self.settings, record.as_dict())
