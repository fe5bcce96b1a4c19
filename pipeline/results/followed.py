"""Real objects followed from one run to another: the fate of each.

The real side's objects are the same where scan and settings are; that is checked by content.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...schemas.columns import Row
from ...schemas.metric_catalogue import QUADRANT_SCORES
from .object_frame import SHAPES, plain_rows, shape_of

#: A score of an object has changed if it moved by more than this.
LEAST_CHANGE = 0.05
KINDS = ("vanished", "worse", "mixed", "alike", "better", "appeared", "not found in both")
#: Columns of a real object that are the same in both runs.
_OF_BOTH = ("cx", "cy", "cz", *SHAPES, "label", "range_m")
#: Columns of the frame of objects that `follow` reads.
FOLLOWED_COLUMNS = (*_OF_BOTH, *QUADRANT_SCORES)
#: Columns of the frame that it returns. Scores and simulated objects (`sim_before`, `sim_after`) are null if it is
#: not found; an object without a label is called by its shape.
CHANGE_COLUMNS = (
    *("pair_id", "real_id", "label", "shape", "range_m", "n_points", "kind"),
    *(f"{name}_{when}" for name in (*QUADRANT_SCORES, "sim") for when in ("before", "after")),
)


def follow(before: pd.DataFrame, after: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """Fate of each real object of some pairs (`CHANGE_COLUMNS`), and the pairs whose real objects differ.

    Real objects differ if their number, points, centroids, classes or shapes do.

    Parameters
    ----------
    before, after : the real objects of both runs in the order of pairs and ids (`object_frame.object_frame`)
    """
    keys = ["pair", "pair_id", "community_id", "n_points", *_OF_BOTH]
    both = before.merge(after, "outer", keys, suffixes=("_before", "_after"), indicator="runs")
    unfollowed = both.loc[both["runs"] != "both", "pair_id"].unique().tolist()
    both = both[~both["pair_id"].isin(unfollowed)]
    shapes = shape_of(*both[[*SHAPES]].to_numpy().T)
    kinds = kinds_of_change(both)
    changes = both.assign(real_id=both["community_id"], shape=shapes, kind=kinds)
    for when in ("before", "after"):
        partner = both[f"partner_{when}"]
        changes[f"sim_{when}"] = partner.where(partner >= 0).astype("Int32")
    return changes[[*CHANGE_COLUMNS]], unfollowed


def kinds_of_change(objects: pd.DataFrame) -> NDArray[np.str_]:
    """Kind of change of each real object, of `KINDS`.

    `appeared`: not found before, matched now; `vanished`: the reverse. Of an object matched in both: `better` if CDC or
    r_lambda fell by more than 0.05 and neither rose by so much, `worse` the reverse, `mixed` if one fell and the other
    rose, else `alike`. A score that is null in either run is ignored.

    Parameters
    ----------
    objects : with the scores before and after, and `partner_before` and `partner_after`, -1 if it is not matched
    """
    change = _steps(objects).fillna(0.0)
    fell = (change < -LEAST_CHANGE).any(axis=1)
    rose = (change > LEAST_CHANGE).any(axis=1)
    before = objects["partner_before"] >= 0
    after = objects["partner_after"] >= 0
    conditions = [~before & ~after, before & ~after, ~before & after, fell & rose, fell, rose]
    kinds = ["not found in both", "vanished", "appeared", "mixed", "better", "worse"]
    return np.select(conditions, kinds, "alike")


def _steps(objects: pd.DataFrame) -> pd.DataFrame:
    """Change of each score of each object; NaN if a run lacks it."""
    steps = {
        name: objects[f"{name}_after"] - objects[f"{name}_before"] for name in QUADRANT_SCORES
    }
    return pd.DataFrame(steps, dtype=np.float64)


def worst_changes(objects: pd.DataFrame, most: int = 5) -> list[Row]:
    """The objects to look at first: in turn the one whose score rose most, and the largest that has vanished."""
    worst = objects[objects["kind"].isin(["worse", "vanished"])]
    size = _steps(worst).abs().fillna(0.0).max(axis=1)
    worst = worst.assign(size=-size, points=-worst["n_points"])
    worst = worst.sort_values(["size", "points", "pair_id", "real_id"])
    worst = worst.assign(turn=worst.groupby("kind").cumcount())
    worst = worst.sort_values(["turn", "kind"], ascending=[True, False])
    return plain_rows(worst[[*CHANGE_COLUMNS]].head(most))
