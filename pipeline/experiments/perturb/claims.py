"""Whether what the paper says of its perturbations holds here, claim by claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import pyarrow as pa

from ....stages.sensing.perturbations import Perturbation

RIGID_D_LAMBDA = 1e-5
RIGID_R_LAMBDA = 0.01
RIGID_R_GAP = 1e-4
LINEAR_TOLERANCE = 1e-3
_TIE = 1e-12


@dataclass(frozen=True)
class Claim:
    """One claim: what the paper says, what the data here say, and whether it holds; None where that cannot be told."""

    claim: str
    paper: str
    here: str
    holds: bool | None


@dataclass(frozen=True)
class Mean:
    """Mean and standard deviation of a metric at a level; None where it could not be computed."""

    mean: float | None
    std: float | None
    n: int


class Means:
    """Rows of `perturb_summary`, to be looked up."""

    def __init__(self, summary: pa.Table) -> None:
        rows = summary.to_pylist()
        self._by_key = {
            (row["object"], Perturbation(row["kind"], row["amount"], row["shift_m"]), row["metric"]): Mean(
                row["mean"], row["std"], row["n"]
            )
            for row in rows
        }
        self.objects = tuple(dict.fromkeys(row["object"] for row in rows if row["object"] is not None))

    def get(self, object_name: str | None, level: Perturbation, metric: str) -> Mean:
        """One value; of the whole scan where `object_name` is None."""
        return self._by_key.get((object_name, level, metric), Mean(None, None, 0))

    def series(self, object_name: str | None, levels: Sequence[Perturbation], metric: str) -> list[float]:
        """The means at some levels; those that could not be computed are left out."""
        means = (self.get(object_name, level, metric).mean for level in levels)
        return [mean for mean in means if mean is not None]

    def missing(self, object_name: str | None, levels: Sequence[Perturbation], metric: str) -> list[Perturbation]:
        """The levels at which a metric could not be computed; none where it was not asked for at any."""
        if not any((object_name, level, metric) in self._by_key for level in levels):
            return []
        return [level for level in levels if self.get(object_name, level, metric).mean is None]


def judge_claims(summary: pa.Table, levels: Sequence[Perturbation]) -> list[Claim]:
    """The claims that these levels are about, in the paper's order.

    A claim is not judged (`holds` is None) where one of its levels has no value, which might tell another tale.

    Parameters
    ----------
    summary : `perturb_summary`
    levels : that were swept
    """
    means = Means(summary)
    by_kind = {
        kind: sorted((level for level in levels if level.kind == kind), key=lambda level: (level.shift_m, level.amount))
        for kind in ("noise", "dropout", "rigid")
    }
    claims = _rigid_claims(means, by_kind["rigid"])
    if len(by_kind["dropout"]) > 1:
        claims += _dropout_claims(means, by_kind["dropout"])
    if by_kind["dropout"] and by_kind["noise"]:
        claims += _noise_claims(means, by_kind["noise"], by_kind["dropout"], by_kind["rigid"])
    return claims


def _rigid_claims(means: Means, rigid: list[Perturbation]) -> list[Claim]:
    claims = []
    rates = means.series(None, rigid, "match_rate")
    if rates:
        worst, gaps = min(rates), _gaps(means, [None], rigid, "match_rate")
        claims.append(
            _claim("rigid motion keeps every object matched", "match rate 1", f"{worst:.4f}", worst == 1, gaps)
        )
    changes = means.series(None, rigid, "eigenspectrum_distance_mean")
    if changes:
        most, gaps = max(changes), _gaps(means, [None], rigid, "eigenspectrum_distance_mean")
        claims.append(
            _claim("rigid motion keeps the spectra", "d_lambda below 1e-5", f"{most:.1e}", most < RIGID_D_LAMBDA, gaps)
        )
    turns = [level for level in rigid if level.shift_m == 0 and level.amount]
    slopes = [
        value / abs(level.amount)
        for level in turns
        if (value := means.get(None, level, "centroid_distance_m_mean").mean) is not None
    ]
    if slopes and len(turns) > 1:
        off = max(slopes) / min(slopes) - 1 if min(slopes) > 0 else float("inf")
        claims.append(
            _claim(
                "d_cent is linear in the angle",
                "0.4126 m per degree",
                f"{slopes[0]:.4f} m per degree, the same within {off:.0e}",
                off < LINEAR_TOLERANCE,
                _gaps(means, [None], turns, "centroid_distance_m_mean"),
            )
        )
    for metric, bound in (("r_lambda", RIGID_R_LAMBDA), ("r_gap", RIGID_R_GAP)):
        values = [value for name in means.objects for value in means.series(name, rigid, metric)]
        if values:
            most, gaps = max(values), _gaps(means, means.objects, rigid, metric)
            claim = f"rigid motion leaves {metric} of objects at 0"
            claims.append(_claim(claim, f"below {bound:g}", f"{most:.1e}", most < bound, gaps))
    return claims


def _dropout_claims(means: Means, dropout: list[Perturbation]) -> list[Claim]:
    claims = []
    for metric in ("r_lambda", "r_gap"):
        curves = {name: means.series(name, dropout, metric) for name in means.objects}
        curves = {name: curve for name, curve in curves.items() if curve}
        if curves:
            rising = [name for name, curve in curves.items() if _is_rising(curve)]
            claims.append(
                _claim(
                    f"{metric} rises with dropout, object by object",
                    "all four",
                    _share(rising, curves),
                    rising == list(curves),
                    _gaps(means, means.objects, dropout, metric),
                )
            )
    rates = means.series(None, dropout, "match_rate")
    if rates:
        here, is_falling = ", ".join(f"{rate:.3f}" for rate in rates), _is_rising([-rate for rate in rates])
        gaps = _gaps(means, [None], dropout, "match_rate")
        claims.append(_claim("the match rate falls with dropout", "0.915, 0.884, 0.854", here, is_falling, gaps))
    changes = means.series(None, dropout, "eigenspectrum_distance_mean")
    if changes:
        here = ", ".join(f"{change:.3f}" for change in changes)
        gaps = _gaps(means, [None], dropout, "eigenspectrum_distance_mean")
        claims.append(_claim("d_lambda rises with dropout", "0.100, 0.300, 0.786", here, _is_rising(changes), gaps))
    return claims


def _noise_claims(
    means: Means, noise: list[Perturbation], dropout: list[Perturbation], rigid: list[Perturbation]
) -> list[Claim]:
    claims = []
    rates = means.series(None, noise, "match_rate")
    if rates:
        worst, gaps = min(rates), _gaps(means, [None], noise, "match_rate")
        claims.append(
            _claim("noise keeps nearly all objects matched", "above 0.95", f"{worst:.3f}", worst > 0.95, gaps)
        )
    below, both = [], []
    for name in means.objects:
        by_noise, by_dropout = means.series(name, noise, "r_lambda"), means.series(name, dropout, "r_lambda")
        if by_noise and by_dropout:
            both.append(name)
            if max(by_noise) < max(by_dropout):
                below.append(name)
    if both:
        claims.append(
            _claim(
                "r_lambda under the most noise is below that under the most dropout",
                "all four",
                _share(below, both),
                below == both,
                _gaps(means, means.objects, [*noise, *dropout], "r_lambda"),
            )
        )
    by_kind = {
        kind: means.series(None, own_levels, "eigenspectrum_distance_mean")
        for kind, own_levels in (("noise", noise), ("dropout", dropout), ("rigid", rigid))
    }
    most = {kind: max(values) for kind, values in by_kind.items() if values}
    if "dropout" in most and len(most) > 1:
        here = ", ".join(f"{kind} {value:.2g}" for kind, value in most.items())
        claims.append(
            _claim(
                "of noise, dropout and rigid motion dropout changes the spectra most",
                "d_lambda 0.044, 0.79, 7e-06",
                here,
                max(most, key=lambda kind: most[kind]) == "dropout",
                _gaps(means, [None], [*noise, *dropout, *rigid], "eigenspectrum_distance_mean"),
            )
        )
    return claims


def _claim(claim: str, paper: str, here: str, holds: bool, gaps: Sequence[str]) -> Claim:
    if gaps:
        return Claim(claim, paper, f"no value for {', '.join(gaps)}", None)
    return Claim(claim, paper, here, holds)


def _gaps(means: Means, objects: Sequence[str | None], levels: Sequence[Perturbation], metric: str) -> list[str]:
    """Which levels of which objects have no value, in words; an object that is None is the whole scan."""
    return [
        f"{level.kind} {level.amount:g}" + (f" of {name}" if name else "")
        for name in objects
        for level in means.missing(name, levels, metric)
    ]


def _is_rising(values: Sequence[float]) -> bool:
    return all(b > a + _TIE for a, b in pairwise(values))


def _share(holding: Sequence[str], judged: Sequence[str] | dict[str, list[float]]) -> str:
    if len(holding) == len(judged):
        return f"all {len(judged)}"
    others = [name for name in judged if name not in holding]
    return f"{len(holding)} of {len(judged)}, not {', '.join(others)}"
