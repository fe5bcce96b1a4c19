"""What experiments share: the scans that they work on, their folder, and how they say which tasks they want.

An experiment has stages of its own, of grain PAIR, and wants parts of them: each a task with arguments, one table, made
once and reused while its key stays. The stages of the pipeline that its own need are made first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.columns import Table
from ...schemas.errors import DatasetError, ScanError
from ...schemas.settings import Settings, to_toml
from ...schemas.tables import TABLES
from ..datasets.pairs import ScanPair, read_dataset, read_label_names
from ..datasets.readers import stem_of, suffix_of
from ..engine.engine import Machines, RunEngine, modules_of
from ..engine.plan import PairPlan, Part, Planner, with_results
from ..engine.progress import Reporter
from ..jobs import STAGES
from ..run import check_folder, select_pairs
from ..stage import Stage
from ..storage.files import key_of, write_whole
from ..storage.folder import RunFolder
from ..storage.record import SETTINGS_TOML, read_run, run_header, what_changed, write_record
from ..storage.tables import JobRecord


@dataclass(frozen=True)
class Source:
    """Scans to work on.

    path : as the user named it
    pairs : from a dataset, or one with a real side alone
    label_names : class names by number
    is_scan : whether one scan file was named
    """

    path: Path
    pairs: tuple[ScanPair, ...]
    label_names: dict[int, str]
    is_scan: bool = False


@dataclass(frozen=True, kw_only=True)
class ExperimentOutcome:
    """What has become of an experiment, whichever it is.

    failures : why a task, a pair or a scan failed, by name
    n_made, n_reused : jobs
    """

    folder: Path
    failures: dict[str, str]
    n_made: int
    n_reused: int
    wall_s: float


def read_source(path: Path, pattern: str | None, *, first_only: bool = False) -> Source:
    """The scan file at a path, or the pairs of the dataset there.

    Parameters
    ----------
    path : a scan file or a dataset folder
    pattern : only pairs whose name matches (shell style)
    first_only : without a pattern the first pair alone

    Raises
    ------
    DatasetError
        There is nothing, the dataset is wrong, or no pair matches.
    ScanError
        The file is of no known format.
    """
    if path.is_file():
        if suffix_of(path) is None:
            raise ScanError(f"{path}: not a known scan format; a scan file or a dataset folder is wanted")
        if pattern is not None:
            raise DatasetError(f"--pairs {pattern!r}: {path} is one scan; a dataset folder is wanted with --pairs")
        folder = path.resolve().parent
        names = read_label_names(folder) or read_label_names(folder.parent)
        return Source(path, (ScanPair(stem_of(path), path, None),), names, is_scan=True)
    dataset = read_dataset(path)
    pairs = select_pairs(dataset, pattern)
    return Source(path, pairs[:1] if first_only and pattern is None else pairs, dataset.label_names)


class Experiment:
    """An experiment while it is worked on; `experimenting` opens one."""

    def __init__(
        self, engine: RunEngine, source: Source, stages: tuple[Stage, ...], sides: Sequence[str], changes: Sequence[str]
    ) -> None:
        self.engine, self.folder = engine, engine.folder
        self._source, self._own, self._sides, self._changes = source, stages, tuple(sides), changes
        self._base = _needed(stages)
        self._planner = Planner(self._base, engine.settings, source.label_names, sides)
        self._parts: Mapping[str, Sequence[Part]] = {}

    @property
    def failures(self) -> dict[str, str]:
        """Why a task, a pair or a scan failed, by name."""
        return self.engine.failures

    @property
    def n_reused(self) -> int:
        """Jobs that were there already."""
        n_done = sum(job.record is not None for plan in self._plans() for job in plan.jobs)
        return n_done - self.engine.n_made

    def prepare(self) -> list[PairPlan]:
        """Makes the stages that the experiment's own need; gives the pairs of which all that is done.

        Raises
        ------
        ScanError
            One scan file was named, and it cannot be used.
        """
        self.engine.inspect(self._source.pairs, self._source.label_names, sides=self._sides)
        if self._source.is_scan and self.failures:
            raise ScanError("; ".join(self.failures.values()))
        self._make(frozenset(stage.name for stage in STAGES))
        return [plan for plan in self._plans() if not plan.todo]

    def make(self, parts: Mapping[str, Sequence[Part]]) -> None:
        """Makes the wanted parts, by pair_id, that are not there under their key; removes all others.

        Raises
        ------
        ValueError
            Two parts have one name: they would write one file. Nothing is removed or made.
        """
        self._parts = parts
        self._make(frozenset(stage.name for stage in self._own))

    def rows(self, table: str) -> pa.Table:
        """All rows of one of the experiment's tables."""
        files = [
            self.folder.folder / name
            for pair_id in self.folder.ledger.pair_ids()
            for record in self.folder.ledger.jobs(pair_id).values()
            for name in record.files
            if name.startswith(f"{table}/")
        ]
        return pa.concat_tables([TABLES[table].schema.empty_table(), *(pq.read_table(file) for file in files)])

    def write_summary(self, table: Table, rows: pa.Table) -> None:
        """Writes a table of the whole experiment."""
        keys = [
            record.key
            for pair_id in self.folder.ledger.pair_ids()
            for record in self.folder.ledger.jobs(pair_id).values()
        ]
        key, path = key_of(sorted(keys)), self.folder.folder / f"{table.name}.parquet"
        stored = self.folder.write_at(path, table.name, rows, key)
        self.folder.ledger.put_job(JobRecord(table.name, "", "", key, {path.name: stored}))

    def write_record(self, name: str, facts: Mapping[str, Any], wall_s: float) -> None:
        """Writes `run.json`: its head, what the experiment wants to be known, and what has become of the tasks."""
        jobs = {"made": self.engine.n_made, "reused": self.n_reused}
        ending = {"failures": self.failures, "jobs": jobs, "wall_s": wall_s}
        header = _header(name, self._source.path, self.engine.settings)
        write_record(self.folder.folder, header | dict(facts) | ending, self.folder.check_token)

    def _plan(self, pair: ScanPair) -> PairPlan:
        return self._planner.plan(pair, self.engine.contents[pair.pair_id], self._parts.get(pair.pair_id, ()))

    def _plans(self) -> Iterator[PairPlan]:
        """The pairs that can be used, knowing what is done."""
        for pair in self._source.pairs:
            if pair.pair_id in self.engine.contents and pair.pair_id not in self.failures:
                yield with_results(self._plan(pair), self.folder)[0]

    def _make(self, exhaustive: frozenset[str]) -> None:
        wanted = {pair.pair_id for pair in self._source.pairs}
        survey = self.engine.survey(
            self._source.pairs, self._plan, selected=wanted, exhaustive=exhaustive, why_absent="not asked for"
        )
        self.engine.replace(survey, self._changes, [stage.name for stage in (*self._base, *self._own)])
        if survey.todo:
            with self.engine.scheduling_missing(survey, self._plan) as schedule:
                schedule.run()


@contextmanager
def experimenting(
    name: str,
    source: Source,
    out: Path,
    settings: Settings,
    machines: Machines,
    reporter: Reporter,
    *,
    stages: tuple[Stage, ...],
    sides: Sequence[str],
) -> Iterator[Experiment]:
    """The folder of an experiment, locked, with the head of its record written.

    Parameters
    ----------
    name : of the experiment, as the command has it
    source : the scans
    stages : of the experiment
    sides : of the pairs that it needs

    Raises
    ------
    RunError
        The folder holds something else, or is in use.
    """
    check_folder(out, source.path, name)
    folder = RunFolder(out)
    with folder.locked(), RunEngine(folder, settings, machines, reporter, modules_of((*STAGES, *stages))) as engine:
        changes = what_changed(read_run(out), settings, {stage.name: stage.version for stage in STAGES})
        write_record(out, _header(name, source.path, settings), folder.check_token)
        write_whole(out / SETTINGS_TOML, to_toml(settings).encode(), before_rename=folder.check_token)
        yield Experiment(engine, source, stages, sides, changes)


def _needed(stages: Sequence[Stage]) -> tuple[Stage, ...]:
    """The stages of the pipeline that make what these take, and what those take in turn; in their order."""
    wanted = {table for stage in stages for table in stage.takes}
    needed = []
    for stage in reversed(STAGES):
        if wanted.intersection(stage.gives):
            needed.append(stage)
            wanted.update(stage.takes)
    return tuple(reversed(needed))


def _header(name: str, source: Path, settings: Settings) -> dict[str, Any]:
    versions = {stage.name: stage.version for stage in STAGES}
    return {"experiment": name, **run_header(source, settings, versions).as_dict()}
