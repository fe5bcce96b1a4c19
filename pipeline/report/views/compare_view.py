"""Comparisons of two runs: decision, causes that changed, families, scores, objects, remarks."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace

from ....schemas.columns import Row
from ....stages.statistics.comparison import LEAST_FLIPPED, LEAST_PAIRS, Difference
from ...results.causes import interval_words
from ...results.compare import Comparison
from ...results.families import ERROR_RATE, MARKS_NOTE, TASKS
from ...results.followed import worst_changes
from ...results.independence import NEEDED, pairs_and_places
from ...results.sectors import N_SECTORS
from ..view import (
    COLOURS,
    Answers,
    Item,
    Note,
    Part,
    Table,
    View,
    first_of,
    items_of,
    number,
    percent,
    shortened,
    signed,
    warnings,
)

_MOST_LEFT_OUT = 5
_PAIR_WIDTH = 24
#: Most objects to look at, and with --all.
_MOST_PLACES = 3
_MOST_PLACES_OF_ALL = 20
#: Verdicts of causes and families in the order in which they are shown; causes of the world have none.
_VERDICTS = ("worse", "mixed", "better", "changed", "")


def compare_view(comparison: Comparison, *, with_all: bool = False) -> View:
    """The decision in a line, the causes and families behind it, and their limits.

    Parameters
    ----------
    with_all : also every score, and more of the objects that became worse
    """
    n_places = _MOST_PLACES_OF_ALL if with_all else _MOST_PLACES
    style = f"bold {COLOURS.get(comparison.decision, '')}"
    parts: list[Part] = [Note(decision(comparison), style), answer(comparison, n_places)]
    parts += numbers_view(comparison, with_all=with_all)
    if not with_all:
        parts.append(Note("all scores and objects: --all; as a page: --html FILE"))
    return [*parts, Note("")]


def numbers_view(comparison: Comparison, *, with_all: bool) -> View:
    """The families of scores and the limits; with `with_all` every score."""
    if not comparison.families:
        return remarks(comparison)
    return [scores_table(comparison, with_all=with_all), *remarks(comparison)]


def decision(comparison: Comparison) -> str:
    """The answer in one short line: the decision, and the first cause or family behind it."""
    parts = []
    if comparison.failed:
        n_base = len(comparison.pairs) + len(comparison.lost)
        n_failed = len(comparison.failed)
        which = f"all {n_base}" if n_failed == n_base else f"{n_failed} of {n_base}"
        parts.append(f"{which} pairs that were scored before fail now")
    behind = reasons(comparison)
    for verdict in ("worse", "mixed", "better"):
        if behind[verdict]:
            heading = "" if verdict == comparison.decision else f"{verdict}: "
            parts.append(heading + _first_words(behind[verdict]))
    if not parts:
        parts.append(_nothing_decided(comparison, behind["changed"]))
    return f"{comparison.decision}: {'; '.join(parts)}"


def _first_words(items: Sequence[Item]) -> str:
    """The first item, and the number of the others."""
    n_more = len(items) - 1
    return items[0][0] + (f" and {n_more} more" if n_more else "")


def _nothing_decided(comparison: Comparison, changed: Sequence[Item]) -> str:
    """Why nothing is worse or better."""
    if comparison.decision == "same":
        return "no score changed"
    if changed:
        return f"changed, neither better nor worse: {_first_words(changed)}"
    counted = pairs_and_places(len(comparison.pairs), comparison.n_places)
    if comparison.lacks_places:
        return f"{counted}. {NEEDED.capitalize()}"
    return f"no change stands out from chance over {counted}"


def reasons(comparison: Comparison) -> dict[str, list[Item]]:
    """Causes and families with their verdict, the clearest first.

    By verdict: worse, mixed, better; changed if that is neither worse nor better, and "" for causes
    of the world, about which the families decide.
    """
    behind: dict[str, list[Item]] = {verdict: [] for verdict in _VERDICTS}
    for cause in comparison.changes.causes:
        amount = f"95 %: {interval_words(cause)}"
        behind[cause.verdict].append((cause.words, amount, cause.setting))
    for family in comparison.families:
        if family.verdict in ("worse", "mixed", "better") and not family.why:
            score = family.scores[0]
            words = f"{score.name} {_interval(score.difference)}"
            behind[family.verdict].append((family.name, words, ""))
    return behind


def answer(comparison: Comparison, n_places: int = _MOST_PLACES) -> Answers:
    """The causes and families behind a decision, where to look (at so many), and how pairs were counted."""
    worst = worst_changes(comparison.objects, n_places)
    names = shortened({row["pair_id"] for row in worst}, _PAIR_WIDTH)
    where = [f"{names[row['pair_id']]}  {place_words(row)}" for row in worst]
    kinds = ", ".join(f"{n} {kind}" for kind, n in comparison.kinds.items() if n)
    again = (comparison.other, "--since", comparison.base)
    sections = {
        "Where": items_of(*where),
        "Objects": items_of(kinds),
        "Compared": items_of(
            f"{comparison.other} against {comparison.base}", chance(comparison)
        ),
        "Next": items_of(shlex.join(["fidpipe", "diagnose", *map(str, again)])),
    }
    return Answers(_by_verdict(comparison) | sections)


def _by_verdict(comparison: Comparison) -> dict[str, list[Item]]:
    """The causes and families behind a decision, by the heading of their verdict."""
    behind = reasons(comparison).items()
    return {verdict.capitalize() or "In the world": items for verdict, items in behind}


def place_words(row: Row) -> str:
    """A changed real object in words."""
    return f"{row['label'] or row['shape']}, {row['range_m']:.0f} m away: {row['kind']}"


def chance(comparison: Comparison) -> str:
    """How pairs were counted, and the rate of false alarms."""
    counted = comparison.counted
    if comparison.by_direction:
        counted += f"; the world counts if frames and {N_SECTORS} directions agree (--independent: frames)"
    if comparison.is_small:
        return f"{counted}; fewer than {LEAST_PAIRS} pairs: of the world only very large changes count"
    return f"{counted}; false-alarm rate at most {100 * ERROR_RATE:.0f} %"


def remarks(comparison: Comparison) -> list[Note]:
    """Notes that qualify the numbers."""
    lines = [f"differs: {text}" for text in (*comparison.settings, *comparison.notes)]
    tending = [family.name for family in comparison.families if family.tendency == "worse"]
    if tending:
        lines.append(
            "not decided, but with a tendency to the worse (p below 5 % alone): "
            f"{', '.join(tending)}"
        )
    if comparison.by_direction and TASKS in [family.name for family in comparison.families]:
        lines.append(
            f"{TASKS}: undecided, as they are not known by direction: needs {LEAST_FLIPPED} places"
        )
    for family in comparison.families:
        if family.why:
            lines.append(f"{family.name}: ({family.verdict}) ignored, because it {family.why}")
    if comparison.changes.elsewhere is not None:
        share = percent(comparison.changes.elsewhere)
        lines.append(
            f"unexplained: {share} of the flat surface is elsewhere than before, which no cause "
            "explains"
        )
    if comparison.changes.doubtful:
        doubtful = "; ".join(comparison.changes.doubtful)
        lines.append(f"seen, but undoing it brings nothing closer: {doubtful}")
    if comparison.on_partition:
        lines.append(comparison.on_partition)
    n_unfollowed = len(comparison.unfollowed)
    if n_unfollowed:
        lines.append(
            f"{n_unfollowed} pairs have different real objects in the two runs: they are not "
            "followed"
        )
    left_out = [f"left out: pair {name}: {why}" for name, why in comparison.left_out.items()]
    lines += first_of(left_out, _MOST_LEFT_OUT, "left out: {} more pairs")
    return warnings(lines)


def scores_table(comparison: Comparison, *, with_all: bool) -> Table:
    """One row per family: its verdict and its clearest score; with `with_all` one per score."""
    rows = []
    for family in comparison.families:
        verdict = family.called
        for score in family.scores if with_all else family.scores[:1]:
            change = score.difference
            p = "<0.001" if score.p is not None and score.p < 0.001 else score.p
            numbers = (change.before, change.after, _interval(change), p)
            rows.append((family.name, verdict, f"{score.name} {score.mark}", *numbers))
            verdict = ""
    headings = ("family", "verdict", "score", "before", "after", "change, 95 %", "p")
    title = (
        f"Means over {len(comparison.pairs)} pairs, the clearest change first ({MARKS_NOTE})"
    )
    return Table(title, headings, rows, words=(0, 1, 2), wide=(6,), whole=(1,))


def changed_since(comparison: Comparison) -> View:
    """The causes that changed since an earlier build; not those against the real scans."""
    title = Note(f"Changed since {comparison.base}", "bold")
    sections = _by_verdict(replace(comparison, families=()))
    if not any(sections.values()):
        return [title, Note("no cause changed by more than the accuracy of its estimate")]
    return [title, Answers(sections)]


def _interval(change: Difference) -> str:
    """A change with half the width of its interval."""
    if change.half_width is None:
        return signed(change.difference)
    return f"{signed(change.difference)} ±{number(change.half_width)}"
