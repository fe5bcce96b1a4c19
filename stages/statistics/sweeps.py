"""What the sweeps of perturbations say: which of the paper's claims hold, and which metric reacts to which alteration.

Works on the means over repeats: of the whole scan, and of the single objects that were altered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from ...schemas.metrics import METRIC, OBJECT_METRICS
from ..sensing.perturbations import Perturbation

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

OWN_METRICS = (
    "r_lambda",
    "r_gap",
    "max_eigenvalue_shift",
    "laplacian_change",
    "eigenspectrum_distance",
    "cdc",
)
_SPECTRA = "eigenspectrum_distance_mean"
#: Values of a metric at some levels, by object; None stands for the whole scan.
_Curves = dict[str | None, list[float]]


@dataclass(frozen=True)
class Claim:
    """One claim: what the paper says, what the data here say, and whether it holds; None where that cannot be told."""

    claim: str
    paper: str
    here: str
    holds: bool | None


@dataclass(frozen=True)
class Mean:
    """Mean and standard deviation of a metric at a level over `n` repeats; None where it could not be computed."""

    mean: float | None = None
    std: float | None = None
    n: int = 0


@dataclass(frozen=True)
class Reaction:
    """A metric at the strongest level of each kind.

    values : means over the objects, in the order of the levels; None where nothing could be computed
    most : the level at which it is farthest from its value for equal objects; None where it never moves
    """

    metric: str
    values: tuple[float | None, ...]
    most: Perturbation | None


class Means:
    """The means of the sweeps, to be looked up.

    Parameters
    ----------
    rows : of `perturb_summary`: object (None for the whole scan), kind, amount, shift_m, metric, mean, std, n
    """

    def __init__(self, rows: Iterable[Mapping[str, Any]]) -> None:
        self._by_key: dict[tuple[str | None, Perturbation, str], Mean] = {}
        for row in rows:
            level = Perturbation(row["kind"], row["amount"], row["shift_m"])
            self._by_key[row["object"], level, row["metric"]] = Mean(row["mean"], row["std"], row["n"])
        self.objects = tuple(dict.fromkeys(name for name, _, _ in self._by_key if name is not None))
        self.object_metrics = {metric for name, _, metric in self._by_key if name is not None}

    def get(self, object_name: str | None, level: Perturbation, metric: str) -> Mean:
        """One value; of the whole scan where `object_name` is None."""
        return self._by_key.get((object_name, level, metric), Mean())

    def series(self, object_name: str | None, levels: Sequence[Perturbation], metric: str) -> list[float]:
        """The means at some levels; those that could not be computed are left out."""
        means = (self.get(object_name, level, metric).mean for level in levels)
        return [mean for mean in means if mean is not None]

    def missing(self, object_name: str | None, levels: Sequence[Perturbation], metric: str) -> list[Perturbation]:
        """The levels at which a metric could not be computed; none where it was not asked for at any."""
        if not any((object_name, level, metric) in self._by_key for level in levels):
            return []
        return [level for level in levels if self.get(object_name, level, metric).mean is None]


def judge_claims(means: Means, levels: Sequence[Perturbation]) -> list[Claim]:
    """The claims that these levels are about, in the paper's order; none where there is no value at all.

    A claim is not judged (`holds` is None) where one of its levels has no value, which might tell another tale.

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


def react(means: Means, levels: Sequence[Perturbation]) -> list[Reaction]:
    """How each metric answers: our own, then the baselines that were swept, by name.

    Parameters
    ----------
    means : of the sweeps
    levels : that were swept
    """
    strongest = strongest_levels(levels)
    reactions = []
    for metric in (*OWN_METRICS, *sorted(means.object_metrics - set(OBJECT_METRICS))):
        values = []
        for level in strongest:
            by_object = [value for name in means.objects for value in means.series(name, [level], metric)]
            values.append(sum(by_object) / len(by_object) if by_object else None)
        equal = METRIC[metric].equal or 0.0
        moved = {level: abs(v - equal) for level, v in zip(strongest, values, strict=True) if v is not None}
        most = max(moved, key=lambda level: moved[level]) if any(moved.values()) else None
        reactions.append(Reaction(metric, tuple(values), most))
    return reactions


def strongest_levels(levels: Sequence[Perturbation]) -> list[Perturbation]:
    """Of each kind the level with the largest amount; of density also the one with the smallest."""
    strongest = []
    for kind in dict.fromkeys(level.kind for level in levels):
        own = sorted((level for level in levels if level.kind == kind), key=lambda level: (level.amount, level.shift_m))
        if kind == "density" and own[0].amount < 1 < own[-1].amount:
            strongest.append(own[0])
        strongest.append(own[-1])
    return strongest


def _rigid_claims(means: Means, rigid: list[Perturbation]) -> list[Claim]:
    claims = [
        *_judge(
            "rigid motion keeps every object matched",
            "match rate 1",
            means,
            ("match_rate", rigid),
            lambda curves: (f"{_least(curves):.4f}", _least(curves) == 1),
        ),
        *_judge(
            "rigid motion keeps the spectra",
            "d_lambda below 1e-5",
            means,
            (_SPECTRA, rigid),
            lambda curves: (f"{_most(curves):.1e}", _most(curves) < RIGID_D_LAMBDA),
        ),
    ]
    turns = [level for level in rigid if level.shift_m == 0 and level.amount]

    def linear(curves: _Curves) -> tuple[str, bool]:
        slopes = [value / abs(level.amount) for level, value in zip(turns, curves[None], strict=True)]
        off = max(slopes) / min(slopes) - 1 if min(slopes) > 0 else float("inf")
        return f"{slopes[0]:.4f} m per degree, the same within {off:.0e}", off < LINEAR_TOLERANCE

    if len(turns) > 1:
        scores = ("centroid_distance_m_mean", turns)
        claims += _judge("d_cent is linear in the angle", "0.4126 m per degree", means, scores, linear)

    for metric, bound in (("r_lambda", RIGID_R_LAMBDA), ("r_gap", RIGID_R_GAP)):

        def below(curves: _Curves, bound: float = bound) -> tuple[str, bool]:
            return f"{_most(curves):.1e}", _most(curves) < bound

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
        lambda curves: (_listed(curves[None]), _is_rising([-rate for rate in curves[None]])),
    )
    claims += _judge(
        "d_lambda rises with dropout",
        "0.100, 0.300, 0.786",
        means,
        (_SPECTRA, dropout),
        lambda curves: (_listed(curves[None]), _is_rising(curves[None])),
    )
    return claims


def _class_claims(means: Means, dropout: list[Perturbation]) -> list[Claim]:
    """What the paper says of its four classes under dropout; of those that have a name, not a shape."""
    names = [name for name in means.objects if name in _CLASSES]
    if len(names) < len(_CLASSES):
        return []
    most = dropout[-1:]

    def is_lowest(curves: _Curves) -> tuple[str, bool]:
        return _ranked(curves), min(names, key=lambda name: curves[name][-1]) == "wall"

    def are_highest(curves: _Curves) -> tuple[str, bool]:
        first = sorted(names, key=lambda name: -curves[name][-1])[:2]
        return _ranked(curves), set(first) == {"car", "vegetation"}

    def is_small(curves: _Curves) -> tuple[str, bool]:
        return f"up to {_most(curves):.4f}", _most(curves) < _WALL_R_GAP

    claims = []
    for metric in ("r_lambda", "r_gap"):
        claims += [
            *_judge(
                f"dropout: the wall is most robust by {metric}", _IN_WORDS, means, (metric, most), is_lowest, names
            ),
            *_judge(
                f"dropout: car and vegetation are most sensitive by {metric}",
                _IN_WORDS,
                means,
                (metric, most),
                are_highest,
                names,
            ),
        ]
    claims += _judge(
        "dropout: r_gap of the wall stays small",
        f"below {_WALL_R_GAP:g}",
        means,
        ("r_gap", dropout),
        is_small,
        ["wall"],
    )
    if most[0].amount == _DROPOUT_SHARE:
        for name, value in _R_LAMBDA_AT_SHARE.items():

            def is_near(curves: _Curves, value: float = value) -> tuple[str, bool]:
                return f"{_most(curves):.3f}", abs(_most(curves) - value) <= value / 10

            claim = f"r_lambda of the {name} at {_DROPOUT_SHARE:.0%} dropout, within a tenth"
            claims += _judge(claim, f"{value:.2f}", means, ("r_lambda", most), is_near, [name])
    return claims


def _flat_tree(means: Means, noise: list[Perturbation]) -> list[Claim]:
    """That the tree answers to noise near-flat: of the four classes its r_lambda moves least over the levels."""
    names = [name for name in means.objects if name in _CLASSES]
    if len(names) < len(_CLASSES) or len(noise) < 2:
        return []

    def is_flattest(curves: _Curves) -> tuple[str, bool]:
        moves = {name: [max(curve) - min(curve)] for name, curve in curves.items()}
        return _ranked(moves), min(moves, key=lambda name: moves[name]) == "tree"

    return _judge(
        "noise: r_lambda of the tree is near-flat (moves least)",
        _IN_WORDS,
        means,
        ("r_lambda", noise),
        is_flattest,
        names,
    )


def _ranked(curves: _Curves) -> str:
    """The last value of each object, largest first."""
    order = sorted(curves, key=lambda name: -curves[name][-1])
    return ", ".join(f"{name} {curves[name][-1]:.3g}" for name in order)


def _noise_claims(
    means: Means, noise: list[Perturbation], dropout: list[Perturbation], rigid: list[Perturbation]
) -> list[Claim]:
    claims = _judge(
        "noise keeps nearly all objects matched",
        "above 0.95",
        means,
        ("match_rate", noise),
        lambda curves: (f"{_least(curves):.3f}", _least(curves) > 0.95),
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
        kind: means.series(None, levels, _SPECTRA)
        for kind, levels in (("noise", noise), ("dropout", dropout), ("rigid", rigid))
    }
    most = {kind: max(values) for kind, values in by_kind.items() if values}
    if "dropout" in most and len(most) > 1:
        here = ", ".join(f"{kind} {value:.2g}" for kind, value in most.items())
        claims += _judge(
            "of noise, dropout and rigid motion dropout changes the spectra most",
            "d_lambda 0.044, 0.79, 7e-06",
            means,
            (_SPECTRA, [*noise, *dropout, *rigid]),
            lambda _: (here, max(most, key=lambda kind: most[kind]) == "dropout"),
        )
    return claims


def _judge(
    claim: str,
    paper: str,
    means: Means,
    scores: tuple[str, Sequence[Perturbation]],
    verdict: Callable[[_Curves], tuple[str, bool]],
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
    here, holds = (f"no value for {', '.join(gaps)}", None) if gaps else verdict(curves)
    return [Claim(claim, paper, here, holds)]


def _least(curves: _Curves) -> float:
    return min(min(values) for values in curves.values())


def _most(curves: _Curves) -> float:
    return max(max(values) for values in curves.values())


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3f}" for value in values)


def _is_rising(values: Sequence[float]) -> bool:
    return all(b > a + _TIE for a, b in pairwise(values))


def _share(curves: _Curves, holds: Callable[[str | None], bool]) -> tuple[str, bool]:
    """Of how many objects something holds, in words, and whether it does of all."""
    others = [str(name) for name in curves if not holds(name)]
    if not others:
        return f"all {len(curves)}", True
    return f"{len(curves) - len(others)} of {len(curves)}, not {', '.join(others)}", False
