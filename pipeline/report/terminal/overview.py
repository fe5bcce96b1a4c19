"""The overview of a run in the terminal: what it ends with, and the same as Markdown for a merge request."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path
from textwrap import fill

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.text import Text

from ....schemas.record import RunRecord
from ....schemas.results import Overview, PreviousRun
from ...results.overview import verdict_sentence
from .layout import markdown_table, number, plain_table, signed

_OBJECT_HEADINGS = ("pair", "object", "class", "range (m)", "points", "what is wrong")
_MOST_CHANGES = 3
#: Cautions that a view has told of already.
_TOLD = ("failed", "frames")


def overview_view(folder: Path, record: RunRecord, overview: Overview) -> RenderableType:
    """The verdict, the numbers and what moved, the worst objects, the commonest failings, what limits trust."""
    headings, *rows = number_rows(record, overview)
    parts: list[RenderableType] = [
        Text(f"\n{verdict_sentence(overview.verdict)}\n", style="bold"),
        plain_table("In five numbers", headings, rows, words=(0, len(headings) - 1)),
        *(Text(line) for line in moved_lines(record, overview)),
        *([Text()] if record.previous else ()),
    ]
    if overview.worst:
        worst = plain_table(
            "The worst objects", _OBJECT_HEADINGS, _worst_rows(overview), words=(0, 1, 2, 5), digits={3: 1}
        )
        first = overview.worst[0]
        name = f"{first.side}:{first.object_id}"
        parts += [worst, Text(f"see one with: {shlex.join(['fidpipe', 'show', str(folder), first.pair_id, name])}\n")]
    if overview.failings:
        parts += _list("The commonest failings", (failing.words for failing in overview.failings))
    cautions = [caution.words for caution in overview.trust if caution.kind not in _TOLD]
    return Group(*parts, *_list("What limits the trust in these numbers", cautions))


def overview_markdown(record: RunRecord, overview: Overview) -> str:
    """The same as Markdown."""
    headings, *rows = number_rows(record, overview)
    parts = [verdict_sentence(overview.verdict), markdown_table(headings, rows), *moved_lines(record, overview)]
    if overview.worst:
        parts += ["**The worst objects**", markdown_table(_OBJECT_HEADINGS, _worst_rows(overview))]
    for title, lines in (
        ("The commonest failings", [failing.words for failing in overview.failings]),
        ("What limits the trust in these numbers", [caution.words for caution in overview.trust]),
    ):
        if lines:
            parts += [f"**{title}**", "\n".join(f"- {line}" for line in lines)]
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"


def number_rows(record: RunRecord, overview: Overview) -> list[list[str]]:
    """Headings, then one row per number: mean and deviation over pairs, what it was and by how much it moved, best."""
    has_last = record.previous is not None
    rows = [["score", "mean", "std", "pairs", *["last run", "moved"] * has_last, "better"]]
    for one in overview.numbers:
        moved = None if one.mean is None or one.last is None else one.mean - one.last
        last = [number(one.last), "same" if moved == 0 else signed(moved)] * has_last
        pairs = f"{one.n_pairs} of {record.pairs.scored}"
        rows.append([one.label, number(one.mean), number(one.std), pairs, *last, one.better])
    return rows


def moved_lines(record: RunRecord, overview: Overview) -> list[str]:
    """What the last run of the folder was, what is other since, and what a moved number does not say."""
    last = record.previous
    if last is None:
        return []
    changes = changes_since(last) or ["nothing that is known"]
    return [
        f"last run: {last.written[:16].replace('T', ' ')} by fidpipe {last.fidpipe}, {last.n_pairs} "
        f"pair{'s' * (last.n_pairs != 1)} scored; other since: {'; '.join(changes)}",
        "a number that moved says nothing about chance: keep both runs (--out), and fidpipe compare judges",
        *other_objects(overview),
    ]


def changes_since(last: PreviousRun) -> list[str]:
    """What is other than in the last run of the folder; of many changes the first ones."""
    n_more = len(last.changes) - _MOST_CHANGES
    return [*last.changes[:_MOST_CHANGES], *[f"{n_more} more, see previous in run.json"] * (n_more > 0)]


def other_objects(overview: Overview) -> list[str]:
    """That the scores are of other objects than in the last run, where the match rate moved."""
    match_rate = overview.numbers[0]
    moved = match_rate.last is not None and match_rate.mean != match_rate.last
    return ["CDC, r_lambda and r_gap are of other objects than before: the match rate moved"] * moved


def _worst_rows(overview: Overview) -> list[tuple[object, ...]]:
    return [
        (one.pair_id, f"{one.side}:{one.object_id}", one.label, one.range_m, one.n_points, one.what)
        for one in overview.worst
    ]


def _list(title: str, lines: Iterable[str]) -> list[RenderableType]:
    """A title and the items below it; nothing where there is none."""
    items = [_Item(line) for line in lines]
    return [Text(title, style="bold"), *items, Text()] if items else []


class _Item:
    """One item of a list; its further lines hang below the first."""

    def __init__(self, line: str) -> None:
        self._line = f"- {line}"

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        lines = fill(self._line, options.max_width, subsequent_indent="  ", break_on_hyphens=False)
        yield Text(self._line if options.no_wrap else lines)
