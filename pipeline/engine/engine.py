"""One engine for runs and experiments: inspects files, plans, removes what is out of date, has jobs made, collects.

A run and an experiment only say which pairs, stages and parts they want.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from shutil import rmtree
from types import TracebackType
from typing import Self

from ...schemas.columns import SIDES
from ...schemas.errors import DiskFullError
from ...schemas.record import FrameSuspect
from ...schemas.settings import Settings
from ..datasets.pairs import ScanPair
from ..inspect.frame_checks import frames_name
from ..inspect.scan_checks import PairFacts, ScanContent, input_name, pair_warnings, recall_pair_frames, recall_scan
from ..stage import Stage
from ..storage.files import megabytes
from ..storage.folder import RunFolder
from ..storage.record import LIBRARIES, library_versions
from ..storage.tables import JobName, JobRecord
from .cluster import start_pool
from .plan import OUT_OF_DATE, PairPlan, with_results
from .pool import InProcess, Pool
from .progress import Reporter
from .reading import read_files, wants_workers
from .schedule import Policy, Schedule
from .time_limit import TimeLimit
from .worker import BatchResult, JobFailure, failures_in_words, is_required

_TIME_NOTES = ".time_limit"  # folder in that of a run, while it works
_OF_INPUT, _OF_READING = "input", "reading"  # keys of failures before all stages: a faulty file, a reader that died

PlanPair = Callable[[ScanPair], PairPlan]


@dataclass(frozen=True)
class Machines:
    """Where work is done; no result depends on it.

    workers : processes on this machine; None for one a core; 1 for none besides this one
    scheduler : address of a dask scheduler, instead of a cluster on this machine
    pool : to be used instead of either; it is not closed
    policy : how work is cut into batches
    pair_timeout_s : a pair that workers have worked on for longer fails; None for as long as it takes
    """

    workers: int | None = None
    scheduler: str | None = None
    pool: Pool | None = None
    policy: Policy = field(default_factory=Policy)
    pair_timeout_s: float | None = None


@dataclass
class Survey:
    """What there is and what is wanted.

    usable : pairs whose files can be read
    todo : those of them that are wanted and have jobs to be made
    unwanted : finished jobs whose results are not wanted, each with the reason
    n_jobs : to be made, of the pairs in `todo`
    """

    usable: list[ScanPair] = field(default_factory=list)
    todo: list[ScanPair] = field(default_factory=list)
    unwanted: dict[JobName, str] = field(default_factory=dict)
    n_jobs: int = 0


class RunEngine:
    """Inspects files, plans, removes what is out of date, has jobs made and keeps the ledger of a run's folder.

    A context, at whose end the pool is ended.

    Parameters
    ----------
    folder : of the run; locked where anything is to be made
    settings : in force
    machines : where work is done
    reporter : shows how it goes on
    stages : whose jobs may be wanted

    Attributes
    ----------
    contents : what the files of each pair hold, by pair_id and side; of pairs whose files can all be read
    frames : by pair_id, those of `contents` whose simulated scan seems to lie in another frame
    failures : why something failed: by pair_id, or "pair_id, part" for a part of an experiment
    n_made : jobs that were made
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
        self.frames: dict[str, FrameSuspect] = {}
        self.failures: dict[str, str] = {}
        self.n_made = 0
        self._machines, self._stages = machines, tuple(stages)
        self._unusable: set[str] = set()
        self._traces: set[str] = set()
        self._pool: Pool | None = machines.pool

    def __enter__(self) -> Self:
        """The engine itself; its pool is started when first needed."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Ends the pool, whatever it is doing."""
        if self._pool is not None and self._pool is not self._machines.pool:
            self._pool.close(now=True)

    @property
    def pool(self) -> Pool:
        """Where batches run; started when first needed."""
        if self._pool is None:
            libraries = dict.fromkeys(name for stage in self._stages for name in stage.libraries(self.settings))
            self._pool = start_pool(
                self._machines.workers,
                self._machines.scheduler,
                self.settings.machine.memory_gib,
                self.folder.token_path,
                library_versions(("fidpipe", *LIBRARIES, *libraries)),
                dict.fromkeys(stage.make.__module__ for stage in self._stages),
                may_end_workers=self._machines.pair_timeout_s is not None,
            )
            if self._pool.dashboard:
                self.reporter.say(f"dask dashboard: {self._pool.dashboard}")
        return self._pool

    def start(self) -> None:
        """Starts the pool, if it is not there: what fails here fails before anything is removed."""
        _ = self.pool

    @property
    def n_workers(self) -> int:
        """Workers of the pool; 0 where none was needed."""
        return 0 if self._pool is None else self._pool.n_workers

    def _limited(self, plans: Iterable[PairPlan]) -> Iterator[PairPlan]:
        """The plans with the time limit of their pairs; what was noted of an earlier run is removed."""
        seconds = self._machines.pair_timeout_s
        for i, plan in enumerate(plans):
            if seconds is None or plan.folder is None:
                yield plan
                continue
            notes = plan.folder / _TIME_NOTES
            if i == 0:
                rmtree(notes, ignore_errors=True)
            yield replace(plan, limit=TimeLimit(seconds, notes / str(i)))

    def fail(self, name: str, reason: str) -> None:
        """Something came to nothing, by pair_id or "pair_id, part"."""
        self.failures[name] = reason
        self.reporter.fail(f"pair {name}", reason)

    def inspect(
        self,
        pairs: Sequence[ScanPair],
        label_names: dict[int, str],
        *,
        sides: Sequence[str] = SIDES,
        is_noted: bool = True,
    ) -> None:
        """Reads every file that is not known yet, once, and names every fault.

        Parameters
        ----------
        pairs : whose files are wanted
        label_names : class names by number
        sides : a pair can be used if these sides of it can be read
        is_noted : whether the ledger remembers what was learnt
        """
        unknown, warnings = [], list[str]()
        for pair in pairs:
            facts = self._recall(pair, sides)
            if facts is None:
                unknown.append(pair)
            else:
                warnings += self._tell(pair, self._judge(pair, facts, sides), is_noted)
        if not is_noted:
            unknown = [pair for pair in unknown if not self._tell_as_before(pair)]
        judged: dict[str, tuple[str, list[str]]] = {}
        ended: set[str] = set()
        for pair, read in self._read_files(unknown, label_names):
            if isinstance(read, str):
                ended.add(pair.pair_id)
                judged[pair.pair_id] = read, []
                continue
            for side, scan in read.sides.items() if is_noted else ():
                self.folder.ledger.put_input(input_name(pair, side), scan.as_dict())
            if read.frames and is_noted:
                self.folder.ledger.put_input(frames_name(pair), read.frames.as_dict())
            judged[pair.pair_id] = self._judge(pair, read, sides)
        for pair in unknown:  # in their order, whichever was read first
            key = _OF_READING if pair.pair_id in ended else _OF_INPUT
            warnings += self._tell(pair, judged[pair.pair_id], is_noted, key)
        self.reporter.warn(*warnings)

    def survey(
        self,
        pairs: Iterable[ScanPair],
        plan_pair: PlanPair,
        *,
        selected: set[str],
        redo: frozenset[str] = frozenset(),
        exhaustive: frozenset[str] = frozenset(),
        why_absent: str = "no longer in the dataset",
    ) -> Survey:
        """Compares what is there with what is wanted; `inspect` comes before.

        Parameters
        ----------
        pairs : all pairs that may have results
        plan_pair : gives the jobs that are wanted of a pair
        selected : names of the pairs that are to be worked on
        redo, exhaustive : see `with_results`; `redo` counts for the selected pairs
        why_absent : why results of other pairs are not wanted
        """
        survey, names = Survey(), set()
        for pair in pairs:
            names.add(pair.pair_id)
            if pair.pair_id not in self.contents or pair.pair_id in self.failures:
                continue
            survey.usable.append(pair)
            is_selected = pair.pair_id in selected
            plan, unwanted = with_results(
                plan_pair(pair), self.folder, redo if is_selected else frozenset(), exhaustive, by_content=True
            )
            survey.unwanted |= unwanted
            if is_selected and plan.todo:
                survey.todo.append(pair)
                survey.n_jobs += len(plan.todo)
        for pair_id in list(self.folder.ledger.pair_ids()):
            reason = "the input cannot be used" if pair_id in self._unusable else why_absent
            if pair_id not in names or pair_id in self._unusable:
                for record in self.folder.ledger.jobs(pair_id).values():
                    survey.unwanted[record.name] = reason
        return survey

    def replace(self, survey: Survey, changes: Sequence[str] = (), stages: Sequence[str] = ()) -> None:
        """Says what will be replaced or removed and why, and removes it.

        Parameters
        ----------
        survey : what is there
        changes : what has changed since the last time, in words
        stages : in their order
        """
        for reason, names in _by_reason(survey.unwanted).items():
            count = Counter(stage for stage, _, _ in names)
            listed = ", ".join(stage for stage in dict.fromkeys((*stages, *count)) if stage in count)
            n_pairs = len({pair_id for _, pair_id, _ in names})
            why = f"{reason} ({'; '.join(changes) or 'the input files changed'})" if reason == OUT_OF_DATE else reason
            self.reporter.say(f"replacing {listed} of {n_pairs} pair{'s' * (n_pairs > 1)}: {why}")
            for stage, pair_id, part in names:
                record = self.folder.ledger.jobs(pair_id).get((stage, part))
                if record is not None:
                    self.folder.forget(record)
        survey.unwanted.clear()
        if n_strays := self.folder.remove_strays():
            self.reporter.say(f"removing {n_strays} file{'s' * (n_strays > 1)} that no finished job accounts for")
        self.folder.ledger.commit()

    @contextmanager
    def scheduling_missing(self, survey: Survey, plan_pair: PlanPair) -> Iterator[Schedule]:
        """The schedule that makes the jobs that are not there, of the pairs that are to be worked on."""
        pool = self.pool
        plans = (with_results(plan_pair(pair), self.folder)[0] for pair in survey.todo)
        try:
            self.reporter.start(len(survey.todo), survey.n_jobs)
            yield Schedule(pool, self._limited(plans), len(survey.todo), self, self._machines.policy)
        except DiskFullError as error:
            n_raw = sum(scan.n_raw for pair in survey.todo for scan in self.contents[pair.pair_id].values())
            need, n_pairs = megabytes(self._machines.policy.costs.disk_bytes(n_raw)), len(survey.todo)
            pairs = (
                f"{n_pairs} pairs that were not finished need" if n_pairs > 1 else "pair that was not finished needs"
            )
            raise DiskFullError(f"{error}: it goes on where it stopped; the {pairs} about {need} in all") from error
        finally:
            self.reporter.stop()
            self.folder.ledger.commit()
            rmtree(self.folder.folder / _TIME_NOTES, ignore_errors=True)
        if survey.todo:
            self.folder.remove_strays()  # what a worker wrote before it died, or had half written

    def batch_done(self, result: BatchResult) -> None:
        """See `Watcher`: the ledger learns of the finished jobs."""
        if result.records:
            self.folder.ledger.put_jobs(result.pair_id, result.records)
        self.n_made += len(result.records)
        self.reporter.advance(len(result.records))

    def pair_done(self, plan: PairPlan, failures: tuple[JobFailure, ...]) -> None:
        """See `Watcher`: failures are shown, those of parts of an experiment one by one.

        The ledger learns why a pair failed, and nothing of a pair without scores stays.
        """
        own = []
        for failure in failures:
            if failure.part in plan.job((failure.stage, failure.part)).stage.parts:
                own.append(failure)
            else:
                self.fail(f"{plan.pair_id}, {failure.part}", failure.reason)
        self.reporter.advance(len(plan.todo), 1)
        if plan.limit is not None:
            rmtree(plan.limit.folder, ignore_errors=True)
        if any(is_required(plan.job((failure.stage, failure.part))) for failure in own):
            for record in self.folder.ledger.jobs(plan.pair_id).values():
                self.folder.forget(record)
                self.n_made -= record.made_by == self.folder.token
        if own:
            self.fail(plan.pair_id, failures_in_words(own))
            key = plan.job((own[0].stage, own[0].part)).key
            self.folder.ledger.put_failure(plan.pair_id, {"key": key, "reason": self.failures[plan.pair_id]})
        else:
            self.folder.ledger.drop_failure(plan.pair_id)
        for trace in dict.fromkeys(failure.trace for failure in failures if failure.trace):
            if trace not in self._traces:
                self._traces.add(trace)
                self.reporter.say(trace)

    def _read_files(
        self, pairs: Sequence[ScanPair], label_names: dict[int, str]
    ) -> Iterator[tuple[ScanPair, PairFacts | str]]:
        """See `read_files`; a few files of formats that are ours are read in this process."""
        seconds, notes = self._machines.pair_timeout_s, self.folder.folder / _TIME_NOTES
        is_here = not pairs or (seconds is None and not wants_workers(pairs))
        limits = {}
        if seconds is not None:
            rmtree(notes, ignore_errors=True)
            limits = {pair.pair_id: TimeLimit(seconds, notes / f"files-{i}") for i, pair in enumerate(pairs)}
        yield from read_files(InProcess() if is_here else self.pool, pairs, self.settings.input, label_names, limits)
        rmtree(notes, ignore_errors=True)

    def _tell_as_before(self, pair: ScanPair) -> bool:
        """Whether reading a pair's files ended a worker the last time; that is told, and not tried again."""
        past = self.folder.ledger.failure(pair.pair_id)
        if past is None or past["key"] != _OF_READING:
            return False
        self._tell(pair, (past["reason"], []), is_noted=False)
        return True

    def _recall(self, pair: ScanPair, sides: Sequence[str]) -> PairFacts | None:
        """What a pair's files hold, if it is known from the last time and still so."""
        known, facts = self.folder.ledger.input, {}
        for side in sides:
            if pair.path(side) is None:
                continue
            scan = recall_scan(known, pair, side, self.settings.input)
            if scan is None:
                return None
            facts[side] = scan
        if len(facts) < len(SIDES):
            return PairFacts(facts, None)
        frames = recall_pair_frames(known, pair, facts)
        return None if frames is None else PairFacts(facts, frames)

    def _judge(self, pair: ScanPair, known: PairFacts, sides: Sequence[str]) -> tuple[str, list[str]]:
        """Keeps what is needed of a pair's files; gives why it cannot be used, or "", and what is odd about it."""
        facts = {side: scan for side, scan in known.sides.items() if side in sides}
        frames = known.frames if len(facts) == len(SIDES) else None
        faults = [scan.fault for scan in facts.values() if scan.fault]
        if not faults:
            self.contents[pair.pair_id] = {side: scan.content for side, scan in facts.items()}
            if frames and frames.suspect:
                self.frames[pair.pair_id] = frames.suspect
        lacks_scan = any(pair.path(side) is None for side in sides)  # that of a side not wanted may be missing
        return (pair.fault if lacks_scan else None) or "; ".join(dict.fromkeys(faults)), pair_warnings(
            pair, facts, frames
        )

    def _tell(self, pair: ScanPair, judged: tuple[str, list[str]], is_noted: bool, key: str = _OF_INPUT) -> list[str]:
        """Says why a pair cannot be used; gives what is odd about it, one line each."""
        fault, warnings = judged
        if fault:
            self.fail(pair.pair_id, fault)
            self._unusable.add(pair.pair_id)
            if is_noted:
                self.folder.ledger.put_failure(pair.pair_id, {"key": key, "reason": fault})
        return [f"pair {pair.pair_id}: {text}" for text in warnings]


def current_records(folder: RunFolder, pair_ids: Iterable[str], stages: Iterable[str]) -> Iterator[JobRecord]:
    """The finished jobs of some stages, pair by pair."""
    wanted = set(stages)
    for pair_id in pair_ids:
        for record in folder.ledger.jobs(pair_id).values():
            if record.stage in wanted:
                yield record


def _by_reason(unwanted: Mapping[JobName, str]) -> dict[str, list[JobName]]:
    reasons: dict[str, list[JobName]] = {}
    for name, reason in unwanted.items():
        reasons.setdefault(reason, []).append(name)
    return reasons
