"""The first screen of a run's page: surface, pieces, what to fix first, worst places, object scores, and trust.

The answers of `results.overview`, which the terminal also shows, with links and pictures.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import orjson
from pydantic import TypeAdapter

from ...schemas.errors import RunError
from ..results.floor import RunExcess
from ..results.gate import Criterion, judge_run
from ..results.overview import over_floor
from ..results.quadrants import QUADRANTS
from .aggregates import quadrants
from .pictures import draw_pieces
from .run_frames import RunResults
from .view import Note, number, percent, sentence
from .views.answer_view import change_words, pieces_words, surface_words
from .views.run_view import coverage_table, dataset_table, surface_line, surface_table, unmatched_lines

_SCORES = (
    *("match_rate", "found", "cdc_mean", "r_lambda_mean", "max_eigenvalue_shift_mean", "laplacian_change_mean"),
    *("r_gap_mean", "alignment_rms_m_mean", "centroid_distance_m_mean"),
)
#: Causes on the first screen.
_MOST_CAUSES = 6


def verdict_of(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """The first screen of a run's page, over a floor if there is one, and the section `details`.

    is_met is True if the acceptance criteria of the last gate are met, None without any.
    """
    record = results.run.record
    overview = over_floor(results.run, excess.floor) if excess else results.run.overview
    if overview is None:
        raise RunError(f"run {results.run.folder}: no pair is scored, so there is nothing to report")
    is_met, good_enough = _good_enough(results, excess)
    return {
        "sentence": sentence(surface_words(record, excess)),
        "pieces": sentence(pieces_words(record).replace(" missing", " pieces missing", 1)),
        "bars": _bars(results, excess),
        "causes": overview.causes[:_MOST_CAUSES],
        "worst": draw_pieces(results, overview.pieces),
        "is_met": is_met,
        "good_enough": good_enough,
        "warning": " ".join(f"Warning: {one.words}" for one in overview.trust if one.kind == "frames"),
        "change": sentence(change_words(record)) if record.previous else "",
        "trust": [sentence(one.words) for one in overview.trust if one.kind not in ("frames", "failed")],
        "details": [
            dataset_table(record, _SCORES),
            Note("Unmatched as worst: each missing and each invented object counted with the worst value."),
            coverage_table(record),
            surface_table(overview),
            Note("Real points that are not covered are missing surface, simulated ones invented surface."),
            *map(Note, (*unmatched_lines(record), surface_line(record))),
        ],
    }


def _bars(results: RunResults, excess: RunExcess | None) -> list[dict[str, Any]]:
    """Stacked bars: surface of both sides by distance to the other one, and real objects by quadrant.

    The parts of each, from good to bad, are kind (its look), words, and share of the whole.
    """
    summary, bars = results.run.record.summary, list[dict[str, Any]]()
    for side, name, alone in (("real", "Real surface", "missing"), ("sim", "Simulated surface", "invented")):
        reaches = [f"covered_{side}_{reach}" for reach in ("0p1m", "0p3m", "1m")]
        ends = [0.0, *(summary[column].mean or 0.0 for column in reaches), 1.0]
        words = ("within 0.1 m", "0.1 to 0.3 m", "0.3 to 1 m", alone)
        parts = [
            (f"{side} step{i}", text, high - low)
            for i, (text, low, high) in enumerate(zip(words, ends[:-1], ends[1:], strict=True))
        ]
        note = f"floor {percent(excess.scores[reaches[1]].floor)}" if excess else ""
        bars.append({"name": name, "value": f"{percent(ends[2])} within 0.3 m", "note": note, "parts": parts})
    counted = quadrants(results)
    n_missing = int((results.unmatched.status == "missing").sum())
    n_all = max(1, len(results.matched) + n_missing)
    fates = {**{key: own["n"] for key, own in counted.items()}, "missing": n_missing}
    kinds = (*QUADRANTS, "unknown", "real step3")
    shares = [(kind, name, n / n_all) for kind, (name, n) in zip(kinds, fates.items(), strict=True)]
    return [*bars, {"name": "Real objects", "value": f"{percent(shares[0][2])} faithful", "parts": shares}]


def _good_enough(results: RunResults, excess: RunExcess | None) -> tuple[bool | None, list[str]]:
    """The criteria of the folder's last gate, evaluated again; or how to set some."""
    folder = results.run.folder
    criteria = _last_criteria(folder / "gate.json")
    if criteria is None:
        return None, [f"No acceptance limits are set yet: fidpipe gate {folder} --max r_lambda.mean=0.4 sets one."]
    try:
        result = judge_run(folder, criteria, None if excess is None else excess.floor)
    except (RunError, ValueError) as error:
        return None, [f"The criteria of {folder / 'gate.json'} cannot be evaluated again: {error}"]
    unmet = [verdict for verdict in result.judged if not verdict.passed]
    on_scores = [verdict for verdict in result.judged if not verdict.measure.startswith("pairs.")]
    n_met = sum(verdict.passed for verdict in on_scores)
    met = f"{n_met} of {len(on_scores)} acceptance criteria on scores are met"
    if not unmet:
        return True, [f"Yes: {met}, and those on the run itself (complete, no pair failed, nothing changed since)."]
    why = [f"{one.name}: {one.why or number(one.value)}" for one in unmet[:3]]
    return False, [f"No: {met}.", *map(sentence, why)]


_CRITERIA = TypeAdapter(list[Criterion])


def _last_criteria(path: Path) -> list[Criterion] | None:
    """The criteria that a gate wrote down; None if none can be read."""
    try:
        return _CRITERIA.validate_python(orjson.loads(path.read_bytes())["criteria"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
