"""The tables of one pair while jobs run on it: those just made, and those that are read when first asked for.

A table that comes from the job before it and one that comes from the run's folder are the same, value for value.
Leaves to others: what is made of them (`jobs`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ...schemas.columns import SIDES
from ...schemas.errors import StageError
from ...schemas.settings import Settings
from ...stages.arrays import FloatArray, IntArray
from ...stages.linalg.subgraph import Edges, Subgraph, split_by_community
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..storage.ledger import JobRecord
from ..storage.store import TableFolder, hash_file
from .task import Facts, Job, ObjectScores, PairTask, Tables


class Workbench:
    """The tables of one pair while jobs run on it: those just made, and those that are read when first asked for."""

    def __init__(
        self, task: PairTask, scans: Mapping[str, Scan] | None = None, scores: list[ObjectScores] | None = None
    ) -> None:
        self.task = task
        self.pair_id = task.pair.pair_id
        self.settings = task.settings
        self.scores = scores
        self._scans = scans or {}
        self._folder = None if task.folder is None else TableFolder(task.folder, task.token)
        self._tables: dict[tuple[str, str], pa.Table] = {}
        self._facts = {(job.stage, job.side): job.facts for job in task.jobs}
        self._steps: list[tuple[str, float]] = []
        self._subgraphs: dict[str, dict[int, Subgraph]] = {}

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Times a step of the job at hand."""
        start = perf_counter()
        try:
            yield
        finally:
            self._steps.append((name, perf_counter() - start))

    def watch(self, name: str) -> AbstractContextManager[None]:
        """The same, for a stage that names its steps."""
        return self.step(name)

    def add_steps(self, of_parts: Iterable[tuple[tuple[str, float], ...]]) -> None:
        """Counts steps of the job at hand that ran elsewhere."""
        for steps in of_parts:
            self._steps.extend(steps)

    def take_steps(self) -> tuple[tuple[str, float], ...]:
        """Seconds by step since the last call."""
        total: dict[str, float] = {}
        for name, seconds in self._steps:
            total[name] = total.get(name, 0.0) + seconds
        self._steps.clear()
        return tuple(total.items())

    def job(self, stage: str, side: str = "") -> Job:
        """A job of this pair."""
        return next(job for job in self.task.jobs if (job.stage, job.side) == (stage, side))

    def facts(self, stage: str, side: str = "") -> Facts:
        """The facts of a finished job."""
        return self._facts[stage, side]

    def table(self, name: str, side: str = "", columns: list[str] | None = None) -> pa.Table:
        """A table of this pair; where it must be read, all of it or only some columns."""
        if (name, side) not in self._tables:
            job = next(job for job in self.task.jobs if name in job.gives and job.side == side)
            if self._folder is None or job.stored is None:
                raise RuntimeError(f"table {name} of side {side!r} is asked for before its job {job.stage} is done")
            path = self._folder.path(name, self.pair_id, side)
            stored = job.stored[str(path.relative_to(self._folder.folder))]
            with self.step("read"):
                self._tables[name, side] = self._folder.read(name, stored, path, columns)
        return self._tables[name, side]

    def finish(self, job: Job, tables: Tables, facts: Facts) -> JobRecord:
        """Keeps and writes what a job has made."""
        files = {}
        for name, rows in tables.items():
            self._tables[name, job.side] = rows
            if self._folder is not None:
                with self.step("write"):
                    written, stored = self._folder.write(name, rows, job.key, self.pair_id, job.side)
                files[written] = stored
        self._facts[job.stage, job.side] = facts
        record = JobRecord(job.stage, self.pair_id, job.side, job.key, files, facts, self.take_steps())
        if self._folder is not None:
            self._folder.note_job(record)
        return record

    def scan(self, side: str) -> Scan:
        """The scan of a side, whose file must be the one that the keys were made of."""
        if side in self._scans:
            return self._scans[side]
        path = self.task.pair.path(side)
        if path is None:
            raise StageError(f"no {side} scan")
        scan = read_scan(path, self.settings.input.columns, dict(self.task.label_names))
        if hash_file(path) != self.task.input_hashes[side]:
            raise StageError(f"{path}: the file changed while the run was using it; run the same command again")
        return scan

    def object_points(self, side: str) -> tuple[IntArray, FloatArray]:
        """Ids and coordinates of the points that are not ground."""
        ground = self.table("ground", side)
        ground = ground.filter(pc.invert(ground.column("is_ground")))
        return as_numpy(ground, "point_id"), np.column_stack([as_numpy(ground, axis) for axis in "xyz"])

    def edges(self, side: str, point_ids: IntArray) -> Edges:
        """The graph of a side by node index."""
        graph = self.table("graph", side, ["src", "dst", "length_m"])
        index_of = np.zeros(int(point_ids[-1]) + 1, dtype=np.int32)
        index_of[point_ids] = np.arange(len(point_ids), dtype=np.int32)
        return Edges(index_of[as_numpy(graph, "src")], index_of[as_numpy(graph, "dst")], as_numpy(graph, "length_m"))

    def subgraph(self, side: str, community: int) -> Subgraph:
        """One matched object of a side."""
        if side not in self._subgraphs:
            point_ids, points = self.object_points(side)
            edges = self.edges(side, point_ids)
            labels = as_numpy(self.table("communities", side), "community_id")
            matched = as_numpy(self.matched(), f"{side}_id")
            with self.step("subgraphs"):
                self._subgraphs[side] = split_by_community(point_ids, points, edges, labels, matched.tolist())
        return self._subgraphs[side][community]

    def under(self, settings: Settings, shared: Iterable[str]) -> Workbench:
        """A bench in memory for the same pair under other settings, which has these tables of both sides in common."""
        other = Workbench(replace(self.task, settings=settings, folder=None))
        other._tables = {(name, side): self.table(name, side) for name in shared for side in SIDES}
        other._facts |= self._facts
        return other

    def matched(self, real_ids: Iterable[int] | None = None) -> pa.Table:
        """The matched rows of `matching`, all or those of some real objects."""
        matching = self.table("matching")
        matched = matching.filter(pc.equal(matching.column("status"), "matched"))
        if real_ids is None:
            return matched
        return matched.filter(pc.is_in(matched.column("real_id"), pa.array(list(real_ids), pa.int32())))


def as_numpy(table: pa.Table, column: str) -> Any:
    """A column as an array."""
    return table.column(column).to_numpy()
