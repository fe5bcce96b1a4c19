"""The diagnosis of a run: its causes with the gain of correcting each, and what no correction explains.

`fidpipe diagnose` makes the table `gains`; here it is read. The gains count as long as the run names the causes with
the amounts that were corrected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.cause_catalogue import BEST_CASE_ACCURACY, CAUSES, PARAMETERS
from ...schemas.record import RunRecord
from ...schemas.results import Cause, Diagnosis, Evidence, Overview
from ...stages.arrays import FloatArray
from ...stages.causes.axes import AXES
from ..stage import AMOUNTS, CURVES, DISTANCES
from ..storage.folder import RunFolder
from .causes import least_part_of_pose

GAINS = "gains"
#: Below this distance over that of a second measurement, metres, or within its accuracy, gains are not shares.
LEAST_EXCESS_M = 0.005
#: Part of what the other causes leave that a cause must explain, else fixing it would not help.
LEAST_PART = 0.03


@dataclass(frozen=True)
class Gains:
    """Gains of all pairs.

    by_cause : (n,) metres by which the distance of each pair becomes smaller
    distances_m : (n, 3) distance before and after all corrections, and that of a second measurement
    curves : by kind, then by side, the mean over the pairs
    """

    by_cause: dict[str, FloatArray]
    distances_m: FloatArray
    curves: dict[str, dict[str, FloatArray]]


def read_gains(store: RunFolder, pair_ids: Sequence[str], causes: Sequence[Cause]) -> Gains | None:
    """The gains of all pairs; None if they are unknown or those of other amounts.

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    amounts = {cause.name: cause.estimate for cause in causes}
    records = []
    for pair_id in pair_ids:
        record = store.ledger.jobs(pair_id).get((GAINS, ""))
        if record is None or record.metadata[AMOUNTS] != amounts:
            return None
        records.append(record)
    if not records:
        return None
    frame = store.read_pairs(pair_ids, {(GAINS, ""): ["cause", "gain_m"]})[GAINS, ""]
    by_cause = {str(name): rows["gain_m"].to_numpy() for name, rows in frame.groupby("cause")}
    distances_m = np.array([record.metadata[DISTANCES] for record in records])
    curves: dict[str, dict[str, FloatArray]] = {}
    for kind, sides in records[0].metadata[CURVES].items():
        drawn = [
            record.metadata[CURVES][kind] for record in records if kind in record.metadata[CURVES]
        ]
        curves[kind] = {}
        for side in sides:
            of_pairs = [values[side] for values in drawn]
            curves[kind][side] = np.mean(of_pairs, axis=0)
    return Gains(by_cause, distances_m, curves)


def causes_to_correct(overview: Overview) -> list[Cause]:
    """The causes of a run that the catalogue has; a run of another version may have others."""
    return [cause for cause in overview.causes if cause.name in CAUSES]


def diagnosis_of(store: RunFolder, record: RunRecord, pair_ids: Sequence[str]) -> Diagnosis | None:
    """The diagnosis of a run; None if no pair is scored, or if it was not diagnosed since its causes changed.

    Parameters
    ----------
    pair_ids : of the scored pairs
    """
    if record.overview is None:
        return None
    causes = causes_to_correct(record.overview)
    gains = read_gains(store, pair_ids, causes)
    if gains is None:
        return None
    before_m, after_m, best_case_m = gains.distances_m.mean(axis=0).tolist()
    gains_m = {name: float(values.mean()) for name, values in gains.by_cause.items()}
    confirmed, doubtful = confirm(causes, gains_m, (before_m, after_m, best_case_m))
    shown = []
    for cause in confirmed:
        evidence = _evidence(CAUSES[cause.name].curve, gains)
        shown.append(cause.model_copy(update={"evidence": evidence}))
    return Diagnosis(
        n_pairs=len(pair_ids),
        distance_m=before_m,
        best_case_m=best_case_m,
        unexplained=unexplained_share((before_m, after_m, best_case_m)),
        causes=tuple(shown),
        doubtful=tuple(cause.words for cause in doubtful),
        unknown=record.overview.unknown,
    )


def confirm(
    causes: Sequence[Cause], gains_m: Mapping[str, float], distances_m: tuple[float, float, float]
) -> tuple[list[Cause], list[Cause]]:
    """The causes with the gain of correcting each, largest first, and those whose correction hardly helps.

    Parameters
    ----------
    causes : from `causes.named_causes`
    gains_m : by name, metres by which the surface distance becomes smaller
    distances_m : before and after all corrections, and that of a second measurement
    """
    _, after_m, best_case_m = distances_m
    excess_m = _excess(distances_m)
    # within the accuracy of the second measurement the whole distance counts, else small gains would be large parts
    left_m = after_m if excess_m is None else after_m - best_case_m
    confirmed: list[Cause] = []
    doubtful: list[Cause] = []
    for cause in causes:
        diagnosed = _with_gain(cause, gains_m.get(cause.name), excess_m)
        if _is_weak(diagnosed, left_m):
            doubtful.append(diagnosed)
        else:
            confirmed.append(diagnosed)
    return sorted(
        confirmed, key=lambda cause: (cause.gain_m is None, -(cause.gain_m or 0.0))
    ), doubtful


def unexplained_share(distances_m: tuple[float, float, float]) -> float | None:
    """Share of the distance over that of a second measurement that no correction explains; None if hardly any is.

    Parameters
    ----------
    distances_m : before and after all corrections, and that of a second measurement
    """
    _, after_m, best_case_m = distances_m
    excess_m = _excess(distances_m)
    if excess_m is None:
        return None
    return min(max((after_m - best_case_m) / excess_m, 0.0), 1.0)


def _excess(distances_m: tuple[float, float, float]) -> float | None:
    """Distance over that of a second measurement, metres; None if it is within the accuracy of the latter."""
    before_m, _, best_case_m = distances_m
    excess_m = before_m - best_case_m
    return excess_m if excess_m >= max(LEAST_EXCESS_M, BEST_CASE_ACCURACY * best_case_m) else None


def with_gains(overview: Overview | None, diagnosis: Diagnosis | None) -> Overview | None:
    """The overview of a run with the causes of its diagnosis, if it has one."""
    if overview is None or diagnosis is None:
        return overview
    return overview.model_copy(update={"causes": diagnosis.causes})


def _with_gain(cause: Cause, gain_m: float | None, excess_m: float | None) -> Cause:
    found: dict[str, object] = {"is_upper_bound": CAUSES[cause.name].is_restored}
    if gain_m is not None:
        found |= {"gain_m": gain_m, "gain": None if excess_m is None else gain_m / excess_m}
    return cause.model_copy(update=found)


def _is_weak(cause: Cause, left_m: float) -> bool:
    """True if correcting a cause brings the sides hardly closer, next to the distance that the others leave."""
    if cause.gain_m is None:
        return False
    least = least_part_of_pose(cause.name) if cause.name in PARAMETERS else LEAST_PART
    return cause.gain_m <= least * (cause.gain_m + left_m)


def _evidence(kind: str, gains: Gains) -> Evidence | None:
    """Mean curves of a kind over the pairs."""
    if kind not in gains.curves:
        return None
    axis = AXES[kind]
    middles = (axis["edges"][:-1] + axis["edges"][1:]) / 2
    sides = {side: tuple(values.round(4).tolist()) for side, values in gains.curves[kind].items()}
    return Evidence(
        x_label=axis["label"],
        y_label=axis["values"],
        x=tuple(middles.round(4).tolist()),
        real=sides.get("real"),
        sim=sides["sim"],
        corrected=sides.get("corrected"),
    )


def unexplained_words(diagnosis: Diagnosis) -> str:
    """Part of the distance that remains if all causes are corrected."""
    distance = f"{100 * max(diagnosis.distance_m - diagnosis.best_case_m, 0.0):.1f} cm"
    over = "by which the surfaces are farther apart than in a second measurement"
    if diagnosis.unexplained is None:
        return f"unexplained: nothing; the surfaces are as close as in a second measurement ({distance})"
    least = "at least " if any(cause.is_upper_bound for cause in diagnosis.causes) else ""
    return f"unexplained: {least}{100 * diagnosis.unexplained:.0f} % of the {distance} {over}"


def gain_words(cause: Cause) -> str:
    """Gain of correcting a cause, as text; "" if it was not measured.

    Examples
    --------
    >>> base = dict(name="height", kind="sensor", words="", estimate=0.1, low=0, high=0.2, unit="m", n_pairs=3)
    >>> rest = dict(setting="", real=None, sim=None, share=0.3)
    >>> gain_words(Cause(**base, **rest, gain_m=0.02, gain=0.41, is_upper_bound=True))
    'gain at most 41 %'
    """
    if cause.gain_m is None:
        return ""
    if cause.gain_m <= 0:
        return "fixing only this brings nothing closer"
    size = f"{100 * cause.gain_m:.1f} cm" if cause.gain is None else f"{100 * cause.gain:.0f} %"
    return f"gain at most {size}" if cause.is_upper_bound else f"gain {size}"
