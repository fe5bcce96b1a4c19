"""A comparison of runs in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.metrics import METRIC
from ....stages.statistics.comparison import LEAST_CHANGE, LEAST_PAIRS
from ...results.compare import SHARED_SCORES, Comparison, ObjectChange, ScoreChange
from .layout import number, plain_table

_MOST_OBJECTS = 10
COLOURS = {"better": "green", "worse": "red", "vanished": "red", "appeared": "green", "undecided": "yellow"}
OBJECTS_NOTE = (
    f"An object is worse or better if CDC or r_lambda changed by more than {LEAST_CHANGE} and neither the other way. "
    "Single objects also change where Louvain cuts the simulated side otherwise: trust many, not one."
)
#: Few pairs make an interval that is too narrow.
FEW_PAIRS = 10


def compare_view(comparisons: Sequence[Comparison]) -> RenderableType:
    """Each comparison: scores, then what has become of the real objects."""
    return Group(*(part for comparison in comparisons for part in _parts(comparison)))


def verdict(comparison: Comparison) -> str:
    """In words, which scores are better and which are worse."""
    named = {word: [score.name for score in comparison.scores if score.verdict == word] for word in ("better", "worse")}
    said = [f"{word}: {', '.join(names)}" for word, names in named.items() if names]
    return "; ".join(said) or "no score is decidedly better or worse"


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
    if comparison.unfollowed:
        lines.append(
            f"{len(comparison.unfollowed)} pairs have other real objects in the two runs: "
            "their objects are not followed"
        )
    lines += [f"left out: pair {name}: {why}" for name, why in list(comparison.left_out.items())[:5]]
    if len(comparison.left_out) > 5:
        lines.append(f"left out: {len(comparison.left_out) - 5} more pairs")
    verdicts = {score.name: score.verdict for score in comparison.scores}
    r_lambda, alignment = (verdicts[METRIC[name].label] for name in ("r_lambda", "alignment_rms_m"))
    if r_lambda == "better" and alignment == "worse":
        lines.append("r_lambda fell while the alignment got worse: a bad alignment alone lowers r_lambda")
    return lines


def changed(comparison: Comparison) -> list[ObjectChange]:
    """The objects that have changed: vanished ones, then those that got worse, most first, then the others."""
    order = {"vanished": 0, "worse": 1, "mixed": 2, "better": 3, "appeared": 4}
    objects = [change for change in comparison.objects if change.kind in order]
    return sorted(
        objects, key=lambda each: (order[each.kind], -abs(each.change), -each.n_points, each.pair_id, each.real_id)
    )


def _parts(comparison: Comparison) -> list[RenderableType]:
    parts: list[RenderableType] = [_scores(comparison)]
    if comparison.objects:
        kinds = plain_table("Real objects", "what has become of them", "objects", "share")
        for kind, n in comparison.kinds.items():
            kinds.add_row(Text(kind, style=COLOURS.get(kind, "")), str(n), f"{100 * n / len(comparison.objects):.0f} %")
        parts.append(kinds)
        objects = changed(comparison)
        for kind in ("vanished", "worse", "better", "appeared"):
            chosen = [change for change in objects if change.kind == kind]
            if chosen:
                parts.append(_objects(kind, chosen))
        parts.append(Text(OBJECTS_NOTE))
    parts += [Text(f"note: {text}", style="yellow") for text in remarks(comparison)]
    parts.append(Text(f"{comparison.other} against {comparison.base}: {verdict(comparison)}\n", style="bold"))
    return parts


def _scores(comparison: Comparison) -> Table:
    table = plain_table(
        f"{comparison.other} less {comparison.base}: {len(comparison.pairs)} pairs, "
        "means and 95 % intervals (paired bootstrap)",
        *("score", "before", "after", "change", "from", "to"),
    )
    table.add_column("verdict")
    with_seeds = has_seeds(comparison)
    if with_seeds:
        table.add_column("more than seeds make")
    for score in comparison.scores:
        d = score.difference
        word = Text(score.verdict, style=COLOURS.get(score.verdict, ""))
        cells = [number(d.before), number(d.after), signed(d.difference), signed(d.low), signed(d.high)]
        table.add_row(score.name, *cells, word, *([beyond_seeds(score)] if with_seeds else []))
    return table


def _objects(kind: str, objects: list[ObjectChange]) -> Table:
    title = (
        f"{kind} ({len(objects)})" if len(objects) <= _MOST_OBJECTS else f"{kind} ({_MOST_OBJECTS} of {len(objects)})"
    )
    scores = (heading for column in SHARED_SCORES for heading in (METRIC[column].label, "after"))
    table = plain_table(title, *("pair", "class", "object", "range (m)", "points"), *scores, words=2)
    for change in objects[:_MOST_OBJECTS]:
        table.add_row(
            Text(change.pair_id),
            Text(change.label or "-"),
            str(change.real_id),
            number(change.range_m, 1),
            str(change.n_points),
            *(number(getattr(change, f"{name}_{when}")) for name in SHARED_SCORES for when in ("before", "after")),
        )
    return table


def has_seeds(comparison: Comparison) -> bool:
    """Whether both runs were repeated under other seeds."""
    return any(score.seed_noise is not None for score in comparison.scores)


def beyond_seeds(score: ScoreChange) -> str:
    """Whether a difference is more than other Louvain seeds alone would make."""
    if score.beyond_seeds is None:
        return "-"
    return f"{'yes' if score.beyond_seeds else 'no'} ({number(score.seed_noise)})"


def signed(value: float | None) -> str:
    """A difference with its sign."""
    return "-" if value is None else f"{value:+.3f}"
