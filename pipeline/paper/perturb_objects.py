"""Choice of the objects to alter in a scan: by label, by number or by shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import Row
from ...schemas.errors import DatasetError
from ..engine.worker import PairTables
from ..jobs.points_job import column
from ..results.object_frame import SHAPES

#: The classes of the paper, section "Controlled Perturbation Analysis".
CLASSES = ("vegetation", "car", "tree", "wall")
#: An object of at most k + 1 points remains a complete graph under any alteration; a typical one has twice as many.
LEAST_POINTS_OVER_K = 2
PURE_SHARE = 0.75


def choose_objects(
    objects: pd.DataFrame, pair_id: str, names: Sequence[str] | None, k: int
) -> list[Row]:
    """One object for each given name; by default for each class of the paper, otherwise for each shape class.

    A number is a community id, a label stands for the typical object of the class. Without objects
    of these classes the default is one object per shape: linear, planar and scattered. No object is
    chosen twice: a name or a shape without a further object is left out. A row has the object's
    name (class, shape or "object 7"), scan and id, n_points and range_m.

    Parameters
    ----------
    objects : from `objects_in`
    names : community ids and labels, or None
    k : neighbours of the graph, `graph.k`; a typical object has at least 2 k points

    Raises
    ------
    DatasetError
        A community does not exist, or no object has the label.
    """
    least = LEAST_POINTS_OVER_K * k
    labels = set(objects["label"].dropna())
    chosen: dict[int, str] = {}
    for name in names or CLASSES:
        if names and name.isdigit() and int(name) < len(objects):
            chosen.setdefault(int(name), f"object {name}")
        elif name in labels:
            typical = _typical_of_class(objects[objects["label"] == name], least)
            chosen.setdefault(typical, name)
        elif names:
            raise DatasetError(
                f"--objects {name}: expected an id of scan {pair_id} from 0 to "
                f"{len(objects) - 1}, or one of its labels: {', '.join(sorted(labels)) or 'none'}"
            )
    chosen = chosen or _typical_of_shapes(objects, least)
    table = objects.loc[[*chosen], ["n_points", "range_m"]]
    table = table.assign(pair_id=pair_id, community_id=[*chosen], name=[*chosen.values()])
    rows: Any = table.to_dict("records")
    return list(rows)


def objects_in(tables: PairTables) -> pd.DataFrame:
    """The objects of the real side of a pair by id: n_points, range_m, label, `SHAPES`, and `label_share`.

    `label_share` is the share of the points of an object that have its label.

    Parameters
    ----------
    tables : among them ground, communities and objects
    """
    ground = tables["ground", "real"].select(["is_ground", "label"]).to_pandas()
    objects: pd.DataFrame = tables["objects", "real"].to_pandas()
    community = column(tables["communities", "real"], "community_id")
    labels = objects["label"].to_numpy()[community]
    has_label = (ground.loc[~ground["is_ground"], "label"] == labels) & pd.notna(labels)
    labelled = community[has_label.to_numpy()]
    n_labelled = np.bincount(labelled, minlength=len(objects))
    return objects.assign(label_share=n_labelled / objects["n_points"])


def _typical_of_class(objects: pd.DataFrame, least: int) -> int:
    """Id of the typical object of a class.

    It is the one of median size among the objects of at least `least` points with three quarters of them of the label;
    without such objects, the largest with that most frequent label.
    """
    typical = objects[(objects["label_share"] >= PURE_SHARE) & (objects["n_points"] >= least)]
    if typical.empty:
        largest: Any = objects["n_points"].idxmax()
        return int(largest)
    return _median_sized(typical)


def _typical_of_shapes(objects: pd.DataFrame, least: int) -> dict[int, str]:
    """One object for each shape, no object twice: id and shape.

    The shape of an object is that of the largest of the three features; among the objects of a shape and at least
    `least` points the one of median size is chosen. Then shapes without an object get the nearest of the others; one
    without a remaining object is left out.
    """
    large = objects[objects["n_points"] >= least]
    free = objects if large.empty else large
    shapes = large[[*SHAPES]].to_numpy().argmax(axis=1)
    chosen: dict[str, int] = {}
    for i, name in enumerate(SHAPES.values()):
        typical = large[shapes == i]
        if len(typical):
            chosen[name] = _median_sized(typical)
    for feature, name in SHAPES.items():
        others = free[feature].drop([*chosen.values()])
        if name not in chosen and len(others):
            largest: Any = others.idxmax()
            chosen[name] = int(largest)
    return {chosen[name]: name for name in SHAPES.values() if name in chosen}


def _median_sized(objects: pd.DataFrame) -> int:
    """Id of the object of median size; for an even number the smaller one."""
    by_size: Any = objects.sort_values("n_points", kind="stable").index
    return int(by_size[(len(by_size) - 1) // 2])
