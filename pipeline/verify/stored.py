"""The tables of one pair as stored, and the sample of it that is recomputed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy import sparse

from ...schemas.columns import SIDES, Row
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, IndexArray
from ...stages.literal import literal_method
from ..datasets.pairs import ScanPair
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..results.finished import FinishedRun
from .compare_frames import TABLE_OF, Tally


@dataclass
class StoredPair:
    """The tables of one pair as stored, and the sample of it that is recomputed.

    tally : of the comparisons
    drawn : rows of `matching` to recompute
    all_nodes : compare the edges of every node, not only of some nodes of the drawn objects
    whole_sides : compare the values of both whole sides
    rng : source of the random nodes
    scans : scans of the pair; None if they are missing or have changed
    """

    run: FinishedRun
    pair_id: str
    settings: Settings
    tally: Tally
    drawn: list[int]
    all_nodes: bool
    whole_sides: bool
    rng: np.random.Generator
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

    def compare(self, table: str, recomputed: Any, side: str = "", *, is_whole: bool = True) -> None:
        """Compare recomputed rows of a table, as a list or columns by name, with the stored ones by their keys."""
        name = TABLE_OF.get(table, table)
        keys = list(TABLES[name].keys)
        frame = pd.DataFrame(recomputed, columns=None if len(recomputed) else keys).set_index(keys)
        stored = self.table(name, side).set_index(keys)
        self.tally.compare(table, stored, frame, pair_id=self.pair_id, side=side, is_whole=is_whole)

    def compare_values(self, table: str, stored: Row, recomputed: Row, side: str = "", **keys: Any) -> None:
        """Compare single values by name; see `Tally.compare_values`."""
        self.tally.compare_values(table, stored, recomputed, pair_id=self.pair_id, side=side, **keys)

    def compare_row(self, recomputed: Row) -> None:
        """Compare recomputed columns of the pair's row of `pairs`."""
        self.compare_values("pairs", {name: self.row[name] for name in recomputed}, recomputed)

    def scan(self, side: str) -> Scan | None:
        """Scan of a side, None if it is missing or has changed."""
        path = self.scans and self.scans.path(side)
        return read_scan(path, self.settings.input.columns_of(side), self.label_names) if path else None

    @cached_property
    def matches(self) -> pd.DataFrame:
        """Rows of `matching` with an object of each side, their sizes, and `n_keep`, the smaller one."""
        rows = self.table("matching")
        rows = rows[rows["status"] == "matched"].drop(columns=["pair_id", "status"])
        for side in SIDES:
            rows[f"n_{side}"] = self.table("objects", side)["n_points"].to_numpy()[rows[f"{side}_id"]]
        return rows.assign(n_keep=rows[["n_real", "n_sim"]].min(axis=1))

    @property
    def drawn_matches(self) -> list[Row]:
        """Matched rows of the sample that have stored nodes; others without them are a difference of `selection`."""
        is_stored = self.matches["real_id"].isin(self.table("selection")["real_id"])
        return rows_of(self.matches[is_stored & self.matches.index.isin(self.drawn)])

    def drawn_ids(self, side: str) -> list[int]:
        """Objects of a side in the sample."""
        ids = self.table("matching")[f"{side}_id"].iloc[self.drawn]
        return [i for i in ids.tolist() if i >= 0]

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

    def points(self, nodes: dict[str, IndexArray]) -> tuple[FloatArray, FloatArray]:
        """Some points of both sides, (n, 3) and (m, 3)."""
        return self.sides["real"].points[nodes["real"]], self.sides["sim"].points[nodes["sim"]]

    def laplacians(self, nodes: dict[str, IndexArray]) -> tuple[FloatArray, FloatArray]:
        """Normalised Laplacians, dense, of the graphs among some nodes of both sides."""
        return self.sides["real"].laplacian(nodes["real"]), self.sides["sim"].laplacian(nodes["sim"])

    def metadata(self, stage: str, side: str = "") -> dict[str, Any]:
        """Stored metadata of the job of a stage."""
        return self.run.store.ledger.jobs(self.pair_id)[stage, side].metadata

    @cached_property
    def sides(self) -> dict[str, StoredSide]:
        """Both sides."""
        return {side: StoredSide(self, side) for side in SIDES}


def rows_of(frame: pd.DataFrame) -> list[Row]:
    """Rows of a frame as dictionaries by column."""
    rows: Any = frame.to_dict("records")
    return list(rows)


class StoredSide:
    """Object points of one side of a stored pair, with their objects and graph."""

    def __init__(self, pair: StoredPair, side: str) -> None:
        self._pair, self.side = pair, side
        ground = pair.table("ground", side)
        self.all_points: FloatArray = ground[["x", "y", "z"]].to_numpy()
        self.is_object = ~ground["is_ground"].to_numpy()
        self.point_ids: IndexArray = ground["point_id"].to_numpy()[self.is_object]
        self.points = self.all_points[self.is_object]
        graph = pair.settings.graph
        self.nearest = cache(lambda node: {*literal_method.nearest(self.points, node, graph.k, graph.ties)})

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

    def neighbours(self, node: int) -> set[int]:
        """Nodes connected to a node by an edge."""
        row = slice(self.adjacency.indptr[node], self.adjacency.indptr[node + 1])
        return set(self.adjacency.indices[row].tolist())

    def laplacian(self, nodes: IndexArray) -> FloatArray:
        """Normalised Laplacian of the graph among some nodes, (k, k), dense."""
        return literal_method.laplacian(self.adjacency[nodes][:, nodes].toarray())
