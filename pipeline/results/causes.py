"""Causes: what to fix first in a simulator, from the columns of `pairs` and from coverage by range and class.

A cause is named if its 95 % interval over pairs lies beyond its tolerance. The tolerance covers the difference between
two measurements of one scene and, for positions, what a poor twin shows without being displaced (docs/power.md).
Causes are ordered by severity: the share of the surface that the flaw affects. A length counts as a share of the reach
at which it is noticed (displacement 0.3 m, noise and range steps 0.1 m), a number of beams or an azimuth step as a
share of the real one, and missing or invented points as a share of all points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.results import Cause
from ...stages.arrays import BoolArray, FloatArray
from ...stages.statistics.findings import BAND_EDGES_M
from .places import short_label

#: Names of the causes from coverage by range and by class.
FAR, CLASS = "far surface", "class"
#: Fewer pairs have no interval: a cause is then named if each of them is beyond the tolerance.
LEAST_FOR_INTERVAL = 3
CONFIDENCE = 0.95
#: The world is displaced in height, not only its road, if its other surfaces follow the road by at least this share.
_FOLLOWS = 1 / 3
#: Surface of a range band or a class is a cause if more of it is missing than of the rest, by this share.
_MORE_MISSING = 0.2
#: Far surface begins at 20 m or beyond.
_FIRST_FAR = BAND_EDGES_M.index(20.0)
#: A band or a class counts in pairs with this many points in it, and outside.
_FEWEST_POINTS = 50


@dataclass(frozen=True)
class CauseKind:
    """A flaw that can be estimated from one row of `pairs`.

    column : of both sides ("{side}" is replaced), or of their difference
    tolerance, relative : not named within `tolerance` plus `relative` times the smaller of both values
    full : value that affects the whole surface; 0: the real value
    words : with {size} (absolute estimate), {way} (of `ways`: above and below 0), {real}, {sim}, {count}
    setting : attributes of CARLA's LiDAR blueprint where they fit
    count : column whose mean over pairs is {count}
    null_as : value of a null if the sensor of that side was recognised
    """

    name: str
    unit: str
    column: str
    tolerance: float
    relative: float
    full: float
    words: str
    setting: str
    ways: tuple[str, str] = ("", "")
    count: str = ""
    null_as: float | None = None

    def sides(self, row: Row) -> tuple[float | None, float | None]:
        """The values of the real and the simulated side; a difference has 0 on the real side."""
        if "{side}" not in self.column:
            return 0.0, row.get(self.column)
        values = [row.get(self.column.format(side=side)) for side in SIDES]
        has_sensor = [row.get(f"sensor_{side}_beams") is not None for side in SIDES]
        real, sim = (self.null_as if v is None and has else v for v, has in zip(values, has_sensor, strict=True))
        return real, sim

    def value(self, row: Row) -> float | None:
        """The estimate of one pair: simulated minus real, 0 without the flaw; None if it is not known.

        Examples
        --------
        >>> CAUSE_KINDS[0].value({"ground_real_peak_m": -1.75, "ground_sim_peak_m": -2.0})
        -0.25
        """
        real, sim = self.sides(row)
        return None if real is None or sim is None else sim - real


_WORLD, _PIECES = "simulated world {size} too {way}", "{count} %s pieces per pair, {size} of the points"
_MOUNT, _FOV, _RATE = "mount height, T_real_sim", "channels, upper_fov, lower_fov", "points_per_second"
_NOISE, _STEP, _QUANTUM = (f"{name} {{sim}}, real {{real}}" for name in ("range noise", "azimuth step", "range steps"))
_LOST, _BEAMS = "{sim} of the pulses lost, real {real}", "{sim} beams, real {real}"
CAUSE_KINDS = (
    CauseKind("height", "m", "ground_{side}_peak_m", 0.03, 0, 0.3, _WORLD, _MOUNT, ("high", "low")),
    CauseKind("forward", "m", "shift_x_m", 0.1, 0, 0.3, _WORLD, "T_real_sim", ("far ahead", "far back")),
    CauseKind("sideways", "m", "shift_y_m", 0.1, 0, 0.3, _WORLD, "T_real_sim", ("far left", "far right")),
    CauseKind("range noise", "m", "sensor_{side}_range_noise_m", 0.015, 0.5, 0.1, _NOISE, "noise_stddev"),
    CauseKind("lost pulses", "share", "sensor_{side}_lost_share", 0.05, 0, 1, _LOST, "dropoff_general_rate"),
    CauseKind("beams", "", "sensor_{side}_beams", 1.5, 0.05, 0, _BEAMS, _FOV),
    CauseKind("azimuth step", "deg", "sensor_{side}_azimuth_step_deg", 0, 0.2, 0, _STEP, _RATE),
    CauseKind("range steps", "m", "sensor_{side}_range_quantum_m", 0.01, 0, 0.1, _QUANTUM, "range format", null_as=0.0),
    *(
        CauseKind(f"{what} pieces", "share", f"{what}_pieces_share", 0.005, 0, 1, _PIECES % what, "assets", count=count)
        for what, count in (("missing", "n_missing_pieces"), ("invented", "n_invented_pieces"))
    ),
)


#: Columns of `pairs` that the causes are estimated from.
CAUSE_COLUMNS = (
    *dict.fromkeys(kind.column.format(side=side) for kind in CAUSE_KINDS for side in SIDES),
    *(kind.count for kind in CAUSE_KINDS if kind.count),
    "shift_z_m",
)


@dataclass(frozen=True)
class GroupCoverage:
    """Object points of a side by group (range band or class), and those without a counterpart within 0.3 m.

    n_points, n_alone : (n_pairs, n_groups) float64
    """

    names: tuple[str, ...]
    n_points: FloatArray
    n_alone: FloatArray

    def of_group(self, i: int) -> tuple[float, float]:
        """Points of a group over all pairs, and those without a counterpart."""
        return float(self.n_points[:, i].sum()), float(self.n_alone[:, i].sum())


def find_causes(
    rows: Sequence[Row], floor: Mapping[str, Row] | None = None, surface: Sequence[Cause] = ()
) -> list[Cause]:
    """The causes that are beyond their tolerance, most severe first.

    Parameters
    ----------
    rows : of `pairs`, the scored ones
    floor : by pair, rows of a floor, whose values are subtracted
    surface : from `surface_causes`
    """
    named = [cause for kind in CAUSE_KINDS if (cause := _cause_of(kind, rows, floor or {}))]
    return sorted([*named, *surface], key=lambda cause: -cause.severity)


def surface_causes(bands: GroupCoverage, classes: GroupCoverage) -> list[Cause]:
    """Range bands and classes of which much more is missing than of the rest.

    Parameters
    ----------
    bands, classes : of the real side, by range band (`BAND_EDGES_M`) and by class ("" for none)
    """
    far = [
        _coverage_cause(FAR, f"beyond {edge_m:g} m {{sim}} of the surface missing", "range, dropoff", bands, is_far)
        for i, edge_m in list(enumerate(BAND_EDGES_M))[_FIRST_FAR:]
        for is_far in [np.arange(len(BAND_EDGES_M)) >= i]
    ]
    farthest = max((cause for cause in far if cause), key=_contrast, default=None)
    named = [
        _coverage_cause(CLASS, f"{short_label(name)}: {{sim}} of the surface missing", "assets", classes, is_own)
        for i, name in enumerate(classes.names)
        if name
        for is_own in [np.arange(len(classes.names)) == i]
    ]
    return [cause for cause in (farthest, *named) if cause]


def mean_interval(values: FloatArray) -> tuple[float, float, float]:
    """Mean over pairs with its 95 % interval (Student's t); the range of the values below 3 pairs."""
    from scipy.special import stdtrit  # takes longer to load than the rest of `show`

    n, mean = len(values), float(values.mean())
    if n < LEAST_FOR_INTERVAL:
        return mean, float(values.min()), float(values.max())
    reach = float(stdtrit(n - 1, (1 + CONFIDENCE) / 2) * values.std(ddof=1) / np.sqrt(n))
    return mean, mean - reach, mean + reach


def size_words(value: float, unit: str) -> str:
    """An absolute value as people write it.

    Examples
    --------
    >>> [size_words(*one) for one in ((0.12, "m"), (0.041, "m"), (0.78, "share"), (0.004, "share"), (32, ""))]
    ['12 cm', '41 mm', '78 %', '0.4 %', '32']
    """
    value = abs(value)
    if unit == "m":
        mm = round(value * 1000)
        return f"{mm} mm" if mm < 50 else f"{value * 100:.0f} cm" if value < 1 else f"{value:.1f} m"
    if unit == "share":
        return f"{100 * value:.{int(value < 0.01)}f} %"
    return f"{value:.3g} {unit}".rstrip()


def _signed(mean_m: float, width_m: float, n_pairs: int) -> str:
    """A signed length with half of its interval."""
    return f"{mean_m:+.2f}{f' ± {width_m / 2:.2f}' if n_pairs >= LEAST_FOR_INTERVAL else ''} m"


def _contrast(cause: Cause) -> float:
    """Variance between both groups of points, by which the distance is chosen at which far surface begins."""
    share = cause.severity / cause.estimate
    return cause.estimate**2 * share * (1 - share)


def _cause_of(kind: CauseKind, rows: Sequence[Row], floor: Mapping[str, Row]) -> Cause | None:
    known = [row for row in rows if kind.value(row) is not None]
    if not known:
        return None
    over = [kind.value(floor[row["pair_id"]]) if row["pair_id"] in floor else None for row in known]
    values = np.array([kind.value(row) for row in known]) - np.array([value or 0.0 for value in over])
    real, sim = np.array([kind.sides(row) for row in known], dtype=np.float64).mean(axis=0).tolist()
    mean, low, high = mean_interval(values)
    if max(low, -high) <= kind.tolerance + kind.relative * min(abs(real), abs(sim)):
        return None
    words, setting, detail = kind.words, kind.setting, ""
    if kind.name == "height":
        shifts = [row["shift_z_m"] for row in known if row.get("shift_z_m") is not None]
        shift, shift_low, shift_high = mean_interval(np.array(shifts)) if shifts else (0.0, 0.0, 0.0)
        if shift / mean < _FOLLOWS:
            words, setting = words.replace("world", "road"), "road height of the map"
        detail = f"road {sim:.2f} against {real:.2f} m"
        if shifts:
            detail = f"shift z {_signed(shift, shift_high - shift_low, len(shifts))}, {detail}"
    elif kind.ways[0]:
        detail = f"{kind.column.removesuffix('_m').replace('_', ' ')} {_signed(mean, high - low, len(known))}"
    count = np.mean([row[kind.count] for row in known]) if kind.count else 0.0
    if len(known) < LEAST_FOR_INTERVAL:
        few = f"{len(known)} pair{'s' * (len(known) > 1)}, no interval: confirm with diagnose"
        detail = f"{detail}; {few}" if detail else few
    return Cause(
        name=kind.name,
        words=words.format(
            size=size_words(mean, kind.unit),
            way=kind.ways[mean < 0],
            real=size_words(real, kind.unit),
            sim=size_words(sim, kind.unit),
            count=f"{count:.1f}",
        ),
        detail=detail,
        setting=setting,
        estimate=mean,
        low=low if len(known) >= LEAST_FOR_INTERVAL else None,
        high=high if len(known) >= LEAST_FOR_INTERVAL else None,
        unit=kind.unit,
        n_pairs=len(known),
        real=real,
        sim=sim,
        severity=min(1.0, abs(mean) / (kind.full or abs(real) or 1.0)),
    )


def _coverage_cause(name: str, words: str, setting: str, groups: GroupCoverage, is_inside: BoolArray) -> Cause | None:
    """A cause for the chosen groups if more of them is missing than of the others, pair by pair."""
    inside, outside = (
        np.stack([groups.n_points[:, own].sum(axis=1), groups.n_alone[:, own].sum(axis=1)])
        for own in (is_inside, ~is_inside)
    )
    judged = (inside[0] >= _FEWEST_POINTS) & (outside[0] >= _FEWEST_POINTS)
    if not judged.any():
        return None
    (n, alone), (n_rest, alone_rest) = inside[:, judged], outside[:, judged]
    mean, low, high = mean_interval(alone / n - alone_rest / n_rest)
    if low <= _MORE_MISSING:
        return None
    sim, real = float((alone / n).mean()), float((alone_rest / n_rest).mean())
    has_interval = len(n) >= LEAST_FOR_INTERVAL
    return Cause(
        name=name,
        words=words.format(sim=size_words(sim, "share")),
        detail=f"{size_words(real, 'share')} {'nearer' if name == FAR else 'elsewhere'}",
        setting=setting,
        estimate=mean,
        low=low if has_interval else None,
        high=high if has_interval else None,
        unit="share",
        n_pairs=len(n),
        real=real,
        sim=sim,
        severity=mean * float((n / (n + n_rest)).mean()),
    )
