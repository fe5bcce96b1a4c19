"""A comparison of runs in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....stages.statistics.comparison import LEAST_CHANGE, LEAST_PAIRS
from ...results.compare import Comparison, ObjectChange, ScoreChange
from .layout import number, plain_table

_MOST_OBJECTS = 10
COLOURS = {"better": "green", "worse": "red", "vanished": "red", "appeared": "green", "undecided": "yellow"}
OBJECTS_NOTE = (
    f"An object is worse or better if CDC or r_lambda changed by more than {LEAST_CHANGE} and neither the other way. "
    "Single objects also change where Louvain cuts the simulated side otherwise: trust many, not one."
)
#: Few pairs make an interval that is too narrow.
FEW_PAIRS = 10


def compare_view(found: Sequence[Comparison]) -> RenderableType:
    """Each comparison: scores, then what has become of the real objects."""
    return Group(*(part for comparison in found for part in _parts(comparison)))


def verdict(found: Comparison) -> str:
    """In words, which scores are better and which are worse."""
    named = {word: [of.name for of in found.scores if of.verdict == word] for word in ("better", "worse")}
    said = [f"{word}: {', '.join(names)}" for word, names in named.items() if names]
    return "; ".join(said) or "no score is decidedly better or worse"


def remarks(found: Comparison) -> list[str]:
    """What a reader must know beside the numbers."""
    lines = [f"settings differ: {text}" for text in found.settings]
    lines += [f"also other: {text}" for text in found.notes]
    undecided: dict[str, list[str]] = {}
    for of in found.scores:
        if of.difference.why:
            undecided.setdefault(of.difference.why, []).append(of.name)
    lines += [f"undecided: {', '.join(names)}: {why}" for why, names in undecided.items()]
    if LEAST_PAIRS <= len(found.pairs) < FEW_PAIRS:
        lines.append(f"{len(found.pairs)} pairs are few: the intervals are too narrow rather than too wide")
    if found.unfollowed:
        lines.append(
            f"{len(found.unfollowed)} pairs have other real objects in the two runs: their objects are not followed"
        )
    lines += [f"left out: pair {name}: {why}" for name, why in list(found.left_out.items())[:5]]
    if len(found.left_out) > 5:
        lines.append(f"left out: {len(found.left_out) - 5} more pairs")
    by_name = {of.name: of for of in found.scores}
    if by_name["r_lambda"].verdict == "better" and by_name["alignment (m)"].verdict == "worse":
        lines.append("r_lambda fell while the alignment got worse: a bad alignment alone lowers r_lambda")
    return lines


def changed(found: Comparison) -> list[ObjectChange]:
    """The objects that have changed: vanished ones, then those that got worse, most first, then the others."""
    order = {"vanished": 0, "worse": 1, "mixed": 2, "better": 3, "appeared": 4}
    objects = [of for of in found.objects if of.kind in order]
    return sorted(objects, key=lambda of: (order[of.kind], -abs(of.change), -of.n_points, of.pair_id, of.real_id))


def _parts(found: Comparison) -> list[RenderableType]:
    parts: list[RenderableType] = [_scores(found)]
    if found.objects:
        kinds = plain_table("Real objects", "what has become of them", "objects", "share")
        for kind, n in found.kinds.items():
            kinds.add_row(Text(kind, style=COLOURS.get(kind, "")), str(n), f"{100 * n / len(found.objects):.0f} %")
        parts.append(kinds)
        objects = changed(found)
        for title, chosen in (
            ("vanished", [of for of in objects if of.kind == "vanished"]),
            ("worse", [of for of in objects if of.kind == "worse"]),
            ("better", [of for of in objects if of.kind == "better"]),
            ("appeared", [of for of in objects if of.kind == "appeared"]),
        ):
            if chosen:
                parts.append(_objects(title, chosen))
        parts.append(Text(OBJECTS_NOTE))
    parts += [Text(f"note: {text}", style="yellow") for text in remarks(found)]
    parts.append(Text(f"{found.other} against {found.base}: {verdict(found)}\n", style="bold"))
    return parts


def _scores(found: Comparison) -> Table:
    table = plain_table(
        f"{found.other} less {found.base}: {len(found.pairs)} pairs, means and 95 % intervals (paired bootstrap)",
        *("score", "before", "after", "change", "from", "to"),
    )
    table.add_column("verdict")
    with_seeds = has_seeds(found)
    if with_seeds:
        table.add_column("more than seeds make")
    for of in found.scores:
        d = of.difference
        word = Text(of.verdict, style=COLOURS.get(of.verdict, ""))
        cells = [number(d.before), number(d.after), signed(d.difference), signed(d.low), signed(d.high)]
        table.add_row(of.name, *cells, word, *([beyond_seeds(of)] if with_seeds else []))
    return table


def _objects(kind: str, objects: list[ObjectChange]) -> Table:
    title = (
        f"{kind} ({len(objects)})" if len(objects) <= _MOST_OBJECTS else f"{kind} ({_MOST_OBJECTS} of {len(objects)})"
    )
    table = plain_table(
        title, *("pair", "class", "object", "range, m", "points", "CDC", "after", "r_lambda", "after"), words=2
    )
    for of in objects[:_MOST_OBJECTS]:
        table.add_row(
            Text(of.pair_id),
            Text(of.label or "-"),
            str(of.real_id),
            number(of.range_m, 1),
            str(of.n_points),
            *(number(value) for value in (of.cdc_before, of.cdc_after, of.r_lambda_before, of.r_lambda_after)),
        )
    return table


def has_seeds(found: Comparison) -> bool:
    """Whether both runs were repeated under other seeds."""
    return any(of.seed_noise is not None for of in found.scores)


def beyond_seeds(of: ScoreChange) -> str:
    """Whether a difference is more than other Louvain seeds alone would make."""
    if of.beyond_seeds is None:
        return "-"
    return f"{'yes' if of.beyond_seeds else 'no'} ({number(of.seed_noise)})"


def signed(value: float | None) -> str:
    """A difference with its sign."""
    return "-" if value is None else f"{value:+.3f}"
