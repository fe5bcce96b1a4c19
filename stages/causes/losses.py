"""Shares of the returns that a simulated side loses on surface that both sides see."""

from __future__ import annotations

import numpy as np

from ...schemas.cause_catalogue import LOSSES, UNEVEN
from ..arrays import BoolArray, FloatArray, IndexArray
from ..sensor_description import SensorDescription
from .beams import DOUBTFUL_BEAMS
from .sides import Side, medians_by_group

#: Returns, far or grazing, that a loss needs of either side.
FEWEST_OF_KIND = 100
_CELL_DEG = 2.0
_N_AROUND = round(360.0 / _CELL_DEG)
_N_CELLS = _N_AROUND * (_N_AROUND // 2 + 2)
_EDGE_DEG = 0.15  # from a beam to the edge of a cell
_FEWEST = 5  # real returns of a cell
_FEWEST_SIM = 2.5  # returns that the simulated side would have in it
#: Relative difference of the median ranges of a cell in which both sides see one surface.
_ALIKE = 0.1
_BEAM_MARGIN_DEG = 0.2  # beyond the outermost beams of both sides


def fit_losses(
    real: Side, sim: Side, is_used_real: BoolArray, is_used_sim: BoolArray, dead: IndexArray
) -> dict[str, float] | None:
    """Share of the returns lost within 25 m at less than 75 degrees, and the further shares lost beyond each.

    Numbers of returns by cell of direction are compared where both sides see one surface; None without such surface.
    The shares are by name of the loss, and `UNEVEN` is their variance between directions, beyond that of counting and
    of the fit. Shares of fewer than 100 returns are left out.

    Parameters
    ----------
    is_used_real, is_used_sim : (n,), (m,) bool, returns that no other flaw explains
    dead : beams of the real sensor without simulated returns
    """
    if not (is_used_real.any() and is_used_sim.any()):
        return None
    edge_deg = _edge_between_beams(real.sensor)
    real_cell = _cell_of(real, edge_deg)[is_used_real]
    sim_cell = _cell_of(sim, edge_deg)[is_used_sim]
    n_real, real_range_m = medians_by_group(real.range_m[is_used_real], real_cell, _N_CELLS)
    n_sim, sim_range_m = medians_by_group(sim.range_m[is_used_sim], sim_cell, _N_CELLS)
    real_per_sim = max(is_used_real.sum() / is_used_sim.sum(), 1.0)
    has_both = (n_real >= max(_FEWEST, _FEWEST_SIM * real_per_sim)) & (n_sim > 0)
    is_alike = has_both & (np.abs(sim_range_m - real_range_m) <= _ALIKE * real_range_m)
    n_real = n_real[is_alike]
    if not len(n_real):
        return None
    kinds = {}
    for name in LOSSES[1:]:
        cell = real_cell[real.concerned(name)[is_used_real]]
        share = np.bincount(cell, minlength=_N_CELLS)[is_alike] / n_real
        n_of_kind = n_real[share > 0.5].sum()
        if min(n_of_kind, n_real.sum() - n_of_kind) >= FEWEST_OF_KIND * real_per_sim:
            kinds[name] = share
    real_deg = real.sensor.firing_deg
    sim_deg = sim.sensor.firing_deg
    firings = real_deg / sim_deg if real_deg and sim_deg else 1.0  # simulated ones per real one
    firings *= _beam_ratio(real.sensor, sim.sensor, dead)
    return _fit(n_real, n_sim[is_alike], firings, kinds)


def _fit(
    n_real: IndexArray, n_sim: IndexArray, firings: float, kinds: dict[str, FloatArray]
) -> dict[str, float]:
    """Poisson regression with a logarithmic link: the shares that remain are multiplied.

    Parameters
    ----------
    n_real, n_sim : (c,) returns of each cell
    firings : of the simulated sensor per firing of the real one
    kinds : by loss, share of the real returns of each cell that it concerns, (c,)
    """
    from sklearn.linear_model import PoissonRegressor  # takes a second to load

    columns = np.column_stack([*kinds.values()]) if kinds else np.zeros((len(n_real), 1))
    model = PoissonRegressor(alpha=0.0, tol=1e-8, max_iter=1000)
    fit = model.fit(columns, n_sim / n_real / firings, n_real)
    expected = n_real * firings * fit.predict(columns)
    unevenness = (((n_sim - expected) ** 2).sum() - expected.sum()) / max(
        (expected**2).sum(), 1.0
    )
    coefficients = [fit.intercept_, *fit.coef_.tolist()]
    names = [LOSSES[0], *kinds]
    shares = {
        name: 1.0 - float(np.exp(c)) for name, c in zip(names, coefficients, strict=False)
    }
    return {UNEVEN: float(unevenness), **shares}


def _beam_ratio(real: SensorDescription, sim: SensorDescription, dead: IndexArray) -> float:
    """Simulated beams per real one that is not dead, in the elevations of both; 1 if they are not counted exactly."""
    if not real.elevation_deg or not sim.elevation_deg or not sim.is_sharp:
        return 1.0
    if abs(len(sim.elevation_deg) - len(real.elevation_deg)) <= DOUBTFUL_BEAMS:
        return 1.0
    low_deg = max(min(real.elevation_deg), min(sim.elevation_deg)) - _BEAM_MARGIN_DEG
    high_deg = min(max(real.elevation_deg), max(sim.elevation_deg)) + _BEAM_MARGIN_DEG
    living_deg = np.delete(real.elevation_deg, dead)
    n_real = sum(low_deg <= elevation <= high_deg for elevation in living_deg)
    n_sim = sum(low_deg <= elevation <= high_deg for elevation in sim.elevation_deg)
    return n_sim / n_real if n_real and n_sim else 1.0


def _edge_between_beams(sensor: SensorDescription) -> float:
    """Elevation in [0, 2) at which cells begin, so that their edges have the fewest beams next to them, degrees.

    An error of a hundredth of a degree would move all returns of such a beam to another cell.
    """
    edges_deg = np.arange(0.0, _CELL_DEG, _EDGE_DEG / 3)
    half_deg = _CELL_DEG / 2
    beams_deg = np.array(sensor.elevation_deg)
    apart_deg = (beams_deg - edges_deg[:, None] + half_deg) % _CELL_DEG - half_deg
    return float(edges_deg[np.argmin((np.abs(apart_deg) < _EDGE_DEG).sum(axis=1))])


def _cell_of(side: Side, edge_deg: float) -> IndexArray:
    """(n,) cell of 2 degrees of direction of each return."""
    row = (side.elevation_deg + 90.0 + _CELL_DEG - edge_deg) // _CELL_DEG
    column = (side.azimuth_deg + 180.0) // _CELL_DEG
    return (row * _N_AROUND + column % _N_AROUND).astype(np.intp)
