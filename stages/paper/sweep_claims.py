"""The paper's claims about its perturbations, checked on the sweeps of a scan.

The claims are rows of `schemas/paper.toml`; each names its metric, levels and objects, and one of the tests below.

An order between classes (the wall is most robust) carries the error of its means over the repeats of the alteration:
the points that noise and dropout hit are random. It is the order of these very objects, one of each class: it does not
predict other walls and cars.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise, product
from typing import Any

from scipy.stats import t as student_t
from scipy.stats import ttest_ind_from_stats

from ...schemas.data_files import read_data
from ..generate.perturbations import Perturbation
from ..statistics.comparison import CONFIDENCE
from .claim_rules import IN_WORDS, UNDECIDED, Claim, Interval, decided, within
from .sweep_means import Mean, Means

_TIE = 1e-12
#: The paper's four objects (section "Point Dropout").
_CLASSES = ("vegetation", "car", "tree", "wall")

#: Means of a metric at some levels, by object; None is the whole scan.
_Curves = Mapping[str | None, Sequence[Mean]]
_Levels = Sequence[Perturbation]
#: The values as text, and the verdict.
_Finding = tuple[str, str]


def check_sweep_claims(means: Means, levels: _Levels) -> list[Claim]:
    """The claims about these levels, in the paper's order; none if no value exists.

    A claim is not decided if one of its levels has no value.

    Parameters
    ----------
    means : of the sweeps
    levels : the swept levels
    """
    by_kind: dict[str, list[Perturbation]] = {"noise": [], "dropout": [], "rigid": []}
    for level in sorted(levels, key=lambda level: (level.shift_m, level.amount)):
        by_kind.setdefault(level.kind, []).append(level)
    by_kind["rotation"] = [level for level in by_kind["rigid"] if level.shift_m == 0 and level.amount]
    by_kind["most dropout"] = by_kind["dropout"][-1:]
    by_kind["dropout of 40 %"] = [level for level in by_kind["most dropout"] if level.amount == 0.4]
    claims = (_check(means, by_kind, row) for row in read_data("paper")["sweep_claims"])
    return [claim for claim in claims if claim is not None]


def _check(means: Means, by_kind: Mapping[str, _Levels], row: Mapping[str, Any]) -> Claim | None:
    """A claim with its verdict; undecided if a value is missing, None if there is nothing to check.

    Parameters
    ----------
    row : `metric`, `levels` (by kind) and `objects` of the curves: "scan", "each", or "classes", all of which must have
        been altered, and of these perhaps `only` one; the `test` in `_TESTS`, which gets the curves of the objects
        with values, all complete, their levels, and the `bounds`; `needs`, the fewest levels of each kind
    """
    if any(len(by_kind[kind]) < n for kind, n in row.get("needs", {}).items()):
        return None
    metric, objects = row["metric"], row.get("objects", "scan")
    names: Sequence[str | None] = {"scan": (None,), "each": means.objects, "classes": _CLASSES}[objects]
    if objects == "classes" and not {*_CLASSES} <= {*means.objects}:
        return None
    names = [row["only"]] if "only" in row else names
    swept = [by_kind[kind] for kind in row["levels"] if by_kind[kind]]
    if not any(swept and all(means.series(name, own, metric) for own in swept) for name in names):
        return None
    every = [level for own in swept for level in own]
    curves = {
        name: [means.get(name, level, metric) for level in every] for name in names if means.series(name, every, metric)
    }
    missing = [
        f"{level.kind} {level.amount:g}" + (f" of {name}" if name else "")
        for name in names
        for level in means.missing(name, every, metric)
    ]
    here, verdict = f"no value for {', '.join(missing)}", UNDECIDED
    if not missing:
        here, verdict = _TESTS[row["test"]](curves, every, **row.get("bounds", {}))
    return Claim(claim=row["claim"], paper=row.get("paper", IN_WORDS), here=here, verdict=verdict)


def _is_below(curves: _Curves, _: _Levels, bound: float) -> _Finding:
    """Test that all values are below a bound."""
    most = max(max(_values(own)) for own in curves.values())
    return f"{most:.1e}", decided(most < bound)


def _is_above(curves: _Curves, _: _Levels, bound: float, digits: int) -> _Finding:
    """Test that all shares are above a bound; a bound of 1 is met by 1."""
    least = min(min(_values(own)) for own in curves.values())
    return f"{least:.{digits}f}", decided(least > bound or least == 1)


def _is_linear(curves: _Curves, levels: _Levels, tolerance: float) -> _Finding:
    """Test that the values are proportional to the amount."""
    slopes = [value / abs(level.amount) for level, value in zip(levels, _values(curves[None]), strict=True)]
    off = max(slopes) / min(slopes) - 1 if min(slopes) > 0 else math.inf
    return f"{slopes[0]:.4f} m per degree, the same within {off:.0e}", decided(off < tolerance)


def _moves(curves: _Curves, _: _Levels, sign: int) -> _Finding:
    """Test that the values of the whole scan rise (`sign` 1) or fall (-1)."""
    values = _values(curves[None])
    return ", ".join(f"{value:.3f}" for value in values), decided(_is_rising([sign * value for value in values]))


def _all_rise(curves: _Curves, _: _Levels) -> _Finding:
    """Test that the values of every object rise."""
    return _for_each_object(curves, _is_rising)


def _is_noise_less(curves: _Curves, levels: _Levels) -> _Finding:
    """Test that of every object the most noise does less than the most dropout."""
    n = sum(level.kind == "noise" for level in levels)
    return _for_each_object(curves, lambda values: max(values[:n]) < max(values[n:]))


def _does_dropout_most(curves: _Curves, levels: _Levels) -> _Finding:
    """Test that dropout reaches the largest value."""
    most: dict[str, float] = {}
    for level, value in zip(levels, _values(curves[None]), strict=True):
        most[level.kind] = max(value, most.get(level.kind, value))
    here = ", ".join(f"{kind} {value:.2g}" for kind, value in most.items())
    return here, decided(max(most, key=lambda kind: most[kind]) == "dropout")


def _is_small(curves: _Curves, _: _Levels, bound: float) -> _Finding:
    """Test that the intervals of the means of an object are below a bound."""
    (own,) = curves.values()
    lows, highs = zip(*map(_ends, own), strict=True)
    here = f"up to {max(_values(own)):.4f}, 95 % below {max(highs):.4f}"
    return here, within(Interval(low=max(lows), high=max(highs)), -math.inf, bound)


def _is_near(curves: _Curves, _: _Levels, value: float) -> _Finding:
    """Test that the interval of a mean is within a tenth of a value."""
    ((mean,),) = curves.values()
    low, high = _ends(mean)
    return f"{low:.3f} to {high:.3f}", within(Interval(low=low, high=high), 0.9 * value, 1.1 * value)


def _is_ordered(curves: _Curves, levels: _Levels, upper: Iterable[str], lower: Iterable[str]) -> _Finding:
    """Test that the value of each object in `upper`, or its move over several levels, is larger than in `lower`.

    It holds if each of the differences is beyond chance, and fails if one is beyond chance in the other direction
    (together at 5 %, each at 5 % over their number: Bonferroni).
    """
    values = {name: _move(own) if len(levels) > 1 else own[0] for name, own in curves.items()}
    ranked = sorted(values, key=lambda name: -(values[name].mean or 0.0))
    both = list(product(upper, lower))
    signs = [_sign(values[a], values[b], (1 - CONFIDENCE) / len(both)) for a, b in both]
    here = ", ".join(f"{name} {values[name].mean or 0.0:.3g}" for name in ranked)
    return here, decided(min(signs) > 0, min(signs) < 0)


_TESTS: dict[str, Callable[..., _Finding]] = {
    "below": _is_below,
    "above": _is_above,
    "linear": _is_linear,
    "moves": _moves,
    "rising": _all_rise,
    "noise below dropout": _is_noise_less,
    "dropout most": _does_dropout_most,
    "small": _is_small,
    "near": _is_near,
    "order": _is_ordered,
}


def _for_each_object(curves: _Curves, holds: Callable[[list[float]], bool]) -> _Finding:
    others = [str(name) for name, own in curves.items() if not holds(_values(own))]
    n = len(curves)
    return f"{n - len(others)} of {n}, not {', '.join(others)}" if others else f"all {n}", decided(not others)


def _sign(a: Mean, b: Mean, chance: float) -> int:
    """1 if a mean is larger than another beyond chance over the repeats, -1 if it is smaller, else 0.

    Welch's t-test (The generalization of Student's problem, Biometrika 1947).
    """
    if a.mean is None or b.mean is None or a.std is None or b.std is None:
        return 0
    if a.std == b.std == 0:
        return (a.mean > b.mean) - (a.mean < b.mean)
    p = ttest_ind_from_stats(a.mean, a.std, a.n, b.mean, b.std, b.n, equal_var=False).pvalue
    return (1 if a.mean > b.mean else -1) if p < chance else 0


def _move(levels: Sequence[Mean]) -> Mean:
    """The largest minus the smallest mean of some levels, with the deviation of both."""
    known = sorted((level for level in levels if level.mean is not None), key=lambda level: level.mean or 0.0)
    low, high = known[0], known[-1]
    std = None if low.std is None or high.std is None else math.hypot(low.std, high.std)
    return Mean((high.mean or 0.0) - (low.mean or 0.0), std, min(low.n, high.n))


def _ends(value: Mean) -> tuple[float, float]:
    """The 95 % interval of a mean over repeats (Student's t); infinite for a single repeat."""
    if value.mean is None or value.std is None or value.n < 2:
        return -math.inf, math.inf
    reach = float(student_t.isf((1 - CONFIDENCE) / 2, value.n - 1)) * value.std / math.sqrt(value.n)
    return value.mean - reach, value.mean + reach


def _values(levels: Iterable[Mean]) -> list[float]:
    """The means that are known."""
    return [level.mean for level in levels if level.mean is not None]


def _is_rising(values: Sequence[float]) -> bool:
    return all(b > a + _TIE for a, b in pairwise(values))
