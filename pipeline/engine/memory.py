"""The jobs of one pair in memory: the same plan as a run's, but nothing is read from a folder or written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pyarrow as pa

from ...schemas.errors import StageError
from ..datasets.readers.scan import Scan
from ..stage import OBJECTS, Grain, Memo, Metadata
from ..storage.table_files import JobId
from .inputs import declared_inputs
from .plan import Job, Source
from .worker import job_title

#: Tables of a pair by name and side.
PairTables = dict[tuple[str, str], pa.Table]


def run_in_memory(
    jobs: Iterable[Job],
    scans: Mapping[str, Scan],
    pair_id: str,
    T_real_sim: tuple[float, ...] | None = None,
) -> tuple[PairTables, dict[JobId, Metadata]]:
    """Run the jobs of a pair one after the other; returns their tables and metadata.

    Parameters
    ----------
    jobs : in their order, from `Planner.jobs`
    scans : by side
    T_real_sim : 12 numbers, [R | t] row by row: maps simulated points into the real sensor's frame

    Raises
    ------
    StageError
        A stage fails; with the name of its job.
    """
    tables: PairTables = {}
    outputs: dict[JobId, Metadata] = {}
    matched: tuple[int, ...] = ()
    memo = Memo()

    def read_table(source: Source) -> pa.Table:
        return tables[source.table, source.side].select(source.columns)

    for job in jobs:
        inputs = declared_inputs(
            job,
            read_table,
            scans.__getitem__,
            outputs,
            T_real_sim,
            pair_id=pair_id,
            objects=matched if job.stage.grain is Grain.OBJECT else (),
            memo=memo,
        )
        try:
            result = job.stage.make(inputs)
        except StageError as error:
            raise StageError(f"{job_title(*job.name)}: {error}") from error
        metadata = result.metadata
        if job.stage.gather is not None:
            metadata = job.stage.gather(inputs, result.tables)
        outputs[job.name] = metadata
        for name, table in result.tables.items():
            tables[name, job.part] = table
        if OBJECTS in metadata:
            matched = tuple(number for number, _ in metadata[OBJECTS])
    return tables, outputs
