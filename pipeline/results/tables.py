"""Reads one table of a scored pair, after the check that its file is as the run wrote it."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.errors import RunError
from ..run import STAGES
from .finished import FinishedRun

_STAGE_OF = {table: stage for stage in STAGES for table in stage.gives}


def read_table(
    run: FinishedRun, table: str, pair_id: str, side: str = "", columns: list[str] | None = None
) -> pa.Table:
    """The rows of a table of one pair, and of one side where each side has its own; all columns, or only those named.

    Raises
    ------
    RunError
        The file is damaged or gone.
    """
    path = run.store.path(table, pair_id, side)
    name = str(path.relative_to(run.folder))
    run.check_file((_STAGE_OF[table].name, pair_id, side), name)
    try:
        return pq.read_table(path, columns=columns, use_threads=False, partitioning=None)
    except (OSError, pa.ArrowInvalid) as error:
        raise RunError(f"run {run.folder}: {name} cannot be read ({error}); run fidpipe run again") from error


def check_tables(run: FinishedRun, pair_id: str) -> None:
    """Raises `RunError` if any table of a scored pair is damaged or gone."""
    for table, stage in _STAGE_OF.items():
        for side in stage.sides:
            name = str(run.store.path(table, pair_id, side).relative_to(run.folder))
            run.check_file((stage.name, pair_id, side), name)
