"""The engine of a run: hashes files, plans, removes stale results, runs jobs, collects results."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from shutil import rmtree
from typing import Any, Self

from ...schemas.columns import SIDES
from ...schemas.errors import DiskFullError, ScanError
from ...schemas.settings import Settings, preset_of
from ..datasets.content import ScanContent, scan_content
from ..datasets.pairs import ScanPair
from ..datasets.readers import files_of, may_crash, stem_of
from ..datasets.readers.scan import label_path_of
from ..stage import Stage
from ..storage.files import megabytes
from ..storage.folder import RunFolder, refuse_overwrite
from ..storage.run_record import LIBRARIES, changed_settings, has_ended, library_versions
from ..storage.table_files import JobId, JobName
from ..storage.urls import is_stub, read_stub, stub_texts, url_of_cache
from .plan import OUT_OF_DATE, PairPlan, with_results
from .pool import Pool
from .progress import Reporter
from .schedule import Policy, Schedule
from .time_limit import TimeLimit
from .worker import BatchResult, JobFailure, failure_text

_LARGE_PAIR = 500_000  # points of both files
_GONE = "no longer in the dataset"
_TIME_NOTES = ".time_limit"  # folder in that of a run, while it works

PlanPair = Callable[[ScanPair], PairPlan]


@dataclass(frozen=True)
class Machines:
    """Machines that do the work; no result depends on them.

    workers : processes on this machine; None for one per core; 1 for this process alone, unless a job may end it
    scheduler : address of a dask scheduler, instead of a cluster on this machine
    pool : to be used instead of either; it is not closed
    policy : for cutting work into batches
    pair_timeout_s : a pair that takes workers longer than this fails; None for no limit
    """

    workers: int | None = None
    scheduler: str | None = None
    pool: Pool | None = None
    policy: Policy = field(default_factory=Policy)
    pair_timeout_s: float | None = None


@dataclass
class Survey:
    """Comparison of existing results with the plan.

    usable : pairs whose files exist
    todo : selected pairs among them that have jobs to do
    stale : finished jobs whose results are no longer needed, each with the reason
    n_jobs : jobs to do, of the pairs in `todo`
    """

    usable: list[ScanPair] = field(default_factory=list)
    todo: list[ScanPair] = field(default_factory=list)
    stale: dict[JobName, str] = field(default_factory=dict)
    n_jobs: int = 0


class RunEngine:
    """Engine of one folder: hashes files, plans, removes stale results, runs jobs and keeps the ledger.

    A context, at whose end the pool is ended.

    Parameters
    ----------
    folder : of the run; locked if anything is to be written
    settings : current settings
    machines : for the jobs
    reporter : shows progress
    stages : all stages whose jobs may be planned

    Attributes
    ----------
    contents : hashes of the files of each pair, by pair_id and side; of pairs whose existing files can all be hashed
    failures : reasons by pair_id
    n_made : jobs that were done
    """

    def __init__(
        self,
        folder: RunFolder,
        settings: Settings,
        machines: Machines,
        reporter: Reporter,
        stages: Iterable[Stage] = (),
    ) -> None:
        self.folder, self.settings, self.reporter = folder, settings, reporter
        self.contents: dict[str, dict[str, ScanContent]] = {}
        self.failures: dict[str, str] = {}
        self.n_made = 0
        self._machines, self._stages = machines, tuple(stages)
        self._unusable: set[str] = set()
        self._traces: set[str] = set()
        self._pool: Pool | None = machines.pool

    def __enter__(self) -> Self:
        """The engine itself; its pool is started when first needed."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the pool, even if tasks are running."""
        if self._pool is not None and self._pool is not self._machines.pool:
            self._pool.close(now=True)

    def start(self, pairs: Iterable[ScanPair]) -> Pool:
        """The pool; started if it is not running, so that it fails, if it does, before anything is removed.

        Parameters
        ----------
        pairs : whose jobs it will run; if a reader may end its process, that is never the command's own
        """
        if self._machines.scheduler and url_of_cache(self.folder.folder):
            from ..storage.remote_run import share_folder

            share_folder(self.folder)
        if self._pool is None:
            is_local = self._machines.scheduler is None
            reader_may_crash = is_local and any(may_crash(path) for pair in pairs for path in pair.paths)
            shared = self._shared_files(pairs)
            libraries = dict.fromkeys(name for stage in self._stages for name in stage.libraries)
            from .cluster import start_pool

            self._pool = start_pool(
                self._machines.workers,
                self._machines.scheduler,
                self.settings.machine.memory_gib,
                shared,
                library_versions(("fidpipe", *LIBRARIES, *libraries)),
                dict.fromkeys(stage.make.__module__ for stage in self._stages),
                may_end_workers=self._machines.pair_timeout_s is not None or reader_may_crash,
            )
            if self._pool.dashboard:
                self.reporter.say(f"dask dashboard: {self._pool.dashboard}")
        return self._pool

    @property
    def n_workers(self) -> int:
        """Workers of the pool; 0 where none was needed."""
        return 0 if self._pool is None else self._pool.n_workers

    def _shared_files(self, pairs: Iterable[ScanPair]) -> list[str]:
        """A scan and the token of the run, which all workers must be able to read."""
        some_scan = [file for pair in pairs for path in pair.paths[:1] for file in files_of(path)][:1]
        scans = [read_stub(scan)[0] if is_stub(scan) else str(scan.resolve()) for scan in some_scan]
        url, token = self.folder.url, self.folder.token_path
        return [*scans, f"{url}/{token.name}" if url else str(token.resolve())]

    def _for_workers(self, plans: Iterable[PairPlan]) -> Iterator[PairPlan]:
        """The plans with the time limit of their pairs, and all that workers need that may not see the files here."""
        seconds, notes = self._machines.pair_timeout_s, self.folder.folder / _TIME_NOTES
        rmtree(notes, ignore_errors=True)  # of an earlier run
        for i, plan in enumerate(plans):
            own = plan if seconds is None else replace(plan, limit=TimeLimit(seconds, notes / str(i)))
            if self._machines.scheduler is not None:
                files = [file for path in plan.pair.paths for file in (path, label_path_of(path, stem_of(path)))]
                own = replace(own, url=self.folder.url, stubs=stub_texts(files))
            yield own

    def fail(self, pair_id: str, reason: str) -> None:
        """Record and report the failure of a pair."""
        self.failures[pair_id] = reason
        self.reporter.fail(f"pair {pair_id}", reason)

    def hash_files(self, pairs: Iterable[ScanPair]) -> None:
        """Hash the files of pairs; a pair of which one is missing or empty fails. No file is parsed."""
        for pair in pairs:
            contents, reasons = {}, []
            for side in SIDES:
                path = pair.path(side)
                try:
                    if path is not None:
                        contents[side] = scan_content(path, self.folder.ledger.input_hash)
                    elif pair.fault and pair.fault not in reasons:
                        reasons.append(pair.fault)
                except ScanError as error:
                    reasons.append(str(error))
            if len(contents) == len(pair.paths):
                self.contents[pair.pair_id] = contents
            if reasons:
                self.fail(pair.pair_id, "; ".join(reasons))
                self._unusable.add(pair.pair_id)
                if self.folder.ledger.is_writable:
                    self.folder.ledger.put_failure(pair.pair_id, "", "; ".join(reasons))

    def survey(
        self,
        pairs: Iterable[ScanPair],
        plan_pair: PlanPair,
        *,
        selected: set[str],
        redo: frozenset[str] = frozenset(),
        complete: Callable[[PairPlan], None] = lambda _: None,
    ) -> Survey:
        """Compare existing results with the plan; call `hash_files` first.

        Parameters
        ----------
        pairs : all pairs that may have results
        plan_pair : returns the plan of a pair
        selected : names of the pairs to work on
        redo : stages of the selected pairs to recompute regardless of their keys
        complete : called with the plan of each pair without jobs to do, so that its records are read once
        """
        survey, names = Survey(), set()
        for pair in pairs:
            names.add(pair.pair_id)
            if pair.pair_id not in self.contents or pair.pair_id in self.failures:
                continue
            survey.usable.append(pair)
            is_selected = pair.pair_id in selected
            plan, stale = with_results(plan_pair(pair), self.folder, redo if is_selected else frozenset())
            survey.stale |= stale
            if not plan.todo:
                complete(plan)
            if is_selected and plan.todo:
                survey.todo.append(pair)
                survey.n_jobs += len(plan.todo)
        for pair_id in list(self.folder.ledger.pair_ids()):
            reason = "the input cannot be used" if pair_id in self._unusable else _GONE
            if pair_id not in names or pair_id in self._unusable:
                for record in self.folder.ledger.jobs(pair_id).values():
                    survey.stale[record.name] = reason
        return survey

    def refuse_replacing(self, survey: Survey, name: str, before: Mapping[str, Any]) -> None:
        """Raise `RunError` if finished results would be replaced because of settings or version.

        Those recomputed because of other input files or libraries are replaced too.

        Parameters
        ----------
        name : of the results, for the error
        before : last record of the folder
        """
        lost = [job for job, reason in survey.stale.items() if reason == OUT_OF_DATE]
        names, n_pairs = {stage for stage, _, _ in lost}, len({pair_id for _, pair_id, _ in lost})
        stages = [stage for stage in self._stages if stage.name in names]
        groups = {group for stage in stages for group in stage.settings}
        changed = changed_settings(before, self.settings)
        why = [text for group, texts in changed.items() if group in groups for text in texts]
        preset = preset_of(self.settings)
        if why and before.get("preset", preset) != preset:
            why.insert(0, f"preset was {before['preset']}, is {preset}")
        versions = before.get("stages", {})
        if old := [stage.name for stage in stages if versions.get(stage.name, stage.version) != stage.version]:
            written = f"fidpipe {before.get('fidpipe')} on {before.get('written', '')[:10]}"
            why.append(f"{written} had other code of {', '.join(old)}")
        if lost and why and has_ended(before):
            listed = ", ".join(dict.fromkeys((*(stage.name for stage in stages), *sorted(names))))
            refuse_overwrite(name, f"{listed} of {n_pairs} pair{'s' * (n_pairs > 1)}", why)

    @contextmanager
    def making(
        self, survey: Survey, plan_pair: PlanPair, begin: Callable[[], None], changes: Sequence[str] = ()
    ) -> Iterator[Schedule]:
        """The schedule of the missing results, after the stale ones were removed.

        Parameters
        ----------
        survey : from `survey`
        plan_pair : returns the plan of a pair
        begin : called before anything is removed or written, once the workers have started
        changes : changes since the last run, as text
        """
        pool = self.start(survey.todo) if survey.todo else Pool()
        if survey.todo or survey.stale:
            begin()
        self._remove_stale(survey, changes)
        if not survey.todo:
            yield Schedule(pool, (), 0, self)
            return
        self._warn_of_large_pairs(survey.todo)
        plans = (with_results(plan_pair(pair), self.folder)[0] for pair in survey.todo)
        try:
            self.reporter.start(len(survey.todo), survey.n_jobs)
            yield Schedule(pool, self._for_workers(plans), len(survey.todo), self, self._machines.policy)
        except DiskFullError as error:
            n_raw, n_pairs = sum(map(self._n_points, survey.todo)), len(survey.todo)
            need = megabytes(self._machines.policy.costs.disk_bytes(n_raw))
            pairs = (
                f"{n_pairs} pairs that were not finished need" if n_pairs > 1 else "pair that was not finished needs"
            )
            raise DiskFullError(f"{error}: it resumes where it stopped; the {pairs} about {need} in all") from error
        finally:
            self.reporter.stop()
            self.folder.ledger.commit()
            rmtree(self.folder.folder / _TIME_NOTES, ignore_errors=True)
        self.folder.remove_strays()  # of workers that died: complete and incomplete files

    def _remove_stale(self, survey: Survey, changes: Sequence[str]) -> None:
        """Report which results are replaced or removed and why, and remove them."""
        by_reason: dict[str, defaultdict[str, set[JobId]]] = {}
        for (stage, pair_id, part), reason in survey.stale.items():
            by_reason.setdefault(reason, defaultdict(set))[pair_id].add((stage, part))
        for reason, jobs in by_reason.items():
            stages = {stage for own in jobs.values() for stage, _ in own}
            listed = ", ".join(dict.fromkeys((*(own.name for own in self._stages if own.name in stages), *stages)))
            why = f"{reason} ({'; '.join(changes) or 'the input files changed'})" if reason == OUT_OF_DATE else reason
            self.reporter.say(f"replacing {listed} of {len(jobs)} pair{'s' * (len(jobs) > 1)}: {why}")
            for pair_id, own in jobs.items():
                self.folder.forget(pair_id, own)
        if n_strays := self.folder.remove_strays():
            self.reporter.say(f"removing {n_strays} file{'s' * (n_strays > 1)} that no finished job accounts for")
        self.folder.ledger.commit()

    def _n_points(self, pair: ScanPair) -> int:
        """Points of both files of a pair, from their size."""
        return sum(scan.approximate_points for scan in self.contents[pair.pair_id].values())

    def _warn_of_large_pairs(self, pairs: Sequence[ScanPair]) -> None:
        """Report memory and time of pairs beyond the points of usual sensors, and how to reduce them."""
        large = [pair for pair in pairs if self._n_points(pair) >= _LARGE_PAIR]
        if large:
            n_raw, costs = max(map(self._n_points, large)), self._machines.policy.costs
            self.reporter.warn(
                f"{len(large)} of {len(pairs)} pairs have {_LARGE_PAIR:,} points or more; the largest has about "
                f"{n_raw:,}; with all of them it takes some {costs.pair_bytes(n_raw) / 2**30:.0f} GiB of memory and "
                f"{costs.pair_seconds(n_raw) / 60:.0f} minutes, more where points are dense; thin both sides in the "
                "same way, lower graph.tau_m, or leave out points with input.max_range_m or input.include_box"
            )

    def batch_done(self, result: BatchResult) -> None:
        """Add the finished jobs of a pair to the ledger; others of its batch may have failed."""
        if result.records:
            self.folder.ledger.put_jobs(result.pair_id, result.records)
        self.n_made += len(result.records)
        self.reporter.advance(len(result.records))

    def objects_done(self, plan: PairPlan, n_done: int) -> None:
        """Show that some objects of a pair are scored; their jobs are finished with the last ones."""
        self.reporter.advance(0, objects=f"; {plan.pair_id}: {n_done} of {len(plan.objects or [])} objects")

    def pair_done(self, plan: PairPlan, failures: tuple[JobFailure, ...]) -> None:
        """Report the failures of a pair that has ended.

        The ledger keeps the reason of a failed pair; all results of a pair without scores are removed.
        """
        order = list(plan.jobs)
        own = sorted(failures, key=lambda failure: order.index(failure.job))
        self.reporter.advance(len(plan.todo), 1)
        if plan.limit is not None:
            rmtree(plan.limit.folder, ignore_errors=True)
        if required := [failure for failure in own if not plan.jobs[failure.job].stage.is_extra]:
            own = required[:1]  # which of the others were begun depends on the number of workers
            for record in self.folder.forget(plan.pair_id):
                self.n_made -= record.made_by == self.folder.token
        if own:
            self.fail(plan.pair_id, failure_text(own))
            self.folder.ledger.put_failure(plan.pair_id, plan.keys[own[0].job], self.failures[plan.pair_id])
        else:
            self.folder.ledger.drop_failure(plan.pair_id)
        for trace in dict.fromkeys(failure.trace for failure in failures if failure.trace):
            if trace not in self._traces:
                self._traces.add(trace)
                self.reporter.say(trace)
