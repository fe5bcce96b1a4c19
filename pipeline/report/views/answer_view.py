"""The first answer of a run: surface, pieces, causes, worst places, scores, trust, next step."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from ....schemas.metric_catalogue import COVERED, headline_scores, metric_of
from ....schemas.record import RunRecord
from ....schemas.results import Cause, Overview, Unknown
from ....stages.statistics.comparison import LEAST_FOR_INTERVAL
from ...results.best_case import RunExcess, read_recipe
from ...results.causes import MANY_UNKNOWN, MOST_SHOWN, interval_words, no_cause_words
from ...results.diagnosis import doubtful_words, gain_words, unexplained_words
from ...results.finished import FinishedRun
from ...storage.run_record import as_options
from ...storage.urls import url_or_path
from ..view import (
    Answers,
    Item,
    Note,
    View,
    count,
    items_of,
    number,
    percent,
    shortened,
)

#: What is shown without --all.
_MOST_PLACES = 3
_MOST_CAUTIONS = 2
_PAIR_WIDTH = 16
#: The measures of tasks that the answer has, and their words.
_TASK_WORDS = {
    "objects.lost": "your obstacles: {} lost",
    "objects.added": "{} added",
    "free_space.too_far": "free space too long in {} of the directions",
    "occupancy.wrongly_free": "{} of the occupied map free",
}
_NOT_YET = "the frame of the simulated scans: see the warning above"


def answer_view(
    run: FinishedRun, excess: RunExcess | None = None, *, with_all: bool = False, took: str = ""
) -> View:
    """The first answer of a run; its first line alone if no pair is scored.

    Parameters
    ----------
    excess : the run over a best case, whose coverage is shown
    with_all : all causes, places and cautions
    took : time and reused jobs of a run that just ended
    """
    sections = answer_sections(run, excess, with_all=with_all)
    return [Note(run_line(run, took), "bold"), Answers(sections)]


def answer_sections(
    run: FinishedRun, excess: RunExcess | None = None, *, with_all: bool = False
) -> dict[str, list[Item]]:
    """The items of an answer by their heading, as `answer_view` shows them."""
    record = run.record
    overview = run.overview
    if overview is None:
        return {}
    first = cause_items(overview.causes if with_all else overview.causes[:MOST_SHOWN])
    if not first:
        first = items_of(_NOT_YET if record.frames else no_cause_words(overview.unknown))
    if run.diagnosis is not None:
        first += items_of(unexplained_words(run.diagnosis))
    doubtful = doubtful_words(run.diagnosis) if run.diagnosis else ""
    small = ""
    if overview.small:
        small = f"seen, but a small part of the distance: {'; '.join(overview.small)}"
    most = None if with_all else _MOST_CAUTIONS
    trust = trust_words(overview, most)
    if not with_all:
        trust.append(
            f"more: {shlex.join(['fidpipe', 'show', url_or_path(run.folder), '--all'])}"
        )
    return {
        "  surface": items_of(surface_words(record, excess)),
        "  pieces": items_of(pieces_words(record)),
        "  tasks": items_of(task_words(record, excess)),
        "Check first": items_of(*overview.doubts),
        "Fix first": first,
        "Doubtful": items_of(doubtful, small),
        "Worst places": _worst_places(overview, with_all),
        "Objects": items_of(scores_words(record)),
        "Trust": items_of(*trust),
        "Next": items_of(*next_commands(run, excess)),
    }


def frame_warnings(run: FinishedRun) -> list[Note]:
    """Warnings that the frames of both sides differ."""
    cautions = run.overview.trust if run.overview else ()
    words = [caution.words for caution in cautions if caution.kind == "frames"]
    return [Note(f"warning: {text}", "red") for text in words]


def cause_items(causes: Sequence[Cause]) -> list[Item]:
    """Causes as items of an answer: words, interval and gain, and the setting."""
    items = []
    for i, cause in enumerate(causes, start=1):
        items.append((f"{i}  {cause.words}", amount_words(cause), cause.setting))
    return items


def _worst_places(overview: Overview, with_all: bool) -> list[Item]:
    pieces = overview.pieces if with_all else overview.pieces[:_MOST_PLACES]
    names = shortened({piece.pair_id for piece in pieces}, _PAIR_WIDTH)
    return [
        (f"{names[piece.pair_id]}  {piece.words}", "", piece.fate_words) for piece in pieces
    ]


def trust_words(overview: Overview, most: int | None) -> list[str]:
    """What limits the trust in a run, at most so many cautions; then causes that are unknown.

    Frames that differ are shown above.
    """
    trust = [caution.words for caution in overview.trust if caution.kind != "frames"]
    return trust[:most] + unknown_words(overview.unknown)


def unknown_words(unknown: Sequence[Unknown]) -> list[str]:
    """One sentence about all unknown causes, with reasons; none without such causes."""
    groups = []
    for group in unknown:
        n_causes = len(group.causes)
        names = ", ".join(group.causes) if n_causes < MANY_UNKNOWN else f"{n_causes} causes"
        groups.append(f"{names} ({group.reason})")
    return [f"unknown: {'; '.join(groups)}"] if groups else []


def next_commands(
    run: FinishedRun, excess: RunExcess | None, *, is_page: bool = False
) -> list[str]:
    """The commands that lead on from a run, or from its page."""
    record = run.record
    name = url_or_path(run.folder)
    if read_recipe(run.folder):
        commands = [["show", "RUN", "--best-case", name]]
    elif record.frames:
        options = as_options(record.preset, record.departures)
        commands = [["check", record.dataset, *options]]
    else:
        commands = [] if run.diagnosis else [["diagnose", name]]
        commands.append(["compare", name, "NEW_RUN"] if is_page else ["report", name, "--open"])
        if excess is None:
            commands.append(["best-case", name])
    return [shlex.join(["fidpipe", *words]) for words in commands]


def amount_words(cause: Cause) -> str:
    """The 95 % interval of a cause, and its gain if it was measured."""
    words = f"95 %: {interval_words(cause)}"
    if cause.n_pairs < LEAST_FOR_INTERVAL:  # the differences between pairs are unknown
        words = f"within {count(cause.n_pairs, 'pair')}: {interval_words(cause)}"
    gain = gain_words(cause)
    return f"{words}; {gain}" if gain else words


def run_line(run: FinishedRun, took: str = "") -> str:
    """Dataset, pairs, time and preset of a run, or of a best case."""
    record = run.record
    n_scored = record.pairs.scored
    n_all = n_scored + record.pairs.failed + record.pairs.to_do
    pairs = count(n_all, "pair")
    if n_scored < n_all:
        pairs = f"{n_scored} of {pairs} scored"
    recipe = read_recipe(run.folder)
    name = f"best case of {Path(recipe.dataset).name}" if recipe else Path(record.dataset).name
    departures = f", but {' '.join(record.departures)}" if record.departures else ""
    return f"{name}: {pairs}{took}, preset {record.preset}{departures}"


def surface_words(record: RunRecord, excess: RunExcess | None = None) -> str:
    """Share of each side's surface that the other side has, with the best case's."""
    real, sim = [percent(record.summary[column].mean) for column in COVERED]
    words = (
        f"{real} of the real surface is simulated within 0.3 m, "
        f"{sim} of the simulated surface is real"
    )
    if excess is None:
        return words
    best_case = ", ".join(percent(excess.scores[column]["best_case"]) for column in COVERED)
    return f"{words} (best case {best_case})"


def pieces_words(record: RunRecord) -> str:
    """Missing and invented pieces per pair."""
    missing = number(record.summary["n_missing_pieces"].mean, 1)
    invented = number(record.summary["n_invented_pieces"].mean, 1)
    return f"{missing} missing and {invented} invented per pair"


def task_words(record: RunRecord, excess: RunExcess | None = None) -> str:
    """Obstacles lost and added, and free space, with the best case's; "" without tasks."""
    words = _gap_words(record.task_gaps)
    if words and excess is not None:
        best_case = _gap_words(excess.task_gaps)
        if best_case:
            words += f" (best case: {best_case})"
    return words


def _gap_words(gaps: Mapping[str, float | None]) -> str:
    words = []
    for measure, text in _TASK_WORDS.items():
        gap = gaps.get(measure)
        if gap is not None:
            words.append(text.format(percent(gap)))
    return ", ".join(words)


def scores_words(record: RunRecord) -> str:
    """The object scores; those of the paper next to them under its preset."""
    words = []
    for column in headline_scores(record.preset):
        metric = metric_of(column)
        word = f"{metric.label} {number(record.summary[column].mean, 2)}"
        if record.preset == "paper" and metric.paper_mean is not None:
            word += f" (paper {metric.paper_mean:.2f})"
        words.append(word)
    return "   ".join(words)
