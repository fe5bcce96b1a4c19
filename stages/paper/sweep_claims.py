"""The paper's claims about its perturbations, checked on the sweeps of a scan.

An order between classes (the wall is most robust) carries the error of its means over the repeats of the alteration:
the points that noise and dropout hit are random. It is the order of these very objects, one of each class: it does not
predict other walls and cars.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import pairwise, product

from scipy.stats import t as student_t
from scipy.stats import ttest_ind_from_stats

from ..generate.perturbations import Perturbation
from ..statistics.comparison import CONFIDENCE
from .claim_rules import IN_WORDS, UNDECIDED, Claim, Interval, decided, within
from .sweep_means import SPECTRA, Mean, Means

RIGID_D_LAMBDA = 1e-5
RIGID_R_LAMBDA = 0.01
RIGID_R_GAP = 1e-4
LINEAR_TOLERANCE = 1e-3
_TIE = 1e-12
#: The paper's four objects, and its values for them at 40 % dropout (section "Point Dropout").
_CLASSES = ("vegetation", "car", "tree", "wall")
_DROPOUT_SHARE = 0.4
_R_LAMBDA_AT_SHARE = {"car": 0.40, "vegetation": 0.35}
_WALL_R_GAP = 0.004

_Levels = Sequence[Perturbation]
#: Means of a metric at some levels, by object; None is the whole scan.
_Curves = dict[str | None, list[Mean]]
#: The values as text, and the verdict.
_Finding = tuple[str, str]
_Test = Callable[[_Curves], _Finding]
#: `_check` with the means of the sweeps.
_Check = Callable[..., Iterator[Claim]]


def check_sweep_claims(means: Means, levels: Sequence[Perturbation]) -> list[Claim]:
    """The claims about these levels, in the paper's order; none if no value exists.

    A claim is not decided if one of its levels has no value.

    Parameters
    ----------
    means : of the sweeps
    levels : the swept levels
    """
    noise, dropout, rigid = (
        sorted((level for level in levels if level.kind == kind), key=lambda level: (level.shift_m, level.amount))
        for kind in ("noise", "dropout", "rigid")
    )
    check = partial(_check, means)
    claims = [*_rigid_claims(check, rigid, means.objects)]
    if len(dropout) > 1:
        claims += _dropout_claims(check, dropout, means.objects)
    if noise and dropout:
        claims += _noise_claims(check, means, noise, dropout, rigid)
    return claims


def _rigid_claims(check: _Check, rigid: _Levels, objects: Sequence[str]) -> Iterator[Claim]:
    every = partial(_smallest, digits=4, holds=lambda rate: rate == 1)
    yield from check("rigid motion keeps every object matched", "match rate 1", "match_rate", rigid, every)
    spectra = ("rigid motion keeps the spectra", "d_lambda below 1e-5", SPECTRA, rigid)
    yield from check(*spectra, partial(_below, bound=RIGID_D_LAMBDA))
    rotations = [level for level in rigid if level.shift_m == 0 and level.amount]

    def is_linear(curves: _Curves) -> _Finding:
        slopes = [value / abs(level.amount) for level, value in zip(rotations, _values(curves[None]), strict=True)]
        off = max(slopes) / min(slopes) - 1 if min(slopes) > 0 else math.inf
        return f"{slopes[0]:.4f} m per degree, the same within {off:.0e}", decided(off < LINEAR_TOLERANCE)

    if len(rotations) > 1:
        claim, paper = "d_cent is linear in the angle", "0.4126 m per degree"
        yield from check(claim, paper, "centroid_distance_m_mean", rotations, is_linear)
    for metric, bound in (("r_lambda", RIGID_R_LAMBDA), ("r_gap", RIGID_R_GAP)):
        claim = f"rigid motion leaves {metric} of objects at 0"
        yield from check(claim, f"below {bound:g}", metric, rigid, partial(_below, bound=bound), objects)


def _dropout_claims(check: _Check, dropout: _Levels, objects: Sequence[str]) -> Iterator[Claim]:
    for metric in ("r_lambda", "r_gap"):
        claim = f"{metric} rises with dropout, object by object"
        yield from check(claim, "all four", metric, dropout, partial(_for_each_object, holds=_is_rising), objects)
    if {*_CLASSES} <= {*objects}:
        yield from _class_claims(check, dropout)
    for claim, paper, metric, sign in (
        ("the match rate falls with dropout", "0.915, 0.884, 0.854", "match_rate", -1),
        ("d_lambda rises with dropout", "0.100, 0.300, 0.786", SPECTRA, 1),
    ):
        yield from check(claim, paper, metric, dropout, partial(_moves, sign=sign))


def _class_claims(check: _Check, dropout: _Levels) -> Iterator[Claim]:
    """The paper's claims about its four classes under dropout; only if objects have labels, not shapes."""
    most = dropout[-1]
    for metric in ("r_lambda", "r_gap"):
        for text, upper, lower in (
            ("the wall is most robust", ("vegetation", "car", "tree"), ("wall",)),
            ("car and vegetation are most sensitive", ("car", "vegetation"), ("tree", "wall")),
        ):
            test = partial(_order, value=lambda own: own[-1], upper=upper, lower=lower)
            yield from check(f"dropout: {text} by {metric}", IN_WORDS, metric, [most], test, _CLASSES)

    def is_small(curves: _Curves) -> _Finding:
        ends = [_ends(mean) for mean in curves["wall"]]
        interval = Interval(low=max(low for low, _ in ends), high=max(high for _, high in ends))
        here = f"up to {max(_values(curves['wall'])):.4f}, 95 % below {interval.high:.4f}"
        return here, within(interval, -math.inf, _WALL_R_GAP)

    claim = "dropout: r_gap of the wall stays small"
    yield from check(claim, f"below {_WALL_R_GAP:g}", "r_gap", dropout, is_small, ["wall"])

    def is_near(curves: _Curves, paper: float) -> _Finding:
        ((mean,),) = curves.values()
        low, high = _ends(mean)
        return f"{low:.3f} to {high:.3f}", within(Interval(low=low, high=high), 0.9 * paper, 1.1 * paper)

    if most.amount == _DROPOUT_SHARE:
        for name, paper in _R_LAMBDA_AT_SHARE.items():
            claim = f"r_lambda of the {name} at {_DROPOUT_SHARE:.0%} dropout, within a tenth"
            yield from check(claim, f"{paper:.2f}", "r_lambda", [most], partial(is_near, paper=paper), [name])


def _noise_claims(check: _Check, means: Means, noise: _Levels, dropout: _Levels, rigid: _Levels) -> Iterator[Claim]:
    nearly = partial(_smallest, digits=3, holds=lambda rate: rate > 0.95)
    yield from check("noise keeps nearly all objects matched", "above 0.95", "match_rate", noise, nearly)
    n = len(noise)
    if any(all(means.series(name, own, "r_lambda") for own in (noise, dropout)) for name in means.objects):
        claim = "r_lambda under the most noise is below that under the most dropout"
        is_less = partial(_for_each_object, holds=lambda values: max(values[:n]) < max(values[n:]))
        yield from check(claim, "all four", "r_lambda", [*noise, *dropout], is_less, means.objects)
    if {*_CLASSES} <= {*means.objects} and n > 1:
        claim = "noise: r_lambda of the tree is near-flat (moves least)"
        test = partial(_order, value=_move, upper=("vegetation", "car", "wall"), lower=("tree",))
        yield from check(claim, IN_WORDS, "r_lambda", noise, test, _CLASSES)
    kinds = {"noise": noise, "dropout": dropout, "rigid": rigid}
    series = {kind: means.series(None, levels, SPECTRA) for kind, levels in kinds.items()}
    most = {kind: max(values) for kind, values in series.items() if values}
    if "dropout" in most and len(most) > 1:
        here = ", ".join(f"{kind} {value:.2g}" for kind, value in most.items())
        verdict = decided(max(most, key=lambda kind: most[kind]) == "dropout")
        claim = "of noise, dropout and rigid motion dropout changes the spectra most"
        every = [*noise, *dropout, *rigid]
        yield from check(claim, "d_lambda 0.044, 0.79, 7e-06", SPECTRA, every, lambda _: (here, verdict))


def _check(
    means: Means,
    claim: str,
    paper: str,
    metric: str,
    levels: _Levels,
    test: _Test,
    objects: Sequence[str | None] = (None,),
) -> Iterator[Claim]:
    """The claim with its verdict: none if no value exists, undecided if one is missing.

    Parameters
    ----------
    metric, levels : of the curves
    test : the values as text and the verdict; gets the curves of the objects with values, all complete
    objects : of the curves; None is the whole scan
    """
    curves = {name: [means.get(name, level, metric) for level in levels] for name in objects}
    curves = {name: own for name, own in curves.items() if _values(own)}
    missing = [
        f"{level.kind} {level.amount:g}" + (f" of {name}" if name else "")
        for name in objects
        for level in means.missing(name, levels, metric)
    ]
    if curves:
        here, verdict = (f"no value for {', '.join(missing)}", UNDECIDED) if missing else test(curves)
        yield Claim(claim=claim, paper=paper, here=here, verdict=verdict)


def _below(curves: _Curves, bound: float) -> _Finding:
    """Test that all values are below a bound."""
    most = max(max(_values(own)) for own in curves.values())
    return f"{most:.1e}", decided(most < bound)


def _smallest(curves: _Curves, digits: int, holds: Callable[[float], bool]) -> _Finding:
    """Test that the smallest value meets a condition."""
    least = min(min(_values(own)) for own in curves.values())
    return f"{least:.{digits}f}", decided(holds(least))


def _for_each_object(curves: _Curves, holds: Callable[[list[float]], bool]) -> _Finding:
    """Test that the values of every object meet a condition."""
    others = [str(name) for name, own in curves.items() if not holds(_values(own))]
    n = len(curves)
    return f"{n - len(others)} of {n}, not {', '.join(others)}" if others else f"all {n}", decided(not others)


def _moves(curves: _Curves, sign: int) -> _Finding:
    """Test that the values of the whole scan rise (`sign` 1) or fall (-1)."""
    values = _values(curves[None])
    return ", ".join(f"{value:.3f}" for value in values), decided(_is_rising([sign * value for value in values]))


def _order(
    curves: _Curves, value: Callable[[list[Mean]], Mean], upper: Iterable[str], lower: Iterable[str]
) -> _Finding:
    """Test that a value of each object in `upper` is larger than that of each in `lower`.

    It holds if each of the differences is beyond chance, and fails if one is beyond chance in the other direction
    (together at 5 %, each at 5 % over their number: Bonferroni).
    """
    values = {name: value(own) for name, own in curves.items()}
    ranked = sorted(values, key=lambda name: -(values[name].mean or 0.0))
    both = list(product(upper, lower))
    signs = [_sign(values[a], values[b], (1 - CONFIDENCE) / len(both)) for a, b in both]
    here = ", ".join(f"{name} {values[name].mean or 0.0:.3g}" for name in ranked)
    return here, decided(min(signs) > 0, min(signs) < 0)


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
