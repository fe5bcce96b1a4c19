"""The points of one pair as a report draws them: object points of both sides with their communities, and the spectra.

Reads the run's tables and nothing else. The spectra are the only thing that is computed anew, from the stored nodes,
and only shown where their largest shift is the stored one. Leaves to others: thinning (`pair_view`), drawing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow.compute as pc

from ...schemas.columns import SIDES
from ...stages.arrays import FloatArray, IntArray
from ...stages.linalg.laplacian import induced_laplacian
from ...stages.linalg.spectrum import eigenvalues
from ..datasets.pairs import ScanPair
from ..engine.pool import one_blas_thread
from ..engine.task import Job, PairTask
from ..engine.workbench import Workbench, as_numpy
from .results import RunResults, stage_of

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


@dataclass(frozen=True)
class Spectra:
    """The ordered spectra of one matched object, (n_keep,) each, or the reason why they are not drawn."""

    real: FloatArray | None = None
    sim: FloatArray | None = None
    reason: str = ""


class PairTables:
    """The tables of one scored pair, read when first asked for."""

    def __init__(self, results: RunResults, pair_id: str) -> None:
        self.pair_id = pair_id
        jobs = tuple(
            Job(of.stage, of.side, of.key, stage_of(of).gives, stage_of(of).make, of.files, of.facts)
            for of in results.jobs[pair_id]
        )
        task = PairTask(ScanPair(pair_id, None, None), results.settings, jobs, folder=results.folder)
        self._bench = Workbench(task)
        self._matched = results.matched[results.matched.pair_id == pair_id]

    def cloud(self, side: str) -> Cloud:
        """The object points of a side."""
        point_ids, points = self._bench.object_points(side)
        return Cloud(point_ids, points, as_numpy(self._bench.table("communities", side), "community_id"))

    def kept(self, side: str) -> IntArray:
        """Ids of the points that stand for their object in the spectral scores, ascending."""
        kept: IntArray = np.sort(as_numpy(self._bench.table("selection"), f"{side}_point_id"))
        return kept

    def spectra(self) -> Iterator[tuple[int, Spectra]]:
        """The spectra of each matched object, by real id."""
        with one_blas_thread():
            for row in self._matched.to_dict("records"):
                yield row["real_id"], self._spectra_of(row)

    def _spectra_of(self, row: Mapping[Any, Any]) -> Spectra:
        selection = self._bench.table("selection")
        own = selection.filter(pc.equal(selection.column("real_id"), row["real_id"]))
        if row["status"] == "too_small":
            return Spectra(reason="too few nodes for a spectrum")
        if len(own) > MOST_SPECTRUM_NODES:
            return Spectra(reason=f"{len(own):,} nodes: spectra are drawn of objects of up to {MOST_SPECTRUM_NODES:,}")
        found: list[FloatArray] = []
        for side, community in zip(SIDES, (row["real_id"], row["sim_id"]), strict=True):
            graph = self._bench.subgraph(side, community)
            nodes = np.searchsorted(graph.point_ids, as_numpy(own, f"{side}_point_id"))
            found.append(eigenvalues(induced_laplacian(graph, nodes)))
        shift = float(np.max(np.abs(found[1] - found[0])))
        stored = row["max_eigenvalue_shift"]
        if abs(shift - stored) > _AGREES:
            return Spectra(reason=f"recomputed shift {shift:.6f} is not the stored {stored:.6f}: not drawn")
        return Spectra(real=found[0], sim=found[1])
