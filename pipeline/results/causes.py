"""Causes: what to fix first in a simulator, from the columns of `pairs` and from coverage by range and class.

A cause is named if its 95 % interval over pairs lies beyond its tolerance. The tolerance covers the difference between
two measurements of one scene and, for positions, what a poor twin shows without being displaced (docs/power.md).
Causes are ordered by severity: the share of the surface that the flaw affects. A length counts as a share of the reach
at which it is noticed (displacement 0.3 m, noise and range steps 0.1 m), a number of beams or an azimuth step as a
share of the real one, and missing or invented points as a share of all points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.results import Cause
from ...stages.arrays import BoolArray, FloatArray
from ...stages.statistics.findings import BAND_EDGES_M
from .places import short_label

if TYPE_CHECKING:
    import pandas as pd

    #: Points of a side by pair (rows) and group (columns), and those of them without a counterpart within 0.3 m.
    GroupPoints = tuple[pd.DataFrame, pd.DataFrame]

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


class Columns(dict[str, FloatArray]):
    """Columns of some rows of `pairs`, read when first used; NaN for null, and if the rows lack the column."""

    def __init__(self, rows: Iterable[Row]) -> None:
        super().__init__()
        self._rows = [*rows]

    def __missing__(self, name: str) -> FloatArray:
        self[name] = np.array([row.get(name) for row in self._rows], dtype=np.float64)
        return self[name]


@dataclass(frozen=True)
class CauseKind:
    """A flaw that can be estimated from columns of `pairs`.

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

    def sides(self, pairs: Mapping[str, FloatArray]) -> list[FloatArray]:
        """The values of the real and the simulated side, (n,) each; a difference has 0 on the real side."""
        if "{side}" not in self.column:
            return [np.zeros(len(pairs[self.column])), pairs[self.column]]
        values = [pairs[self.column.format(side=side)] for side in SIDES]
        if self.null_as is None:
            return values
        is_known = [pairs[f"sensor_{side}_beams"] > 0 for side in SIDES]
        return [np.where(np.isnan(v) & has, self.null_as, v) for v, has in zip(values, is_known, strict=True)]

    def value(self, pairs: Mapping[str, FloatArray]) -> FloatArray:
        """The estimate of each pair, (n,): simulated minus real, 0 without the flaw; NaN if it is not known.

        Examples
        --------
        >>> CAUSE_KINDS["height"].value(Columns([{"ground_real_peak_m": -1.75, "ground_sim_peak_m": -2.0}]))
        array([-0.25])
        """
        real, sim = self.sides(pairs)
        return sim - real


_WORLD, _PIECES = "simulated world {size} too {way}", "{count} %s pieces per pair, {size} of the points"
_MOUNT, _FOV, _RATE = "mount height, T_real_sim", "channels, upper_fov, lower_fov", "points_per_second"
_NOISE, _STEP, _QUANTUM = (f"{name} {{sim}}, real {{real}}" for name in ("range noise", "azimuth step", "range steps"))
_LOST, _BEAMS = "{sim} of the pulses lost, real {real}", "{sim} beams, real {real}"
_KINDS = (
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
#: The flaws by name.
CAUSE_KINDS = {kind.name: kind for kind in _KINDS}

#: Causes by the beginning of a difference of the sensors.
_DIFFERENCES = {
    "beams: ": "beams",
    "azimuth step": "azimuth step",
    "range quantum": "range steps",
    "range noise": "range noise",
    "pulses lost": "lost pulses",
}

#: Columns of `pairs` that the causes are estimated from.
CAUSE_COLUMNS = (
    *dict.fromkeys(kind.column.format(side=side) for kind in _KINDS for side in SIDES),
    *(kind.count for kind in _KINDS if kind.count),
    "shift_z_m",
)


def find_causes(
    pairs: Mapping[str, FloatArray], floors: Mapping[str, FloatArray] | None = None, surface: Sequence[Cause] = ()
) -> list[Cause]:
    """The causes that are beyond their tolerance, most severe first.

    Parameters
    ----------
    pairs : `CAUSE_COLUMNS` of the scored pairs; NaN for null
    floors : those of a floor, pair by pair, which are subtracted
    surface : from `surface_causes`
    """
    floors = Columns([{}]) if floors is None else floors
    named = [cause for kind in _KINDS if (cause := _cause_of(kind, pairs, floors))]
    return sorted([*named, *surface], key=lambda cause: -cause.severity)


def surface_causes(bands: GroupPoints, classes: GroupPoints) -> list[Cause]:
    """Range bands and classes of which much more is missing than of the rest.

    Parameters
    ----------
    bands, classes : of the real side, by range band (index in `BAND_EDGES_M`) and by class ("" for none)
    """
    far = [
        _coverage_cause(FAR, f"beyond {edge_m:g} m {{sim}} of the surface missing", "range, dropoff", bands, is_far)
        for i, edge_m in list(enumerate(BAND_EDGES_M))[_FIRST_FAR:]
        for is_far in [np.arange(len(BAND_EDGES_M)) >= i]
    ]
    farthest = max((cause for cause in far if cause), key=_contrast, default=None)
    named = [
        _coverage_cause(CLASS, f"{short_label(name)}: {{sim}} of the surface missing", "assets", classes, is_own)
        for name in classes[0].columns
        if name
        for is_own in [classes[0].columns == name]
    ]
    return [cause for cause in (farthest, *named) if cause]


def with_tolerance(texts: Sequence[str], row: Row) -> list[str]:
    """Differences of both sensors, those within the tolerance of their cause marked.

    Parameters
    ----------
    texts : from `sensor_description.differences`
    row : `sensor_description.pair_columns` of both
    """
    pairs = Columns([row])
    small = {
        kind.name
        for kind in _KINDS
        if not np.isnan(kind.value(pairs)).any() and _cause_of(kind, pairs, Columns([{}])) is None
    }
    starts = tuple(start for start, name in _DIFFERENCES.items() if name in small)
    return [f"{text} (too little for Fix first)" if text.startswith(starts) else text for text in texts]


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


def _cause_of(kind: CauseKind, pairs: Mapping[str, FloatArray], floors: Mapping[str, FloatArray]) -> Cause | None:
    values = kind.value(pairs)
    known = ~np.isnan(values)
    if not known.any():
        return None
    n = int(known.sum())
    mean, low, high = mean_interval((values - np.nan_to_num(kind.value(floors)))[known])
    real, sim = np.column_stack(kind.sides(pairs))[known].mean(axis=0).tolist()
    if max(low, -high) <= kind.tolerance + kind.relative * min(abs(real), abs(sim)):
        return None
    words, setting, detail = kind.words, kind.setting, []
    if kind.name == "height":
        shifts = pairs["shift_z_m"][known & ~np.isnan(pairs["shift_z_m"])]
        shift, shift_low, shift_high = mean_interval(shifts) if len(shifts) else (0.0, 0.0, 0.0)
        if shift / mean < _FOLLOWS:
            words, setting = words.replace("world", "road"), "road height of the map"
        detail = [f"shift z {_signed(shift, shift_high - shift_low, len(shifts))}"] * bool(len(shifts))
        detail = [", ".join([*detail, f"road {sim:.2f} against {real:.2f} m"])]
    elif kind.ways[0]:
        detail = [f"{kind.column.removesuffix('_m').replace('_', ' ')} {_signed(mean, high - low, n)}"]
    if n < LEAST_FOR_INTERVAL:
        detail.append(f"{n} pair{'s' * (n > 1)}, no interval: confirm with diagnose")
    sizes = {name: size_words(value, kind.unit) for name, value in (("size", mean), ("real", real), ("sim", sim))}
    count = f"{pairs[kind.count][known].mean():.1f}" if kind.count else ""
    return Cause(
        name=kind.name,
        words=words.format(way=kind.ways[mean < 0], count=count, **sizes),
        detail="; ".join(detail),
        setting=setting,
        estimate=mean,
        low=low if n >= LEAST_FOR_INTERVAL else None,
        high=high if n >= LEAST_FOR_INTERVAL else None,
        unit=kind.unit,
        n_pairs=n,
        real=real,
        sim=sim,
        severity=min(1.0, abs(mean) / (kind.full or abs(real) or 1.0)),
    )


def _coverage_cause(name: str, words: str, setting: str, groups: GroupPoints, is_inside: BoolArray) -> Cause | None:
    """A cause for the chosen groups if more of them is missing than of the others, pair by pair."""
    (n, alone), (n_rest, alone_rest) = (
        [points.to_numpy()[:, own].sum(axis=1) for points in groups] for own in (is_inside, ~is_inside)
    )
    judged = (n >= _FEWEST_POINTS) & (n_rest >= _FEWEST_POINTS)
    if not judged.any():
        return None
    n, alone, n_rest, alone_rest = (values[judged] for values in (n, alone, n_rest, alone_rest))
    mean, low, high = mean_interval(alone / n - alone_rest / n_rest)
    if low <= _MORE_MISSING:
        return None
    sim, real = float((alone / n).mean()), float((alone_rest / n_rest).mean())
    return Cause(
        name=name,
        words=words.format(sim=size_words(sim, "share")),
        detail=f"{size_words(real, 'share')} {'nearer' if name == FAR else 'elsewhere'}",
        setting=setting,
        estimate=mean,
        low=low if len(n) >= LEAST_FOR_INTERVAL else None,
        high=high if len(n) >= LEAST_FOR_INTERVAL else None,
        unit="share",
        n_pairs=len(n),
        real=real,
        sim=sim,
        severity=mean * float((n / (n + n_rest)).mean()),
    )
