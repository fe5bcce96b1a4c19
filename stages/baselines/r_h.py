"""The bounded diffusion change r_H: change of the heat kernel of an object, over the change of its Laplacian."""

from __future__ import annotations

import scipy

from ...schemas.settings import MetricsSettings
from ..linalg.heat import heat_change
from ..linalg.laplacian import induced_laplacian
from ..linalg.spectrum import spectral_norm
from ..metrics import IDENTICAL_CHANGE, MIN_NODES
from .interface import Baseline, Baselines, MatchedObject


def compare(matched: MatchedObject, settings: MetricsSettings) -> Baselines:
    """Baseline of `diffusion_change` of the aligned nodes; None for fewer than 3 nodes."""
    nodes_real, nodes_sim = matched.selection.real_nodes, matched.selection.sim_nodes
    if len(nodes_real) < MIN_NODES:
        return (Baseline("r_h", None, f"{len(nodes_real)} aligned nodes, at least {MIN_NODES} are needed"),)
    laplacians = induced_laplacian(matched.real, nodes_real), induced_laplacian(matched.sim, nodes_sim)
    return (Baseline("r_h", diffusion_change(*laplacians, matched.t, IDENTICAL_CHANGE)),)


def diffusion_change(
    real: scipy.sparse.csr_matrix, sim: scipy.sparse.csr_matrix, t: float, identical_change: float
) -> float:
    """r_H = |dH_t|_2 / (t |dL|_2), dH_t = exp(-t L_sim) - exp(-t L_real), 0 to 1.

    "Bounded diffusion change" in the source of the paper (equation "rH", commented out there). The bound holds because
    exp(-t .) changes by no more than t |dL| between matrices without negative eigenvalues (Duhamel's formula). The
    norms are largest absolute eigenvalues by Lanczos iteration; that of dH_t is applied to vectors as a power series.
    If |dL| is at most `identical_change` the result is 0, as for r_lambda.

    Parameters
    ----------
    real, sim : (n, n) CSR float64, normalised Laplacians, nodes aligned
    t : diffusion time
    identical_change : see above
    """
    change = spectral_norm(sim - real)
    if change <= identical_change:
        return 0.0
    return min(1.0, heat_change(real, sim, t) / (t * change))
