"""Selection of the most influential nodes of a matched object, and their alignment (paper, Algorithm 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..schemas.settings import SelectionSettings
from .arrays import FloatArray, IndexArray, Watch, unwatched
from .linalg.assignment import align_nodes
from .linalg.heat import heat_row_sums
from .linalg.laplacian import normalised_laplacian
from .linalg.subgraph import Subgraph

INFLUENCE_DECIMALS = 9


@dataclass(frozen=True)
class Selection:
    """Aligned nodes, by decreasing real influence, ties by point id.

    real_nodes, sim_nodes : (n_keep,) indices into the two subgraphs; row i of one is aligned with row i of the other
    real_influence, sim_influence : (n_keep,) float64, rounded to 1e-9
    """

    real_nodes: IndexArray
    sim_nodes: IndexArray
    real_influence: FloatArray
    sim_influence: FloatArray


def select_nodes(
    real: Subgraph,
    sim: Subgraph,
    settings: SelectionSettings,
    *,
    watch: Watch = unwatched,
) -> Selection:
    """Select the n_keep = min(n_real, n_sim) nodes of largest influence on each side, and align them one to one.

    Influence is the row sum of the heat kernel, s = exp(-tL) 1 (paper, equations "heat" and "influence"), rounded to
    1e-9 and then ranked, ties by point id. Alignment: see `align_nodes`.

    Parameters
    ----------
    real, sim : one object on both sides, at least one node each
    settings : diffusion time t
    watch : entered around the steps laplacian, heat and alignment
    """
    n_keep = min(len(real.points), len(sim.points))
    real_influence = _influence(real, settings, watch)
    sim_influence = _influence(sim, settings, watch)
    real_nodes = _most_influential(real_influence, n_keep)
    sim_nodes = _most_influential(sim_influence, n_keep)
    with watch("alignment"):
        sim_nodes = sim_nodes[align_nodes(real.points[real_nodes], sim.points[sim_nodes])]
    return Selection(
        real_nodes, sim_nodes, real_influence[real_nodes], sim_influence[sim_nodes]
    )


def _influence(graph: Subgraph, settings: SelectionSettings, watch: Watch) -> FloatArray:
    """Influence of each node, (n,), rounded to 1e-9."""
    with watch("laplacian"):
        laplacian = normalised_laplacian(graph.adjacency)
    with watch("heat"):
        return np.round(heat_row_sums(laplacian, settings.t), INFLUENCE_DECIMALS)


def _most_influential(influence: FloatArray, n_keep: int) -> IndexArray:
    """Indices by decreasing influence, ties by index (nodes are in point id order)."""
    return np.argsort(-influence, kind="stable")[:n_keep]
