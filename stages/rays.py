"""Both sides compared ray by ray: what each firing of the sensor returned in reality and in the simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from ..schemas.results import Number
from .arrays import BoolArray, FloatArray, IndexArray, IntArray
from .statistics.findings import BAND_EDGES_M

#: What became of a ray. Both sides returned: ranges agree, or the simulated return is nearer or farther. Only the real
#: side returned: with or without simulated surface near its return. Only the simulated side returned; neither did.
OUTCOMES = ("same", "in_front", "behind", "dropped", "no_surface", "sim_only", "none")
SAME, IN_FRONT, BEHIND, DROPPED, NO_SURFACE, SIM_ONLY, NONE = range(len(OUTCOMES))
#: Ranges agree if they differ by at most this, or by three standard deviations of the noise of both sides.
SAME_M, SAME_SIGMAS = 0.1, 3.0
#: A real return without a simulated one was dropped if there is simulated surface within this distance.
SURFACE_M = 0.3
#: Two returns belong to one ray if their directions differ by at most this number of cells, root of the sum of squares.
REACH = 0.75
#: Edges of the bands in which rays are scored; the last has no end.
RANGE_EDGES_M, INCIDENCE_EDGES_DEG = BAND_EDGES_M, (0.0, 30.0, 60.0, 75.0, 85.0)
#: Edges of the directions in which rays are scored.
AZIMUTH_EDGES_DEG = tuple(range(-180, 181, 45))
_CANDIDATES, _NEIGHBOURS = 6, 8
_PHASE_CELLS = 32  # columns over which the columns of the two sides keep their phase
_STEADY = 0.5  # resultant length of phases that agree
_ADJACENT = 1.3  # steps between two firings, none of them lost; columns of HDL-64E jitter by half a step
_FINER = 1.2  # ratio of steps
_SQUEEZE, _LEAST_ROWS = 4.0, 0.6
_ROW = 0.35  # rows; neighbours along a row are within it
_NEAR_ROW = (0.5, 1.6)
_GRAZING = 0.02  # cosine of incidence
_MOST_MOVED = 0.5  # of a range, from the return's own to that of the plane around it


@dataclass(frozen=True)
class RayGrid:
    """Directions in which a sensor fires.

    elevation_deg : (b,) float64, of its beams, ascending
    step_deg : azimuth between two firings of a beam
    origin_height_m, block_deg : heights above the origin at which the beams start, () for 0, and the elevation between
        a lower and an upper block of beams with a height each
    """

    elevation_deg: FloatArray
    step_deg: float
    origin_height_m: tuple[float, ...] = ()
    block_deg: float = -90.0

    def elevation_of(self, points: FloatArray) -> FloatArray:
        """(n,) degrees, elevation of each point seen from where its beam starts."""
        level = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-9)
        height: float | FloatArray = 0.0
        if self.origin_height_m:
            seen = np.degrees(np.arctan2(points[:, 2] - np.mean(self.origin_height_m), level))
            height = np.where(seen < self.block_deg, self.origin_height_m[0], self.origin_height_m[-1])
        return np.degrees(np.arctan2(points[:, 2] - height, level))

    def beam_of(self, points: FloatArray) -> IndexArray:
        """(n,) intp, the beam nearest in elevation to each point."""
        limits = (self.elevation_deg[1:] + self.elevation_deg[:-1]) / 2
        return np.searchsorted(limits, self.elevation_of(points))


@dataclass(frozen=True)
class Rays:
    """One row per ray of the grid, sorted by beam and column.

    beam, column : (n,) int32, beam of the real sensor, and number of the firing from azimuth -180 degrees on
    real_row, sim_row : (n,) int32, row of the return in the input; -1 for none
    real_range_m : (n,) float64, range of the real return, NaN for none
    sim_range_m : (n,) float64, range of the simulated return, along the real ray if there is one; NaN for none
    outcome : (n,) int32, index into `OUTCOMES`
    incidence_deg : (n,) float64, between the ray and the normal of the surface that it met, the simulated one if both
        sides returned; NaN if undetermined
    """

    beam: IntArray
    column: IntArray
    real_row: IntArray
    sim_row: IntArray
    real_range_m: FloatArray
    sim_range_m: FloatArray
    outcome: IntArray
    incidence_deg: FloatArray

    @property
    def azimuth_deg(self) -> FloatArray:
        """(n,) degrees, of the middle of each ray's column; at most 180, if a beam returned more than once a column.

        A turn has as many columns as the beam that has fewest, since every beam has a ray in each of them.
        """
        last = np.zeros(self.beam.max(initial=0) + 1, dtype=np.intp)
        np.maximum.at(last, self.beam, self.column)
        n_columns = last[np.unique(self.beam)].min(initial=self.column.max(initial=0)) + 1
        return (np.minimum(self.column, n_columns - 1) + 0.5) * 360.0 / n_columns - 180.0


def compare_rays(
    real: FloatArray, sim: FloatArray, real_grid: RayGrid, sim_grid: RayGrid, noise_m: float = 0.0
) -> Rays:
    """Pair the returns of both sides by direction and compare their ranges.

    A cell is one azimuth step of the coarser side wide and as high as the distance of neighbouring beams, again of the
    coarser side, at that elevation. Returns whose directions differ by at most 0.75 cells (root of the sum of squares)
    are one ray, one to one, in order of that difference; in azimuth it is counted from the phase between the columns of
    the two sides, a circular mean over 32 columns of a beam. A return without a partner between two adjacent firings of
    the other side belongs to a finer grid and is left out. So are simulated returns above and below the real beams.

    The simulated range is that at which the real ray meets the plane around the simulated return (through its
    neighbours in its own and the next row): half a cell of difference in direction is 20 cm on a road 15 m away.

    Parameters
    ----------
    real, sim : (n, 3) and (m, 3) float64, metres, clean points of both sides in the frame of one sensor position
    real_grid, sim_grid : directions in which the two sensors fire
    noise_m : standard deviation of the difference of two ranges of a ray
    """
    step = max(real_grid.step_deg, sim_grid.step_deg)
    limits, rows = _rows_of(real_grid, sim_grid)
    a = _Side(real, real_grid, step, limits, rows)
    b = _Side(sim, sim_grid, step, limits, rows)
    partner = _partners(a, b)
    of_sim = np.full(len(sim), -1)
    both = np.flatnonzero(partner >= 0)
    of_sim[partner[both]] = both
    lowest, highest = np.interp(real_grid.elevation_deg[[0, -1]], limits, rows)
    is_seen = (b.place[:, 1] >= lowest - REACH) & (b.place[:, 1] <= highest + REACH)
    only_real = _without_finer(np.flatnonzero(partner < 0), a, b)
    only_sim = _without_finer(np.flatnonzero((of_sim < 0) & is_seen), b, a)
    met, single = b.normals(partner[both]), [side.normals(rows) for side, rows in ((a, only_real), (b, only_sim))]
    ranges = _range_along(real[both] / a.range_m[both, None], sim[partner[both]], met)
    difference = ranges - a.range_m[both]
    is_same = np.abs(difference) <= max(SAME_M, SAME_SIGMAS * noise_m)
    surface = scipy.spatial.cKDTree(sim, balanced_tree=False)
    is_far = surface.query(real[only_real], distance_upper_bound=SURFACE_M)[0] > SURFACE_M
    n_real, n_sim = len(only_real), len(only_sim)
    real_row = np.concatenate([both, only_real, np.full(n_sim, -1)])
    sim_row = np.concatenate([partner[both], np.full(n_real, -1), only_sim])
    is_real = real_row >= 0
    return _in_grid(
        beam=np.where(is_real, a.beam[real_row], real_grid.beam_of(sim)[sim_row]),
        azimuth=np.where(is_real, a.place[real_row, 0], b.place[sim_row, 0]),
        n_beams=len(real_grid.elevation_deg),
        n_columns=round(a.width),
        real_row=real_row,
        sim_row=sim_row,
        real_range_m=np.where(is_real, a.range_m[real_row], np.nan),
        sim_range_m=np.concatenate([ranges, np.full(n_real, np.nan), b.range_m[only_sim]]),
        outcome=np.concatenate(
            [
                np.where(is_same, SAME, np.where(difference < 0, IN_FRONT, BEHIND)),
                np.where(is_far, NO_SURFACE, DROPPED),
                np.full(n_sim, SIM_ONLY),
            ]
        ),
        incidence_deg=np.concatenate(
            [
                b.incidence_deg(partner[both], met),
                a.incidence_deg(only_real, single[0]),
                b.incidence_deg(only_sim, single[1]),
            ]
        ),
    )


def find_rays(
    real: FloatArray,
    sim: FloatArray,
    sensors: tuple[Mapping[str, Any], Mapping[str, Any]],
    T_real_sim: FloatArray | None = None,
) -> Rays | str:
    """Compare the rays of two scans whose sensors are known, or return the reason for which there are none.

    Parameters
    ----------
    real, sim : (n, 3) and (m, 3) float64, metres, clean points of both sides in the real sensor's frame
    sensors : of the real and the simulated side, the fields of `SensorDescription` by name
    T_real_sim : (3, 4) float64, motion of the simulated into the real sensor's frame, if they differ
    """
    for side, sensor in zip(("real", "simulated"), sensors, strict=True):
        for name in ("elevation_deg", "azimuth_step_deg"):
            if not sensor[name]:
                return f"{side} scan: {sensor['untold'].get(name, 'no beams')}"
    grids = [
        RayGrid(
            np.array(one["elevation_deg"]), one["azimuth_step_deg"], tuple(one["origin_height_m"]), one["block_deg"]
        )
        for one in sensors
    ]
    apart_m = 0.0 if T_real_sim is None else float(np.linalg.norm(T_real_sim[:, 3]))
    median_m = float(np.median(np.linalg.norm(real, axis=1)))
    cell_m = np.radians(max(grid.step_deg for grid in grids)) * median_m
    if apart_m > cell_m:
        return (
            f"the simulated sensor is {apart_m:.2f} m from the real one: at the median range of {median_m:.1f} m its "
            f"rays are {apart_m / cell_m:.1f} cells off"
        )
    noise_real, noise_sim = (sensor["range_noise_m"] or 0.0 for sensor in sensors)
    return compare_rays(real, sim, grids[0], grids[1], float(np.hypot(noise_real, noise_sim)))


def score_rays(rays: Rays, is_in: BoolArray | None = None) -> dict[str, Number]:
    """Scores of some rays, by column of `pairs`; None if no ray allows them.

    Shares are of the rays with a return on either side. `rays_hit_f1` is 2 b / (2 b + r + s) and `rays_drop_f1`
    2 n / (2 n + r + s), with b, r, s, n the rays that both sides, the real side only, the simulated side only, and
    neither returned. Bias (simulated minus real) and scale (simulated over real, minus 1) are medians over the rays
    that both returned; the interval of the bias is that of order statistics, 95 %, for independent rays. MAE, MedAE,
    p90 and RMSE are of the absolute difference on the same rays.

    Parameters
    ----------
    is_in : (n,) bool, rays to be scored; all by default
    """
    outcome = rays.outcome if is_in is None else rays.outcome[is_in]
    count = dict(zip(OUTCOMES, np.bincount(outcome, minlength=len(OUTCOMES)).tolist(), strict=True))
    n_none = count.pop("none")
    n_rays = sum(count.values())
    n_both = sum(count[name] for name in OUTCOMES[:DROPPED])
    n_single = n_rays - n_both
    scores: dict[str, Number] = {"n_rays": n_rays}
    scores |= {f"rays_{name}": n / n_rays if n_rays else None for name, n in count.items()}
    for name, n in (("hit", n_both), ("drop", n_none)):
        scores[f"rays_{name}_f1"] = 2 * n / (2 * n + n_single) if n + n_single else None
    is_both = rays.outcome <= BEHIND if is_in is None else (rays.outcome <= BEHIND) & is_in
    real, sim = rays.real_range_m[is_both], rays.sim_range_m[is_both]
    difference = np.sort(sim - real)
    names = ("bias_m", "bias_low_m", "bias_high_m", "scale", "mae_m", "medae_m", "p90_m", "rmse_m")
    values: list[Number] = [None] * len(names)
    if n_both:
        reach = 0.98 * np.sqrt(n_both)
        ranks = np.clip([n_both / 2 - reach, n_both / 2 + reach], 0, n_both - 1).astype(np.intp)
        error = np.abs(difference)
        values = [
            float(value)
            for value in (
                *(np.median(difference), *difference[ranks], np.median(sim / real) - 1.0),
                *(error.mean(), np.median(error), np.quantile(error, 0.9), np.sqrt((error**2).mean())),
            )
        ]
    return scores | dict(zip((f"rays_{name}" for name in names), values, strict=True))


def _rows_of(real_grid: RayGrid, sim_grid: RayGrid) -> tuple[FloatArray, FloatArray]:
    """Elevations, degrees, and a coordinate that grows by 1 from beam to beam of the side that is coarser there."""
    grids = [grid.elevation_deg for grid in (real_grid, sim_grid)]
    elevation = np.linspace(-90.0, 90.0, 18_001)
    apart = [np.interp(elevation, (grid[1:] + grid[:-1]) / 2, np.diff(grid)) for grid in grids]
    rows = np.cumsum(0.01 / np.maximum(*apart))
    return elevation, rows - rows[0]


class _Side:
    """The returns of a side by direction.

    place : (n, 2) float64, azimuth in cells from -180 degrees on, and row; see `_rows_of`
    beam : (n,) intp, of the side's own sensor
    width : cells of azimuth around
    step : of the side's own columns, in cells
    """

    def __init__(
        self, points: FloatArray, grid: RayGrid, step_deg: float, elevation_deg: FloatArray, rows: FloatArray
    ) -> None:
        self.points, self.range_m, self.beam = points, np.linalg.norm(points, axis=1), grid.beam_of(points)
        self.width, self.step = 360.0 / step_deg, grid.step_deg / step_deg
        azimuth = (np.degrees(np.arctan2(points[:, 1], points[:, 0])) + 180.0) / step_deg % self.width
        elevation = np.degrees(np.arcsin(points[:, 2] / self.range_m))
        self.place = np.column_stack([azimuth, np.interp(elevation, elevation_deg, rows)])
        self.tree = scipy.spatial.cKDTree(self.place, boxsize=[self.width, 0.0], balanced_tree=False)

    def incidence_deg(self, at: IndexArray | IntArray, normal: FloatArray) -> FloatArray:
        """(k,) angle between the rays of some returns and the normals of the surface that they met."""
        cosine = np.abs(np.einsum("ij,ij->i", normal, self.points[at])) / self.range_m[at]
        return np.degrees(np.arccos(np.minimum(cosine, 1.0)))

    def across(self, cells: FloatArray) -> FloatArray:
        """A difference of azimuths, in cells, the short way round."""
        return (cells + self.width / 2) % self.width - self.width / 2

    def normals(self, at: IndexArray | IntArray) -> FloatArray:
        """(k, 3) unit vectors of some returns, NaN if neighbours are missing.

        Of the plane through a return, its nearest neighbour along its row, and that on the rows next to it.
        """
        own = self.place[at]
        k = min(_NEIGHBOURS, len(self.place))
        distance, near = self.tree.query(own, k=k, distance_upper_bound=_NEAR_ROW[1])
        is_there = np.isfinite(distance) & (near != at[:, None])
        near = np.where(is_there, near, 0)
        across = np.abs(self.across(self.place[near, 0] - own[:, :1]))
        rows = np.abs(self.place[near, 1] - own[:, 1:])
        along = np.where(is_there & (rows < _ROW), across, np.inf)
        upward = np.where(is_there & (rows >= _NEAR_ROW[0]) & (rows < _NEAR_ROW[1]), np.hypot(across, rows), np.inf)
        edges = []
        for choice in (along, upward):
            best = choice.argmin(axis=1)[:, None]
            edge = self.points[np.take_along_axis(near, best, 1)[:, 0]] - self.points[at]
            edges.append(np.where(np.isfinite(np.take_along_axis(choice, best, 1)), edge, np.nan))
        normal = np.cross(edges[0], edges[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            unit: FloatArray = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        return unit


def _partners(a: _Side, b: _Side) -> IntArray:
    """(n,) for each return of `a` the row of its partner in `b`, -1 for none."""
    distance, near = b.tree.query(a.place, k=_CANDIDATES, distance_upper_bound=REACH + 1.0)
    row, rank = np.nonzero(np.isfinite(distance))
    near = near[row, rank]
    azimuth = a.across(b.place[near, 0] - a.place[row, 0])
    azimuth -= _phase(a, row[rank == 0], azimuth[rank == 0])[row]
    apart = np.hypot(azimuth, b.place[near, 1] - a.place[row, 1])
    row, near, apart = row[apart <= REACH], near[apart <= REACH], apart[apart <= REACH]
    order = np.argsort(apart, kind="stable")
    row, near = row[order], near[order]
    partner, is_taken = np.full(len(a.points), -1, dtype=np.int32), np.zeros(len(b.points), dtype=np.bool_)
    while len(row):  # a pair that comes first for both of its returns is the nearest pair of both
        first = np.flatnonzero(_is_first(row, len(partner)) & _is_first(near, len(is_taken)))
        partner[row[first]] = near[first]
        is_taken[near[first]] = True
        is_free = (partner[row] < 0) & ~is_taken[near]
        row, near = row[is_free], near[is_free]
    return partner


def _is_first(values: IndexArray, n: int) -> BoolArray:
    """True where a value, from 0 to n - 1, occurs for the first time."""
    first, places = np.empty(n, dtype=np.intp), np.arange(len(values))
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
    block = a.beam * n_blocks + (a.place[:, 0] // _PHASE_CELLS).astype(np.intp)
    of_beam, of_block = (_mean_phase(place, row, azimuth)[place] for place in (a.beam, block))
    return of_beam + (of_block - of_beam + 0.5) % 1.0 - 0.5


def _mean_phase(place: IndexArray, row: IndexArray, azimuth: FloatArray) -> FloatArray:
    """Circular mean of azimuths, in cells, by place; 0 where they do not agree."""
    size = int(place.max(initial=0)) + 1
    turn = np.exp(2j * np.pi * azimuth)
    total = np.bincount(place[row], turn.real, size) + 1j * np.bincount(place[row], turn.imag, size)
    is_steady = np.abs(total) > _STEADY * np.maximum(np.bincount(place[row], minlength=size), 1)
    return np.where(is_steady, np.angle(total) / (2 * np.pi), 0.0)


def _without_finer(rows: IndexArray, own: _Side, other: _Side) -> IndexArray:
    """Those of some returns without a partner that are rays: the other side would have fired there.

    Left out are returns between two adjacent firings of the other side, and, if the own grid is finer, all but the
    first of each cell.
    """
    near_rows = np.array([_SQUEEZE, 1.0])  # the nearest row counts more than the nearest column
    tree = scipy.spatial.cKDTree(other.place / near_rows, boxsize=[other.width / _SQUEEZE, 0.0], balanced_tree=False)
    k = min(_CANDIDATES, len(other.place))
    distance, near = tree.query(own.place[rows] / near_rows, k=k, distance_upper_bound=_LEAST_ROWS)
    is_there = np.isfinite(distance)
    near = np.where(is_there, near, 0)
    azimuth = own.across(other.place[near, 0] - own.place[rows, :1])
    is_there &= np.abs(other.place[near, 1] - other.place[near[:, :1], 1]) <= _ROW
    gap = [np.where(is_there & (sign * azimuth >= 0), sign * azimuth, np.inf).min(axis=1) for sign in (-1, 1)]
    rows = rows[gap[0] + gap[1] > _ADJACENT * other.step]
    if own.step * _FINER < 1.0:
        cell = np.column_stack([own.beam[rows], own.place[rows, 0].astype(np.intp)])
        rows = rows[np.sort(np.unique(cell, axis=0, return_index=True)[1])]
    return rows


def _range_along(directions: FloatArray, points: FloatArray, normal: FloatArray) -> FloatArray:
    """(n,) metres, where rays meet the planes around points; a point's own range if its ray grazes the plane."""
    own = np.linalg.norm(points, axis=1)
    cosine = np.einsum("ij,ij->i", directions, normal)
    with np.errstate(invalid="ignore", divide="ignore"):
        meeting = np.einsum("ij,ij->i", points, normal) / cosine
        is_met = (np.abs(cosine) > _GRAZING) & (np.abs(meeting - own) < _MOST_MOVED * own)
    return np.where(is_met, meeting, own)


def _in_grid(beam: IndexArray, azimuth: FloatArray, n_beams: int, n_columns: int, **values: IntArray) -> Rays:
    """Give each ray a column, no two of a beam the same, and add the rays that returned on neither side."""
    order = np.lexsort((azimuth, beam))
    beam, count = beam[order], np.bincount(beam, minlength=n_beams)
    start = np.repeat(np.cumsum(count) - count, count)
    rank = np.arange(len(order)) - start
    base = start * 1.0 + beam * n_columns
    column = azimuth[order].astype(np.intp)
    column = (np.maximum.accumulate(column - rank + base) - base + rank).astype(np.intp)
    most = np.maximum(n_columns, count)[beam] - count[beam] + rank
    column = np.minimum(column, most)
    is_silent = np.ones((n_beams, n_columns), dtype=np.bool_)
    is_silent[beam[column < n_columns], column[column < n_columns]] = False
    silent = np.nonzero(is_silent)
    n_silent = len(silent[0])
    empty = {"outcome": NONE, "real_row": -1, "sim_row": -1}
    beams, columns = np.concatenate([beam, silent[0]]), np.concatenate([column, silent[1]])
    final = np.lexsort((columns, beams))
    filled = {
        name: np.concatenate([own[order], np.full(n_silent, empty.get(name, np.nan), dtype=own.dtype)])[final]
        for name, own in values.items()
    }
    return Rays(beam=beams[final].astype(np.int32), column=columns[final].astype(np.int32), **filled)
