"""What the paper says of its perturbations, and whether the sweeps of a scan bear it out.

An order between classes (the wall is most robust) carries the error of its means over the repeats of the alteration:
which points noise and dropout hit is chance. It is that of these very objects, one of each class: it does not say what
other walls and cars would do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise, product

from scipy.stats import t as student_t
from scipy.stats import ttest_ind_from_stats

from ..generate.perturbations import Perturbation
from ..statistics.comparison import CONFIDENCE
from .claim_rules import UNDECIDED, Claim, Interval, decided, within
from .sweeps import SPECTRA, Mean, Means

RIGID_D_LAMBDA = 1e-5
RIGID_R_LAMBDA = 0.01
RIGID_R_GAP = 1e-4
LINEAR_TOLERANCE = 1e-3
_TIE = 1e-12
#: The paper's four objects, and what it says of them at 40 % dropout (section "Point Dropout").
_CLASSES = ("vegetation", "car", "tree", "wall")
_DROPOUT_SHARE = 0.4
_R_LAMBDA_AT_SHARE = {"car": 0.40, "vegetation": 0.35}
_WALL_R_GAP = 0.004
_IN_WORDS = "(in words)"

#: Values of a metric at some levels, by object; None stands for the whole scan.
_Curves = dict[str | None, list[float]]
#: The values in words, and the verdict.
_Verdict = tuple[str, str]


def judge_claims(means: Means, levels: Sequence[Perturbation]) -> list[Claim]:
    """The claims that these levels are about, in the paper's order; none if there is no value at all.

    A claim is not decided if one of its levels has no value.

    Parameters
    ----------
    means : of the sweeps
    levels : that were swept
    """
    noise, dropout, rigid = (
        sorted((level for level in levels if level.kind == kind), key=lambda level: (level.shift_m, level.amount))
        for kind in ("noise", "dropout", "rigid")
    )
    claims = _rigid_claims(means, rigid)
    if len(dropout) > 1:
        claims += _dropout_claims(means, dropout)
    if noise and dropout:
        claims += _noise_claims(means, noise, dropout, rigid)
    return claims


def _rigid_claims(means: Means, rigid: list[Perturbation]) -> list[Claim]:
    claims = [
        *_judge(
            "rigid motion keeps every object matched",
            "match rate 1",
            means,
            ("match_rate", rigid),
            lambda curves: (f"{_least(curves):.4f}", decided(_least(curves) == 1)),
        ),
        *_judge(
            "rigid motion keeps the spectra",
            "d_lambda below 1e-5",
            means,
            (SPECTRA, rigid),
            lambda curves: (f"{_most(curves):.1e}", decided(_most(curves) < RIGID_D_LAMBDA)),
        ),
    ]
    turns = [level for level in rigid if level.shift_m == 0 and level.amount]

    def linear(curves: _Curves) -> _Verdict:
        slopes = [value / abs(level.amount) for level, value in zip(turns, curves[None], strict=True)]
        off = max(slopes) / min(slopes) - 1 if min(slopes) > 0 else float("inf")
        return f"{slopes[0]:.4f} m per degree, the same within {off:.0e}", decided(off < LINEAR_TOLERANCE)

    if len(turns) > 1:
        scores = ("centroid_distance_m_mean", turns)
        claims += _judge("d_cent is linear in the angle", "0.4126 m per degree", means, scores, linear)

    for metric, bound in (("r_lambda", RIGID_R_LAMBDA), ("r_gap", RIGID_R_GAP)):

        def below(curves: _Curves, bound: float = bound) -> _Verdict:
            return f"{_most(curves):.1e}", decided(_most(curves) < bound)

        claim, paper = f"rigid motion leaves {metric} of objects at 0", f"below {bound:g}"
        claims += _judge(claim, paper, means, (metric, rigid), below, means.objects)
    return claims


def _dropout_claims(means: Means, dropout: list[Perturbation]) -> list[Claim]:
    claims = []
    for metric in ("r_lambda", "r_gap"):
        claim = f"{metric} rises with dropout, object by object"
        claims += _judge(
            claim,
            "all four",
            means,
            (metric, dropout),
            lambda curves: _share(curves, lambda name: _is_rising(curves[name])),
            means.objects,
        )
    claims += _class_claims(means, dropout)
    claims += _judge(
        "the match rate falls with dropout",
        "0.915, 0.884, 0.854",
        means,
        ("match_rate", dropout),
        lambda curves: (_listed(curves[None]), decided(_is_rising([-rate for rate in curves[None]]))),
    )
    claims += _judge(
        "d_lambda rises with dropout",
        "0.100, 0.300, 0.786",
        means,
        (SPECTRA, dropout),
        lambda curves: (_listed(curves[None]), decided(_is_rising(curves[None]))),
    )
    return claims


def _class_claims(means: Means, dropout: list[Perturbation]) -> list[Claim]:
    """What the paper says of its four classes under dropout; of those that have a name, not a shape."""
    if any(name not in means.objects for name in _CLASSES):
        return []
    most, claims = dropout[-1], []
    for metric in ("r_lambda", "r_gap"):
        for words, upper, lower in (
            ("the wall is most robust", ("vegetation", "car", "tree"), ("wall",)),
            ("car and vegetation are most sensitive", ("car", "vegetation"), ("tree", "wall")),
        ):

            def order(
                _: _Curves, metric: str = metric, parts: tuple[tuple[str, ...], ...] = (upper, lower)
            ) -> _Verdict:
                return _order({name: means.get(name, most, metric) for name in _CLASSES}, *parts)

            claims += _judge(f"dropout: {words} by {metric}", _IN_WORDS, means, (metric, [most]), order, _CLASSES)

    def is_small(curves: _Curves) -> _Verdict:
        ends = [_ends(means.get("wall", level, "r_gap")) for level in dropout]
        interval = Interval(low=max(low for low, _ in ends), high=max(high for _, high in ends))
        verdict = within(interval, -math.inf, _WALL_R_GAP)
        return f"up to {_most(curves):.4f}, 95 % below {interval.high:.4f}", verdict

    paper = f"below {_WALL_R_GAP:g}"
    claims += _judge("dropout: r_gap of the wall stays small", paper, means, ("r_gap", dropout), is_small, ["wall"])
    if most.amount == _DROPOUT_SHARE:
        for name, value in _R_LAMBDA_AT_SHARE.items():

            def is_near(_: _Curves, name: str = name, value: float = value) -> _Verdict:
                low, high = _ends(means.get(name, most, "r_lambda"))
                return f"{low:.3f} to {high:.3f}", within(Interval(low=low, high=high), 0.9 * value, 1.1 * value)

            claim = f"r_lambda of the {name} at {_DROPOUT_SHARE:.0%} dropout, within a tenth"
            claims += _judge(claim, f"{value:.2f}", means, ("r_lambda", [most]), is_near, [name])
    return claims


def _flat_tree(means: Means, noise: list[Perturbation]) -> list[Claim]:
    """That the tree answers to noise near-flat: of the four classes its r_lambda moves least over the levels."""
    if any(name not in means.objects for name in _CLASSES) or len(noise) < 2:
        return []

    def order(_: _Curves) -> _Verdict:
        moves = {name: _move([means.get(name, level, "r_lambda") for level in noise]) for name in _CLASSES}
        return _order(moves, ("vegetation", "car", "wall"), ("tree",))

    claim = "noise: r_lambda of the tree is near-flat (moves least)"
    return _judge(claim, _IN_WORDS, means, ("r_lambda", noise), order, _CLASSES)


def _order(values: dict[str, Mean], upper: Iterable[str], lower: Iterable[str]) -> _Verdict:
    """The values, largest first, and whether each of `upper` is larger than each of `lower`.

    It is where each of the differences is beyond chance, it is not where one is beyond chance the other way round
    (together at 5 %, each at 5 % over their number: Bonferroni).
    """
    ranked = sorted(values, key=lambda name: -(values[name].mean or 0.0))
    both = list(product(upper, lower))
    differences = [_sign(values[a], values[b], (1 - CONFIDENCE) / len(both)) for a, b in both]
    words = ", ".join(f"{name} {values[name].mean or 0.0:.3g}" for name in ranked)
    return words, decided(all(sign > 0 for sign in differences), any(sign < 0 for sign in differences))


def _sign(a: Mean, b: Mean, chance: float) -> int:
    """1 where a mean is larger than another, -1 where it is smaller, beyond chance over the repeats; else 0.

    Welch's t-test (The generalization of Student's problem, Biometrika 1947).
    """
    if a.mean is None or b.mean is None or a.std is None or b.std is None:
        return 0
    if a.std == b.std == 0:
        return (a.mean > b.mean) - (a.mean < b.mean)
    p = ttest_ind_from_stats(a.mean, a.std, a.n, b.mean, b.std, b.n, equal_var=False).pvalue
    return (1 if a.mean > b.mean else -1) if p < chance else 0


def _move(levels: Sequence[Mean]) -> Mean:
    """How far a metric moves over some levels: its largest mean less its smallest, with the deviation of both."""
    known = sorted((level for level in levels if level.mean is not None), key=lambda level: level.mean or 0.0)
    low, high = known[0], known[-1]
    std = None if low.std is None or high.std is None else math.hypot(low.std, high.std)
    return Mean((high.mean or 0.0) - (low.mean or 0.0), std, min(low.n, high.n))


def _ends(value: Mean) -> tuple[float, float]:
    """The 95 % interval of a mean over repeats (Student's t); without bounds where there is one repeat only."""
    if value.mean is None or value.std is None or value.n < 2:
        return -math.inf, math.inf
    reach = float(student_t.isf((1 - CONFIDENCE) / 2, value.n - 1)) * value.std / math.sqrt(value.n)
    return value.mean - reach, value.mean + reach


def _noise_claims(
    means: Means, noise: list[Perturbation], dropout: list[Perturbation], rigid: list[Perturbation]
) -> list[Claim]:
    claims = _judge(
        "noise keeps nearly all objects matched",
        "above 0.95",
        means,
        ("match_rate", noise),
        lambda curves: (f"{_least(curves):.3f}", decided(_least(curves) > 0.95)),
    )
    n = len(noise)
    if any(all(means.series(name, own, "r_lambda") for own in (noise, dropout)) for name in means.objects):
        claims += _judge(
            "r_lambda under the most noise is below that under the most dropout",
            "all four",
            means,
            ("r_lambda", [*noise, *dropout]),
            lambda curves: _share(curves, lambda name: max(curves[name][:n]) < max(curves[name][n:])),
            means.objects,
        )
    claims += _flat_tree(means, noise)
    by_kind = {
        kind: means.series(None, levels, SPECTRA)
        for kind, levels in (("noise", noise), ("dropout", dropout), ("rigid", rigid))
    }
    most = {kind: max(values) for kind, values in by_kind.items() if values}
    if "dropout" in most and len(most) > 1:
        here = ", ".join(f"{kind} {value:.2g}" for kind, value in most.items())
        claims += _judge(
            "of noise, dropout and rigid motion dropout changes the spectra most",
            "d_lambda 0.044, 0.79, 7e-06",
            means,
            (SPECTRA, [*noise, *dropout, *rigid]),
            lambda _: (here, decided(max(most, key=lambda kind: most[kind]) == "dropout")),
        )
    return claims


def _judge(
    claim: str,
    paper: str,
    means: Means,
    scores: tuple[str, Sequence[Perturbation]],
    verdict: Callable[[_Curves], _Verdict],
    objects: Sequence[str | None] = (None,),
) -> list[Claim]:
    """The claim with its verdict; [] where there is no value, no verdict where one is missing.

    Parameters
    ----------
    scores : the metric that it is about, and the levels
    verdict : what the values say, and whether the claim holds; of the objects with values, each of which has all
    objects : whose values they are; the whole scan where it is None
    """
    metric, levels = scores
    curves = {name: curve for name in objects if (curve := means.series(name, levels, metric))}
    gaps = [
        f"{level.kind} {level.amount:g}" + (f" of {name}" if name else "")
        for name in objects
        for level in means.missing(name, levels, metric)
    ]
    if not curves:
        return []
    here, judged = (f"no value for {', '.join(gaps)}", UNDECIDED) if gaps else verdict(curves)
    return [Claim(claim=claim, paper=paper, here=here, verdict=judged)]


def _least(curves: _Curves) -> float:
    return min(min(values) for values in curves.values())


def _most(curves: _Curves) -> float:
    return max(max(values) for values in curves.values())


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3f}" for value in values)


def _is_rising(values: Sequence[float]) -> bool:
    return all(b > a + _TIE for a, b in pairwise(values))


def _share(curves: _Curves, holds: Callable[[str | None], bool]) -> _Verdict:
    """The number of objects of which something holds, in words, and the verdict on all of them."""
    others = [str(name) for name in curves if not holds(name)]
    if not others:
        return f"all {len(curves)}", decided(True)
    return f"{len(curves) - len(others)} of {len(curves)}, not {', '.join(others)}", decided(False)
