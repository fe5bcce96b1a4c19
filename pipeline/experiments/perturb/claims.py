"""Whether what the paper says of its perturbations holds here, claim by claim.

Leaves to others: the means that are judged (`perturb_summary`), how a claim is shown (`report`).
"""

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
    """One claim: what the paper says, what was found here, and whether it holds; None where that cannot be told."""

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
        self._of = {
            (row["object"], Perturbation(row["kind"], row["amount"], row["shift_m"]), row["metric"]): Mean(
                row["mean"], row["std"], row["n"]
            )
            for row in rows
        }
        self.objects = tuple(dict.fromkeys(row["object"] for row in rows if row["object"] is not None))

    def get(self, of_object: str | None, level: Perturbation, metric: str) -> Mean:
        """One value; of the whole scan where `of_object` is None."""
        return self._of.get((of_object, level, metric), Mean(None, None, 0))

    def series(self, of_object: str | None, levels: Sequence[Perturbation], metric: str) -> list[float]:
        """The means at some levels; those that could not be computed are left out."""
        found = (self.get(of_object, level, metric).mean for level in levels)
        return [value for value in found if value is not None]

    def missing(self, of_object: str | None, levels: Sequence[Perturbation], metric: str) -> list[Perturbation]:
        """The levels at which a metric could not be computed; none where it was not asked for at any."""
        if not any((of_object, level, metric) in self._of for level in levels):
            return []
        return [level for level in levels if self.get(of_object, level, metric).mean is None]


def judge_claims(summary: pa.Table, levels: Sequence[Perturbation]) -> list[Claim]:
    """The claims that these levels are about, in the paper's order.

    A claim is not judged (`holds` is None) where one of its levels has no value, which might tell another tale.

    Parameters
    ----------
    summary : `perturb_summary`
    levels : that were swept
    """
    means = Means(summary)
    of_kind = {
        kind: sorted((of for of in levels if of.kind == kind), key=lambda of: (of.shift_m, of.amount))
        for kind in ("noise", "dropout", "rigid")
    }
    claims = _rigid_claims(means, of_kind["rigid"])
    if len(of_kind["dropout"]) > 1:
        claims += _dropout_claims(means, of_kind["dropout"])
    if of_kind["dropout"] and of_kind["noise"]:
        claims += _noise_claims(means, of_kind["noise"], of_kind["dropout"], of_kind["rigid"])
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
    turns = [of for of in rigid if of.shift_m == 0 and of.amount]
    slopes = [
        value / abs(of.amount)
        for of in turns
        if (value := means.get(None, of, "centroid_distance_m_mean").mean) is not None
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
        values = [value for of in means.objects for value in means.series(of, rigid, metric)]
        if values:
            most, gaps = max(values), _gaps(means, means.objects, rigid, metric)
            name = f"rigid motion leaves {metric} of objects at 0"
            claims.append(_claim(name, f"below {bound:g}", f"{most:.1e}", most < bound, gaps))
    return claims


def _dropout_claims(means: Means, dropout: list[Perturbation]) -> list[Claim]:
    claims = []
    for metric in ("r_lambda", "r_gap"):
        curves = {of: means.series(of, dropout, metric) for of in means.objects}
        curves = {of: curve for of, curve in curves.items() if curve}
        if curves:
            rising = [of for of, curve in curves.items() if _is_rising(curve)]
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
    for of in means.objects:
        by_noise, by_dropout = means.series(of, noise, "r_lambda"), means.series(of, dropout, "r_lambda")
        if by_noise and by_dropout:
            both.append(of)
            if max(by_noise) < max(by_dropout):
                below.append(of)
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
        kind: means.series(None, of_kind, "eigenspectrum_distance_mean")
        for kind, of_kind in (("noise", noise), ("dropout", dropout), ("rigid", rigid))
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
        f"{level.kind} {level.amount:g}" + (f" of {of}" if of else "")
        for of in objects
        for level in means.missing(of, levels, metric)
    ]


def _is_rising(values: Sequence[float]) -> bool:
    return all(b > a + _TIE for a, b in pairwise(values))


def _share(holding: Sequence[str], of_all: Sequence[str] | dict[str, list[float]]) -> str:
    if len(holding) == len(of_all):
        return f"all {len(of_all)}"
    others = [of for of in of_all if of not in holding]
    return f"{len(holding)} of {len(of_all)}, not {', '.join(others)}"
