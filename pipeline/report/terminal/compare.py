"""A comparison of runs in the terminal; the cells of its tables and its remarks are the same on its page."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.metrics import METRIC
from ....stages.statistics.comparison import LEAST_CHANGE, LEAST_PAIRS
from ...results.compare import SHARED_SCORES, Comparison, ObjectChange, ScoreChange
from .layout import number, percent, plain_table

_MOST_OBJECTS = 10
_MOST_LEFT_OUT = 5
#: What may have become of an object, and the colour of the word; those that are alike are not listed.
_COLOURS = {
    **{"vanished": "red", "worse": "red", "mixed": "", "better": "green", "appeared": "green"},
    **{"undecided": "yellow"},
}
SCORE_HEADINGS = ("before", "after", "change", "from", "to")
OBJECT_HEADINGS = (
    *("class", "object", "range (m)", "points"),
    *(heading for score in SHARED_SCORES for heading in (METRIC[score].label, "after")),
)
SEEDS_HEADING = "more than seeds make"
OBJECTS_NOTE = (
    f"An object is worse or better if CDC or r_lambda changed by more than {LEAST_CHANGE} and neither the other way. "
    "Single objects also change where Louvain cuts the simulated side otherwise: trust many, not one."
)
#: Fewer pairs make an interval that is too narrow.
FEW_PAIRS = 10


def compare_view(comparisons: Sequence[Comparison]) -> RenderableType:
    """Each comparison: scores, then what has become of the real objects."""
    return Group(*(part for comparison in comparisons for part in _parts(comparison)))


def verdict(comparison: Comparison) -> str:
    """In words, which scores are better and which are worse."""
    named = {word: [score.name for score in comparison.scores if score.verdict == word] for word in ("better", "worse")}
    return "; ".join(f"{word}: {', '.join(names)}" for word, names in named.items() if names) or (
        "no score is decidedly better or worse"
    )


def remarks(comparison: Comparison) -> list[str]:
    """What a reader must know beside the numbers."""
    lines = [f"settings differ: {text}" for text in comparison.settings]
    lines += [f"also other: {text}" for text in comparison.notes]
    undecided: dict[str, list[str]] = {}
    for score in comparison.scores:
        if score.difference.why:
            undecided.setdefault(score.difference.why, []).append(score.name)
    lines += [f"undecided: {', '.join(names)}: {why}" for why, names in undecided.items()]
    if LEAST_PAIRS <= len(comparison.pairs) < FEW_PAIRS:
        lines.append(f"{len(comparison.pairs)} pairs are few: the intervals are too narrow rather than too wide")
    n_unfollowed = len(comparison.unfollowed)
    if n_unfollowed:
        lines.append(f"{n_unfollowed} pairs have other real objects in the two runs: their objects are not followed")
    left_out = [f"left out: pair {name}: {why}" for name, why in comparison.left_out.items()]
    lines += left_out[:_MOST_LEFT_OUT]
    if len(left_out) > _MOST_LEFT_OUT:
        lines.append(f"left out: {len(left_out) - _MOST_LEFT_OUT} more pairs")
    verdicts = {score.name: score.verdict for score in comparison.scores}
    if (verdicts[METRIC["r_lambda"].label], verdicts[METRIC["alignment_rms_m"].label]) == ("better", "worse"):
        lines.append("r_lambda fell while the alignment got worse: a bad alignment alone lowers r_lambda")
    return lines


def changed(comparison: Comparison) -> list[ObjectChange]:
    """The objects that have changed: vanished ones, then those that got worse, most first, then the others."""
    order = {kind: i for i, kind in enumerate(("vanished", "worse", "mixed", "better", "appeared"))}
    return sorted(
        (change for change in comparison.objects if change.kind in order),
        key=lambda each: (order[each.kind], -abs(each.change), -each.n_points, each.pair_id, each.real_id),
    )


def score_cells(score: ScoreChange) -> list[str]:
    """What stands under `SCORE_HEADINGS`."""
    change = score.difference
    return [number(change.before), number(change.after), *map(signed, (change.difference, change.low, change.high))]


def object_cells(change: ObjectChange) -> list[str]:
    """What stands under `OBJECT_HEADINGS`."""
    scores = [getattr(change, f"{name}_{when}") for name in SHARED_SCORES for when in ("before", "after")]
    place = [change.label or "-", str(change.real_id), number(change.range_m, 1), str(change.n_points)]
    return [*place, *map(number, scores)]


def kind_rows(comparison: Comparison) -> list[tuple[str, str, str]]:
    """What real objects have become, how many, and their share; no rows where none is followed."""
    n_all = len(comparison.objects)
    return [(kind, str(n), percent(n / n_all)) for kind, n in comparison.kinds.items() if n_all]


def seed_cells(comparison: Comparison) -> list[list[str]]:
    """By score a list of one cell: whether its difference is more than other Louvain seeds alone would make.

    Of no cells where the two runs were not both repeated under other seeds.
    """
    if all(score.seed_noise is None for score in comparison.scores):
        return [[] for _ in comparison.scores]
    words = {None: "-", True: "yes ({})", False: "no ({})"}
    return [[words[score.beyond_seeds].format(number(score.seed_noise))] for score in comparison.scores]


def signed(value: float | None) -> str:
    """A difference with its sign."""
    return "-" if value is None else f"{value:+.3f}"


def _parts(comparison: Comparison) -> list[RenderableType]:
    parts: list[RenderableType] = [_scores(comparison)]
    if comparison.objects:
        kinds = ((_coloured(kind), *counts) for kind, *counts in kind_rows(comparison))
        parts.append(plain_table("Real objects", ("what has become of them", "objects", "share"), kinds))
        objects = changed(comparison)
        for kind in ("vanished", "worse", "better", "appeared"):
            own = [change for change in objects if change.kind == kind]
            if own:
                n = f"{_MOST_OBJECTS} of {len(own)}" if len(own) > _MOST_OBJECTS else f"{len(own)}"
                rows = ((change.pair_id, *object_cells(change)) for change in own[:_MOST_OBJECTS])
                parts.append(plain_table(f"{kind} ({n})", ("pair", *OBJECT_HEADINGS), rows, words=(0, 1)))
        parts.append(Text(OBJECTS_NOTE))
    parts += [Text(f"note: {text}", style="yellow") for text in remarks(comparison)]
    parts.append(Text(f"{comparison.other} against {comparison.base}: {verdict(comparison)}\n", style="bold"))
    return parts


def _scores(comparison: Comparison) -> Table:
    seeds = seed_cells(comparison)
    rows = [
        (score.name, *score_cells(score), _coloured(score.verdict), *beyond)
        for score, beyond in zip(comparison.scores, seeds, strict=True)
    ]
    title = (
        f"{comparison.other} less {comparison.base}: {len(comparison.pairs)} pairs, "
        "means and 95 % intervals (paired bootstrap)"
    )
    columns = ("score", *SCORE_HEADINGS, "verdict", *([SEEDS_HEADING] if seeds[0] else []))
    return plain_table(title, columns, rows, words=(0, 6, 7))


def _coloured(word: str) -> Text:
    return Text(word, style=_COLOURS.get(word, ""))
