"""The jobs of one pair in memory: the same plan as a run's, but nothing is read from a folder or written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import pyarrow as pa

from ...schemas.errors import StageError
from ..datasets.readers.scan import Scan
from ..stage import OBJECTS, Grain, Inputs, Memo, Metadata
from .plan import Job
from .worker import job_title

#: Tables of a pair by name and side.
PairTables = dict[tuple[str, str], pa.Table]


def run_in_memory(
    jobs: Iterable[Job], scans: Mapping[str, Scan], pair_id: str
) -> tuple[PairTables, dict[tuple[str, str], Metadata]]:
    """Run the jobs of a pair one after the other; returns their tables, and the metadata of the job of each table.

    Parameters
    ----------
    jobs : in their order, from `Planner.jobs`
    scans : by side

    Raises
    ------
    StageError
        A stage fails; with the name of its job.
    """
    tables: PairTables = {}
    outputs: dict[tuple[str, str], Metadata] = {}
    matched: tuple[int, ...] = ()
    memo = Memo()
    for job in jobs:
        inputs = _inputs(job, scans, tables, outputs, pair_id, memo, matched)
        try:
            result = job.stage.make(inputs)
        except StageError as error:
            raise StageError(f"{job_title(*job.name)}: {error}") from error
        metadata = result.metadata
        if job.stage.gather is not None:
            metadata = job.stage.gather(inputs, result.tables)
        for name, table in result.tables.items():
            tables[name, job.part] = table
            outputs[name, job.part] = metadata
        if OBJECTS in metadata:
            matched = tuple(number for number, _ in metadata[OBJECTS])
    return tables, outputs


def _inputs(
    job: Job,
    scans: Mapping[str, Scan],
    tables: PairTables,
    outputs: Mapping[tuple[str, str], Metadata],
    pair_id: str,
    memo: Memo,
    matched: tuple[int, ...],
) -> Inputs:
    """The argument of a job: its declared inputs."""
    declared: dict[tuple[str, str], Callable[[], pa.Table]] = {}
    metadata = {}
    own_scans = {}
    for source in job.sources:
        name = source.table, source.side
        if source.maker is None:
            own_scans[source.side] = partial(_same, scans[source.side])
            continue
        if source.columns:
            declared[name] = partial(_same, tables[name].select(source.columns))
        metadata[name] = outputs[name]
    return Inputs(
        pair_id=pair_id,
        part=job.part,
        settings=job.settings,
        tables=declared,
        outputs=metadata,
        scans=own_scans,
        objects=matched if job.stage.grain is Grain.OBJECT else (),
        arguments=job.arguments,
        memo=memo,
    )


def _same(value: Any) -> Any:
    return value
