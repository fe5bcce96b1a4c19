"""Runs in a row: the decision, the runs, and their scores side by side."""

from __future__ import annotations

from ....stages.statistics.comparison import CONFIDENCE, LEAST_PAIRS
from ...results.families import MARKS_NOTE
from ...results.history import FamilyHistory, History, Step
from ..view import Note, Table, View, number

_MARKS = {"better": "+", "worse": "-", "mixed": "±", "same": "=", "undecided": "."}
_MARKS_NOTE = (
    "Under each mean, the verdict of its family against the first run and against the one before: "
    "+ better, - worse, ± mixed, = same, . undecided; in brackets: does not count (compare says why)."
)


def history_view(history: History) -> View:
    """The decision, the runs, and the means of their scores, each with a mark for both verdicts below."""
    runs = [
        (str(i), run.written[:16].replace("T", " "), run.n_scored, run.n_failed, str(run.folder))
        for i, run in enumerate(history.runs, start=1)
    ]
    rows: list[tuple[str, ...]] = []
    for score in history.families:
        rows.append((arrowed(score), *map(_mean, score.steps)))
        rows.append(("", *(f"{_mark(step.since_first)} {_mark(step.since_last)}" for step in score.steps)))
    title = f"Means over {len(history.pairs)} pairs that all runs have scored"
    return [
        Note(history_decision(history), "bold"),
        Table("Runs", ("", "made (UTC)", "scored", "failed", "folder"), runs, words=(1, 4)),
        Table(title, ("score", *map(str, range(1, len(history.runs) + 1))), rows),
        Note(f"{MARKS_NOTE}. {_MARKS_NOTE}"),
        *history_remarks(history),
    ]


def history_decision(history: History) -> str:
    """The last run against the first in one line, with the number of independent pairs."""
    last = [score.steps[-1].since_first for score in history.families]
    n, pairs = len(last), f"{history.n_blocks} independent pair{'s' * (history.n_blocks != 1)}"
    counts = [f"{last.count(word)} of {n} families {word}" for word in ("worse", "mixed", "better") if word in last]
    what = ", ".join(counts) or (
        "no score changed" if set(last) == {"same"} else "no difference stands out from chance"
    )
    n_failed = f"{len(history.failed)} pair{'s' * (len(history.failed) != 1)}"
    failed = f"{n_failed} that run 1 has scored fail now; of the others " if history.failed else ""
    return f"run {len(history.runs)} against run 1: {failed}{what}, with {pairs}"


def history_remarks(history: History) -> list[Note]:
    """Notes that a reader needs next to the numbers."""
    share, n = 1 - CONFIDENCE, history.n_comparisons
    lines = [
        f"each of the {n} comparisons calls a family better or worse by chance in {100 * share:.0f} % of the cases or "
        f"fewer: up to {share * n:.2g} of them"
        if n > 1
        else f"the comparison calls a family better or worse by chance in {100 * share:.0f} % of the cases or fewer"
    ]
    if history.n_blocks < LEAST_PAIRS:
        lines.append(
            f"too few independent pairs for intervals and verdicts: {history.n_blocks}, {LEAST_PAIRS} are needed; "
            "only moves to the worse far beyond the noise are named"
        )
    if history.left_out:
        name, why = next(iter(history.left_out.items()))
        lines.append(f"{len(history.left_out)} pairs are left out of all runs; the first: {name}: {why}")
    return [Note(f"note: {line}", "yellow") for line in [*lines, *history.notes]]


def arrowed(score: FamilyHistory) -> str:
    """The name of a score with its direction of good."""
    return f"{score.family}: {score.name} {score.mark}"


def history_records(history: History) -> Table:
    """One row per score and run, numbers in full."""
    columns = ("family", "score", "better is", "run", "written", "mean", "from", "to", "since first", "since last")
    rows = [
        (
            *(score.family, score.name, score.mark, str(run.folder), run.written),
            *(step.mean, step.low, step.high, step.since_first, step.since_last),
        )
        for score in history.families
        for run, step in zip(history.runs, score.steps, strict=True)
    ]
    return Table("", columns, rows)


def _mark(verdict: str) -> str:
    """The mark of a verdict, in brackets if the verdict is."""
    word = verdict.strip("()")
    return verdict.replace(word, _MARKS[word]) if word else ""


def _mean(step: Step) -> str:
    """The mean in three digits, or in one if it is large."""
    return number(step.mean, 3 if abs(step.mean or 0.0) < 10 else 1)
