"""Common parts of experiments: their scans, their folder, and the parts of their stages that are requested.

An experiment has additional stages of grain PAIR and requests parts of them: each part is a task with arguments and one
table, computed once and reused while its key is the same. The pipeline stages that they depend on are computed first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from dataclasses import replace as replace_fields
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from ...schemas.columns import Row, Table
from ...schemas.errors import DatasetError, ScanError
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.summary import mean_and_std
from ..datasets.pairs import Dataset, ScanPair, read_dataset, read_label_names
from ..datasets.readers import is_scan_path, stem_of, suffix_of
from ..datasets.readers.frame_address import address_of
from ..engine.engine import Machines, RunEngine
from ..engine.plan import NOT_REQUESTED, PairPlan, Part, Planner, with_results
from ..engine.progress import Reporter
from ..jobs import STAGES
from ..pair_checks import inspection_of, pair_warnings
from ..run import select_pairs
from ..stage import Stage
from ..storage.files import key_of
from ..storage.folder import RunFolder, check_folder
from ..storage.run_record import (
    has_ended,
    read_run,
    run_header,
    what_changed,
    write_record,
)
from ..storage.table_files import JobRecord

_SEED = "seed"  # another seed is another experiment; for other numbers a larger one includes the smaller
_VERSIONS = {stage.name: stage.version for stage in STAGES}


@dataclass(frozen=True, kw_only=True)
class ExperimentOutcome:
    """Outcome of any experiment.

    failures : reasons for failed tasks, pairs and scans, by name
    n_made, n_reused : numbers of jobs
    """

    folder: Path
    failures: dict[str, str]
    n_made: int
    n_reused: int
    wall_s: float


def read_source(
    path: Path, pattern: str | None = None, *, first_only: bool = False, machines: Machines | None = None
) -> Dataset:
    """The pairs of a dataset, or a scan file as a dataset of one pair without a simulated side.

    Parameters
    ----------
    path : a scan file or a dataset folder
    pattern : only pairs whose name matches (shell style)
    first_only : return only the first pair if no pattern is given
    machines : workers of a cluster may have another working directory, and get absolute paths

    Raises
    ------
    DatasetError
        No dataset exists, it is invalid, or no pair matches.
    ScanError
        The format of the file is unknown.
    """
    if machines is not None and machines.scheduler:
        path = path.absolute()
    if is_scan_path(path):
        if suffix_of(path) is None:
            raise ScanError(f"{path}: not a known scan format; expected a scan file or a dataset folder")
        if pattern is not None:
            raise DatasetError(f"--pairs {pattern!r}: {path} is one scan; expected a dataset folder")
        folder = address_of(path).file.resolve().parent
        names = read_label_names(folder) or read_label_names(folder.parent)
        return Dataset(path, (ScanPair(stem_of(path), path, None),), names)
    if not path.exists() and suffix_of(path) is not None:
        raise ScanError(f"{path}: no such file; expected a scan file or a dataset folder")
    dataset = read_dataset(path)
    pairs = select_pairs(dataset, pattern)
    return replace_fields(dataset, pairs=pairs[:1] if first_only and pattern is None else pairs)


@dataclass
class Experiment:
    """A running experiment; opened by `experimenting`, which describes its fields."""

    name: str
    engine: RunEngine
    source: Dataset
    stages: tuple[Stage, ...]
    sides: Sequence[str]
    replace: bool

    def __post_init__(self) -> None:
        self.folder = self.engine.folder
        self._start = perf_counter()
        before = read_run(self.folder.folder)
        self._finished = before if has_ended(before) and not self.replace else {}
        self._changes = what_changed(before, self.engine.settings, _VERSIONS)
        self._planner = Planner(_needed(self.stages), self.engine.settings, self.source.label_names, self.sides)
        self._parts: Mapping[str, Sequence[Part]] = {}
        self._request: dict[str, Any] = {}

    def prepare(self) -> list[PairPlan]:
        """Compute the pipeline stages that the experiment needs; returns the pairs for which all of them are done.

        Raises
        ------
        ScanError
            The single scan file of the experiment is unusable.
        """
        self.engine.hash_files(self.source.pairs, sides=self.sides)
        self._make(STAGES)
        if is_scan_path(self.source.folder) and self.engine.failures:
            raise ScanError("; ".join(self.engine.failures.values()))
        for pair in self.source.pairs:
            jobs = self.folder.ledger.jobs(pair.pair_id).values()
            self.engine.reporter.warn(*pair_warnings(pair, *inspection_of(jobs)))
        return [plan for plan in self._plans() if not plan.todo]

    def make(self, parts: Mapping[str, Sequence[Part]], request: Mapping[str, Any]) -> None:
        """Compute the requested parts that do not exist under their key; remove all others.

        Parameters
        ----------
        parts : requested parts by pair_id
        request : the request as stored in `run.json`: lists of values, numbers of repeats, a seed

        Raises
        ------
        RunError
            Results of a finished experiment that `request` no longer request would be removed without --replace.
        ValueError
            Two parts have the same name, and so the same file. Nothing is removed or computed.
        """
        self._parts, self._request = parts, dict(request)
        self._make(self.stages)

    def rows(self, table: str) -> pa.Table:
        """All rows of one of the experiment's tables."""
        files = ((name, stored) for record in self._records() for name, stored in record.files.items())
        own = [each for each in files if each[0].startswith(f"{table}/")]
        parts = (self.folder.read(table, stored, name) for name, stored in own)
        return pa.concat_tables([TABLES[table].schema.empty_table(), *parts])

    def write_summary(self, table: Table, rows: list[Row]) -> pa.Table:
        """Write a table of the whole experiment and return it."""
        key, path = key_of(sorted(record.key for record in self._records())), f"{table.name}.parquet"
        summary = table.from_rows(rows)
        stored = self.folder.write_at(self.folder.folder / path, table.name, summary, key)
        self.folder.ledger.put_job(JobRecord(table.name, "", "", key, {path: stored}))
        return summary

    def finish(self) -> dict[str, Any]:
        """Write the outcome into `run.json` and return the fields of an `ExperimentOutcome`."""
        failures, n_made, wall_s = self.engine.failures, self.engine.n_made, perf_counter() - self._start
        n_done = sum(len(plan.records) for plan in self._plans())
        jobs = {"made": n_made, "reused": n_done - n_made}
        self._write_record({**self._request, "failures": failures, "jobs": jobs, "wall_s": wall_s})
        outcome = {"folder": self.folder.folder, "failures": failures, "wall_s": wall_s}
        return outcome | {f"n_{name}": n for name, n in jobs.items()}

    def _write_record(self, outcome: Mapping[str, Any]) -> None:
        """Write the settings and the record; without outcome, that of an experiment that has not ended."""
        header = {
            "experiment": self.name,
            **run_header(self.source.folder, self.engine.settings, _VERSIONS).as_dict(),
        }
        write_record(
            self.folder.folder, self.engine.settings, (header | dict(outcome)).items(), self.folder.check_token
        )

    def _records(self) -> Iterator[JobRecord]:
        for pair_id in self.folder.ledger.pair_ids():
            yield from self.folder.ledger.jobs(pair_id).values()

    def _plan(self, pair: ScanPair) -> PairPlan:
        return self._planner.plan(pair, self.engine.contents[pair.pair_id], self._parts.get(pair.pair_id, ()))

    def _plans(self) -> Iterator[PairPlan]:
        """The plans of the usable pairs with their existing results."""
        for pair in self.source.pairs:
            if pair.pair_id in self.engine.contents and pair.pair_id not in self.engine.failures:
                yield with_results(self._plan(pair), self.folder)[0]

    def _make(self, stages: Sequence[Stage]) -> None:
        """Compute the missing results of some stages and remove their other results."""
        survey = self.engine.survey(
            self.source.pairs,
            self._plan,
            selected={pair.pair_id for pair in self.source.pairs},
            exhaustive=frozenset(stage.name for stage in stages),
            why_absent=NOT_REQUESTED,
        )
        if self._finished:
            existing = sorted({pair_id for _, pair_id, _ in survey.stale})
            requested = self._request | {"pairs": [pair.pair_id for pair in self.source.pairs]}
            unrequested = _reductions(self._finished | {"pairs": existing}, requested)
            self.engine.refuse_replacing(survey, f"{self.name} {self.folder.folder}", self._finished, unrequested)

        def begin() -> None:
            """If results are only added, the record of the finished experiment stays valid."""
            if survey.stale or not self._finished or stages is not STAGES:
                self._write_record({})

        with self.engine.making(survey, self._plan, begin, self._changes) as schedule:
            schedule.run()


@contextmanager
def experimenting(
    name: str,
    source: Dataset,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    *,
    stages: tuple[Stage, ...],
    sides: Sequence[str],
    machines: Machines | None = None,
    replace: bool = False,
) -> Iterator[Experiment]:
    """Open and lock the folder of an experiment.

    Parameters
    ----------
    name : of the experiment, equal to the command
    source : the scans
    out : the folder
    settings : effective settings
    stages : stages of the experiment
    sides : sides of the pairs that it needs
    machines : workers
    replace : allow results of a finished experiment to be replaced by another request

    Raises
    ------
    RunError
        The folder holds something else, or is in use.
    """
    check_folder(out, source.folder, name)
    folder = RunFolder(out.absolute() if machines and machines.scheduler else out)
    with folder.locked(), RunEngine(folder, settings, machines or Machines(), reporter, (*STAGES, *stages)) as engine:
        yield Experiment(name, engine, source, stages, sides, replace)


def mean_rows(scores: pd.DataFrame, keys: list[str]) -> Iterator[Row]:
    """Keys, n, mean and std (n - 1) of `value` for each group of rows with equal keys, null keys included."""
    for names, values in scores.groupby(keys, dropna=False, sort=False)["value"]:
        mean, std = mean_and_std(values.to_numpy(dtype=np.float64))
        yield dict(zip(keys, names, strict=True)) | {"n": int(values.notna().sum()), "mean": mean, "std": std}


def _reductions(before: Mapping[str, Any], now: Mapping[str, Any], name: str = "") -> Iterator[str]:
    """Human-readable reductions of a request: values missing from a list, a smaller number, another seed."""
    for key in (key for key in now if key in before):
        own, (old, new) = f"{name}.{key}".lstrip("."), (before[key], now[key])
        if isinstance(new, Mapping):
            yield from _reductions(old, new, own)
        elif isinstance(new, Sequence):
            gone = [each for each in old if each not in new]
            texts = [
                " ".join(map(str, [*each.values()][:2])) if isinstance(each, Mapping) else str(each) for each in gone
            ]
            if gone:
                yield f"{own} {', '.join(texts[:5])}{' ...' * (len(texts) > 5)} {NOT_REQUESTED}"
        elif new != old if key == _SEED else new < old:
            yield f"{own} was {old}, is {new}"


def _needed(stages: Sequence[Stage]) -> tuple[Stage, ...]:
    """The pipeline stages that produce the inputs of these, directly or indirectly, in their order."""
    tables = {table for stage in stages for table in stage.takes}
    needed = []
    for stage in reversed(STAGES):
        if tables.intersection(stage.gives):
            needed.append(stage)
            tables.update(stage.takes)
    return tuple(reversed(needed))
