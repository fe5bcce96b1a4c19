"""What experiments share: the scans that they work on, their folder, and how they say which tasks they want.

An experiment has stages of its own, of grain PAIR, and wants parts of them: each a task with arguments, one table, made
once and reused while its key stays. The stages of the pipeline that its own need are made first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from ...schemas.columns import Row, Table
from ...schemas.errors import DatasetError, ScanError
from ...schemas.settings import Settings
from ...schemas.settings_text import to_toml
from ...schemas.tables import TABLES
from ...stages.summary import mean_and_std
from ..datasets.pairs import ScanPair, read_dataset, read_label_names
from ..datasets.readers import is_scan_path, stem_of, suffix_of
from ..datasets.readers.frames import address_of
from ..engine.engine import Machines, RunEngine, Survey
from ..engine.plan import OUT_OF_DATE, PairPlan, Part, Planner, with_results
from ..engine.progress import Reporter
from ..inspect.frame_checks import inspection_of, pair_warnings
from ..jobs import STAGES
from ..run import select_pairs
from ..stage import Stage
from ..storage.files import key_of, write_whole
from ..storage.folder import RunFolder, check_folder, refuse_overwrite
from ..storage.record import (
    SETTINGS_TOML,
    changed_settings,
    has_ended,
    read_run,
    run_header,
    what_changed,
    write_record,
)
from ..storage.tables import JobRecord

_NOT_ASKED_FOR = "not asked for"
_SEED = "seed"  # any other one is another experiment; of other numbers the larger holds the smaller
_VERSIONS = {stage.name: stage.version for stage in STAGES}


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


def read_source(
    path: Path, pattern: str | None = None, *, first_only: bool = False, machines: Machines | None = None
) -> Source:
    """The scan file at a path, or the pairs of the dataset there.

    Parameters
    ----------
    path : a scan file or a dataset folder
    pattern : only pairs whose name matches (shell style)
    first_only : without a pattern the first pair alone
    machines : workers of a cluster may run in other folders, and get absolute paths

    Raises
    ------
    DatasetError
        There is nothing, the dataset is wrong, or no pair matches.
    ScanError
        The file is of no known format.
    """
    if machines is not None and machines.scheduler:
        path = path.absolute()
    if is_scan_path(path):
        if suffix_of(path) is None:
            raise ScanError(f"{path}: not a known scan format; expected a scan file or a dataset folder")
        if pattern is not None:
            raise DatasetError(f"--pairs {pattern!r}: {path} is one scan; --pairs needs a dataset folder")
        folder = address_of(path).file.resolve().parent
        names = read_label_names(folder) or read_label_names(folder.parent)
        return Source(path, (ScanPair(stem_of(path), path, None),), names, is_scan=True)
    if not path.exists() and suffix_of(path) is not None:
        raise ScanError(f"{path}: no such file; expected a scan file or a dataset folder")
    dataset = read_dataset(path)
    pairs = select_pairs(dataset, pattern)
    return Source(path, pairs[:1] if first_only and pattern is None else pairs, dataset.label_names)


class Experiment:
    """An experiment while it is worked on; `experimenting` opens one."""

    def __init__(
        self,
        name: str,
        engine: RunEngine,
        source: Source,
        stages: tuple[Stage, ...],
        sides: Sequence[str],
        *,
        replace: bool = False,
    ) -> None:
        self.engine, self.folder = engine, engine.folder
        self._start = perf_counter()
        self._name, self._source, self._own, self._sides = name, source, stages, sides
        before = read_run(self.folder.folder)
        self._finished = before if has_ended(before) and not replace else {}
        self._changes = what_changed(before, engine.settings, _VERSIONS)
        self._base = _needed(stages)
        self._planner = Planner(self._base, engine.settings, source.label_names, sides)
        self._parts: Mapping[str, Sequence[Part]] = {}
        self._facts: Mapping[str, Any] = {}

    def prepare(self) -> list[PairPlan]:
        """Makes the stages that the experiment's own need; gives the pairs of which all that is done.

        Raises
        ------
        ScanError
            One scan file was named, and it cannot be used.
        """
        self.engine.hash_files(self._source.pairs, sides=self._sides)
        self._make(STAGES)
        if self._source.is_scan and self.engine.failures:
            raise ScanError("; ".join(self.engine.failures.values()))
        for pair in self._source.pairs:
            jobs = self.folder.ledger.jobs(pair.pair_id).values()
            self.engine.reporter.warn(*pair_warnings(pair, *inspection_of(jobs)))
        return [plan for plan in self._plans() if not plan.todo]

    def make(self, parts: Mapping[str, Sequence[Part]], facts: Mapping[str, Any]) -> None:
        """Makes the wanted parts, by pair_id, that are not there under their key; removes all others.

        Parameters
        ----------
        parts : wanted, by pair_id
        facts : what was asked for, as `run.json` keeps it: lists of values, numbers of repeats, a seed

        Raises
        ------
        RunError
            Results of a finished experiment would go that `facts` do not ask for any more, unasked.
        ValueError
            Two parts have one name: they would write one file. Nothing is removed or made.
        """
        self._parts, self._facts = parts, facts
        self._make(self._own)

    def rows(self, table: str) -> pa.Table:
        """All rows of one of the experiment's tables."""
        files = ((name, stored) for record in self._records() for name, stored in record.files.items())
        own = [each for each in files if each[0].startswith(f"{table}/")]
        parts = (self.folder.read(table, stored, name) for name, stored in own)
        return pa.concat_tables([TABLES[table].schema.empty_table(), *parts])

    def write_summary(self, table: Table, rows: list[Row]) -> pa.Table:
        """Writes a table of the whole experiment, and returns it."""
        key, path = key_of(sorted(record.key for record in self._records())), f"{table.name}.parquet"
        summary = table.from_rows(rows)
        stored = self.folder.write_at(self.folder.folder / path, table.name, summary, key)
        self.folder.ledger.put_job(JobRecord(table.name, "", "", key, {path: stored}))
        return summary

    def finish(self, facts: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """What an `ExperimentOutcome` says of any experiment; writes it into `run.json`.

        Parameters
        ----------
        facts : what came out, to stand there besides what was asked for
        """
        failures, n_made, wall_s = self.engine.failures, self.engine.n_made, perf_counter() - self._start
        n_done = sum(job.record is not None for plan in self._plans() for job in plan.jobs)
        jobs = {"made": n_made, "reused": n_done - n_made}
        self._write_record({**self._facts, **(facts or {}), "failures": failures, "jobs": jobs, "wall_s": wall_s})
        outcome = {"folder": self.folder.folder, "failures": failures, "wall_s": wall_s}
        return outcome | {f"n_{name}": n for name, n in jobs.items()}

    def _write_record(self, facts: Mapping[str, Any]) -> None:
        """Writes the settings and the record; without facts it is the head of an experiment that has not ended."""
        settings = to_toml(self.engine.settings).encode()
        write_whole(self.folder.folder / SETTINGS_TOML, settings, before_rename=self.folder.check_token)
        header = {"experiment": self._name, **run_header(self._source.path, self.engine.settings, _VERSIONS).as_dict()}
        write_record(self.folder.folder, header | dict(facts), self.folder.check_token)

    def _records(self) -> Iterator[JobRecord]:
        for pair_id in self.folder.ledger.pair_ids():
            yield from self.folder.ledger.jobs(pair_id).values()

    def _plan(self, pair: ScanPair) -> PairPlan:
        return self._planner.plan(pair, self.engine.contents[pair.pair_id], self._parts.get(pair.pair_id, ()))

    def _plans(self) -> Iterator[PairPlan]:
        """The pairs that can be used, knowing what is done."""
        for pair in self._source.pairs:
            if pair.pair_id in self.engine.contents and pair.pair_id not in self.engine.failures:
                yield with_results(self._plan(pair), self.folder)[0]

    def _make(self, stages: Sequence[Stage]) -> None:
        """Makes what is wanted and not there; of these stages nothing else stays."""
        survey = self.engine.survey(
            self._source.pairs,
            self._plan,
            selected={pair.pair_id for pair in self._source.pairs},
            exhaustive=frozenset(stage.name for stage in stages),
            why_absent=_NOT_ASKED_FOR,
        )
        self._refuse_replacing(survey)
        if survey.todo:
            self.engine.start(survey.todo)
        only_adds = stages is STAGES and self._finished and not survey.stale  # what stays is still as it was asked
        if (survey.todo or survey.stale) and not only_adds:
            self._write_record({})
        self.engine.replace(survey, self._changes, [stage.name for stage in (*self._base, *self._own)])
        if survey.todo:
            with self.engine.scheduling_missing(survey, self._plan) as schedule:
                schedule.run()

    def _refuse_replacing(self, survey: Survey) -> None:
        """Refuses to replace or remove results of a finished experiment because something else is asked for.

        Results that only grow, by further values, repeats or pairs, are no such thing; nor is what other input files,
        libraries or a newer fidpipe make anew.

        Raises
        ------
        RunError
            They would be replaced; says which, and by what.
        """
        if not self._finished:
            return
        changed = changed_settings(self._finished, self.engine.settings)
        groups = {group for stage in (*self._base, *self._own) for group in stage.settings}
        why = [text for group, texts in changed.items() if group in groups for text in texts]
        why += _dropped(self._finished, self._facts)
        left_out = sorted({pair_id for _, pair_id, _ in survey.stale} - {pair.pair_id for pair in self._source.pairs})
        why += [f"pair{'s' * (len(left_out) > 1)} {', '.join(left_out[:5])} not asked for"] if left_out else []
        lost = [name for name, reason in survey.stale.items() if reason in (OUT_OF_DATE, _NOT_ASKED_FOR)]
        if not lost or not why:
            return
        stages, pairs = dict.fromkeys(stage for stage, _, _ in lost), {pair_id for _, pair_id, _ in lost}
        what = f"{', '.join(stages)} of {len(pairs)} scan{'s' * (len(pairs) > 1)}"
        refuse_overwrite(f"{self._name} {self.folder.folder}", what, why)


@contextmanager
def experimenting(
    name: str,
    source: Source,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    *,
    stages: tuple[Stage, ...],
    sides: Sequence[str],
    machines: Machines | None = None,
    replace: bool = False,
) -> Iterator[Experiment]:
    """The folder of an experiment, locked.

    Parameters
    ----------
    name : of the experiment, as the command has it
    source : the scans
    out : the folder
    settings : in force
    stages : of the experiment
    sides : of the pairs that it needs
    machines : where work is done
    replace : whether results of a finished experiment may be replaced because something else is requested

    Raises
    ------
    RunError
        The folder holds something else, or is in use.
    """
    check_folder(out, source.path, name)
    folder = RunFolder(out.absolute() if machines and machines.scheduler else out)
    with folder.locked(), RunEngine(folder, settings, machines or Machines(), reporter, (*STAGES, *stages)) as engine:
        yield Experiment(name, engine, source, stages, sides, replace=replace)


def mean_rows(scores: pd.DataFrame, keys: list[str]) -> Iterator[Row]:
    """Of each group of rows with the same keys, nulls among them too: keys, n, mean and std (n - 1) of `value`."""
    for names, values in scores.groupby(keys, dropna=False, sort=False)["value"]:
        mean, std = mean_and_std(values.to_numpy(dtype=np.float64))
        yield dict(zip(keys, names, strict=True)) | {"n": int(values.notna().sum()), "mean": mean, "std": std}


def _dropped(before: Mapping[str, Any], now: Mapping[str, Any], name: str = "") -> Iterator[str]:
    """In words, what was asked for before and is not now: values of a list, a number that was larger, another seed."""
    for key in (key for key in now if key in before):
        own, (old, new) = f"{name}.{key}".lstrip("."), (before[key], now[key])
        if isinstance(new, Mapping):
            yield from _dropped(old, new, own)
        elif isinstance(new, Sequence):
            gone = [each for each in old if each not in new]
            words = [
                " ".join(map(str, [*each.values()][:2])) if isinstance(each, Mapping) else str(each) for each in gone
            ]
            if gone:
                yield f"{own} {', '.join(words[:5])}{' ...' * (len(words) > 5)} not asked for"
        elif new != old if key == _SEED else new < old:
            yield f"{own} was {old}, is {new}"


def _needed(stages: Sequence[Stage]) -> tuple[Stage, ...]:
    """The stages of the pipeline that make what these take, and what those take in turn; in their order."""
    wanted = {table for stage in stages for table in stage.takes}
    needed = []
    for stage in reversed(STAGES):
        if wanted.intersection(stage.gives):
            needed.append(stage)
            wanted.update(stage.takes)
    return tuple(reversed(needed))
