"""Which objects of a scan are altered: one for each kind, by label, by the user's word, or by shape."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ...schemas.errors import DatasetError
from ...stages.statistics.typical_objects import SHAPES, ChosenObject, ScanObjects, typical_of_class, typical_of_shapes
from ..jobs.points import column
from ..storage.folder import RunFolder

#: The classes of the paper, section "Controlled Perturbation Analysis".
CLASSES = ("vegetation", "car", "tree", "wall")
#: An object of at most k + 1 points is a complete graph, whatever is done to it; a typical one has twice as many.
LEAST_POINTS_OVER_K = 2


def choose_objects(
    scan: ScanObjects, wanted: Sequence[str] | None, k: int, say: Callable[[str], None]
) -> list[ChosenObject]:
    """One object for each word that is wanted; by default for each class of the paper, or else for each shape class.

    A number is a community id, a label stands for the typical object of the class. Without objects of these classes one
    is taken for each shape: linear, planar and scattered. No object is chosen twice: a word or a shape that leaves
    nothing new is left out.

    Parameters
    ----------
    wanted : community ids and labels, or None
    k : neighbours of the graph, `graph.k`; a typical object has at least 2 k points
    say : told what a user should know about the choice

    Raises
    ------
    DatasetError
        There is no such community, or no object with such a label.
    """
    least = LEAST_POINTS_OVER_K * k
    if wanted is not None:
        return _by_words(scan, wanted, least, say)
    objects = [chosen for name in CLASSES if (chosen := typical_of_class(scan, name, least)) is not None]
    if objects:
        absent = " or ".join(name for name in CLASSES if name not in {chosen.name for chosen in objects})
        if absent:
            say(f"scan {scan.pair_id} has no object labelled {absent}")
        return objects
    why = f"has no object labelled {', '.join(CLASSES)}" if any(scan.labels) else "has no labels"
    say(f"scan {scan.pair_id} {why}: one typical object for each shape instead")
    objects = typical_of_shapes(scan, least)
    absent = " or ".join(name for name in SHAPES.values() if name not in {chosen.name for chosen in objects})
    if absent:
        say(f"scan {scan.pair_id} has no further object that could stand for {absent}")
    return objects


def read_objects(folder: RunFolder, scan_id: str) -> ScanObjects:
    """The objects of a scan whose communities are done."""
    tables = ("objects", "ground", "communities")
    objects, ground, communities = (folder.read_table(name, scan_id, "real") for name in tables)
    labels = objects.column("label").to_pylist()
    point_labels = ground.filter(pc.invert(ground.column("is_ground"))).column("label")
    community, n_points = column(communities, "community_id"), column(objects, "n_points")
    own = pc.equal(point_labels, pa.array([labels[i] for i in community.tolist()], pa.string()))
    n_own = np.bincount(community[pc.fill_null(own, False).to_numpy(zero_copy_only=False)], minlength=len(n_points))
    return ScanObjects(
        pair_id=scan_id,
        n_points=n_points,
        range_m=column(objects, "range_m"),
        labels=labels,
        label_share=n_own / n_points,
        shape=np.column_stack([column(objects, feature) for feature in SHAPES]),
    )


def _by_words(scan: ScanObjects, words: Sequence[str], least: int, say: Callable[[str], None]) -> list[ChosenObject]:
    chosen: dict[int, ChosenObject] = {}
    for word in words:
        candidate = _by_word(scan, word, least)
        first = chosen.setdefault(candidate.community_id, candidate)
        if first is not candidate:
            say(
                f"--objects {word}: in scan {scan.pair_id} that is object {candidate.community_id}, "
                f"which is chosen as {first.name} already; left out"
            )
    return list(chosen.values())


def _by_word(scan: ScanObjects, word: str, least: int) -> ChosenObject:
    if word.isdigit():
        if int(word) >= len(scan.n_points):
            raise DatasetError(
                f"--objects {word}: scan {scan.pair_id} has no such object; ids are 0 to {len(scan.n_points) - 1}"
            )
        return scan.chosen(int(word), f"object {word}", "as asked for")
    chosen = typical_of_class(scan, word, least)
    if chosen is None:
        known = ", ".join(sorted({label for label in scan.labels if label})) or "none: it has no labels"
        raise DatasetError(f"--objects {word}: scan {scan.pair_id} has no object labelled so; its labels are {known}")
    return chosen
