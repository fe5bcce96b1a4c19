"""Real objects followed from one run to another: the fate of each, and of all objects of a class or a band of range.

The real side's objects are the same where scan and settings are; that is checked by content.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import Row
from ...schemas.metric_catalogue import QUADRANT_SCORES
from ...stages.statistics.comparison import KINDS, kinds_of_change
from ...stages.statistics.findings import BAND_EDGES_M, BAND_NAMES
from .object_frame import plain_rows

_PLACE = ("n_points", "cx", "cy", "cz")
#: Columns of the frame of objects that `follow` reads.
FOLLOWED_COLUMNS = (*_PLACE[1:], *QUADRANT_SCORES, "label", "shape", "range_m")
#: Columns of the frame that it returns. Scores and simulated objects (`sim_before`, `sim_after`) are null if it is
#: missing; an object without a label is called by its shape.
CHANGE_COLUMNS = (
    *("pair_id", "real_id", "label", "shape", "range_m", "n_points", "kind"),
    *(f"{name}_{when}" for name in (*QUADRANT_SCORES, "sim") for when in ("before", "after")),
)


def follow(before: pd.DataFrame, after: pd.DataFrame) -> tuple[pd.DataFrame, list[int]]:
    """Fate of each real object of some pairs (`CHANGE_COLUMNS`), and the pairs whose real objects differ.

    Real objects differ if their number, their points or their centroids do.

    Parameters
    ----------
    before, after : the real objects of both runs in the order of pairs and ids (`objects.object_parts`)
    """
    both = before.merge(after, how="outer", on=["pair", "community_id"], suffixes=("_before", "_after"))
    before_at = both[[f"{name}_before" for name in _PLACE]].to_numpy(dtype=np.float64)
    after_at = both[[f"{name}_after" for name in _PLACE]].to_numpy(dtype=np.float64)
    is_alike = (before_at == after_at) | (np.isnan(before_at) & np.isnan(after_at))
    is_other = ~is_alike.all(axis=1)
    differing = np.unique(both.loc[is_other, "pair"]).tolist()
    both = both[~both["pair"].isin(differing)]
    was_matched = (both["partner_before"] >= 0).to_numpy()
    is_matched = (both["partner_after"] >= 0).to_numpy()
    cdc = both["cdc_before"].to_numpy(), both["cdc_after"].to_numpy()
    r_lambda = both["r_lambda_before"].to_numpy(), both["r_lambda_after"].to_numpy()
    columns: dict[str, Any] = {name: both[f"{name}_before"] for name in ("pair_id", "label", "shape", "range_m")}
    columns |= {"real_id": both["community_id"], "n_points": both["n_points_before"].astype(int)}
    columns |= {"kind": kinds_of_change(was_matched, is_matched, cdc, r_lambda)}
    for when in ("before", "after"):
        columns |= {f"{name}_{when}": both[f"{name}_{when}"] for name in QUADRANT_SCORES}
        columns[f"sim_{when}"] = both[f"partner_{when}"].where(both[f"partner_{when}"] >= 0).astype("Int32")
    return pd.DataFrame(columns)[[*CHANGE_COLUMNS]], differing


def by_class(objects: pd.DataFrame) -> list[Row]:
    """Fates of the real objects by class, or by shape where no scan is labelled, counted; the largest group first.

    A description without a test of significance. Each row has `name`, `n` (objects), `kinds` (of these, how many have
    become what), `n_pairs` (pairs that have such objects), `n_both` (objects that both runs have matched), and the mean
    change of each score over those of them that have it in both runs; None if no object has it.
    """
    is_labelled = objects["label"].notna().any()
    names = objects["label"].fillna("").replace("", "(no label)") if is_labelled else objects["shape"]
    return sorted(_grouped(objects, names), key=lambda group: (-group["n"], group["name"]))


def by_range(objects: pd.DataFrame) -> list[Row]:
    """The same by distance from the sensor, near objects first; bands without an object are left out."""
    bands = np.searchsorted(BAND_EDGES_M, objects["range_m"].to_numpy(dtype=np.float64), "right") - 1
    return [group | {"name": BAND_NAMES[group["name"]]} for group in _grouped(objects, bands)]


def by_change(objects: pd.DataFrame) -> pd.DataFrame:
    """The objects in the order of the largest rise of a score, or fall where none rose; of equal ones the largest."""
    steps = [(objects[f"{s}_after"] - objects[f"{s}_before"]).fillna(0.0).abs() for s in QUADRANT_SCORES]
    keys = {"size": -pd.concat(steps, axis=1).max(axis=1), "points": -objects["n_points"]}
    return objects.assign(**keys).sort_values([*keys, "pair_id", "real_id"]).drop(columns=[*keys])


def worst_changes(objects: pd.DataFrame, most: int = 5) -> list[Row]:
    """The objects to look at first: in turn the one whose score rose most, and the largest that has vanished."""
    worst = by_change(objects[objects["kind"].isin(["worse", "vanished"])])
    in_turn = worst.assign(turn=worst.groupby("kind").cumcount()).sort_values(["turn", "kind"], ascending=[True, False])
    return plain_rows(in_turn.drop(columns="turn").head(most))


def _grouped(objects: pd.DataFrame, names: Any) -> Iterator[Row]:
    for name, own in objects.groupby(names):
        steps = {
            s: (own[f"{s}_after"] - own[f"{s}_before"]).dropna().to_numpy(dtype=np.float64) for s in QUADRANT_SCORES
        }
        yield {
            "name": name,
            "n": len(own),
            "kinds": own["kind"].value_counts().reindex(KINDS, fill_value=0).to_dict(),
            "n_pairs": own["pair_id"].nunique(),
            "n_both": int(own[["sim_before", "sim_after"]].notna().all(axis=1).sum()),
            **{score: float(step.mean()) if len(step) else None for score, step in steps.items()},
        }
