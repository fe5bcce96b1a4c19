"""A comparison of runs in the terminal; the cells of its tables and its remarks are the same on its page."""

from __future__ import annotations

from collections.abc import Container, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.metrics import METRIC
from ....stages.statistics.comparison import BLOCK_S, CONFIDENCE, LEAST_CHANGE, LEAST_PAIRS
from ...results.compare import Comparison, ScoreChange
from ...results.followed import SHARED_SCORES, GroupChange, ObjectChange
from ..look import ARROWS
from .floor import both_excesses_table, excess_notes
from .layout import csv_table, markdown_table, number, percent, plain_table, shortened, signed

_MOST_OBJECTS = 5
_MOST_LEFT_OUT = 5
_COLOURS = {"vanished": "red", "worse": "red", "better": "green", "appeared": "green", "undecided": "yellow"}
#: What may have become of an object; those that are alike are not listed.
_CHANGED = ("vanished", "worse", "mixed", "better", "appeared")
OBJECTS_NOTE = (
    f"An object is worse or better if CDC or r_lambda changed by more than {LEAST_CHANGE} and neither the other way. "
    "Single objects also change where Louvain cuts the simulated side otherwise: trust many, not one."
)
GROUPS_NOTE = (
    "Classes and ranges are described, not judged: no test says which of these changes chance makes, and of many "
    "groups some always move. Mean changes are over the objects that both runs have matched; below 0 is better."
)
#: From this share of the matched objects on it is said first that they have gone.
_MANY = 0.25
ARROWS_NOTE = "↑ higher is better, ↓ lower is better"


def compare_view(comparisons: Sequence[Comparison]) -> RenderableType:
    """Each comparison: the decision, the scores, then what has become of the real objects."""
    return Group(*(part for comparison in comparisons for part in _parts(comparison)))


def decision(comparison: Comparison) -> str:
    """The answer in one line: better or worse, on how many independent pairs, and how often chance says so."""
    n, n_base = len(comparison.scores), len(comparison.pairs) + len(comparison.lost)
    if comparison.failed:
        count = f"all {n_base}" if len(comparison.failed) == n_base else f"{len(comparison.failed)} of {n_base}"
        line = f"worse: {count} pairs that were scored before fail now"
        return f"{line}; of the others: {_of_scores(comparison)}" if comparison.pairs else line
    if comparison.decision == "same":
        return f"same: all {n} scores are the same, {_pairs(comparison.n_blocks)}"
    return f"{comparison.decision}: {_of_scores(comparison)}"


def _of_scores(comparison: Comparison) -> str:
    n, pairs = len(comparison.scores), _pairs(comparison.n_blocks)
    worse = [score for score in comparison.scores if score.called == "worse"]
    better = [score for score in comparison.scores if score.called == "better"]
    if not worse and not better:
        few = f" (at least {LEAST_PAIRS} are wanted)" if comparison.n_blocks < LEAST_PAIRS else ""
        moved = [score.direction for score in comparison.scores]
        counts = f"{moved.count('worse')} of {n} scores moved to the worse, {moved.count('better')} to the better"
        return f"no difference can be told from chance with {pairs}{few}; {counts}"
    parts = [f"{len(worse)} of {n} scores worse"] * bool(worse) + [f"{len(better)} of {n} better"] * bool(better)
    far = f", far beyond the noise, though {pairs} are too few for a verdict"
    on = far if all(score.verdict == "undecided" for score in (*worse, *better)) else f", with {pairs}"
    rate = f"{100 * (1 - CONFIDENCE):.0f} %"
    return f"{', '.join(parts)}{on}; chance alone calls any of them so in {rate} of such comparisons or fewer"


def verdict(comparison: Comparison) -> str:
    """In words, which scores are better and which are worse, and what broke although too few pairs decide."""
    named = {word: [score.name for score in comparison.scores if score.verdict == word] for word in ("worse", "better")}
    parts = [f"{word}: {', '.join(names)}" for word, names in named.items() if names]
    for word in ("worse", "better"):
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
    n_all = len(comparison.scores)
    lines += [
        f"undecided: {', '.join(names) if len(names) < n_all else f'all {n_all} scores'}: {why}"
        for why, names in undecided.items()
    ]
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


def p_words(p: float | None) -> str:
    """How often chance makes it, in three digits."""
    return "<0.001" if p is not None and p < 0.001 else number(p)


def with_arrow(score: ScoreChange) -> str:
    """The name of a score with its direction of good."""
    return f"{score.name} {ARROWS[score.higher_is_better]}"


def score_table(comparison: Comparison) -> list[list[str]]:
    """Headings, then one row per score: name, verdict, before, after, change, its interval and p, pairs that have it.

    The name has an arrow to where it is better. Where both runs were repeated under other seeds, also whether the
    change is more than they alone would make; with a floor, whether it is more than measuring again makes.
    """
    with_floor = any(score.floor is not None for score in comparison.scores)
    with_seeds = any(score.seed_noise is not None for score in comparison.scores)
    rows = [
        [
            *("score", "verdict", "before", "after", "change", "from", "to", "p", "pairs"),
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
            p_words(score.p),
        )
        seeds = beyond[score.beyond_seeds].format(number(score.seed_noise))
        floor = beyond[score.beyond_floor].format(number(score.floor))
        rows.append(
            [
                with_arrow(score),
                score.verdict,
                *numbers,
                str(change.n_pairs),
                *[seeds] * with_seeds,
                *[floor] * with_floor,
            ]
        )
    return rows


def object_table(changes: Sequence[ObjectChange]) -> list[list[str]]:
    """Headings, then one row per real object: pair, what has become of it, class, place, scores before and after."""
    scores = [f"{name}_{when}" for name in SHARED_SCORES for when in ("before", "after")]
    headings = [heading for name in SHARED_SCORES for heading in (METRIC[name].label, "after")]
    rows = [["pair", "what", "class", "object", "range (m)", "points", *headings]]
    for one in changes:
        place = (one.label or one.shape, str(one.real_id), number(one.range_m, 1), str(one.n_points))
        rows.append([one.pair_id, one.kind, *place, *(number(getattr(one, name)) for name in scores)])
    return rows


def group_table(what: str, groups: Sequence[GroupChange]) -> list[list[str]]:
    """Headings, then one row per class or band of range: how many objects became what, and how far scores moved."""
    kinds = ("vanished", "appeared", "worse", "better")
    rows = [[what, "objects", *kinds, "in both", *(f"{METRIC[score].label} change" for score in SHARED_SCORES)]]
    for group in groups:
        counts = (group.n, *(group.kinds[kind] for kind in kinds), group.n_both)
        rows.append([group.name, *map(str, counts), *(signed(getattr(group, score)) for score in SHARED_SCORES)])
    return rows


def class_heading(comparison: Comparison) -> str:
    """What objects are grouped by: their class, or their shape where no scan is labelled."""
    return "class" if any(change.label is not None for change in comparison.objects) else "shape"


def kind_table(comparison: Comparison) -> list[list[str]]:
    """Headings, then what real objects have become, how many, and their share; no rows where none is followed."""
    n_all = len(comparison.objects)
    rows = [[kind, str(n), percent(n / n_all)] for kind, n in comparison.kinds.items() if n_all]
    return [["what has become of them", "objects", "share"], *rows]


def compare_markdown(comparisons: Sequence[Comparison]) -> str:
    """Each comparison for a merge request: the decision, tables of scores, classes and ranges, remarks."""
    parts = []
    for one in comparisons:
        tables = [score_table(one)]
        if one.objects:
            tables += [group_table(class_heading(one), one.by_class), group_table("range", one.by_range)]
        texts = [f"**{decision(one)}**\n", f"{one.other} against {one.base}, {len(one.pairs)} pairs; {ARROWS_NOTE}.\n"]
        texts += [markdown_table(headings, rows) for headings, *rows in tables]
        if one.objects:
            texts.append(f"{GROUPS_NOTE}\n")
        texts.append("".join(f"- {line}\n" for line in remarks(one)))
        parts.append("\n".join(texts))
    return "\n".join(parts)


def compare_csv(comparisons: Sequence[Comparison]) -> str:
    """One row per run and score, numbers in full."""
    headings = ("base", "run", "score", "better is", "verdict", "pairs", "independent pairs")
    numbers = ("before", "after", "change", "from", "to", "p")
    rows = []
    for one in comparisons:
        for score in one.scores:
            own, better = score.difference, "higher" if score.higher_is_better else "lower"
            words = (str(one.base), str(one.other), score.name, better, score.verdict, own.n_pairs, own.n_blocks)
            rows.append([*words, own.before, own.after, own.difference, own.low, own.high, score.p])
    return csv_table([*headings, *numbers], rows)


def _parts(comparison: Comparison) -> list[RenderableType]:
    parts: list[RenderableType] = [
        Text(decision(comparison), style=f"bold {_COLOURS.get(comparison.decision, '')}"),
        Text(f"{comparison.other} against {comparison.base}: {verdict(comparison)}"),
        _scores(comparison),
        Text(ARROWS_NOTE),
    ]
    if comparison.excess:
        headings, *excesses = both_excesses_table(*comparison.excess)
        parts.append(_table(f"Over the floor {comparison.excess[0].floor}", headings, excesses))
    if comparison.objects:
        headings, *kinds = kind_table(comparison)
        parts.append(_table("Real objects", headings, kinds))
        narrow = {"objects": "count", "in both": "in\nboth"}
        for what, groups in ((class_heading(comparison), comparison.by_class), ("range", comparison.by_range)):
            headings, *rows = group_table(what, groups)
            short = shortened((name for name, *_ in rows), 11)
            named = [[short[name], *cells] for name, *cells in rows]
            headings = [narrow.get(heading, heading.replace(" change", "\nchange")) for heading in headings]
            parts.append(_table(f"Real objects by {what}", headings, named))
        parts.append(Text(GROUPS_NOTE))
        objects = changed(comparison)
        for kind in ("vanished", "worse", "better", "appeared"):
            if own := [change for change in objects if change.kind == kind]:
                n = f"the first {_MOST_OBJECTS} of {len(own)}" if len(own) > _MOST_OBJECTS else f"{len(own)}"
                parts.append(_objects(f"{kind} ({n})", own[:_MOST_OBJECTS]))
        parts.append(Text(OBJECTS_NOTE))
    return [*parts, *(Text(f"note: {text}", style="yellow") for text in remarks(comparison)), Text()]


def _scores(comparison: Comparison) -> Table:
    """The scores, in 80 columns: the verdict last, and pairs only where not all have each score."""
    have_all = all(score.difference.n_pairs == len(comparison.pairs) for score in comparison.scores)
    rows = []
    for score in comparison.scores:
        own = score.difference
        interval = "-" if own.low is None else f"{signed(own.low)} {signed(own.high)}"
        numbers = (number(own.before), number(own.after), signed(own.difference), interval, p_words(score.p))
        rows.append([with_arrow(score), *[str(own.n_pairs)] * (not have_all), *numbers, score.verdict])
    columns = ("score", *["pairs"] * (not have_all), "before", "after", "change", "95 % interval", "p", "verdict")
    title = f"Means over {len(comparison.pairs)} pairs, change with 95 % interval (paired t)"
    return _table(title, columns, rows, words=(0, len(columns) - 1))


def _objects(title: str, changes: Sequence[ObjectChange]) -> Table:
    """Some objects in 80 columns, whatever the names of pairs and classes."""
    _, *rows = object_table(changes)
    columns = ("pair", "real object", "range\n(m)", "points", "CDC", "after", "r_lambda", "after")
    pairs, labels = shortened((row[0] for row in rows), 16), shortened((row[2] for row in rows), 10)
    named = [(pairs[pair], f"{labels[label]} {i}", *cells) for pair, _, label, i, *cells in rows]
    return _table(title, columns, named, words=(0, 1))


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], words: Container[int] = (0,)) -> Table:
    """A table in which words of change have their colour."""
    coloured = ([Text(cell, style=_COLOURS.get(cell, "")) for cell in row] for row in rows)
    return plain_table(title, headings, coloured, words)
