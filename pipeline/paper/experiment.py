"""Common parts of the experiments perturb and ablate: each is one stage, run by the engine on the pairs of a dataset.

What an experiment was asked for is a group of settings of its own, so that keys, resuming and the
record are those of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from ...schemas.columns import Row
from ...schemas.record import RunHeader
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.summary import mean_and_std
from ..datasets.pairs import Dataset, ScanPair, read_dataset, read_label_names
from ..datasets.readers.scan_ref import scan_ref
from ..engine.engine import Machines
from ..engine.progress import Reporter
from ..engine.worker import PairTables, run_in_memory
from ..jobs import STAGES, baselines_job
from ..run import Run
from ..run_tables import records_of, write_table
from ..stage import SCAN, Inputs, JobResult, Stage
from ..storage.files import key_of
from ..storage.folder import RunFolder, check_folder
from ..storage.run_record import library_versions, write_record
from ..storage.table_files import JobRecord

#: From the tables of all pairs by name, frames with a row per score and its `value`.
Scores = Callable[[Mapping[str, pd.DataFrame]], list[pd.DataFrame]]


@dataclass(frozen=True, kw_only=True)
class ExperimentOutcome:
    """Outcome of an experiment.

    failures : reasons by failed pair
    n_made, n_reused : number of pairs
    pairs : names of the finished ones
    tables : all tables over all pairs, by name
    """

    folder: Path
    settings: Settings
    failures: dict[str, str]
    n_made: int
    n_reused: int
    pairs: list[str]
    tables: dict[str, pa.Table]


def experiment_stage(
    name: str,
    version: int,
    tables: tuple[str, ...],
    make: Callable[[Inputs], JobResult],
) -> Stage:
    """The stage of an experiment; it may call the code of any other stage, and read all settings.

    Parameters
    ----------
    version : increase it when the same request results in other numbers
    tables : names of the tables that it makes
    """
    stages = (*STAGES, baselines_job.STAGE)
    libraries = chain.from_iterable(stage.libraries for stage in stages)
    groups = [group for group in Settings.model_fields if group != "machine"]
    return Stage(
        name=name,
        takes=(SCAN,),
        gives=tables,
        settings=(*groups, name),
        version=version + sum(stage.version for stage in stages),
        make=make,
        libraries=tuple(dict.fromkeys(libraries)),
        is_long=True,
    )


def settings_of(settings: Settings) -> Settings:
    """The settings of a run, without those of the experiment."""
    groups = vars(settings)
    return Settings(**{name: groups[name] for name in groups if name in Settings.model_fields})


def run_stages(inputs: Inputs, stages: Sequence[Stage], sides: Sequence[str]) -> PairTables:
    """Tables of stages on some sides of a pair, in memory."""
    scans = {side: inputs.scans[side]() for side in sides}
    pair = ScanPair(inputs.pair_id, None, None, T_real_sim=inputs.T_real_sim)
    return run_in_memory(stages, inputs.settings, pair=pair, scans=scans)[0]


def read_source(path: Path) -> Dataset:
    """The pairs of a dataset, or a scan file as a dataset of one pair without a simulated side.

    Raises
    ------
    DatasetError
        No dataset exists, or it is invalid.
    """
    scan = scan_ref(path)
    if not scan.exists:
        return read_dataset(path)
    folder = scan.file.resolve().parent
    names = read_label_names(folder) or read_label_names(folder.parent)
    return Dataset(path, (ScanPair(scan.stem, scan, None),), names)


def run_experiment(
    stage: Stage,
    source: Dataset,
    selected: Iterable[ScanPair],
    out: Path,
    settings: Settings,
    reporter: Reporter,
    scores: Scores,
    *,
    n_workers: int | None = None,
    replace_finished: bool = False,
) -> ExperimentOutcome:
    """Evaluate the selected pairs that have no current result, and write the tables over all pairs that have one.

    Parameters
    ----------
    source : all pairs
    selected : those to evaluate
    out : folder of the results
    settings : those of a run, and what the experiment was asked for
    scores : rows of which the table `NAME_summary` has the means
    n_workers : processes; None for one per core
    replace_finished : allow results of a finished experiment to be replaced by another request

    Raises
    ------
    RunError
        The folder holds something else, is in use, or holds a finished experiment of another
        request.
    """
    check_folder(out, source.folder, stage.name)
    folder = RunFolder(out)
    names = {pair.pair_id for pair in selected}
    with folder.locked():
        run = _ExperimentRun(source, names, folder, (stage,), settings, reporter)
        run.survey_results(replace=replace_finished)
        with run.schedule(Machines(n_workers)) as schedule:
            schedule.run()
        records = list(records_of(folder, (stage,), [pair.pair_id for pair in source.pairs]))
        tables = _write_tables(stage, folder, records, scores)
        run.write_results()
    return ExperimentOutcome(
        folder=out,
        settings=settings,
        failures=run.collector.failures,
        n_made=run.collector.n_made,
        n_reused=len(records) - run.collector.n_made,
        pairs=[record.pair_id for record in records],
        tables=tables,
    )


class _ExperimentRun(Run):
    """A run of the stage of an experiment, whose record has no results but failures."""

    def write_results(self) -> None:
        """Write the record of an experiment that has ended."""
        failures = self.collector.failures
        wall_s = self.wall_s["total"]
        self._write_record(self._header(), failures=failures, wall_s=wall_s)

    def _write_record(self, record: RunHeader, **results: Any) -> None:
        """Write settings that a run can take, and the record."""
        content = {"experiment": self.stages[0].name, **record.as_dict(), **results}
        settings = settings_of(self.settings)
        write_record(self.folder, settings, content)


def _write_tables(
    stage: Stage,
    folder: RunFolder,
    records: list[JobRecord],
    scores: Scores,
) -> dict[str, pa.Table]:
    """Join the tables of all pairs, summarise them, and write both; returns them by name."""
    key = key_of(library_versions(["fidpipe"]), sorted(record.key for record in records))
    tables = {}
    for name in stage.gives:
        parts = [folder.read_table(name, record.pair_id) for record in records]
        tables[name] = write_table(folder, name, key, parts)
    frames = scores({name: table.to_pandas() for name, table in tables.items()})
    summary = f"{stage.name}_summary"
    tables[summary] = write_table(
        folder, summary, key, TABLES[summary].from_rows(_means(frames))
    )
    return tables


def _means(frames: Iterable[pd.DataFrame]) -> Iterator[Row]:
    """Number, mean and standard deviation (n - 1) of `value` where all other columns are equal."""
    for scores in frames:
        keys = [name for name in scores.columns if name != "value"]
        for group, values in scores.groupby(keys, sort=False)["value"]:
            mean, std = mean_and_std(values.to_numpy(dtype=np.float64))
            n = int(values.notna().sum())
            row: Row = dict(zip(keys, group, strict=True))
            yield row | {"n": n, "n_pairs": n, "mean": mean, "std": std}
