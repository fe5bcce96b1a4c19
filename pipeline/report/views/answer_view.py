"""The first answer of a run: surface, pieces, causes, worst places, scores, trust, and the next step."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from ....schemas.metric_catalogue import metric_of
from ....schemas.record import RunHeader, RunRecord
from ....schemas.results import Cause, Caution, Diagnosis, Overview
from ...results.best_case import BestCaseRecipe, RunExcess, read_recipe, run_of_best_case
from ...results.causes import MOST_SHOWN, interval_words
from ...results.diagnosis import gain_words, unexplained_words, with_gains
from ...storage.urls import url_or_path
from ..view import Answers, Note, View, number, percent, shortened

#: Causes, places and cautions that are shown without --all.
_FEW = MOST_SHOWN, 3, 2
_PAIR = 16
_SCORES = ("cdc_mean", "r_lambda_mean", "r_gap_mean")
_COVERED = ("covered_real_0p3m", "covered_sim_0p3m")
#: Sentence if no cause is named.
NO_CAUSE = "no cause is larger than the differences between two measurements of one scene"
_NOT_YET = "the frame of the simulated scans: see the warning above"
#: Cautions that are shown above the answer.
_SHOWN_ABOVE = ("failed", "frames")


def answer_view(
    folder: Path,
    record: RunRecord,
    diagnosis: Diagnosis | None = None,
    excess: RunExcess | None = None,
    *,
    with_all: bool = False,
    took: str = "",
) -> View:
    """The first answer of a run; its first line alone if no pair is scored.

    Parameters
    ----------
    diagnosis : of the run, if it has one
    excess : the run over a best case, whose coverage is shown
    with_all : all causes, places and cautions
    took : time and reused jobs of a run that just ended
    """
    run, recipe = url_or_path(folder), read_recipe(folder)
    line = Note(run_line(record, took, recipe), "bold")
    overview = with_gains(record.overview, diagnosis)
    if overview is None:
        return [line]
    n_causes, n_places, n_cautions = (None, None, None) if with_all else _FEW
    first = cause_items(overview.causes[:n_causes])
    if not first:
        first = [(_NOT_YET if record.frames else NO_CAUSE, "", "")]
    if diagnosis is not None:
        first.append((unexplained_words(diagnosis), "", ""))
    pieces = overview.pieces[:n_places]
    names = shortened({own.pair_id for own in pieces}, _PAIR)
    hidden = {*_SHOWN_ABOVE, *(["best_case"] if excess or recipe else [])}
    trust = trust_words(folder, [caution for caution in overview.trust if caution.kind not in hidden])[:n_cautions]
    if overview.unknown:
        trust.append(unknown_words(overview))
    if not with_all:
        trust.append(f"more: {shlex.join(['fidpipe', 'show', run, '--all'])}")
    following = [["check", record.dataset, *run_options(record)]] if record.frames else [["report", run, "--open"]]
    if recipe is not None:
        following = [["show", run_of_best_case(folder, recipe), "--best-case", run]]
    elif diagnosis is None and not record.frames:
        following.insert(0, ["diagnose", run])
    sections = {
        "  surface": [(surface_words(record, excess), "", "")],
        "  pieces": [(pieces_words(record), "", "")],
        "Fix first": first,
        "Worst places": [(f"{names[own.pair_id]}  {own.words}", "", own.fate_words) for own in pieces],
        "Objects": [(scores_words(record), "", "")],
        "Last run": [(change_words(record), "", "")] if record.previous else [],
        "Trust": [(words, "", "") for words in trust],
        "Next": [(shlex.join(["fidpipe", *words]), "", "") for words in following],
    }
    return [line, Answers([(heading, items) for heading, items in sections.items() if items])]


def trust_words(folder: Path, cautions: Sequence[Caution]) -> list[str]:
    """The limits to the trust in a run, with its folder in the commands."""
    command = shlex.join(["fidpipe", "best-case", url_or_path(folder)])
    return [caution.words.replace("fidpipe best-case RUN", command) for caution in cautions]


def run_options(record: RunHeader) -> list[str]:
    """Preset and settings of a run, as options of a command."""
    options = ["--preset", record.preset]
    for setting in record.departures:
        options += ["--set", setting]
    return options


def cause_items(causes: Sequence[Cause]) -> list[tuple[str, str, str]]:
    """Causes as items of an answer: words, interval and gain, and the setting."""
    return [(f"{i}  {cause.words}", f"95 %: {amount_words(cause)}", cause.setting) for i, cause in enumerate(causes, 1)]


def amount_words(cause: Cause) -> str:
    """The 95 % interval of a cause, and its gain if it was measured."""
    gain = gain_words(cause)
    return f"{interval_words(cause)}; {gain}" if gain else interval_words(cause)


def unknown_words(overview: Overview) -> str:
    """The causes that cannot be estimated, by reason."""
    return "unknown: " + "; ".join(f"{', '.join(group.causes)} ({group.reason})" for group in overview.unknown)


def run_line(record: RunRecord, took: str = "", recipe: BestCaseRecipe | None = None) -> str:
    """Dataset, pairs, time and preset of a run, or of a best case if its recipe is given."""
    pairs = record.pairs
    n, n_all = pairs.scored, pairs.scored + pairs.failed + pairs.to_do
    counts = f"{n} of {n_all}" if n < n_all else n
    scored = " scored" * (n < n_all)
    differing = f", but {' '.join(record.departures)}" if record.departures else ""
    name = Path(record.dataset).name if recipe is None else f"best case of {Path(recipe.dataset).name}"
    return f"{name}: {counts} pair{'s' * (n_all != 1)}{scored}{took}, preset {record.preset}{differing}"


def surface_words(record: RunRecord, excess: RunExcess | None = None) -> str:
    """Share of each side's surface that the other side has, with the best case's."""
    real, sim = (percent(record.summary[column].mean) for column in _COVERED)
    best_case = excess and ", ".join(percent(excess.scores[column].best_case) for column in _COVERED)
    return (
        f"{real} of the real surface is simulated within 0.3 m, {sim} of the simulated surface is real"
        f"{f' (best case {best_case})' if best_case else ''}"
    )


def pieces_words(record: RunRecord) -> str:
    """Missing and invented pieces per pair."""
    missing, invented = (record.summary[f"n_{kind}_pieces"].mean for kind in ("missing", "invented"))
    return f"{number(missing, 1)} missing and {number(invented, 1)} invented per pair"


def headline_scores(record: RunRecord) -> tuple[str, ...]:
    """Columns of `pairs`: the object scores that a run is described by; *found* if the real side fixes the objects."""
    return ("match_rate" if record.preset == "paper" else "found", *_SCORES)


def scores_words(record: RunRecord) -> str:
    """The object scores; those of the paper next to them under its preset."""
    words = []
    for column in headline_scores(record):
        metric = metric_of(column)
        word = f"{metric.label} {number(record.summary[column].mean, 2)}"
        if record.preset == "paper" and metric.paper_mean is not None:
            word += f" (paper {metric.paper_mean:.2f})"
        words.append(word)
    return "   ".join(words)


def change_words(record: RunRecord) -> str:
    """Changes since the results that this run replaced in its folder; "" if it replaced none."""
    last = record.previous
    if last is None:
        return ""
    moved = [
        f"{metric_of(column).label.partition(',')[0]} {now - before:+.2f}"
        for column in (*_COVERED, *headline_scores(record))
        if (now := record.summary[column].mean) is not None
        and (before := last.means.get(column)) is not None
        and abs(now - before) >= 5e-3
    ]
    return f"{', '.join(moved) or 'no score moved'} since {last.written}; is it chance? fidpipe compare"
