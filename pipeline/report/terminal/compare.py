"""A comparison of runs in the terminal; the cells of its tables and its remarks are the same on its page."""

from __future__ import annotations

from collections.abc import Container, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.metrics import METRIC
from ....stages.statistics.comparison import BLOCK_S, LEAST_CHANGE, LEAST_PAIRS
from ...results.compare import SHARED_SCORES, Comparison, ObjectChange, ScoreChange
from .floor import both_excesses_table, excess_notes
from .layout import number, percent, plain_table, signed

_MOST_OBJECTS = 10
_MOST_LEFT_OUT = 5
_COLOURS = {"vanished": "red", "worse": "red", "better": "green", "appeared": "green", "undecided": "yellow"}
#: What may have become of an object; those that are alike are not listed.
_CHANGED = ("vanished", "worse", "mixed", "better", "appeared")
OBJECTS_NOTE = (
    f"An object is worse or better if CDC or r_lambda changed by more than {LEAST_CHANGE} and neither the other way. "
    "Single objects also change where Louvain cuts the simulated side otherwise: trust many, not one."
)
#: From this share of the matched objects on it is said first that they have gone.
_MANY = 0.25


def compare_view(comparisons: Sequence[Comparison]) -> RenderableType:
    """Each comparison: scores, then what has become of the real objects."""
    return Group(*(part for comparison in comparisons for part in _parts(comparison)))


def verdict(comparison: Comparison) -> str:
    """In words, which scores are better and which are worse, and what broke although too few pairs decide."""
    named = {word: [score.name for score in comparison.scores if score.verdict == word] for word in ("better", "worse")}
    parts = [f"{word}: {', '.join(names)}" for word, names in named.items() if names]
    for word in ("better", "worse"):
        far = [score for score in comparison.scores if score.is_far and score.verdict == "undecided"]
        words = [f"{score.name} ({_moved(score)})" for score in far if score.direction == word]
        if words:
            parts.append(
                f"far beyond the noise, though {_pairs(comparison.n_blocks)} decide nothing: {word}: {', '.join(words)}"
            )
    n_gone, n_new = (comparison.kinds[kind] for kind in ("vanished", "appeared"))
    n_before = sum(change.cdc_before is not None for change in comparison.objects)
    if n_gone - n_new > _MANY * max(n_before, 1) and n_gone > LEAST_PAIRS:
        parts.append(f"{n_gone} of {n_before} objects that were matched have vanished, {n_new} have appeared")
    if parts:
        return "; ".join(parts)
    if {score.verdict for score in comparison.scores} == {"same"}:
        return "all scores are the same"
    decided = "no score is decidedly better or worse"
    if comparison.n_blocks >= LEAST_PAIRS:
        return decided
    moved = [score for score in comparison.scores if score.direction and score.difference.before]
    largest = max(moved, key=lambda s: abs((s.difference.difference or 0) / (s.difference.before or 1)), default=None)
    return f"{_pairs(comparison.n_blocks)} cannot decide what is better or worse" + (
        f"; the largest change is {largest.name} ({_moved(largest)})" if largest else ""
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
    lines += _on_chance(comparison)
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


def _on_chance(comparison: Comparison) -> list[str]:
    """What the verdicts stand on: independent pairs, and seeds."""
    n, n_blocks = len(comparison.pairs), comparison.n_blocks
    lines = [comparison.on_partition] if comparison.on_partition else []
    if n_blocks < n:
        lines.append(
            f"{n} pairs count as {n_blocks}: copies of a real scan, and scans within {BLOCK_S:g} s, count once"
        )
    elif not comparison.has_times and n > 1:
        lines.append(
            "no timestamps: each pair counts as independent; where pairs are neighbouring frames of a drive, give "
            "timestamp_s in pairs.csv, or differences by chance are taken for real ones"
        )
    by_seeds = [score.name for score in comparison.scores if score.beyond_seeds is False]
    if by_seeds:
        lines.append(f"no more than Louvain seeds alone make: {', '.join(by_seeds)}")
    below = [score for score in comparison.scores if score.beyond_floor is False and score.direction]
    if below:
        lines.append(
            "no more than the floor, what a second measurement of the real scan alone is off by: "
            + ", ".join(
                f"{score.name} ({signed(score.difference.difference)}, floor {number(score.floor)})" for score in below
            )
        )
    if comparison.excess:
        lines += list(dict.fromkeys(note for each in comparison.excess for note in excess_notes(each)))
    decided = [score for score in comparison.scores if score.verdict in ("better", "worse") or score.is_far]
    if any(score.seed_noise is None for score in decided):
        names = [score.name for score in decided if score.seed_noise is None]
        lines.append(
            f"what seeds alone make is unknown of {', '.join(names)}; with fidpipe run --seeds 5 for both runs it is "
            "known of the scores over all objects"
        )
    return lines


def _pairs(n: int) -> str:
    return "1 independent pair" if n == 1 else f"{n} independent pairs"


def _moved(score: ScoreChange) -> str:
    change = score.difference
    return f"{number(change.before)} to {number(change.after)}"


def changed(comparison: Comparison) -> list[ObjectChange]:
    """The objects that have changed: vanished ones, then those that got worse, most first, then the others."""
    return sorted(
        (change for change in comparison.objects if change.kind in _CHANGED),
        key=lambda each: (_CHANGED.index(each.kind), -abs(each.change), -each.n_points, each.pair_id, each.real_id),
    )


def score_table(comparison: Comparison) -> list[list[str]]:
    """Headings, then one row per score: name, verdict, pairs that have it, before, after, change, its interval and p.

    Where both runs were repeated under other seeds, also whether the change is more than they alone would make; with a
    floor, whether it is more than measuring again makes.
    """
    with_floor = any(score.floor is not None for score in comparison.scores)
    with_seeds = any(score.seed_noise is not None for score in comparison.scores)
    rows = [
        [
            *("score", "verdict", "pairs", "before", "after", "change", "from", "to", "p"),
            *["more than seeds make"] * with_seeds,
            *["more than the floor"] * with_floor,
        ]
    ]
    beyond = {None: "-", True: "yes ({})", False: "no ({})"}
    for score in comparison.scores:
        change = score.difference
        numbers = (
            number(change.before),
            number(change.after),
            *map(signed, (change.difference, change.low, change.high)),
            number(score.p),
        )
        seeds = beyond[score.beyond_seeds].format(number(score.seed_noise))
        floor = beyond[score.beyond_floor].format(number(score.floor))
        rows.append(
            [score.name, score.verdict, str(change.n_pairs), *numbers, *[seeds] * with_seeds, *[floor] * with_floor]
        )
    return rows


def object_table(changes: Sequence[ObjectChange]) -> list[list[str]]:
    """Headings, then one row per real object: pair, what has become of it, class, place, scores before and after."""
    scores = [f"{name}_{when}" for name in SHARED_SCORES for when in ("before", "after")]
    headings = [heading for name in SHARED_SCORES for heading in (METRIC[name].label, "after")]
    rows = [["pair", "what", "class", "object", "range (m)", "points", *headings]]
    for one in changes:
        place = (one.label or "-", str(one.real_id), number(one.range_m, 1), str(one.n_points))
        rows.append([one.pair_id, one.kind, *place, *(number(getattr(one, name)) for name in scores)])
    return rows


def kind_table(comparison: Comparison) -> list[list[str]]:
    """Headings, then what real objects have become, how many, and their share; no rows where none is followed."""
    n_all = len(comparison.objects)
    rows = [[kind, str(n), percent(n / n_all)] for kind, n in comparison.kinds.items() if n_all]
    return [["what has become of them", "objects", "share"], *rows]


def _parts(comparison: Comparison) -> list[RenderableType]:
    headings, *scores = score_table(comparison)
    for row in (headings, *scores):
        row.insert(8, row.pop(1))  # the verdict, behind the numbers that it is about
    title = f"{comparison.other} less {comparison.base}: {len(comparison.pairs)} pairs, means and 95 % intervals"
    parts: list[RenderableType] = [_table(f"{title} (paired t)", headings, scores, words=(0, 8, 9, 10))]
    if comparison.excess:
        headings, *excesses = both_excesses_table(*comparison.excess)
        parts.append(_table(f"Over the floor {comparison.excess[0].floor}", headings, excesses))
    if comparison.objects:
        headings, *kinds = kind_table(comparison)
        parts.append(_table("Real objects", headings, kinds))
        objects = changed(comparison)
        for kind in ("vanished", "worse", "better", "appeared"):
            own = [change for change in objects if change.kind == kind]
            headings, *rows = ([pair, *row] for pair, _, *row in object_table(own[:_MOST_OBJECTS]))
            n = f"{_MOST_OBJECTS} of {len(own)}" if len(own) > _MOST_OBJECTS else f"{len(own)}"
            if own:
                parts.append(_table(f"{kind} ({n})", headings, rows, words=(0, 1)))
        parts.append(Text(OBJECTS_NOTE))
    parts += [Text(f"note: {text}", style="yellow") for text in remarks(comparison)]
    parts.append(Text(f"{comparison.other} against {comparison.base}: {verdict(comparison)}\n", style="bold"))
    return parts


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], words: Container[int] = (0,)) -> Table:
    """A table in which words of change have their colour."""
    coloured = ([Text(cell, style=_COLOURS.get(cell, "")) for cell in row] for row in rows)
    return plain_table(title, headings, coloured, words)
