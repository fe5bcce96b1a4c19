"""Real objects followed from one run to another: the fate of each, and of all objects of a class or a band of range.

The real side's objects are the same where scan and settings are; that is checked by content.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...stages.statistics.comparison import KINDS, kinds_of_change
from ...stages.statistics.findings import BAND_EDGES_M, BAND_NAMES
from .object_frame import plain_rows

#: Scores that are followed, columns of `metrics`.
SHARED_SCORES = ("cdc", "r_lambda")
_PLACE = ("n_points", "cx", "cy", "cz")
#: Columns of the frame of objects that `follow` reads.
FOLLOWED_COLUMNS = (*_PLACE[1:], *SHARED_SCORES, "label", "shape", "range_m")


@dataclass(frozen=True)
class ObjectChange:
    """A real object before and after; scores are None if it is missing or a score is null.

    shape : what it is called by where scans have no labels
    sim_before, sim_after : the simulated object that it is matched with; None if it is missing
    """

    pair_id: str
    real_id: int
    label: str | None
    shape: str
    range_m: float
    n_points: int
    kind: str
    cdc_before: float | None
    cdc_after: float | None
    r_lambda_before: float | None
    r_lambda_after: float | None
    sim_before: int | None
    sim_after: int | None

    @property
    def change(self) -> float:
        """The largest rise of a score, or fall where none rose; for sorting."""
        return max((step for score in SHARED_SCORES if (step := self.step(score)) is not None), key=abs, default=0.0)

    def step(self, score: str) -> float | None:
        """Change of a score; None if it is null in either run."""
        before, after = getattr(self, f"{score}_before"), getattr(self, f"{score}_after")
        return None if before is None or after is None else float(after - before)


@dataclass(frozen=True)
class GroupChange:
    """Fates of some real objects, counted: a description without a test of significance.

    name : of the class, the shape or the band of range
    n : real objects; kinds : of these, how many have become what
    n_pairs : pairs that have such objects
    n_both : objects that both runs have matched
    cdc, r_lambda : mean change over those of them that have the score in both runs; None if no object has it
    """

    name: str
    n: int
    kinds: dict[str, int]
    n_pairs: int
    n_both: int
    cdc: float | None
    r_lambda: float | None


def follow(before: pd.DataFrame, after: pd.DataFrame) -> tuple[list[ObjectChange], list[int]]:
    """Fate of each real object of some pairs, and the pairs whose real objects differ.

    Real objects differ if their number, their points or their centroids do.

    Parameters
    ----------
    before, after : the real objects of both runs in the order of pairs and ids (`objects.object_parts`)
    """
    differing = _differing_pairs(before, after)
    before, after = (objects[~objects["pair"].isin(differing)] for objects in (before, after))
    was_matched, is_matched = ((objects["partner"] >= 0).to_numpy() for objects in (before, after))
    scores = {name: (before[name].to_numpy(), after[name].to_numpy()) for name in SHARED_SCORES}
    columns = {name: before[name].to_numpy() for name in ("pair_id", "label", "shape", "range_m", "n_points")}
    columns["real_id"] = before["community_id"].to_numpy()
    columns["kind"] = kinds_of_change(was_matched, is_matched, scores["cdc"], scores["r_lambda"])
    for i, (when, objects) in enumerate((("before", before), ("after", after))):
        columns |= {f"{name}_{when}": scores[name][i] for name in SHARED_SCORES}
        columns[f"sim_{when}"] = objects["partner"].astype("Int32").where(objects["partner"] >= 0).to_numpy()
    return [ObjectChange(**row) for row in plain_rows(pd.DataFrame(columns))], differing


def _differing_pairs(before: pd.DataFrame, after: pd.DataFrame) -> list[int]:
    """The pairs whose real objects differ in number, points or centroids."""
    pairs = [objects["pair"].to_numpy() for objects in (before, after)]
    n_pairs = 1 + max(int(own.max(initial=-1)) for own in pairs)
    n_before, n_after = (np.bincount(own, minlength=n_pairs) for own in pairs)
    differs = n_before != n_after
    rows = [~differs[own] for own in pairs]
    a, b = (
        objects.loc[own, [*_PLACE]].to_numpy(dtype=np.float64)
        for objects, own in zip((before, after), rows, strict=True)
    )
    moved = ((a != b) & ~(np.isnan(a) & np.isnan(b))).any(axis=1)
    differs[pairs[0][rows[0]][moved]] = True
    return [int(pair) for pair in np.flatnonzero(differs)]


def by_class(changes: Sequence[ObjectChange]) -> tuple[GroupChange, ...]:
    """Real objects by class, or by shape where no scan is labelled; the largest group first."""
    is_labelled = any(change.label is not None for change in changes)
    groups = _grouped(changes, lambda one: (one.label or "(no label)") if is_labelled else one.shape)
    return tuple(sorted(groups, key=lambda group: (-group.n, group.name)))


def by_range(changes: Sequence[ObjectChange]) -> tuple[GroupChange, ...]:
    """Real objects by distance from the sensor, near ones first; bands without an object are left out."""
    groups = _grouped(changes, lambda one: BAND_NAMES[np.searchsorted(BAND_EDGES_M, one.range_m, "right") - 1])
    return tuple(sorted(groups, key=lambda group: BAND_NAMES.index(group.name)))


def worst_changes(changes: Sequence[ObjectChange], most: int = 5) -> list[ObjectChange]:
    """The objects to look at first: in turn the one whose score rose most, and the largest that has vanished."""
    worse = sorted((one for one in changes if one.kind == "worse"), key=_by_change)
    vanished = sorted((one for one in changes if one.kind == "vanished"), key=_by_change)
    in_turn = sorted([*enumerate(worse), *enumerate(vanished)], key=lambda placed: placed[0])
    return [change for _, change in in_turn[:most]]


def _by_change(one: ObjectChange) -> tuple[float, int, str, int]:
    return -abs(one.change), -one.n_points, one.pair_id, one.real_id


def _grouped(changes: Sequence[ObjectChange], name_of: Callable[[ObjectChange], str]) -> list[GroupChange]:
    own: dict[str, list[ObjectChange]] = {}
    for change in changes:
        own.setdefault(name_of(change), []).append(change)
    return [_group(name, objects) for name, objects in own.items()]


def _group(name: str, objects: Sequence[ObjectChange]) -> GroupChange:
    count = Counter(change.kind for change in objects)
    steps = {score: [step for one in objects if (step := one.step(score)) is not None] for score in SHARED_SCORES}
    return GroupChange(
        name=name,
        n=len(objects),
        kinds={kind: count[kind] for kind in KINDS},
        n_pairs=len({change.pair_id for change in objects}),
        n_both=sum(one.sim_before is not None and one.sim_after is not None for one in objects),
        **{score: float(np.mean(own)) if own else None for score, own in steps.items()},
    )
