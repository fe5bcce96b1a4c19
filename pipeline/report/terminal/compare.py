"""A comparison of runs in the terminal; the cells of its tables and its remarks are the same on its page."""

from __future__ import annotations

from collections.abc import Container, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.metrics import METRIC
from ....stages.statistics.comparison import LEAST_CHANGE, LEAST_FOR_INTERVAL, LEAST_PAIRS, Difference
from ...results.compare import Comparison
from ...results.families import ERROR_RATE, MARKS_NOTE, ScoreChange, overall
from ...results.followed import SHARED_SCORES, GroupChange, ObjectChange
from ...results.sectors import N_SECTORS
from .floor import both_excesses_table, excess_notes
from .layout import csv_table, markdown_table, number, percent, plain_table, shortened, signed

_MOST_OBJECTS = 5
_MOST_LEFT_OUT = 5
_COLOURS = {
    "vanished": "red",
    "worse": "red",
    "mixed": "red",
    "better": "green",
    "appeared": "green",
    "undecided": "yellow",
}
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
INTENSITY_NOTE = "intensity is not compared: no score uses it yet"


def compare_view(comparisons: Sequence[Comparison], *, with_all: bool = False) -> RenderableType:
    """Each comparison: the decision, and its families.

    Parameters
    ----------
    with_all : also every score, and the real objects by class, by range and one by one
    """
    return Group(*(part for comparison in comparisons for part in _parts(comparison, with_all)))


def decision(comparison: Comparison) -> str:
    """The answer in one line: the decision, the families behind it, and the error rate."""
    n_base = len(comparison.pairs) + len(comparison.lost)
    parts = []
    if comparison.failed:
        count = f"all {n_base}" if len(comparison.failed) == n_base else f"{len(comparison.failed)} of {n_base}"
        parts.append(f"{count} pairs that were scored before fail now")
    by_verdict = {
        word: [family.name for family in comparison.families if family.verdict == word and not family.why]
        for word in ("worse", "mixed", "better")
    }
    parts += [f"{word}: {', '.join(names)}" for word, names in by_verdict.items() if names]
    if comparison.pairs and not any(by_verdict.values()):
        others = " of the others" * bool(comparison.failed)
        is_same = overall(comparison.families) == "same"
        few = f"{comparison.n_blocks} independent pair{'s' * (comparison.n_blocks != 1)} cannot decide"
        is_few = comparison.n_blocks < LEAST_FOR_INTERVAL and not comparison.by_direction
        unsure = few if is_few else f"no change{others} stands out from chance"
        parts.append(f"no score{others} changed" if is_same else unsure)
    words = [part.removeprefix(f"{comparison.decision}: ") for part in parts]
    return f"{comparison.decision}: {'; '.join(words)}"


def chance(comparison: Comparison) -> str:
    """The second line: how pairs were counted, and how often equal simulators are called better or worse."""
    counted = comparison.blocking
    if comparison.by_direction:
        counted += (
            f"; a change counts if it is consistent over the frames and over {N_SECTORS} directions from each place "
            "(--independent: over the frames alone, for a decision about these places only)"
        )
    if comparison.is_small:
        return f"{counted}; fewer than {LEAST_PAIRS} pairs decide only changes far beyond the noise"
    rate = f"{100 * ERROR_RATE:.0f} %"
    return f"{counted}; error rate over all families at most {rate} for equal simulators"


def remarks(comparison: Comparison) -> list[str]:
    """Notes that qualify the numbers."""
    lines = [f"settings differ: {text}" for text in comparison.settings]
    lines += [f"also differs: {text}" for text in comparison.notes]
    tending = [family.name for family in comparison.families if family.tendency == "worse"]
    if tending:
        lines.append(f"not decided, but with a tendency to the worse (p below 5 % alone): {', '.join(tending)}")
    lines += [f"({own.verdict}) does not count: {own.name}: {own.why}" for own in comparison.families if own.why]
    lines += _on_chance(comparison)
    n_unfollowed = len(comparison.unfollowed)
    if n_unfollowed:
        lines.append(f"{n_unfollowed} pairs have different real objects in the two runs: they are not followed")
    left_out = [f"left out: pair {name}: {why}" for name, why in comparison.left_out.items()]
    lines += left_out[:_MOST_LEFT_OUT]
    if len(left_out) > _MOST_LEFT_OUT:
        lines.append(f"left out: {len(left_out) - _MOST_LEFT_OUT} more pairs")
    return [*lines, INTENSITY_NOTE]


def _on_chance(comparison: Comparison) -> list[str]:
    """Seeds and floor: which changes are not more than these make."""
    lines = [comparison.on_partition] if comparison.on_partition else []
    by_seeds = [score.name for score in comparison.scores if score.beyond_seeds is False]
    if by_seeds:
        lines.append(f"no more than Louvain seeds alone make: {', '.join(by_seeds)}")
    below = [score for score in comparison.scores if score.beyond_floor is False and score.towards]
    if below:
        lines.append(
            "no more than the floor, by which a second measurement of the real scan differs: "
            + ", ".join(
                f"{score.name} ({signed(score.difference.difference)}, floor {number(score.floor)})" for score in below
            )
        )
    if comparison.excess:
        lines += list(dict.fromkeys(note for each in comparison.excess for note in excess_notes(each)))
    return lines


def changed(comparison: Comparison) -> list[ObjectChange]:
    """The objects that have changed: vanished ones, then those that got worse, most first, then the others."""
    return sorted(
        (change for change in comparison.objects if change.kind in _CHANGED),
        key=lambda each: (_CHANGED.index(each.kind), -abs(each.change), -each.n_points, each.pair_id, each.real_id),
    )


def p_words(p: float | None) -> str:
    """How often chance makes it, in three digits."""
    return "<0.001" if p is not None and p < 0.001 else number(p)


def family_table(comparison: Comparison) -> list[list[str]]:
    """Headings, then one row per family: name, verdict, p, and its most telling score."""
    rows = [["family", "verdict", "p", "score", "before", "after", "change", "from", "to"]]
    for family in comparison.families:
        score = family.scores[0]
        verdict = f"{family.verdict}, {family.why}" if family.why else family.verdict
        rows.append([family.name, verdict, p_words(family.p), f"{score.name} {score.mark}", *_numbers(score)])
    return rows


def cause_table(comparison: Comparison) -> list[list[str]]:
    """Headings, then one row per cause that changed: name, before, after, change, and the setting that controls it."""
    rows = [["cause", "before", "after", "change, 95 %", "setting"]]
    for cause in comparison.causes:
        own, unit = cause.difference, f" ({cause.unit})" if cause.unit else ""
        numbers = (signed(own.before), signed(own.after), _interval(own))
        rows.append([f"{cause.name}{unit}", *numbers, cause.setting])
    return rows


def score_table(comparison: Comparison) -> list[list[str]]:
    """Headings, then one row per score: name, verdict, before, after, change, its interval and p, pairs that have it.

    The name has an arrow to where it is better. If both runs were repeated under other seeds, also whether the
    change is more than they alone would make; with a floor, whether it is more than a second measurement makes.
    """
    with_floor = any(score.floor is not None for score in comparison.scores)
    with_seeds = any(score.seed_noise is not None for score in comparison.scores)
    rows = [
        [
            *("family", "score", "verdict", "before", "after", "change", "from", "to", "p", "pairs"),
            *["more than seeds make"] * with_seeds,
            *["more than the floor"] * with_floor,
        ]
    ]
    beyond = {None: "-", True: "yes ({})", False: "no ({})"}
    for family in comparison.families:
        for score in family.scores:
            seeds = beyond[score.beyond_seeds].format(number(score.seed_noise))
            floor = beyond[score.beyond_floor].format(number(score.floor))
            verdict = f"{score.verdict}, {score.why}" if score.why else score.verdict
            rows.append(
                [
                    *(family.name, f"{score.name} {score.mark}", verdict, *_numbers(score), p_words(score.p)),
                    *(str(score.difference.n_pairs), *[seeds] * with_seeds, *[floor] * with_floor),
                ]
            )
    return rows


def _numbers(score: ScoreChange) -> tuple[str, ...]:
    own = score.difference
    return (number(own.before), number(own.after), *map(signed, (own.difference, own.low, own.high)))


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
        tables = [family_table(one), *[cause_table(one)] * bool(one.causes), score_table(one)]
        if one.objects:
            tables += [group_table(class_heading(one), one.by_class), group_table("range", one.by_range)]
        texts = [f"**{decision(one)}**\n", f"{one.other} against {one.base}, {chance(one)}; {MARKS_NOTE}.\n"]
        texts += [markdown_table(headings, rows) for headings, *rows in tables]
        if one.objects:
            texts.append(f"{GROUPS_NOTE}\n")
        texts.append("".join(f"- {line}\n" for line in remarks(one)))
        parts.append("\n".join(texts))
    return "\n".join(parts)


def compare_csv(comparisons: Sequence[Comparison]) -> str:
    """One row per run and score, numbers in full."""
    headings = ("base", "run", "family", "score", "better is", "verdict", "pairs", "independent pairs")
    numbers = ("before", "after", "change", "from", "to", "p")
    rows = []
    for one in comparisons:
        for family in one.families:
            for score in family.scores:
                own = score.difference
                words = (str(one.base), str(one.other), family.name, score.name, score.mark, score.verdict)
                counts = (own.n_pairs, own.n_blocks)
                rows.append([*words, *counts, own.before, own.after, own.difference, own.low, own.high, score.p])
    return csv_table([*headings, *numbers], rows)


def _parts(comparison: Comparison, with_all: bool) -> list[RenderableType]:
    kinds = ", ".join(f"{n} {kind}" for kind, n in comparison.kinds.items() if n)
    notes = [Text(f"note: {text}", style="yellow") for text in remarks(comparison)]
    first: list[RenderableType] = [
        Text(decision(comparison), style=f"bold {_COLOURS.get(comparison.decision, '')}"),
        Text(f"{comparison.other} against {comparison.base}: {chance(comparison)}"),
        *[_families(comparison)] * bool(comparison.families),
        *[_causes(comparison)] * bool(comparison.causes),
    ]
    if not with_all:
        count = [Text(f"{len(comparison.objects)} real objects: {kinds}")] * bool(kinds)
        return [
            *first,
            *count,
            *notes,
            Text("all scores and objects: --all; as a page: --html FILE"),
            Text(),
        ]
    parts = [*first, _scores(comparison), Text(MARKS_NOTE)]
    if comparison.excess:
        headings, *excesses = both_excesses_table(*comparison.excess)
        parts.append(_table(f"Over the floor {comparison.excess[0].floor}", headings, excesses))
    if comparison.objects:
        headings, *counts = kind_table(comparison)
        parts.append(_table("Real objects", headings, counts))
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
    return [*parts, *notes, Text()]


def _families(comparison: Comparison) -> Table:
    """One line per family in 80 columns: verdict, and its most telling score before and after."""
    rows = []
    for family in comparison.families:
        score, own = family.scores[0], family.scores[0].difference
        verdict = f"({family.verdict})" if family.why else Text(family.verdict, style=_COLOURS.get(family.verdict, ""))
        numbers = (number(own.before), number(own.after), _interval(own))
        rows.append([family.name, verdict, score.name, *numbers])
    columns = ("family", "verdict", "clearest change", "before", "after", "change, 95 %")
    return plain_table("", columns, rows, words=(0, 1, 2))


def _causes(comparison: Comparison) -> Table:
    headings, *rows = cause_table(comparison)
    return plain_table("Causes that changed: simulated minus real", headings, rows, words=(0, 4))


def _interval(own: Difference) -> str:
    """A change with half the width of its interval."""
    return signed(own.difference) + (
        "" if own.low is None or own.high is None else f" ±{number((own.high - own.low) / 2)}"
    )


def _scores(comparison: Comparison) -> Table:
    """The scores, in 80 columns: the verdict last, and pairs only if not all have each score."""
    have_all = all(score.difference.n_pairs == len(comparison.pairs) for score in comparison.scores)
    rows = []
    for score in comparison.scores:
        own = score.difference
        numbers = (number(own.before), number(own.after), _interval(own), p_words(score.p))
        verdict = f"({score.verdict})" if score.why else score.verdict
        rows.append([f"{score.name} {score.mark}", *[str(own.n_pairs)] * (not have_all), *numbers, verdict])
    columns = ("score", *["pairs"] * (not have_all), "before", "after", "change, 95 %", "p", "verdict")
    title = f"Means over {len(comparison.pairs)} pairs; in brackets: does not count"
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
