"""Causes of a run: flaws of the catalogue with amount, 95 % interval and setting, from the table `causes`.

Every command shows this list. A cause is named if its interval over the pairs lies beyond its tolerance; a change
between two runs, if it lies beyond the resolution of the estimate. Causes are ordered by the gain of correcting them
(table `gains`, from `fidpipe diagnose`), or without it by the share of the surface that they affect.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...schemas.cause_catalogue import CAUSES, FLAT, LOSSES, PARAMETERS, UNEVEN, CauseModel
from ...schemas.columns import Row
from ...schemas.results import Cause, Unknown
from ...stages.arrays import FloatArray, IntArray
from ...stages.statistics.comparison import LEAST_FOR_INTERVAL, block_means, mean_interval
from ..storage.folder import RunFolder

if TYPE_CHECKING:
    import pandas as pd

#: Most causes that are shown at first.
MOST_SHOWN = 7
#: From so many on, causes that are unknown for one reason are counted, not named.
MANY_UNKNOWN = 8
#: Intensity that is missing, as a share: over another run, of what that one has.
SCALE = "intensity scale"
#: Variance of returns between directions that is still random, and the square of the loss.
_UNEVEN = 0.01
#: More of the points in other places, with both of these, are a bent world.
_BENT = 0.03
_ALONE = ("missing parts", "invented parts")
#: If the road stays where it is while all else is raised, the world is not displaced: part of the height that remains.
_ROAD_STAYS = 0.3
#: A road that is higher or lower by this, metres, is seen as further beams: those of the objects remain.
_ROAD_AS_BEAMS_M = 0.02
#: If more of the curved surface is too flat, more than the shape of some objects is wrong.
_MELTED = 0.3
#: Solid foliage also flattens surface, by less than this part of its amount; boxes also stop rays in foliage. So only
#: one of the two is named.
_FLAT_OF_SOLID = 0.25
#: Not named with a displacement unless larger than this, degrees, as a displacement blurs beams too.
_BLURRED = ("elevation noise", "azimuth noise")
_BLUR_OF_DISPLACED_DEG = 0.08
#: A scale and a bias of the range that cancel each other at this range, but for a part of the larger one, are those of
#: a bent world.
_MIDDLE_M, _CANCELLED = 10.0, 0.5
#: Part of the resolution that covers the errors of 95 % of the estimates.
_ACCURACY = 0.7
#: Displacements move every point: a change counts if it explains this part of the distance that all others leave.
LEAST_PART_OF_POSE = 0.15
#: The same of lengths and angles against the real scan, from which a poor simulator is far in other ways too; no other
#: flaw feigns an angle in all pairs.
_LEAST_PART_OF_LENGTH, _LEAST_PART_OF_ANGLE = 0.08, 0.02
_ANGLES = ("roll", "pitch", "yaw")
_OF_POSE = (*PARAMETERS, "elevation scale")
#: Independent places that all lie beyond a resolution.
_ENOUGH = 4
_NUMBERS = ["amount", "real", "sim", "share"]
_COLUMNS = ["cause", *_NUMBERS, "reason"]
_OTHER_VERSION = "the run was made by a version without this cause"

#: (pairs, columns) of a cause by its name: amount, real, sim, share and reason of table `causes`; NaN if unknown.
CauseRows = Mapping[str, "pd.DataFrame"]


def read_causes(store: RunFolder, pair_ids: Sequence[str]) -> dict[str, pd.DataFrame]:
    """The table `causes` of some pairs, for each cause of the catalogue; tables of another version may have others.

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    frame = store.read_pairs(pair_ids, {("causes", ""): _COLUMNS})["causes", ""]
    return _by_cause(frame, sorted(CAUSES), len(pair_ids))


def cause_values(pairs: Sequence[Sequence[Row]]) -> dict[str, pd.DataFrame]:
    """Estimates of some pairs, by name of the cause; those that no pair has are left out.

    Parameters
    ----------
    pairs : rows of the table `causes` of each pair
    """
    import pandas as pd

    rows = []
    for pair, of_pair in enumerate(pairs):
        rows += [{"pair": pair} | row for row in of_pair]
    frame = pd.DataFrame(rows, columns=["pair", *_COLUMNS])
    return _by_cause(frame, frame["cause"].unique(), len(pairs))


def _by_cause(
    frame: pd.DataFrame, names: Iterable[str], n_pairs: int
) -> dict[str, pd.DataFrame]:
    """`CauseRows` of some causes, from a row per pair and cause."""
    frame = frame.set_index("pair").astype(dict.fromkeys(_NUMBERS, np.float64))
    return {name: frame[frame["cause"] == name].reindex(range(n_pairs)) for name in names}


def independent_blocks(blocks: IntArray) -> IntArray:
    """The blocks over which an interval is formed: each pair counts as one if there are fewer than three blocks."""
    if len(np.unique(blocks)) < LEAST_FOR_INTERVAL:
        return np.arange(len(blocks), dtype=np.int32)
    return blocks


def named_causes(values: CauseRows, blocks: IntArray) -> list[Cause]:
    """The causes whose interval lies beyond the tolerance, those that affect most of the surface first."""
    return named_and_small(values, blocks)[0]


def named_and_small(values: CauseRows, blocks: IntArray) -> tuple[list[Cause], list[str]]:
    """The named causes, and displacements that explain too little of the distance to be named, as sentences.

    Parameters
    ----------
    values : from `read_causes`
    blocks : (n,) independent place of each pair; pairs of one place count once, with their mean
    """
    blocks = independent_blocks(blocks)
    named = []
    small = []
    for name in _named(values, blocks, is_change=False):
        cause = _cause(name, values[name], blocks)
        if _is_small(cause):
            small.append(cause.words)
        else:
            named.append(cause)
    return sorted(named, key=lambda cause: -cause.share), small


def _is_small(cause: Cause) -> bool:
    return cause.name in _OF_POSE and cause.share < least_part_of_pose(cause.name)


def unknown_causes(values: CauseRows) -> list[Unknown]:
    """The causes that are unknown in most pairs, by reason."""
    by_reason: dict[str, list[str]] = {}
    for name, rows in values.items():
        if name != UNEVEN and not _is_known(rows):
            by_reason.setdefault(_reason(rows), []).append(name)
    return [Unknown(causes=tuple(names), reason=reason) for reason, names in by_reason.items()]


def _reason(rows: pd.DataFrame) -> str:
    """Why a cause is unknown, in the first pair without an amount."""
    reasons = rows["reason"].dropna().tolist()
    return reasons[0] if reasons else _OTHER_VERSION


def no_cause_words(unknown: Sequence[Unknown]) -> str:
    """Sentence if no cause is named: there is none, or most are unknown."""
    none = "no cause is larger than the differences between two measurements of one scene"
    n_unknown = sum(len(group.causes) for group in unknown)
    if n_unknown == 0:
        return none
    n_causes = len(CAUSES.keys() - {UNEVEN})
    if 2 * n_unknown <= n_causes:
        return f"{none}; {n_unknown} of {n_causes} are unknown"
    largest = max(unknown, key=lambda group: len(group.causes))
    return f"no cause can be named: {n_unknown} of {n_causes} are unknown ({largest.reason})"


def mean_amount(name: str, rows: pd.DataFrame, blocks: IntArray) -> Cause | Unknown:
    """A cause with its mean amount over the pairs, also if it is too small to be named."""
    if not _is_known(rows):
        return Unknown(causes=(name,), reason=_reason(rows))
    return _cause(name, rows, independent_blocks(blocks))


def _is_known(rows: pd.DataFrame) -> bool:
    """True if a cause has an amount in at least half of the pairs."""
    return 2 * int(rows["amount"].count()) >= len(rows)


def least_part_of_pose(name: str) -> float:
    """Part of the distance that a displacement of this name must explain, of what all others leave."""
    return _LEAST_PART_OF_ANGLE if name in _ANGLES else _LEAST_PART_OF_LENGTH


def changed_causes(
    before: CauseRows, after: CauseRows, between: Mapping[str, FloatArray], blocks: IntArray
) -> list[Cause]:
    """The causes that changed from one run to another by more than the resolution, those that moved most first.

    Parameters
    ----------
    before, after : of the same pairs in both runs
    between : by name, amounts that were measured between the simulated scans of both runs, which are more accurate
        than differences of two amounts against the real scan; NaN for pairs that were not chosen
    blocks : (n,) independent place of each pair
    """
    changes = {}
    for name, rows in after.items():
        if name in before:
            changes[name] = rows.assign(amount=change_of(name, before[name], rows, between))
    blocks = independent_blocks(blocks)
    named = _named(changes, blocks, is_change=True, measured=between)
    causes = [_cause(name, changes[name], blocks) for name in named]
    return sorted(
        causes, key=lambda cause: -abs(cause.estimate) / CAUSES[cause.name].resolution
    )


def change_of(
    name: str, before: pd.DataFrame, after: pd.DataFrame, between: Mapping[str, FloatArray]
) -> FloatArray:
    """(n,) change of the amount of a cause; of a lost share, relative to what the first run returned."""
    if name in between:
        return between[name]
    first, last = [rows["amount"].to_numpy() for rows in (before, after)]
    if name in (*LOSSES, SCALE):
        return 1.0 - (1.0 - last) / np.maximum(1.0 - first, 1e-9)
    return last - first


def _named(
    values: CauseRows, blocks: IntArray, *, is_change: bool, measured: Collection[str] = ()
) -> list[str]:
    """Names of the causes beyond the tolerance, or of the changes beyond the resolution; those feigned are left out.

    Parameters
    ----------
    measured : causes that count although they are known in less than half of the pairs, as a few were chosen
    """
    means = {name: _mean(rows["amount"]) or 0.0 for name, rows in values.items()}
    named = {}
    for name, rows in values.items():
        model = CAUSES[name]
        amounts = rows["amount"].to_numpy()
        is_known = ~np.isnan(amounts)
        is_enough = is_known.any() if name in measured else _is_known(rows)
        if name == UNEVEN or not is_enough or _is_feigned(name, means):
            continue
        limit = model.resolution if is_change else model.tolerance
        of_blocks = block_means(amounts[is_known], blocks[is_known])
        if _is_beyond(model, of_blocks, limit, is_change=is_change):
            named[name] = means[name]
    return [name for name in named if name not in _weaker(named)]


def _mean(values: pd.Series[float]) -> float | None:
    """Mean of the values that are known; None if none is."""
    return float(values.mean()) if values.notna().any() else None


def _is_beyond(model: CauseModel, means: FloatArray, limit: float, *, is_change: bool) -> bool:
    """True if the interval of the mean lies beyond a limit; of a change, also if that of each of many places does."""
    _, low, high = mean_interval(means)
    if is_change and len(means) >= _ENOUGH:
        low = max(low, float(means.min()))
        high = min(high, float(means.max()))
    return low > limit or (high < -limit and len(model.words) > 1)


def _is_feigned(name: str, means: Mapping[str, float]) -> bool:
    """True if a larger flaw of the world, or losses that are not random, feign a cause."""
    mean = means[name]
    road_m = means.get("road height", 0.0)
    if name in ("height", "road height"):
        height_m = means.get("height", 0.0)
        return abs(height_m + road_m) < _ROAD_STAYS * abs(height_m)
    if name in ("range scale", "range bias"):
        scale_m = _MIDDLE_M * means.get("range scale", 0.0)
        bias_m = means.get("range bias", 0.0)
        return abs(scale_m + bias_m) < _CANCELLED * max(abs(scale_m), abs(bias_m))
    if name == "beams":
        return mean > 0 and abs(road_m) > _ROAD_AS_BEAMS_M
    if name == "moved parts":
        return mean > _BENT and min(means.get(other, 0.0) for other in _ALONE) > mean / 10
    if name == FLAT:
        return mean > _MELTED
    return name in LOSSES and means.get(UNEVEN, 0.0) > _UNEVEN + mean**2


def _weaker(named: Mapping[str, float]) -> set[str]:
    """Of causes that exclude each other, the ones to leave out."""
    weaker = set[str]()
    if not named.keys().isdisjoint(PARAMETERS):
        weaker.update(n for n in _BLURRED if named.get(n, 0.0) < _BLUR_OF_DISPLACED_DEG)
    if "lost far returns" in named:
        weaker.add("far surface")
    if FLAT in named:
        is_solid = named[FLAT] < _FLAT_OF_SOLID * abs(named.get("solid foliage", 0.0))
        weaker.add(FLAT if is_solid else "solid foliage")
    return weaker


def cause_interval(
    model: CauseModel, amounts: FloatArray, blocks: IntArray
) -> tuple[float, float, float]:
    """Mean amount of a cause with its 95 % interval.

    Half of the interval is the root of the sum of the squares of Student's t over places, of the accuracy of the
    estimate, and of its error in proportion to the amount.

    Parameters
    ----------
    amounts, blocks : (n,) of the pairs in which it is known
    """
    mean, low, high = mean_interval(block_means(amounts, blocks))
    reach = float(
        np.linalg.norm([(high - low) / 2, _ACCURACY * model.resolution, model.relative * mean])
    )
    return mean, mean - reach, mean + reach


def _cause(name: str, rows: pd.DataFrame, blocks: IntArray) -> Cause:
    model = CAUSES[name]
    is_known = rows["amount"].notna().to_numpy()
    known = rows[is_known]
    mean, low, high = cause_interval(model, known["amount"].to_numpy(), blocks[is_known])
    return Cause(
        name=name,
        kind=model.kind,
        words=cause_words(model, mean),
        setting=model.setting,
        estimate=mean,
        low=low,
        high=high,
        unit=model.unit,
        n_pairs=len(known),
        real=_mean(known["real"]),
        sim=_mean(known["sim"]),
        share=_mean(known["share"]) or 0.0,
        limbs=model.limbs,
    )


def cause_words(model: CauseModel, amount: float) -> str:
    """The flaw as a sentence with its amount."""
    too_much = model.words[0]
    too_little = model.words[-1]
    return (too_little if amount < 0 else too_much).format(size=size_words(amount, model.unit))


def size_words(value: float, unit: str) -> str:
    """An absolute value as people write it.

    Examples
    --------
    >>> [size_words(*pair) for pair in ((0.12, "m"), (0.041, "m"), (0.78, "share"), (0.004, "share"), (32, ""))]
    ['12 cm', '41 mm', '78 %', '0.4 %', '32']
    """
    value = abs(value)
    if unit == "m":
        if round(value * 1000) < 50:
            return f"{value * 1000:.0f} mm"
        return f"{value * 100:.0f} cm" if value < 1 else f"{value:.1f} m"
    if unit == "share":
        return f"{100 * value:.1f} %" if value < 0.01 else f"{100 * value:.0f} %"
    return f"{value:.3g} {unit}".rstrip()


def interval_words(cause: Cause) -> str:
    """The 95 % interval of the amount of a cause; a minus is the opposite of its sentence."""
    sign = -1 if cause.estimate < 0 else 1
    ends = sorted((sign * cause.low, sign * cause.high))
    sizes = [("-" if end < 0 else "") + size_words(end, cause.unit) for end in ends]
    return " to ".join(sizes)
