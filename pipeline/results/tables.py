"""Reads one table of a scored pair, after the check that its file is as the run wrote it."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.errors import RunError
from ..storage.tables import table_name
from .finished import FinishedRun


def read_table(
    run: FinishedRun, table: str, pair_id: str, side: str = "", columns: list[str] | None = None
) -> pa.Table:
    """The rows of a table of one pair, and of one side where each side has its own; all columns, or only those named.

    Raises
    ------
    RunError
        The file is damaged or gone.
    """
    name = table_name(table, pair_id, side)
    run.check_file(name)
    try:
        return pq.read_table(run.folder / name, columns=columns, use_threads=False, partitioning=None)
    except (OSError, pa.ArrowInvalid) as error:
        raise RunError(f"run {run.folder}: {name} cannot be read ({error}); run fidpipe run again") from error


def check_tables(run: FinishedRun, pair_id: str) -> None:
    """Raises `RunError` if any table of a scored pair is damaged or gone."""
    for record in run.store.ledger.jobs(pair_id).values():
        for name in record.files:
            run.check_file(name)
