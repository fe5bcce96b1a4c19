"""A finished run as it is read again: its record, its pairs, and the objects of one pair; nothing is computed.

What is read is checked against the run's index, so that a damaged table is named and not believed. Leaves to others:
showing (`report`), judging (`gate`, `compare`).
"""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ..storage.ledger import JobName
from ..storage.record import read_run
from ..storage.store import Store

Row = dict[str, Any]


@dataclass(frozen=True)
class PairObjects:
    """The objects of a pair.

    row : of `pairs`
    sides : by side, the rows of `objects`; the place in the list is the object's id
    matched : rows of `metrics`
    missing, hallucinated : ids of the unmatched objects of the real and of the simulated side
    """

    row: Row
    sides: dict[str, list[Row]]
    matched: list[Row]
    missing: list[int]
    hallucinated: list[int]


class FinishedRun:
    """A run that has ended.

    Raises
    ------
    RunError
        The folder is no run, the run has not ended, or its table of pairs is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.record = read_run(folder)
        if not self.record or self.record.get("experiment", "run") != "run":
            raise RunError(f"run {folder}: no run.json of fidpipe run found; a folder written by fidpipe run is wanted")
        if not {"summary", "findings"} <= self.record.keys():
            raise RunError(
                f"run {folder}: the run has not ended, or an older fidpipe wrote it; "
                f"finish it with: fidpipe run {self.record.get('dataset')} --out {folder}"
            )
        self.store = Store(folder)
        self.rows = self._read(("pairs", "", ""), "pairs.parquet")
        self._row_of = {row["pair_id"]: row for row in self.rows}

    @property
    def scored(self) -> list[Row]:
        """The rows of the scored pairs, by name."""
        return [row for row in self.rows if row["status"] == "scored"]

    def row(self, pair_id: str) -> Row:
        """The row of a pair; `RunError` if the run does not have it."""
        if pair_id not in self._row_of:
            near = get_close_matches(pair_id, self._row_of, 3) or list(self._row_of)[:3]
            raise RunError(
                f"run {self.folder}: no pair {pair_id!r} among its {len(self.rows)}; "
                f"it has {', '.join(repr(name) for name in near)} ..."
            )
        return self._row_of[pair_id]

    def check(self, pair_id: str) -> None:
        """Raises `RunError` if a table of objects or scores of a scored pair is damaged."""
        for job, name in self._jobs(pair_id):
            self.check_file(job, name)

    def objects(self, pair_id: str) -> PairObjects:
        """The objects of a scored pair; `RunError` if it failed or a table is damaged."""
        row = self.row(pair_id)
        if row["status"] != "scored":
            raise RunError(f"run {self.folder}, pair {pair_id}: it failed and has no objects ({row['reason']})")
        sides = {side: self.side_objects(pair_id, side) for side in SIDES}
        matched = self._read(("metrics", pair_id, ""), self._name("metrics", pair_id))
        alone = [sorted({of["community_id"] for of in sides[s]} - {of[f"{s}_id"] for of in matched}) for s in SIDES]
        return PairObjects(row, sides, matched, *alone)

    def side_objects(self, pair_id: str, side: str) -> list[Row]:
        """The objects of one side of a scored pair."""
        return self._read(("communities", pair_id, side), self._name("objects", pair_id, side))

    def _name(self, table: str, pair_id: str, side: str = "") -> str:
        return str(self.store.path(table, pair_id, side).relative_to(self.folder))

    def _jobs(self, pair_id: str) -> list[tuple[JobName, str]]:
        """The jobs that made the objects and scores of a pair, and the table of each."""
        sides = [(("communities", pair_id, side), self._name("objects", pair_id, side)) for side in SIDES]
        return [*sides, (("metrics", pair_id, ""), self._name("metrics", pair_id))]

    def _read(self, job: JobName, name: str) -> list[Row]:
        self.check_file(job, name)
        rows: list[Row] = pq.read_table(self.folder / name, use_threads=False).to_pylist()
        return rows

    def check_file(self, job: JobName, name: str) -> None:
        """Raises `RunError` if a file is not as the job wrote it, or gone."""
        record = self.store.records.get(job)
        if record is None or not self.store.is_whole(record):
            raise RunError(
                f"run {self.folder}: {name} is damaged or gone; run it again with: "
                f"fidpipe run {self.record['dataset']} --out {self.folder}"
            )
