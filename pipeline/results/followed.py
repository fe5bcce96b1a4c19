"""Real objects followed from one run to another: the fate of each, and of all objects of a class or a band of range.

The real side's objects are the same where scan and settings are; that is checked by content.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from ...stages.arrays import IndexArray
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
    both = before.merge(after, how="outer", on=["pair", "community_id"], suffixes=("_before", "_after"))
    places = [both[[f"{name}_{when}" for name in _PLACE]].to_numpy(dtype=np.float64) for when in ("before", "after")]
    is_other = ~((places[0] == places[1]) | np.isnan(places).all(axis=0)).all(axis=1)
    differing = np.unique(both.loc[is_other, "pair"]).tolist()
    both = both[~both["pair"].isin(differing)]
    was_matched, is_matched = ((both[f"partner_{when}"] >= 0).to_numpy() for when in ("before", "after"))
    cdc, r_lambda = ((both[f"{name}_before"].to_numpy(), both[f"{name}_after"].to_numpy()) for name in SHARED_SCORES)
    columns: dict[str, Any] = {name: both[f"{name}_before"] for name in ("pair_id", "label", "shape", "range_m")}
    columns |= {"real_id": both["community_id"], "n_points": both["n_points_before"].astype(int)}
    columns |= {"kind": kinds_of_change(was_matched, is_matched, cdc, r_lambda)}
    for when in ("before", "after"):
        columns |= {f"{name}_{when}": both[f"{name}_{when}"] for name in SHARED_SCORES}
        columns[f"sim_{when}"] = both[f"partner_{when}"].where(both[f"partner_{when}"] >= 0).astype("Int32")
    return [ObjectChange(**row) for row in plain_rows(pd.DataFrame(columns))], differing


def by_class(changes: Sequence[ObjectChange]) -> tuple[GroupChange, ...]:
    """Real objects by class, or by shape where no scan is labelled; the largest group first."""
    is_labelled = any(change.label is not None for change in changes)
    groups = _grouped(changes, [one.label or "(no label)" if is_labelled else one.shape for one in changes])
    return tuple(sorted(groups, key=lambda group: (-group.n, group.name)))


def by_range(changes: Sequence[ObjectChange]) -> tuple[GroupChange, ...]:
    """Real objects by distance from the sensor, near ones first; bands without an object are left out."""
    bands: IndexArray = np.searchsorted(BAND_EDGES_M, [one.range_m for one in changes], "right") - 1
    return tuple(replace(group, name=BAND_NAMES[int(group.name)]) for group in _grouped(changes, bands))


def worst_changes(changes: Sequence[ObjectChange], most: int = 5) -> list[ObjectChange]:
    """The objects to look at first: in turn the one whose score rose most, and the largest that has vanished."""
    worse = sorted((one for one in changes if one.kind == "worse"), key=_by_change)
    vanished = sorted((one for one in changes if one.kind == "vanished"), key=_by_change)
    in_turn = sorted([*enumerate(worse), *enumerate(vanished)], key=lambda placed: placed[0])
    return [change for _, change in in_turn[:most]]


def _by_change(one: ObjectChange) -> tuple[float, int, str, int]:
    return -abs(one.change), -one.n_points, one.pair_id, one.real_id


def _grouped(changes: Sequence[ObjectChange], names: Sequence[str] | IndexArray) -> list[GroupChange]:
    if not changes:
        return []
    groups = []
    for name, own in pd.DataFrame(map(vars, changes)).groupby(np.asarray(names)):
        count = Counter(own["kind"])
        steps = {s: (own[f"{s}_after"] - own[f"{s}_before"]).dropna().to_numpy(dtype=np.float64) for s in SHARED_SCORES}
        groups.append(
            GroupChange(
                name=str(name),
                n=len(own),
                kinds={kind: count[kind] for kind in KINDS},
                n_pairs=own["pair_id"].nunique(),
                n_both=int(own[["sim_before", "sim_after"]].notna().all(axis=1).sum()),
                **{score: float(step.mean()) if len(step) else None for score, step in steps.items()},
            )
        )
    return groups
