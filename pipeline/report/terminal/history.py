"""Runs in a row in the terminal, as Markdown and as CSV; the cells of the table are the same on the page."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from ....stages.statistics.comparison import CONFIDENCE, LEAST_PAIRS
from ...results.families import MARKS_NOTE
from ...results.history import FamilyHistory, History, Step
from .layout import csv_table, markdown_table, number, plain_table, shortened

_MARKS = {"better": "+", "worse": "-", "mixed": "±", "same": "=", "undecided": "."}
_MARKS_NOTE = (
    "Under each mean, the verdict of its family against the first run and against the one before: "
    "+ better, - worse, ± mixed, = same, . undecided."
)
_COLOURS = {"better": "green", "worse": "red"}


def history_view(history: History) -> RenderableType:
    """The decision, the runs, and their scores side by side, in 80 columns."""
    names = shortened((str(run.folder) for run in history.runs), 40)
    runs = [
        (str(i), run.written[:16].replace("T", " "), run.n_scored, run.n_failed, names[str(run.folder)])
        for i, run in enumerate(history.runs, start=1)
    ]
    rows = [[Text(arrowed(score)), *map(_marked, score.steps)] for score in history.families]
    columns = [str(i) for i in range(1, len(history.runs) + 1)]
    pairs = f"{len(history.pairs)} pairs that all runs have scored"
    return Group(
        Text(history_decision(history), style="bold"),
        plain_table("Runs", ("", "made (UTC)", "scored", "failed", "folder"), runs, words=(1, 4)),
        plain_table(f"Means over {pairs}", ("score", *columns), rows),
        Text(f"{MARKS_NOTE}. {_MARKS_NOTE}"),
        *(Text(f"note: {text}", style="yellow") for text in history_remarks(history)),
    )


def history_decision(history: History) -> str:
    """In one line, how the last run stands against the first, and on how many independent pairs."""
    last = [score.steps[-1].since_first for score in history.families]
    n, pairs = len(last), f"{history.n_blocks} independent pair{'s' * (history.n_blocks != 1)}"
    counts = [f"{last.count(word)} of {n} families {word}" for word in ("worse", "mixed", "better") if word in last]
    what = ", ".join(counts) or (
        "no score changed" if set(last) == {"same"} else "no difference stands out from chance"
    )
    n_failed = f"{len(history.failed)} pair{'s' * (len(history.failed) != 1)}"
    failed = f"{n_failed} that run 1 has scored fail now; of the others " if history.failed else ""
    return f"run {len(history.runs)} against run 1: {failed}{what}, with {pairs}"


def history_remarks(history: History) -> list[str]:
    """What a reader must know beside the numbers."""
    share, n = 1 - CONFIDENCE, history.n_comparisons
    lines = [
        f"each of the {n} comparisons calls a family better or worse by chance in {100 * share:.0f} % of the cases or "
        f"fewer: up to {share * n:.2g} of them"
        if n > 1
        else f"the comparison calls a family better or worse by chance in {100 * share:.0f} % of the cases or fewer"
    ]
    if history.n_blocks < LEAST_PAIRS:
        lines.append(
            f"{history.n_blocks} independent pairs are too few for intervals and verdicts, {LEAST_PAIRS} are wanted; "
            "only moves to the worse far beyond the noise are named"
        )
    if history.left_out:
        name, why = next(iter(history.left_out.items()))
        lines.append(f"{len(history.left_out)} pairs are left out of all runs; the first: {name}: {why}")
    return [*lines, *history.notes]


def arrowed(score: FamilyHistory) -> str:
    """The name of a score with its direction of good."""
    return f"{score.family}: {score.name} {score.mark}"


def history_markdown(history: History) -> str:
    """The decision for a merge request, and a table of scores by runs."""
    headings = ["score", *(f"{i}: {run.folder}" for i, run in enumerate(history.runs, start=1))]
    rows = [
        [
            arrowed(score),
            *(
                number(step.mean) + (f" ({step.since_first}, {step.since_last})" if step.since_first else "")
                for step in score.steps
            ),
        ]
        for score in history.families
    ]
    lines = "".join(f"- {line}\n" for line in history_remarks(history))
    note = f"{MARKS_NOTE}. In brackets: against run 1, and against the run before."
    return f"**{history_decision(history)}**\n\n{markdown_table(headings, rows)}\n{note}\n\n{lines}"


def history_csv(history: History) -> str:
    """One row per score and run, numbers in full."""
    columns = ("family", "score", "better is", "run", "written", "mean", "from", "to", "since first", "since last")
    rows = [
        [
            *(score.family, score.name, score.mark, str(run.folder), run.written),
            *(step.mean, step.low, step.high, step.since_first, step.since_last),
        ]
        for score in history.families
        for run, step in zip(history.runs, score.steps, strict=True)
    ]
    return csv_table(columns, rows)


def _marked(step: Step) -> Text:
    """The mean in three digits, and under it a mark for each verdict."""
    text = Text(number(step.mean, 3 if abs(step.mean or 0.0) < 10 else 1))
    for gap, verdict in (("\n", step.since_first), (" ", step.since_last)):
        text.append(gap).append(_MARKS.get(verdict, ""), style=_COLOURS.get(verdict, ""))
    return text
