"""Both sides compared ray by ray: what each firing of the sensor returned in reality and in the simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..schemas.results import Number
from .arrays import BoolArray, FloatArray, IndexArray, azimuths_deg
from .linalg.nearest import search_tree
from .sensor_description import SensorDescription
from .statistics.bands import BAND_EDGES_M

#: What became of a ray. Both sides returned: ranges agree, or the simulated return is nearer or farther. Only the real
#: side returned: with or without simulated surface near its return. Only the simulated side returned; neither did.
OUTCOMES = ("same", "in_front", "behind", "dropped", "no_surface", "sim_only", "none")
SAME, IN_FRONT, BEHIND, DROPPED, NO_SURFACE, SIM_ONLY, NONE = range(len(OUTCOMES))
#: Ranges agree if they differ by at most this, or by three standard deviations of the noise of both sides.
SAME_M = 0.1
SAME_SIGMAS = 3.0
#: A real return without a simulated one was dropped if there is simulated surface within this distance.
SURFACE_M = 0.3
#: Two returns belong to one ray if their directions differ by at most this number of cells, root of the sum of squares.
REACH = 0.75
#: Edges of the bands in which rays are scored; the last has no end.
RANGE_EDGES_M = BAND_EDGES_M
INCIDENCE_EDGES_DEG = (0.0, 30.0, 60.0, 75.0, 85.0)
#: Edges of the directions in which rays are scored.
AZIMUTH_EDGES_DEG = tuple(range(-180, 181, 45))
_ELEVATIONS_DEG = np.linspace(-90.0, 90.0, 18_001)
_CANDIDATES = 6
_NEIGHBOURS = 8
_PHASE_CELLS = 32  # columns over which the columns of the two sides keep their phase
_STEADY = 0.5  # resultant length of phases that agree
#: Steps between two firings, none of them lost; columns of HDL-64E jitter by half a step.
_ADJACENT = 1.3
_FINER = 1.2  # ratio of steps
_SQUEEZE = 4.0
_LEAST_ROWS = 0.6
_ROW = 0.35  # rows; neighbours along a row are within it
_NEAR_ROW = (0.5, 1.6)
_GRAZING = 0.02  # cosine of incidence
_MOST_MOVED = 0.5  # of a range, from the return's own to that of the plane around it


@dataclass(frozen=True)
class Rays:
    """One row per ray of the grid, sorted by beam and column.

    beam, column : (n,) intp, beam of the real sensor, and number of the firing from azimuth -180 degrees on
    real_row, sim_row : (n,) intp, row of the return in the input; -1 for none
    outcome : (n,) intp, index into `OUTCOMES`
    real_range_m : (n,) float64, range of the real return, NaN for none
    sim_range_m : (n,) float64, range of the simulated return, along the real ray if there is one; NaN for none
    incidence_deg : (n,) float64, between the ray and the normal of the surface that it met, the simulated one if both
        sides returned; NaN if undetermined
    """

    beam: IndexArray
    column: IndexArray
    real_row: IndexArray
    sim_row: IndexArray
    outcome: IndexArray
    real_range_m: FloatArray
    sim_range_m: FloatArray
    incidence_deg: FloatArray

    @property
    def azimuth_deg(self) -> FloatArray:
        """(n,) degrees, of the middle of each ray's column; at most 180, if a beam returned more than once a column.

        A turn has as many columns as the beam that has fewest, since every beam has a ray in each of them.
        """
        is_last = np.append(np.diff(self.beam) > 0, True)
        n_columns = self.column[is_last].min() + 1
        return (np.minimum(self.column, n_columns - 1) + 0.5) * 360.0 / n_columns - 180.0


def find_rays(
    real: FloatArray,
    sim: FloatArray,
    sensors: tuple[SensorDescription, SensorDescription],
    T_real_sim: FloatArray | None = None,
) -> Rays | str:
    """Pair the returns of both sides by direction and compare their ranges, or return the reason why there are no rays.

    A cell is one azimuth step of the coarser side wide and as high as the distance of neighbouring beams, again of the
    coarser side, at that elevation. Returns whose directions differ by at most 0.75 cells (root of the sum of squares)
    are one ray, one to one, in order of that difference; in azimuth it is counted from the phase between the columns of
    the two sides, a circular mean over 32 columns of a beam. A return without a partner between two adjacent firings of
    the other side belongs to a finer grid and is left out. So are simulated returns above and below the real beams.

    The simulated range is that at which the real ray meets the plane around the simulated return (through its
    neighbours in its own and the next row): half a cell of difference in direction is 20 cm on a road 15 m away.

    Parameters
    ----------
    real, sim : (n, 3) and (m, 3) float64, metres, clean points of both sides in the real sensor's frame
    sensors : of the real and the simulated side; ranges may differ by their noise
    T_real_sim : (3, 4) float64, motion of the simulated into the real sensor's frame, if they differ
    """
    steps_deg = []
    for side, sensor in zip(("real", "simulated"), sensors, strict=True):
        if not sensor.azimuth_step_deg:
            return f"{side} scan: {sensor.why_unknown('azimuth_step_deg')}"
        steps_deg.append(sensor.azimuth_step_deg)
    apart_m = 0.0 if T_real_sim is None else float(np.linalg.norm(T_real_sim[:, 3]))
    median_m = float(np.median(np.linalg.norm(real, axis=1)))
    cell_m = np.radians(max(steps_deg)) * median_m
    if apart_m > cell_m:
        return (
            f"the simulated sensor is {apart_m:.2f} m from the real one: at the median range of {median_m:.1f} m its "
            f"rays are {apart_m / cell_m:.1f} cells off"
        )
    rows = _rows_of(sensors)
    real_side = _Side(real, sensors[0], max(steps_deg), rows)
    sim_side = _Side(sim, sensors[1], max(steps_deg), rows)
    beam, column, real_row, sim_row = _in_grid(real_side, sim_side)
    return _compare_ranges(real_side, sim_side, beam, column, real_row, sim_row)


def _in_grid(real: _Side, sim: _Side) -> IndexArray:
    """(4, n) beam, column, and rows of the real and of the simulated return of each ray, sorted; -1 for no return.

    No two rays of a beam have the same column.
    """
    real_row, sim_row = _sort_returns(real, sim)
    is_real = real_row >= 0
    azimuth = np.where(is_real, real.place[real_row, 0], sim.place[sim_row, 0])
    beam = np.where(is_real, real.beam[real_row], real.sensor.beam_of(sim.points)[sim_row])
    order = np.lexsort((azimuth, beam))
    beam = beam[order]
    n_columns = round(real.width)
    n_beams = len(real.sensor.elevation_deg)
    count = np.bincount(beam, minlength=n_beams)
    start = np.repeat(np.cumsum(count) - count, count)
    rank = np.arange(len(order)) - start
    base = start * 1.0 + beam * n_columns
    column = azimuth[order].astype(int)
    column = (np.maximum.accumulate(column - rank + base) - base + rank).astype(int)
    most = np.maximum(n_columns, count)[beam] - count[beam] + rank
    column = np.minimum(column, most)
    is_inside = column < n_columns
    is_silent = np.ones((n_beams, n_columns), dtype=bool)
    is_silent[beam[is_inside], column[is_inside]] = False
    silent = np.argwhere(is_silent).T
    returned = np.stack([beam, column, real_row[order], sim_row[order]])
    rays = np.hstack([returned, np.vstack([silent, np.full_like(silent, -1)])])
    return rays[:, np.lexsort(rays[1::-1])]


def _sort_returns(real: _Side, sim: _Side) -> tuple[IndexArray, IndexArray]:
    """Rows of the real and of the simulated return of each ray with a return, -1 for none."""
    partner = _partners(real, sim)
    both = np.flatnonzero(partner >= 0)
    sim_rows = sim.place[:, 1]
    is_single = (sim_rows >= real.lowest - REACH) & (sim_rows <= real.highest + REACH)
    is_single[partner[both]] = False
    only_real = _without_finer(np.flatnonzero(partner < 0), real, sim)
    only_sim = _without_finer(np.flatnonzero(is_single), sim, real)
    real_row = np.concatenate([both, only_real, np.full(len(only_sim), -1)])
    sim_row = np.concatenate([partner[both], np.full(len(only_real), -1), only_sim])
    return real_row, sim_row


def _compare_ranges(
    real: _Side,
    sim: _Side,
    beam: IndexArray,
    column: IndexArray,
    real_row: IndexArray,
    sim_row: IndexArray,
) -> Rays:
    """The rays with their ranges, outcomes and incidences, from their returns on both sides."""
    is_real = real_row >= 0
    is_sim = sim_row >= 0
    only_real = is_real & ~is_sim
    normal = np.full((len(beam), 3), np.nan)
    normal[only_real] = real.normals(real_row[only_real])
    normal[is_sim] = sim.normals(sim_row[is_sim])
    met = np.where(is_sim[:, None], sim.points[sim_row], real.points[real_row])
    met_range_m = np.linalg.norm(met, axis=1)
    cosine = np.abs(np.einsum("ij,ij->i", normal, met)) / met_range_m

    directions = real.points[real_row] / real.range_m[real_row, None]
    along_m = _range_along(directions, met, normal)
    real_range_m = np.where(is_real, real.range_m[real_row], np.nan)
    sim_range_m = np.select([is_real & is_sim, is_sim], [along_m, met_range_m], np.nan)
    difference_m = sim_range_m - real_range_m
    noise_m = np.hypot(real.sensor.range_noise_m or 0.0, sim.sensor.range_noise_m or 0.0)
    is_same = np.abs(difference_m) <= max(SAME_M, SAME_SIGMAS * noise_m)
    surface_m = np.full(len(beam), np.inf)
    tree = search_tree(sim.points)
    surface_m[only_real], _ = tree.query(met[only_real], distance_upper_bound=SURFACE_M)
    outcome = np.select(
        [is_same, difference_m < 0, difference_m > 0, is_sim, surface_m <= SURFACE_M, is_real],
        [SAME, IN_FRONT, BEHIND, SIM_ONLY, DROPPED, NO_SURFACE],
        NONE,
    )
    incidence_deg = np.degrees(np.arccos(np.minimum(cosine, 1.0)))
    return Rays(
        beam, column, real_row, sim_row, outcome, real_range_m, sim_range_m, incidence_deg
    )


def score_rays(rays: Rays, is_in: BoolArray | slice = slice(None)) -> dict[str, Number]:
    """Scores of some rays, by column of `pairs`; None, or left out for ranges, if no ray allows them.

    Shares are of the rays with a return on either side. `rays_hit_f1` is 2 b / (2 b + r + s) and `rays_drop_f1`
    2 n / (2 n + r + s), with b, r, s, n the rays that both sides, the real side only, the simulated side only, and
    neither returned. Bias (simulated minus real) and scale (simulated over real, minus 1) are medians over the rays
    that both returned; the interval of the bias is that of order statistics, 95 %, for independent rays. MAE, MedAE,
    p90 and RMSE are of the absolute difference on the same rays.

    Parameters
    ----------
    is_in : (n,) bool, rays to be scored; all by default
    """
    outcome = rays.outcome[is_in]
    counts = np.bincount(outcome, minlength=len(OUTCOMES)).tolist()
    n_none = counts[NONE]
    n_rays = sum(counts[:NONE])
    n_both = sum(counts[:DROPPED])
    n_single = n_rays - n_both
    scores: dict[str, Number] = {"n_rays": n_rays}
    for name, n in zip(OUTCOMES[:NONE], counts, strict=False):
        scores[f"rays_{name}"] = n / n_rays if n_rays else None
    for name, n in (("hit", n_both), ("drop", n_none)):
        scores[f"rays_{name}_f1"] = 2 * n / (2 * n + n_single) if n + n_single else None
    is_both = outcome <= BEHIND
    real_m = rays.real_range_m[is_in][is_both]
    sim_m = rays.sim_range_m[is_in][is_both]
    return scores | _range_scores(real_m, sim_m)


def _range_scores(real: FloatArray, sim: FloatArray) -> dict[str, float]:
    """Bias, scale and error of the ranges of rays that both sides returned, by column of `pairs`."""
    n = len(real)
    if not n:
        return {}
    difference = np.sort(sim - real)
    reach = 0.98 * np.sqrt(n)
    low, high = np.clip([n / 2 - reach, n / 2 + reach], 0, n - 1).astype(int)
    error = np.abs(difference)
    return {
        "rays_bias_m": float(np.median(difference)),
        "rays_bias_low_m": float(difference[low]),
        "rays_bias_high_m": float(difference[high]),
        "rays_scale": float(np.median(sim / real)) - 1.0,
        "rays_mae_m": float(error.mean()),
        "rays_medae_m": float(np.median(error)),
        "rays_p90_m": float(np.quantile(error, 0.9)),
        "rays_rmse_m": float(np.sqrt((error**2).mean())),
    }


def _rows_of(sensors: tuple[SensorDescription, SensorDescription]) -> FloatArray:
    """A coordinate by `_ELEVATIONS_DEG` that grows by 1 from beam to beam of the side that is coarser there."""
    apart = []
    for sensor in sensors:
        grid = sensor.beams_deg
        apart.append(np.interp(_ELEVATIONS_DEG, (grid[1:] + grid[:-1]) / 2, np.diff(grid)))
    rows = np.cumsum(0.01 / np.maximum(*apart))
    return rows - rows[0]


class _Side:
    """The returns of a side by direction.

    place : (n, 2) float64, azimuth in cells from -180 degrees on, and row; see `_rows_of`
    beam : (n,) intp, of the side's own sensor
    width : cells of azimuth around
    step : of the side's own columns, in cells
    lowest, highest : rows of the first and the last beam
    """

    def __init__(
        self,
        points: FloatArray,
        sensor: SensorDescription,
        step_deg: float,
        rows: FloatArray,
    ) -> None:
        self.points = points
        self.sensor = sensor
        self.range_m: FloatArray = np.linalg.norm(points, axis=1)
        self.beam = sensor.beam_of(points)
        self.width = 360.0 / step_deg
        self.step = (sensor.azimuth_step_deg or 0.0) / step_deg
        azimuth = (azimuths_deg(points) + 180.0) / step_deg % self.width
        elevation_deg = np.degrees(np.arcsin(points[:, 2] / self.range_m))
        self.place = np.column_stack([azimuth, np.interp(elevation_deg, _ELEVATIONS_DEG, rows)])
        self.lowest, self.highest = np.interp(sensor.beams_deg[[0, -1]], _ELEVATIONS_DEG, rows)
        around = [self.width, 0.0]
        self.tree = scipy.spatial.cKDTree(self.place, boxsize=around, balanced_tree=False)

    def across(self, cells: FloatArray) -> FloatArray:
        """A difference of azimuths, in cells, the short way round."""
        return (cells + self.width / 2) % self.width - self.width / 2

    @np.errstate(invalid="ignore", divide="ignore")
    def normals(self, at: IndexArray) -> FloatArray:
        """(k, 3) unit vectors of some returns, NaN if neighbours are missing.

        Of the plane through a return, its nearest neighbour along its row, and that on the rows next to it.
        """
        place = self.place[at]
        distance, near = self.tree.query(place, _NEIGHBOURS, distance_upper_bound=_NEAR_ROW[1])
        is_there = np.isfinite(distance) & (near != at[:, None])
        near = np.where(is_there, near, 0)
        across = np.abs(self.across(self.place[near, 0] - place[:, :1]))
        rows = np.abs(self.place[near, 1] - place[:, 1:])
        is_along = is_there & (rows < _ROW)
        is_next = is_there & (rows >= _NEAR_ROW[0]) & (rows < _NEAR_ROW[1])
        along = self._edges(at, near, np.where(is_along, across, np.inf))
        upward = self._edges(at, near, np.where(is_next, np.hypot(across, rows), np.inf))
        normal = np.cross(along, upward)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def _edges(self, at: IndexArray, near: IndexArray, distance: FloatArray) -> FloatArray:
        """(k, 3) metres from some returns to that of their neighbours with the least distance; NaN without one."""
        nearest = np.arange(len(at)), distance.argmin(axis=1)
        is_there = np.isfinite(distance[nearest])[:, None]
        return np.where(is_there, self.points[near[nearest]] - self.points[at], np.nan)


def _partners(a: _Side, b: _Side) -> IndexArray:
    """(n,) for each return of `a` the row of its partner in `b`, -1 for none."""
    distance, near = b.tree.query(a.place, _CANDIDATES, distance_upper_bound=REACH + 1.0)
    row, rank = np.nonzero(np.isfinite(distance))
    near = near[row, rank]
    azimuth = a.across(b.place[near, 0] - a.place[row, 0])
    azimuth -= _phase(a, row[rank == 0], azimuth[rank == 0])[row]
    apart = np.hypot(azimuth, b.place[near, 1] - a.place[row, 1])
    order = np.argsort(apart, kind="stable")
    order = order[apart[order] <= REACH]
    row = row[order]
    near = near[order]
    partner = np.full(len(a.points), -1)
    is_taken = np.zeros(len(b.points), dtype=bool)
    while len(row):
        # a pair that comes first for both of its returns is the nearest pair of both
        first = np.flatnonzero(_is_first(row, len(partner)) & _is_first(near, len(is_taken)))
        partner[row[first]] = near[first]
        is_taken[near[first]] = True
        is_free = (partner[row] < 0) & ~is_taken[near]
        row = row[is_free]
        near = near[is_free]
    return partner


def _is_first(values: IndexArray, n: int) -> BoolArray:
    """True where a value, from 0 to n - 1, occurs for the first time."""
    first = np.empty(n, dtype=int)
    places = np.arange(len(values))
    first[values[::-1]] = places[::-1]  # the last assignment counts
    return first[values] == places


def _phase(a: _Side, row: IndexArray, azimuth: FloatArray) -> FloatArray:
    """(n,) cells from the columns of `a` on to those of the other side, around each return; 0 where they do not agree.

    That of 32 columns of a beam, counted on from that of the whole beam, so that it does not jump from -1/2 to 1/2.

    Parameters
    ----------
    row, azimuth : returns of `a`, and how far in azimuth the nearest return of the other side is
    """
    n_blocks = int(a.width // _PHASE_CELLS) + 1
    block = a.beam * n_blocks + (a.place[:, 0] // _PHASE_CELLS).astype(int)
    of_beam = _mean_phase(a.beam, row, azimuth)[a.beam]
    of_block = _mean_phase(block, row, azimuth)[block]
    return of_beam + (of_block - of_beam + 0.5) % 1.0 - 0.5


def _mean_phase(place: IndexArray, row: IndexArray, azimuth: FloatArray) -> FloatArray:
    """Circular mean of azimuths, in cells, by place; 0 where they do not agree."""
    size = int(place.max(initial=0)) + 1
    turn = np.exp(2j * np.pi * azimuth)
    at = place[row]
    total = np.bincount(at, turn.real, size) + 1j * np.bincount(at, turn.imag, size)
    count = np.bincount(at, minlength=size)
    is_steady = np.abs(total) > _STEADY * np.maximum(count, 1)
    return np.where(is_steady, np.angle(total) / (2 * np.pi), 0.0)


def _without_finer(rows: IndexArray, side: _Side, other: _Side) -> IndexArray:
    """Those of some returns without a partner that are rays: the other side would have fired there.

    Left out are returns between two adjacent firings of the other side, and, if the own grid is finer, all but the
    first of each cell.
    """
    near_rows = np.array([_SQUEEZE, 1.0])  # the nearest row counts more than the nearest column
    around = [other.width / _SQUEEZE, 0.0]
    tree = scipy.spatial.cKDTree(other.place / near_rows, boxsize=around, balanced_tree=False)
    place = side.place[rows]
    distance, near = tree.query(
        place / near_rows, _CANDIDATES, distance_upper_bound=_LEAST_ROWS
    )
    is_there = np.isfinite(distance)
    near = np.where(is_there, near, 0)
    azimuth = side.across(other.place[near, 0] - place[:, :1])
    is_there &= np.abs(other.place[near, 1] - other.place[near[:, :1], 1]) <= _ROW
    before = np.where(is_there & (azimuth <= 0), -azimuth, np.inf).min(axis=1)
    after = np.where(is_there & (azimuth >= 0), azimuth, np.inf).min(axis=1)
    rows = rows[before + after > _ADJACENT * other.step]
    if side.step * _FINER < 1.0:
        cell = np.column_stack([side.beam[rows], side.place[rows, 0].astype(int)])
        rows = rows[np.sort(np.unique(cell, axis=0, return_index=True)[1])]
    return rows


@np.errstate(invalid="ignore", divide="ignore")
def _range_along(directions: FloatArray, points: FloatArray, normal: FloatArray) -> FloatArray:
    """(n,) metres, where rays meet the planes around points; a point's own range if its ray grazes the plane."""
    range_m = np.linalg.norm(points, axis=1)
    cosine = np.einsum("ij,ij->i", directions, normal)
    meeting = np.einsum("ij,ij->i", points, normal) / cosine
    is_near = np.abs(meeting - range_m) < _MOST_MOVED * range_m
    return np.where((np.abs(cosine) > _GRAZING) & is_near, meeting, range_m)
