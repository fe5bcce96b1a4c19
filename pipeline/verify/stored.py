"""The tables of one pair as stored, and the sample of it that is recomputed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy import sparse

from ...schemas.columns import SIDES, Row
from ...schemas.record import BaselineSummary
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, IndexArray
from ...stages.literal import literal_method
from ..datasets.pairs import ScanPair
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..results.finished import FinishedRun
from ..storage.run_record import library_versions

#: Table of the values of checks with another name.
TABLE_OF = {"scan": "ground"}


@dataclass(frozen=True)
class Sample:
    """Part of a pair that is recomputed.

    rows : rows of `matching`
    all_nodes : compare the edges of every node, not only of some nodes of the drawn objects
    whole_sides : compare the values of both whole sides
    rng : source of the random nodes
    """

    rows: list[int]
    all_nodes: bool
    whole_sides: bool
    rng: np.random.Generator


@dataclass(frozen=True)
class Part:
    """Rows of a table, stored and recomputed, with the same keys as index; for `is_whole` see `compare`."""

    table: str
    stored: pd.DataFrame
    recomputed: pd.DataFrame
    side: str = ""
    is_whole: bool = True


@dataclass(frozen=True)
class Skipped:
    """Reason why something is not recomputed, and the columns (`table.column`) or tables without comparison."""

    why: str
    columns: Sequence[str] = ()


@dataclass
class StoredPair:
    """The tables of one pair as stored.

    sample : part that is recomputed
    scans : scans of the pair; None if they are missing or have changed
    """

    run: FinishedRun
    pair_id: str
    settings: Settings
    sample: Sample
    scans: ScanPair | None = None
    label_names: dict[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.table: Callable[..., pd.DataFrame] = cache(self._table)
        self.row = self.run.row(self.pair_id)

    def _table(self, name: str, side: str = "") -> pd.DataFrame:
        """Stored table; null keys are -1, other null numbers NaN."""
        rows = self.run.read_table(name, self.pair_id, side)
        frame: pd.DataFrame = rows.to_pandas()
        for key in TABLES[name].keys:
            if pa.types.is_integer(rows.schema.field(key).type):
                frame[key] = frame[key].fillna(-1).astype(np.intp)
        return frame

    def part(self, table: str, recomputed: Any, side: str = "", *, is_whole: bool = True) -> Part:
        """Recomputed rows of a table, a list of rows or columns by name, next to the stored ones, by their keys."""
        name = TABLE_OF.get(table, table)
        keys = list(TABLES[name].keys)
        frame = pd.DataFrame(recomputed, columns=None if len(recomputed) else keys).set_index(keys)
        return Part(table, self.table(name, side).set_index(keys), frame, side, is_whole)

    def in_pairs(self, recomputed: Row) -> Part:
        """Recomputed columns of the pair's row of `pairs`."""
        return values("pairs", {name: self.row[name] for name in recomputed}, recomputed)

    def scan(self, side: str) -> Scan | None:
        """Scan of a side, None if it is missing or has changed."""
        path = self.scans and self.scans.path(side)
        return read_scan(path, self.settings.input.columns_of(side), self.label_names) if path else None

    @cached_property
    def matching(self) -> list[Row]:
        """Rows of `matching`; None for null."""
        rows: list[Row] = self.run.read_table("matching", self.pair_id).to_pylist()
        return rows

    @property
    def matched(self) -> list[Row]:
        """Rows of `matching` with an object of each side."""
        return [row for row in self.matching if row["status"] == "matched"]

    @property
    def drawn_matches(self) -> list[Row]:
        """Matched rows of the sample."""
        return [self.matching[i] for i in self.sample.rows if self.matching[i]["status"] == "matched"]

    def drawn_ids(self, side: str) -> list[int]:
        """Objects of a side in the sample."""
        ids = [self.matching[i][f"{side}_id"] for i in self.sample.rows]
        return [i for i in ids if i is not None]

    def n_kept(self, match: Row) -> int:
        """Expected number of aligned nodes of a matched object: the points of the smaller side."""
        return min(int(self.table("objects", side)["n_points"][match[f"{side}_id"]]) for side in SIDES)

    def members(self, match: Row) -> dict[str, IndexArray]:
        """Points of a matched object, by side."""
        return {side: self.sides[side].members(match[f"{side}_id"]) for side in SIDES}

    def selected(self, match: Row) -> pd.DataFrame:
        """Stored rows of `selection` of a matched object."""
        table = self.table("selection")
        rows: pd.DataFrame = table.loc[table["real_id"] == match["real_id"]]
        return rows

    def kept(self, match: Row) -> dict[str, IndexArray]:
        """Aligned nodes of a matched object, by side."""
        rows = self.selected(match)
        return {side: self.sides[side].index(rows[f"{side}_point_id"]) for side in SIDES}

    def has_same_library(self, name: str) -> bool:
        """True if the installed version of a library is that of the run."""
        return self.run.record.libraries.get(name) == library_versions([name])[name]

    def metadata(self, stage: str, side: str = "") -> dict[str, Any]:
        """Stored metadata of the job of a stage."""
        return self.run.store.ledger.jobs(self.pair_id)[stage, side].metadata

    @cached_property
    def sides(self) -> dict[str, StoredSide]:
        """Both sides."""
        return {side: StoredSide(self, side) for side in SIDES}


class StoredSide:
    """Object points of one side of a stored pair, with their objects and graph."""

    def __init__(self, pair: StoredPair, side: str) -> None:
        self._pair, self.side = pair, side
        ground = pair.table("ground", side)
        self.all_points: FloatArray = ground[["x", "y", "z"]].to_numpy()
        self.is_object = ~ground["is_ground"].to_numpy()
        self.point_ids: IndexArray = ground["point_id"].to_numpy()[self.is_object]
        self.points = self.all_points[self.is_object]
        self.nearest = cache(self._nearest)

    @cached_property
    def labels(self) -> IndexArray:
        """Object of each point, (n,); -1 for none."""
        communities = self._pair.table("communities", self.side)
        labels = np.full(len(self.points), -1, dtype=np.intp)
        labels[self.index(communities["point_id"])] = communities["community_id"]
        return labels

    @property
    def sizes(self) -> IndexArray:
        """Number of points of each object of the side, by id."""
        n_objects = len(self._pair.table("objects", self.side))
        return np.bincount(self.labels[self.labels >= 0], minlength=n_objects)

    def members(self, community: int) -> IndexArray:
        """Points of an object, by index."""
        return np.flatnonzero(self.labels == community)

    def index(self, point_ids: Any) -> IndexArray:
        """Indices of points by their ids; ValueError if one is not an object point."""
        ids = np.asarray(point_ids, dtype=np.intp)
        index: IndexArray = np.minimum(np.searchsorted(self.point_ids, ids), len(self.point_ids) - 1)
        is_strange = self.point_ids[index] != ids
        if is_strange.any():
            raise ValueError(f"point {ids[is_strange][0]} is not an object point of the {self.side} side")
        return index

    @cached_property
    def edges(self) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Both ends of each edge by index, and the lengths."""
        graph = self._pair.table("graph", self.side)
        return self.index(graph["src"]), self.index(graph["dst"]), graph["length_m"].to_numpy(dtype=np.float64)

    @cached_property
    def adjacency(self) -> sparse.csr_array:
        """Edge lengths, (n, n); lengths of 0 are kept as edges."""
        src, dst, length = self.edges
        n = len(self.points)
        ends = np.concatenate([src, dst]), np.concatenate([dst, src])
        return sparse.coo_array((np.concatenate([length, length]), ends), shape=(n, n)).tocsr()

    def _nearest(self, node: int) -> frozenset[int]:
        """The k nearest neighbours of a node among all points."""
        settings = self._pair.settings.graph
        return frozenset(literal_method.nearest(self.points, node, settings.k, settings.ties))

    def neighbours(self, node: int) -> set[int]:
        """Nodes connected to a node by an edge."""
        row = slice(self.adjacency.indptr[node], self.adjacency.indptr[node + 1])
        return set(self.adjacency.indices[row].tolist())

    def matrix(self, nodes: IndexArray) -> FloatArray:
        """Edge lengths among some nodes, (k, k), dense."""
        dense: FloatArray = self.adjacency[nodes][:, nodes].toarray()
        return dense


def values(table: str, stored: Row, recomputed: Row, side: str = "", **keys: Any) -> Part:
    """Single values, such as metadata of a job, as frames of one row; `keys` identify the owner."""
    index = pd.MultiIndex.from_arrays([[key] for key in keys.values()], names=list(keys)) if keys else None
    a, b = (pd.DataFrame([row], index=index, columns=list(recomputed)) for row in (stored, recomputed))
    return Part(table, a, b, side, is_whole=False)


def summaries(stored: Sequence[BaselineSummary], recomputed: Sequence[tuple[Any, ...]]) -> Part:
    """Means over pairs in `run.json`, and the recomputed ones as baseline, level, mean, std, n, n_null."""
    columns = ["baseline", "level", "mean", "std", "n", "n_null"]
    rows = [tuple(getattr(summary, name) for name in columns) for summary in stored]
    a, b = (pd.DataFrame(own, columns=columns).set_index(columns[:2]) for own in (rows, recomputed))
    return Part("run.json", a, b)
