"""Scores of a matched object: drift of its geometry and of its structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, Watch, unwatched
from .coverage import nearest_distances
from .linalg.laplacian import induced_laplacian
from .linalg.spectrum import eigenvalues, spectral_norm
from .linalg.subgraph import Subgraph
from .selection import Selection

MIN_NODES = 3
IDENTICAL_CHANGE = 1e-5
MAX_CHANGE = 2.0


@dataclass(frozen=True)
class Scores:
    """Scores of one object; a spectral score that cannot be computed is None, with the reason."""

    cdc: float
    alignment_rms_m: float
    status: str
    reason: str | None = None
    r_lambda: float | None = None
    r_gap: float | None = None
    max_eigenvalue_shift: float | None = None
    laplacian_change: float | None = None
    eigenspectrum_distance: float | None = None
    gap_real: float | None = None
    gap_sim: float | None = None


def score_object(
    real: Subgraph,
    sim: Subgraph,
    selection: Selection,
    *,
    watch: Watch = unwatched,
) -> Scores:
    """Compute geometry (CDC) and structure (r_lambda, r_gap) scores of one matched object.

    With L_real, L_sim the normalised Laplacians of the reduced subgraphs, rows and columns of L_sim in the aligned
    order, dL = L_sim - L_real, and l_0 <= l_1 <= ... their spectra (paper, section "Graph-Based Validation Metrics"):

    max_eigenvalue_shift = max_i |l_i(sim) - l_i(real)|, at most 2 as both spectra lie in [0, 2]
    laplacian_change = |dL|_2, at most 2 likewise
    r_lambda = max_eigenvalue_shift / laplacian_change, at most 1 by Weyl's inequality
    r_gap = |gap_sim - gap_real| / (2 laplacian_change), gap = l_1 - l_0; at most 0.5 because l_0 = 0 on both sides
    eigenspectrum_distance = |l(sim) - l(real)|_2

    If laplacian_change <= 1e-5 both ratios are set to 0 and the status is "identical": they would be ratios of rounding
    errors. Objects of fewer than 3 nodes have no spectral scores (status "too_small").

    Parameters
    ----------
    real, sim : one object on both sides
    selection : the aligned nodes
    watch : entered around the steps cdc, laplacian, spectra and norm
    """
    with watch("cdc"):
        cdc = chamfer_density_aware(real.points, sim.points)
    rms_m = _alignment_rms(real.points[selection.real_nodes], sim.points[selection.sim_nodes])
    n_keep = len(selection.real_nodes)
    if n_keep < MIN_NODES:
        reason = f"{n_keep} aligned nodes, at least {MIN_NODES} are needed for a spectrum"
        return Scores(cdc, rms_m, "too_small", reason)
    with watch("laplacian"):
        laplacian_real = induced_laplacian(real, selection.real_nodes)
        laplacian_sim = induced_laplacian(sim, selection.sim_nodes)
    with watch("norm"):
        change = spectral_norm(laplacian_sim - laplacian_real)
    change = min(MAX_CHANGE, change)  # an excess is rounding
    with watch("spectra"):
        spectrum_real = eigenvalues(laplacian_real)
        spectrum_sim = spectrum_real  # of equal matrices, exactly equal
        if change > 0:
            spectrum_sim = eigenvalues(laplacian_sim)
    shift = min(MAX_CHANGE, float(np.max(np.abs(spectrum_sim - spectrum_real))))
    gap_real = float(spectrum_real[1] - spectrum_real[0])
    gap_sim = float(spectrum_sim[1] - spectrum_sim[0])
    status = "identical"
    r_lambda = r_gap = 0.0
    if change > IDENTICAL_CHANGE:
        status = "scored"
        r_lambda = min(1.0, shift / change)
        r_gap = min(0.5, abs(gap_sim - gap_real) / (2 * change))
    return Scores(
        cdc=cdc,
        alignment_rms_m=rms_m,
        status=status,
        r_lambda=r_lambda,
        r_gap=r_gap,
        max_eigenvalue_shift=shift,
        laplacian_change=change,
        eigenspectrum_distance=float(np.linalg.norm(spectrum_sim - spectrum_real)),
        gap_real=gap_real,
        gap_sim=gap_sim,
    )


def chamfer_density_aware(real: FloatArray, sim: FloatArray) -> float:
    """CDC = mean_x min_y (1 - exp(-|x - y|^2)) + mean_y min_x (1 - exp(-|y - x|^2)), 0 to 2 (paper, equation "cdc").

    x are the real points, y the simulated ones, distances in metres, without centring. Despite its name in the paper
    this is not the published DCD of Wu et al. 2021, which also weighs by counts.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each

    Examples
    --------
    >>> import numpy as np
    >>> chamfer_density_aware(np.zeros((1, 3)), np.array([[0.0, 0, 100], [0, 0, 200]]))
    2.0
    """
    to_sim, to_real = nearest_distances(real, sim)
    return float(np.mean(-np.expm1(-(to_sim**2))) + np.mean(-np.expm1(-(to_real**2))))


def _alignment_rms(real: FloatArray, sim: FloatArray) -> float:
    """Root mean square distance of aligned nodes, both sides centred, in metres."""
    apart = (real - real.mean(axis=0)) - (sim - sim.mean(axis=0))
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))
