"""Choice of the objects to alter in a scan: by label, by number or by shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ...schemas.errors import DatasetError
from ...stages.statistics.typical_objects import (
    SHAPES,
    ChosenObject,
    ScanObjects,
    typical_of_class,
    typical_of_shapes,
)
from ..engine.worker import PairTables
from ..jobs.points_job import column

#: The classes of the paper, section "Controlled Perturbation Analysis".
CLASSES = ("vegetation", "car", "tree", "wall")
#: An object of at most k + 1 points remains a complete graph under any alteration; a typical one has twice as many.
LEAST_POINTS_OVER_K = 2


def choose_objects(scan: ScanObjects, names: Sequence[str] | None, k: int) -> list[ChosenObject]:
    """One object for each given name; by default for each class of the paper, otherwise for each shape class.

    A number is a community id, a label stands for the typical object of the class. Without objects
    of these classes the default is one object per shape: linear, planar and scattered. No object is
    chosen twice: a name or a shape without a further object is left out.

    Parameters
    ----------
    names : community ids and labels, or None
    k : neighbours of the graph, `graph.k`; a typical object has at least 2 k points

    Raises
    ------
    DatasetError
        A community does not exist, or no object has the label.
    """
    least = LEAST_POINTS_OVER_K * k
    if names is None:
        typical = [typical_of_class(scan, name, least) for name in CLASSES]
        chosen = [candidate for candidate in typical if candidate is not None]
        return chosen or typical_of_shapes(scan, least)
    by_id: dict[int, ChosenObject] = {}
    for name in names:
        candidate = _by_name(scan, name, least)
        by_id.setdefault(candidate.community_id, candidate)
    return list(by_id.values())


def objects_in(tables: PairTables, scan_id: str) -> ScanObjects:
    """The objects of the real side of a pair.

    Parameters
    ----------
    tables : among them ground, communities and objects
    """
    ground = tables["ground", "real"]
    objects = tables["objects", "real"]
    community = column(tables["communities", "real"], "community_id")
    n_points = column(objects, "n_points")
    labels = objects.column("label").to_pylist()
    point_labels = ground.filter(pc.invert(ground.column("is_ground"))).column("label")
    label_of_object = pa.array([labels[number] for number in community.tolist()], pa.string())
    has_label = pc.fill_null(pc.equal(point_labels, label_of_object), False)
    labelled = community[has_label.to_numpy(zero_copy_only=False)]
    return ScanObjects(
        pair_id=scan_id,
        n_points=n_points,
        range_m=column(objects, "range_m"),
        labels=labels,
        label_share=np.bincount(labelled, minlength=len(n_points)) / n_points,
        shape=np.column_stack([column(objects, feature) for feature in SHAPES]),
    )


def _by_name(scan: ScanObjects, name: str, least: int) -> ChosenObject:
    if name.isdigit() and int(name) < len(scan.n_points):
        return scan.chosen(int(name), f"object {name}", "as requested")
    chosen = typical_of_class(scan, name, least)
    if chosen is None:
        labels = {label for label in scan.labels if label}
        raise DatasetError(
            f"--objects {name}: expected an id of scan {scan.pair_id} from 0 to "
            f"{len(scan.n_points) - 1}, or one of its labels: {', '.join(sorted(labels)) or 'none'}"
        )
    return chosen
