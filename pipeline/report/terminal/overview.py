"""The first answer of a run in the terminal, and the same as Markdown for a merge request."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import TextWrapper

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from ....schemas.metrics import metric_of
from ....schemas.record import RunRecord
from ....schemas.results import Overview
from ...results.floor import RunExcess
from .layout import number, percent, shortened

#: Causes, places and cautions that are shown without --all.
_FEW = 5, 3, 2
_INDENT, _NARROWEST, _PAIR = 14, 40, 16
_SCORES = ("cdc_mean", "r_lambda_mean", "r_gap_mean")
_COVERED = ("covered_real_0p3m", "covered_sim_0p3m")
#: Cautions that are shown above the answer.
_SHOWN_ABOVE = ("failed", "frames")
_WRAPPER = partial(TextWrapper, break_long_words=False, break_on_hyphens=False)


@dataclass(frozen=True)
class FirstAnswer:
    """The first answer of a run as a view: surface, pieces, causes, worst places, scores, trust, and the next step.

    overview : of the record, or over a floor (`over_floor`)
    excess : the run over a floor, whose coverage is shown
    with_all : all causes, places and cautions
    took : time and reused jobs of a run that just ended
    """

    folder: Path
    record: RunRecord
    overview: Overview
    excess: RunExcess | None = None
    with_all: bool = False
    took: str = ""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = max(options.max_width, _NARROWEST)
        yield Text(run_line(self.record, self.took), style="bold")
        for heading, items in self.sections():
            lines = [line for item in items for line in _lines(item, width - _INDENT)]
            for i, line in enumerate(lines):
                title = (heading if i == 0 else "").ljust(_INDENT)
                yield Text.assemble((title, "bold" if heading[0].isupper() else ""), line)

    def sections(self) -> Iterator[tuple[str, list[tuple[str, str, str]]]]:
        """Headings and their items: words, detail and setting; the last two may be empty."""
        overview, record = self.overview, self.record
        n_causes, n_places, n_cautions = (None, None, None) if self.with_all else _FEW
        yield "  surface", [(surface_words(record, self.excess), "", "")]
        yield "  pieces", [(pieces_words(record), "", "")]
        causes = overview.causes[:n_causes]
        yield (
            "Fix first",
            [(f"{i}  {own.words}", own.detail, own.setting) for i, own in enumerate(causes, 1)]
            or [("nothing beyond the differences between two measurements of a scene", "", "")],
        )
        if overview.pieces:
            pieces = overview.pieces[:n_places]
            names = shortened({own.pair_id for own in pieces}, _PAIR)
            yield "Worst places", [(f"{names[own.pair_id]}  {own.words}", "", own.fate_words) for own in pieces]
        yield "Objects", [(scores_words(record), "", "")]
        if record.previous:
            yield "Last run", [(change_words(record), "", "")]
        trust = [own.words for own in overview.trust if own.kind not in _SHOWN_ABOVE]
        show = shlex.join(["fidpipe", "show", str(self.folder), "--all"])
        yield (
            "Trust",
            [(words, "", "") for words in trust[:n_cautions]] + [(f"more: {show}", "", "")] * (not self.with_all),
        )
        report = ["fidpipe", "report", str(self.folder), "--open"]
        yield "Next", [(shlex.join(["fidpipe", "check", record.dataset] if record.frames else report), "", "")]

    def markdown(self) -> str:
        """The same as Markdown."""
        parts = [f"**{run_line(self.record)}**"]
        for heading, items in self.sections():
            lines = ["; ".join(filter(None, item)) for item in items]
            name = heading.strip()
            parts.append(
                f"{name}: {lines[0]}"
                if len(lines) == 1
                else "\n".join([f"{name}:\n", *(f"- {line}" for line in lines)])
            )
        return "\n\n".join(parts) + "\n"


def run_line(record: RunRecord, took: str = "") -> str:
    """Dataset, pairs, time and preset of a run."""
    pairs = record.pairs
    n, n_all = pairs.scored, pairs.scored + pairs.failed + pairs.to_do
    of_all = f" of {n_all}" if n < n_all else ""
    differing = f", but {' '.join(record.departures)}" if record.departures else ""
    name = Path(record.dataset).name
    return f"{name}: {n}{of_all} pair{'s' * (n_all != 1)}{took}, preset {record.preset}{differing}"


def surface_words(record: RunRecord, excess: RunExcess | None = None) -> str:
    """Share of each side's surface that the other side has, with the floor's."""
    real, sim = (percent(record.summary[column].mean) for column in _COVERED)
    floor = excess and ", ".join(percent(excess.scores[column].floor) for column in _COVERED)
    return (
        f"{real} of the real surface is simulated within 0.3 m, {sim} of the simulated surface is real"
        f"{f' (floor {floor})' if floor else ''}"
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
        paper = metric_of(column).paper if record.preset == "paper" else None
        value = number(record.summary[column].mean, 2)
        words.append(f"{metric_of(column).label} {value}{f' (paper {paper.mean:.2f})' if paper else ''}")
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
    more = len(last.changes) - 1
    why = "".join(last.changes[:1]) + (f" and {more} more changes" if more > 0 else "")
    return f"{', '.join(moved) or 'no score moved'}{f' ({why})' if why else ''}; chance: fidpipe compare"


def _lines(item: tuple[str, str, str], width: int) -> Iterator[str]:
    """An item in lines: words, detail, and at the end of the first line the setting; what does not fit comes below."""
    words, detail, setting = item
    hang = " " * 3 * (words[1:3] == "  ")
    if detail and len(words) + len(detail) + len(setting) + 5 <= width:
        words, detail = f"{words}   {detail}", ""
    if setting and len(words) + len(setting) + 2 <= width:
        words, setting = words.ljust(width - len(setting)) + setting, ""
    for text, indent in ((words, ""), ("   ".join(filter(None, (detail, setting))), hang)):
        yield from _WRAPPER(width=width, initial_indent=indent, subsequent_indent=hang).wrap(text)
