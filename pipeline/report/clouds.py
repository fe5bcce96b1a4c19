"""The points of one pair as a report draws them: object points of both sides with their communities, and the spectra.

The spectra are the only thing that is computed anew, from the stored nodes, and only shown where their largest shift is
the stored one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES
from ...stages.arrays import FloatArray, IntArray
from ...stages.linalg.laplacian import induced_laplacian
from ...stages.linalg.spectrum import eigenvalues
from ...stages.linalg.subgraph import Edges, Subgraph, split_by_community
from ..engine.pool import one_blas_thread
from .results import RunResults

#: Objects with more nodes have their spectra left out: one of 1,500 costs about half a second, one of 3,000 four.
MOST_SPECTRUM_NODES = 1500
_AGREES = 1e-6


@dataclass(frozen=True)
class Cloud:
    """The object points of one side.

    point_ids : (n,) int32, ascending
    points : (n, 3) float64, metres, real sensor's frame
    community : (n,) int32
    """

    point_ids: IntArray
    points: FloatArray
    community: IntArray

    def members(self, community_id: int) -> FloatArray:
        """The points of one object, (m, 3)."""
        return self.points[self.community == community_id]


@dataclass(frozen=True)
class Spectra:
    """The ordered spectra of one matched object, (n_keep,) each, or the reason why they are not drawn."""

    real: FloatArray | None = None
    sim: FloatArray | None = None
    reason: str = ""


class PairTables:
    """The tables of one scored pair, each read when it is first asked for.

    Raises
    ------
    RunError
        From every property and method: a table is damaged or gone.
    """

    def __init__(self, results: RunResults, pair_id: str) -> None:
        self.matched = results.matched[results.matched.pair_id == pair_id]
        self.unmatched = results.unmatched[results.unmatched.pair_id == pair_id]
        self._run, self._pair_id = results.run, pair_id

    @cached_property
    def clouds(self) -> dict[str, Cloud]:
        """The object points by side."""
        clouds = {}
        for side in SIDES:
            points = self._columns("ground", side, ["point_id", "x", "y", "z", "is_ground"]).query("~is_ground")
            community = self._columns("communities", side, ["community_id"]).community_id
            clouds[side] = Cloud(points.point_id.to_numpy(), points[["x", "y", "z"]].to_numpy(), community.to_numpy())
        return clouds

    @cached_property
    def selection(self) -> pd.DataFrame:
        """The kept nodes of each matched object, in aligned pairs: real_id, real_point_id, sim_point_id."""
        return self._columns("selection", "", ["real_id", "real_point_id", "sim_point_id"])

    def spectra(self) -> Iterator[tuple[int, Spectra]]:
        """The spectra of each matched object, by real id; with a reason in their place where they are not drawn."""
        graphs = {side: self._graphs(side) for side in SIDES}
        nodes = dict(iter(self.selection.groupby("real_id")))
        with one_blas_thread():
            for row in self.matched.itertuples():
                if row.status == "too_small":
                    yield row.real_id, Spectra(reason="too few nodes for a spectrum")
                else:
                    pair = graphs["real"][row.real_id], graphs["sim"][row.sim_id]
                    yield row.real_id, _spectra_of(pair, nodes[row.real_id], row.max_eigenvalue_shift)

    def _graphs(self, side: str) -> dict[int, Subgraph]:
        """The graph of each matched object of a side, by the object's id."""
        cloud = self.clouds[side]
        graph = self._columns("graph", side, ["src", "dst", "length_m"])
        src, dst = (np.searchsorted(cloud.point_ids, graph[end].to_numpy()).astype(np.int32) for end in ("src", "dst"))
        edges = Edges(src, dst, graph.length_m.to_numpy())
        wanted = self.matched[f"{side}_id"].tolist()
        return split_by_community(cloud.point_ids, cloud.points, edges, cloud.community, wanted)

    def _columns(self, table: str, side: str, columns: list[str]) -> pd.DataFrame:
        rows: pd.DataFrame = self._run.read_table(table, self._pair_id, side, columns).to_pandas()
        return rows


def _spectra_of(graphs: tuple[Subgraph, Subgraph], nodes: pd.DataFrame, stored_shift: float) -> Spectra:
    """Both spectra of one object from its graphs and its kept nodes, in aligned pairs."""
    if len(nodes) > MOST_SPECTRUM_NODES:
        return Spectra(reason=f"{len(nodes):,} nodes: spectra are drawn of objects of up to {MOST_SPECTRUM_NODES:,}")
    real, sim = (
        eigenvalues(induced_laplacian(graph, np.searchsorted(graph.point_ids, nodes[f"{side}_point_id"].to_numpy())))
        for side, graph in zip(SIDES, graphs, strict=True)
    )
    shift = float(np.max(np.abs(sim - real)))
    if abs(shift - stored_shift) > _AGREES:
        return Spectra(reason=f"recomputed shift {shift:.6f} is not the stored {stored_shift:.6f}: not drawn")
    return Spectra(real=real, sim=sim)
