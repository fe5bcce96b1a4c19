"""The diagnosis of a run: its causes with the gain of correcting each, and what no correction explains.

`fidpipe diagnose` makes the table `gains`; here it is read. The gains count as long as the run names the causes with
the amounts that were corrected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...schemas.cause_catalogue import BEST_CASE_ACCURACY, CAUSES, PARAMETERS
from ...schemas.record import RunRecord
from ...schemas.results import Cause, Diagnosis
from ..stage import AMOUNTS, DISTANCES
from ..storage.folder import RunFolder
from .causes import least_part_of_pose

GAINS = "gains"
#: Below this distance over that of a second measurement, metres, or within its accuracy, gains are not shares.
LEAST_EXCESS_M = 0.005
#: Part of what the other causes leave that a cause must explain, else fixing it would not help.
LEAST_PART = 0.03


def diagnosis_of(
    store: RunFolder, record: RunRecord, pair_ids: Sequence[str]
) -> Diagnosis | None:
    """The diagnosis of a run; None if no pair is scored, or if it was not diagnosed since its causes changed.

    Parameters
    ----------
    pair_ids : of the scored pairs
    """
    if record.overview is None:
        return None
    causes = record.overview.causes
    amounts = {cause.name: cause.estimate for cause in causes}
    distances_m = []
    for pair_id in pair_ids:
        job = store.ledger.jobs(pair_id).get((GAINS, ""))
        if job is None or job.metadata[AMOUNTS] != amounts:
            return None
        distances_m.append(job.metadata[DISTANCES])
    table = store.read_pairs(pair_ids, {(GAINS, ""): ["cause", "gain_m"]})[GAINS, ""]
    gains_m: dict[Any, float] = table.groupby("cause")["gain_m"].mean().to_dict()
    means_m = before_m, _, best_case_m = np.mean(distances_m, axis=0).tolist()
    confirmed, doubtful = confirm(causes, gains_m, means_m)
    return Diagnosis(
        n_pairs=len(pair_ids),
        distance_m=before_m,
        best_case_m=best_case_m,
        unexplained=unexplained_share(means_m),
        causes=tuple(confirmed),
        doubtful=tuple(cause.words for cause in doubtful),
        unknown=record.overview.unknown,
    )


def confirm(
    causes: Sequence[Cause],
    gains_m: Mapping[str, float],
    distances_m: tuple[float, float, float],
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
        gain_m = gains_m.get(cause.name)
        gain = None if gain_m is None or excess_m is None else gain_m / excess_m
        is_upper_bound = CAUSES[cause.name].is_restored
        least = least_part_of_pose(cause.name) if cause.name in PARAMETERS else LEAST_PART
        is_weak = gain_m is not None and gain_m <= least * (gain_m + left_m)
        update = {"is_upper_bound": is_upper_bound, "gain_m": gain_m, "gain": gain}
        (doubtful if is_weak else confirmed).append(cause.model_copy(update=update))
    confirmed.sort(key=lambda cause: (cause.gain_m is None, -(cause.gain_m or 0.0)))
    return confirmed, doubtful


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
    return (
        excess_m if excess_m >= max(LEAST_EXCESS_M, BEST_CASE_ACCURACY * best_case_m) else None
    )


def unexplained_words(diagnosis: Diagnosis) -> str:
    """Part of the distance that remains if all causes are corrected."""
    distance = f"{100 * max(diagnosis.distance_m - diagnosis.best_case_m, 0.0):.1f} cm"
    over = "by which the surfaces are farther apart than in a second measurement"
    if diagnosis.unexplained is None:
        close = "the surfaces are as close as in a second measurement"
        return f"unexplained: nothing; {close} ({distance})"
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


def doubtful_words(diagnosis: Diagnosis) -> str:
    """The causes of which a correction gains hardly anything, as text; "" without any."""
    if not diagnosis.doubtful:
        return ""
    return f"seen, but fixing it would not help: {'; '.join(diagnosis.doubtful)}"
