"""The tables of one pair as they are stored, and what of it is computed again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from ...schemas.columns import SIDES, Row
from ...schemas.settings import Settings
from ...stages.arrays import FloatArray, IndexArray
from ...stages.literal import method
from ..datasets.pairs import ScanPair
from ..jobs import EXTRAS, STAGES
from ..results.finished import FinishedRun
from ..stage import Stage
from ..storage.record import library_versions
from .comparisons import Place


@dataclass(frozen=True)
class Drawn:
    """What of a pair is computed again.

    rows : of `matching`
    all_nodes : compare the edges of every node, not only of some of the drawn objects
    whole_sides : compare what is told of both whole sides
    rng : draws the nodes
    """

    rows: list[int]
    all_nodes: bool
    whole_sides: bool
    rng: np.random.Generator


class StoredPair:
    """The tables of one pair as they are stored.

    Parameters
    ----------
    drawn : what of it is computed again
    scans : where the scans lie; None where they are gone or others
    """

    def __init__(
        self,
        run: FinishedRun,
        pair_id: str,
        settings: Settings,
        drawn: Drawn,
        scans: ScanPair | None = None,
        label_names: dict[int, str] | None = None,
    ) -> None:
        self.pair_id, self.settings, self.drawn = pair_id, settings, drawn
        self.scans, self.label_names = scans, label_names or {}
        self.row = run.row(pair_id)
        self._run = run
        self._columns: dict[tuple[str, str], dict[str, Any]] = {}

    def place(self, table: str, side: str = "", object_: str = "") -> Place:
        """Where a number of this pair stands."""
        return Place(table, self.pair_id, side, object_)

    def columns(self, table: str, side: str = "") -> dict[str, Any]:
        """The columns of a table as arrays; null numbers are NaN, null words None."""
        if (table, side) not in self._columns:
            rows = self._run.read_table(table, self.pair_id, side)
            self._columns[table, side] = {
                name: rows.column(name).to_numpy(zero_copy_only=False) for name in rows.column_names
            }
        return self._columns[table, side]

    def rows(self, table: str, side: str = "") -> list[Row]:
        """The rows of a table."""
        rows: list[Row] = self._run.read_table(table, self.pair_id, side).to_pylist()
        return rows

    @cached_property
    def matching(self) -> list[Row]:
        """The rows of `matching`."""
        return self.rows("matching")

    @property
    def matched(self) -> list[Row]:
        """The rows of `matching` whose objects both sides have."""
        return [row for row in self.matching if row["status"] == "matched"]

    def n_kept(self, match: Row) -> int:
        """How many aligned nodes a matched object must have: the points of the smaller side."""
        return min(int(self.columns("objects", side)["n_points"][match[f"{side}_id"]]) for side in SIDES)

    @property
    def drawn_matches(self) -> list[Row]:
        """The drawn rows of `matching` whose objects both sides have."""
        return [self.matching[i] for i in self.drawn.rows if self.matching[i]["status"] == "matched"]

    def drawn_ids(self, side: str) -> list[int]:
        """The drawn objects of a side."""
        ids = [self.matching[i][f"{side}_id"] for i in self.drawn.rows]
        return [i for i in ids if i is not None]

    def members(self, match: Row) -> dict[str, IndexArray]:
        """The points of a matched object, by side."""
        return {side: self.sides[side].members(match[f"{side}_id"]) for side in SIDES}

    def kept(self, match: Row) -> dict[str, IndexArray]:
        """Its aligned nodes, by side."""
        stored = self.columns("selection")
        own = stored["real_id"] == match["real_id"]
        return {side: self.sides[side].index(stored[f"{side}_point_id"][own]) for side in SIDES}

    @property
    def tables(self) -> list[tuple[str, str]]:
        """The tables of the pair that today's stages have made, each with its side, "" where it has both."""
        versions, stages = self._run.record.stages, wanted_stages(self.settings)
        stages = [stage for stage in stages if versions.get(stage.name, stage.version) == stage.version]
        return [(table, side) for stage in stages for side in stage.parts for table in stage.gives]

    def n_objects(self, side: str) -> int:
        """How many objects `objects` has of a side."""
        return len(self.columns("objects", side)["community_id"])

    def has_same_library(self, name: str) -> bool:
        """Whether the installed version of a library is that of the run."""
        return self._run.record.libraries.get(name) == library_versions([name])[name]

    def facts(self, stage: str, side: str = "") -> dict[str, Any]:
        """What the job of a stage noted."""
        return self._run.store.ledger.jobs(self.pair_id)[stage, side].facts

    @cached_property
    def sides(self) -> dict[str, StoredSide]:
        """Both sides."""
        return {side: StoredSide(self, side) for side in SIDES}


class StoredSide:
    """The object points of one side of a stored pair, with their objects and their graph."""

    def __init__(self, pair: StoredPair, side: str) -> None:
        self._pair, self.side = pair, side
        self._nearest: dict[int, frozenset[int]] = {}
        ground = pair.columns("ground", side)
        self.all_points: FloatArray = np.column_stack([ground[axis] for axis in "xyz"])
        self.is_object = ~ground["is_ground"].astype(bool)
        self.point_ids: IndexArray = ground["point_id"][self.is_object].astype(np.intp)
        self.points = self.all_points[self.is_object]

    @cached_property
    def labels(self) -> IndexArray:
        """The object of each point, (n,)."""
        communities = self._pair.columns("communities", self.side)
        index_of = self.index(communities["point_id"])
        labels = np.full(len(self.points), -1, dtype=np.intp)
        labels[index_of] = communities["community_id"]
        return labels

    def members(self, community: int) -> IndexArray:
        """The points of an object, by index."""
        return np.flatnonzero(self.labels == community)

    def index(self, point_ids: Any) -> IndexArray:
        """Indices of some points by their ids; ValueError where one is no object point."""
        wanted = np.asarray(point_ids, dtype=np.intp)
        index: IndexArray = np.minimum(np.searchsorted(self.point_ids, wanted), len(self.point_ids) - 1)
        strange = self.point_ids[index] != wanted
        if strange.any():
            raise ValueError(f"point {wanted[strange][0]} is no object point of the {self.side} side")
        return index

    @cached_property
    def edges(self) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Both ends of each edge by index, and its length."""
        graph = self._pair.columns("graph", self.side)
        return self.index(graph["src"]), self.index(graph["dst"]), graph["length_m"].astype(np.float64)

    @cached_property
    def adjacency(self) -> sparse.csr_array:
        """Edge lengths, (n, n); lengths of 0 are kept as edges."""
        src, dst, length = self.edges
        n = len(self.points)
        ends = np.concatenate([src, dst]), np.concatenate([dst, src])
        return sparse.coo_array((np.concatenate([length, length]), ends), shape=(n, n)).tocsr()

    def nearest(self, node: int) -> frozenset[int]:
        """The k nearest neighbours of a node, found among all points."""
        if node not in self._nearest:
            settings = self._pair.settings.graph
            self._nearest[node] = frozenset(method.nearest(self.points, node, settings.k, settings.ties))
        return self._nearest[node]

    def neighbours(self, node: int) -> set[int]:
        """The nodes that an edge joins with one."""
        row = slice(self.adjacency.indptr[node], self.adjacency.indptr[node + 1])
        return set(self.adjacency.indices[row].tolist())

    def matrix(self, nodes: IndexArray) -> FloatArray:
        """Edge lengths among some nodes, (k, k), dense."""
        dense: FloatArray = self.adjacency[nodes][:, nodes].toarray()
        return dense


def wanted_stages(settings: Settings) -> list[Stage]:
    """The stages that a run under these settings has, in their order."""
    return [stage for stage in (*STAGES, *EXTRAS) if stage.is_wanted is None or stage.is_wanted(settings)]


def object_name(match: Row) -> str:
    """An object in words, such as "real 3, sim 5"."""
    return ", ".join(f"{side} {match[f'{side}_id']}" for side in SIDES if match[f"{side}_id"] is not None)
