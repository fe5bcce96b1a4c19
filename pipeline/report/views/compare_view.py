"""Comparisons of two runs: the decision, families, causes, scores, objects and remarks."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from ....schemas.columns import Row
from ....schemas.metric_catalogue import METRIC
from ....stages.statistics.comparison import LEAST_CHANGE, LEAST_FOR_INTERVAL, LEAST_PAIRS, Difference
from ...results.compare import Comparison
from ...results.families import ERROR_RATE, MARKS_NOTE, FamilyChange, ScoreChange, overall
from ...results.followed import SHARED_SCORES, by_change, by_class, by_range
from ...results.object_frame import plain_rows
from ...results.sectors import N_SECTORS
from ...storage.urls import url_or_path
from ..view import Note, Part, Table, View, number, percent, signed
from .floor_view import both_excesses_table, excess_notes

_MOST_OBJECTS = 5
_MOST_LEFT_OUT = 5
_COLOURS = {"worse": "red", "mixed": "red", "better": "green", "undecided": "yellow"}
#: Fates of an object that are listed; unchanged ones are not.
_CHANGED = ("vanished", "worse", "mixed", "better", "appeared")
OBJECTS_NOTE = (
    f"An object is worse or better if CDC or r_lambda changed by more than {LEAST_CHANGE} and neither the other way. "
    "Single objects also change where Louvain cuts the simulated side otherwise: trust many, not one."
)
GROUPS_NOTE = (
    "Classes and ranges are described, not tested: some of these changes are due to chance, and of many groups "
    "some always move. Mean changes are over the objects that both runs have matched; below 0 is better."
)


def compare_view(comparison: Comparison, *, with_all: bool = False) -> View:
    """The decision, its families and causes, and their limits.

    Parameters
    ----------
    with_all : also every score, and the real objects by class, by range and one by one
    """
    kinds = ", ".join(f"{n} {kind}" for kind, n in comparison.kinds.items() if n)
    first: list[Part] = [
        Note(decision(comparison), f"bold {_COLOURS.get(comparison.decision, '')}"),
        Note(f"{comparison.other} against {comparison.base}: {chance(comparison)}"),
        *[family_table(comparison)] * bool(comparison.families),
        *[cause_table(comparison)] * bool(comparison.causes),
    ]
    if with_all:
        objects = changed(comparison)
        few = [one for kind in _CHANGED for one in [own for own in objects if own["kind"] == kind][:_MOST_OBJECTS]]
        more = f" (of each kind the first {_MOST_OBJECTS})" if len(few) < len(objects) else ""
        excess = [both_excesses_table(*comparison.excess)] if comparison.excess else []
        first += [score_table(comparison), Note(MARKS_NOTE), *excess, *object_view(comparison)]
        if few:
            first += [object_table(f"Objects that have changed{more}", few), Note(OBJECTS_NOTE)]
    elif kinds:
        first.append(Note(f"{len(comparison.objects)} real objects: {kinds}"))
    hint = [Note("all scores and objects: --all; as a page: --html FILE")] * (not with_all)
    if comparison.pairs and comparison.decision != "same" and not comparison.settings:
        words = ["fidpipe", "diagnose", url_or_path(comparison.other), "--floor", url_or_path(comparison.base)]
        hint.append(Note(f"next: {shlex.join(words)}"))
    return [*first, *remarks(comparison), *hint, Note("")]


def object_view(comparison: Comparison) -> View:
    """The real objects by fate, by class or shape, and by range."""
    objects, n_all = comparison.objects, len(comparison.objects)
    if not n_all:
        return []
    rows = [(kind, str(n), percent(n / n_all)) for kind, n in comparison.kinds.items()]
    kind = "class" if objects["label"].notna().any() else "shape"
    return [
        Table("Real objects", ("what has become of them", "objects", "share"), rows),
        _group_table(kind, by_class(objects)),
        _group_table("range", by_range(objects)),
        Note(GROUPS_NOTE),
    ]


def decision(comparison: Comparison) -> str:
    """The answer in one line: the decision, the families behind it, and the error rate."""
    n_base = len(comparison.pairs) + len(comparison.lost)
    parts = []
    if comparison.failed:
        count = f"all {n_base}" if len(comparison.failed) == n_base else f"{len(comparison.failed)} of {n_base}"
        parts.append(f"{count} pairs that were scored before fail now")
    by_verdict = {
        word: [family for family in comparison.families if family.verdict == word and not family.why]
        for word in ("worse", "mixed", "better")
    }
    for word, families in by_verdict.items():
        if families:
            names = [_both_ways(own) if word == "mixed" else own.name for own in families]
            parts.append(f"{'both ways' if word == 'mixed' else word}: {', '.join(names)}")
    if comparison.pairs and not any(by_verdict.values()):
        others = " of the others" * bool(comparison.failed)
        is_same = overall(comparison.families) == "same"
        few = f"{comparison.n_blocks} independent pair{'s' * (comparison.n_blocks != 1)} cannot decide"
        is_few = comparison.n_blocks < LEAST_FOR_INTERVAL and not comparison.by_direction
        unsure = few if is_few else f"no change{others} stands out from chance"
        parts.append(f"no score{others} changed" if is_same else unsure)
    words = [parts[0].removeprefix(f"{comparison.decision}: "), *parts[1:]] if parts else []
    return f"{comparison.decision}: {'; '.join(words)}"


def _both_ways(family: FamilyChange) -> str:
    """A family some scores of which are better and some worse."""
    counted = [own for own in family.scores if not own.why and own.verdict in ("worse", "better")]
    return f"{family.name} ({', '.join(f'{own.name} {own.verdict}' for own in counted)})"


def chance(comparison: Comparison) -> str:
    """The second line: how pairs were counted, and the rate at which equal simulators are called better or worse."""
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


def remarks(comparison: Comparison) -> list[Note]:
    """Notes that qualify the numbers."""
    lines = [f"settings differ: {text}" for text in comparison.settings]
    lines += [f"also differs: {text}" for text in comparison.notes]
    tending = [family.name for family in comparison.families if family.tendency == "worse"]
    if tending:
        lines.append(f"not decided, but with a tendency to the worse (p below 5 % alone): {', '.join(tending)}")
    lines += [f"{own.name}: ({own.verdict}) does not count, {own.why}" for own in comparison.families if own.why]
    lines += _on_chance(comparison)
    n_unfollowed = len(comparison.unfollowed)
    if n_unfollowed:
        lines.append(f"{n_unfollowed} pairs have different real objects in the two runs: they are not followed")
    left_out = [f"left out: pair {name}: {why}" for name, why in comparison.left_out.items()]
    lines += left_out[:_MOST_LEFT_OUT]
    if len(left_out) > _MOST_LEFT_OUT:
        lines.append(f"left out: {len(left_out) - _MOST_LEFT_OUT} more pairs")
    return [Note(f"note: {line}", "yellow") for line in lines]


def _on_chance(comparison: Comparison) -> list[str]:
    """Seeds and floor: which changes are not more than these make."""
    lines = [comparison.on_partition] if comparison.on_partition else []
    by_seeds = [score.name for score in comparison.scores if score.exceeds(score.seed_noise) is False]
    if by_seeds:
        lines.append(f"no more than Louvain seeds alone make: {', '.join(by_seeds)}")
    below = [score for score in comparison.scores if score.exceeds(score.floor) is False and score.towards]
    if below:
        lines.append(
            "no more than the floor, by which a second measurement of the real scan differs: "
            + ", ".join(
                f"{score.name} ({signed(score.difference.difference)}, floor {number(score.floor)})" for score in below
            )
        )
    if comparison.excess:
        lines += dict.fromkeys(
            note.text.removeprefix("note: ") for each in comparison.excess for note in excess_notes(each)
        )
    return lines


def changed(comparison: Comparison) -> list[Row]:
    """The objects that have changed: vanished ones, then those that got worse, most first, then the others."""
    objects = by_change(comparison.objects[comparison.objects["kind"].isin(_CHANGED)])
    return sorted(plain_rows(objects), key=lambda one: _CHANGED.index(one["kind"]))


def family_table(comparison: Comparison, families: Sequence[FamilyChange] | None = None) -> Table:
    """One row per family, or per family chosen: verdict, and its clearest score before and after."""
    rows = []
    for family in comparison.families if families is None else families:
        score, own = family.scores[0], family.scores[0].difference
        numbers = (own.before, own.after, _interval(own), _p(family.p))
        rows.append((family.name, family.called, score.name, *numbers))
    headings = ("family", "verdict", "clearest change", "before", "after", "change, 95 %", "p")
    return Table("", headings, rows, words=(0, 1, 2), wide=(6,))


def cause_table(comparison: Comparison) -> Table:
    """One row per cause that changed: before, after, change, and the setting that controls it."""
    rows = []
    for cause in comparison.causes:
        own, unit = cause.difference, f" ({cause.unit})" if cause.unit else ""
        numbers = (signed(own.before), signed(own.after), _interval(own))
        rows.append((f"{cause.name}{unit}", *numbers, cause.setting))
    headings = ("cause", "before", "after", "change, 95 %", "setting")
    return Table("Causes that changed: simulated minus real", headings, rows, words=(0, 4))


def score_table(comparison: Comparison, chosen: Sequence[ScoreChange] | None = None) -> Table:
    """One row per score, or per score chosen, with its numbers, and an arrow to where it is better.

    Not in a terminal: the pairs if all have each score; if both runs were repeated under other seeds, whether the
    change is more than they alone make; with a floor, whether it is more than a second measurement makes.
    """
    beyond = {None: "-", True: "yes ({})", False: "no ({})"}
    with_seeds = any(score.seed_noise is not None for score in comparison.scores)
    with_floor = any(score.floor is not None for score in comparison.scores)
    rows = [
        (
            *(family.name, f"{score.name} {score.mark}", score.difference.n_pairs, score.difference.before),
            *(score.difference.after, _interval(score.difference), _p(score.p)),
            f"({score.verdict})" if score.why else score.verdict,
            *[beyond[score.exceeds(score.seed_noise)].format(number(score.seed_noise))] * with_seeds,
            *[beyond[score.exceeds(score.floor)].format(number(score.floor))] * with_floor,
        )
        for score in (comparison.scores if chosen is None else chosen)
        for family in comparison.families
        if score in family.scores
    ]
    have_all = all(score.difference.n_pairs == len(comparison.pairs) for score in comparison.scores)
    headings = ("family", "score", "pairs", "before", "after", "change, 95 %", "p", "verdict")
    beyonds = ["more than seeds make"] * with_seeds + ["more than the floor"] * with_floor
    title = f"Means over {len(comparison.pairs)} pairs; in brackets: does not count"
    wide = (0, 8, 9, 2) if have_all else (0, 8, 9)
    return Table(title, (*headings, *beyonds), rows, words=(0, 1, 7), wide=wide)


def object_table(title: str, changes: Sequence[Row]) -> Table:
    """One row per real object: pair, fate, class, place, scores before and after."""
    scores = [f"{name}_{when}" for name in SHARED_SCORES for when in ("before", "after")]
    headings = [heading for name in SHARED_SCORES for heading in (METRIC[name].label, "after")]
    rows = [
        (
            *(one["pair_id"], one["kind"], f"{one['label'] or one['shape']} {one['real_id']}"),
            *(one[name] for name in ("range_m", "n_points", *scores)),
        )
        for one in changes
    ]
    columns = ("pair", "what", "real object", "range\n(m)", "points", *headings)
    return Table(title, columns, rows, words=(0, 1, 2), digits={3: 1})


def _group_table(what: str, groups: Sequence[Row]) -> Table:
    """One row per class or band of range: number of objects by fate, and changes of scores."""
    kinds = ("vanished", "appeared", "worse", "better")
    changes = (f"{METRIC[score].label}\nchange" for score in SHARED_SCORES)
    rows = [
        (
            *(group["name"], group["n"], *(group["kinds"][kind] for kind in kinds), group["n_both"]),
            *(signed(group[score]) for score in SHARED_SCORES),
        )
        for group in groups
    ]
    return Table(f"Real objects by {what}", (what, "count", *kinds, "in\nboth", *changes), rows)


def compare_records(comparisons: Sequence[Comparison]) -> Table:
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
                rows.append((*words, *counts, own.before, own.after, own.difference, own.low, own.high, score.p))
    return Table("", (*headings, *numbers), rows)


def _p(p: float | None) -> str:
    return "<0.001" if p is not None and p < 0.001 else number(p)


def _interval(own: Difference) -> str:
    """A change with half the width of its interval."""
    return signed(own.difference) + ("" if own.half_width is None else f" ±{number(own.half_width)}")
