"""Which objects of a scan are altered: one for each kind, by label, by the user's word, or by shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ....schemas.errors import DatasetError
from ....stages.arrays import FloatArray, IntArray
from ...jobs.points import column
from ...storage.folder import RunFolder

#: The classes of the paper, section "Controlled Perturbation Analysis".
CLASSES = ("vegetation", "car", "tree", "wall")
_TABLES = ("objects", "ground", "communities")
SHAPES = ("linearity", "planarity", "scattering")
SHAPE_NAMES = {"linearity": "linear", "planarity": "planar", "scattering": "scattered"}
PURE_SHARE = 0.75
#: An object of at most k + 1 points is a complete graph, whatever is done to it; a typical one has twice as many.
LEAST_POINTS_OVER_K = 2


@dataclass(frozen=True)
class ChosenObject:
    """An object that is altered.

    name : its class, or "object 7"
    n_points, range_m : its size and distance
    why : how it was chosen, in words
    """

    pair_id: str
    community_id: int
    name: str
    n_points: int
    range_m: float
    why: str


@dataclass(frozen=True)
class Choice:
    """The chosen objects of a scan, and what a user should know about the choice."""

    objects: tuple[ChosenObject, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _ScanObjects:
    """The objects of a scan: size, distance, label with its share of the points, and shape, by community id."""

    pair_id: str
    n_points: IntArray
    range_m: FloatArray
    labels: list[str | None]
    label_share: FloatArray
    shape: FloatArray

    def chosen(self, community_id: int, name: str, why: str) -> ChosenObject:
        """The object of this id as a choice."""
        size, range_m = int(self.n_points[community_id]), float(self.range_m[community_id])
        return ChosenObject(self.pair_id, community_id, name, size, range_m, why)


def choose_objects(folder: RunFolder, scan_id: str, wanted: Sequence[str] | None, k: int) -> Choice:
    """One object for each word that is wanted; by default for each class of the paper, or else for each shape class.

    A number is a community id. A label stands for the typical object of the class: of the communities of which at
    least three quarters are of that label and that have at least 2 k points, the one of median size (of an even
    number the lower); where there is none, the largest whose most frequent label it is. Without labels the same is
    done for the linear, planar and scattered objects (the largest of the three shape features tells which); where
    there is none of a kind, the one that comes nearest of those that stand for no other. No object is chosen twice:
    a word or a shape that leaves nothing new is left out, with a note.

    Parameters
    ----------
    folder, scan_id : of the experiment, and a scan whose communities are done
    wanted : community ids and labels, or None
    k : neighbours of the graph, `graph.k`

    Raises
    ------
    DatasetError
        There is no such community, or no object with such a label.
    """
    scan = _describe(folder, scan_id)
    least = LEAST_POINTS_OVER_K * k
    if wanted is not None:
        return _by_words(scan, wanted, least)
    objects = [chosen for name in CLASSES if (chosen := _by_label(scan, name, least)) is not None]
    if objects:
        absent = [name for name in CLASSES if name not in {chosen.name for chosen in objects}]
        notes = (f"scan {scan.pair_id} has no object labelled {' or '.join(absent)}",) if absent else ()
        return Choice(tuple(objects), notes)
    why = "has no labels" if not any(scan.labels) else f"has no object labelled {', '.join(CLASSES)}"
    return _by_shapes(scan, least, f"scan {scan.pair_id} {why}: one typical object for each shape instead")


def _describe(folder: RunFolder, scan_id: str) -> _ScanObjects:
    objects, ground, communities = (folder.read_table(name, scan_id, "real") for name in _TABLES)
    labels = objects.column("label").to_pylist()
    point_labels = ground.filter(pc.invert(ground.column("is_ground"))).column("label")
    community, n_points = column(communities, "community_id"), column(objects, "n_points")
    own = pc.equal(point_labels, pa.array([labels[i] for i in community.tolist()], pa.string()))
    n_own = np.bincount(community[pc.fill_null(own, False).to_numpy(zero_copy_only=False)], minlength=len(n_points))
    return _ScanObjects(
        pair_id=scan_id,
        n_points=n_points,
        range_m=column(objects, "range_m"),
        labels=labels,
        label_share=n_own / n_points,
        shape=np.column_stack([column(objects, name) for name in SHAPES]),
    )


def _by_words(scan: _ScanObjects, words: Sequence[str], least: int) -> Choice:
    chosen: dict[int, ChosenObject] = {}
    notes = []
    for word in words:
        candidate = _by_word(scan, word, least)
        first = chosen.setdefault(candidate.community_id, candidate)
        if first is not candidate:
            notes.append(
                f"--objects {word}: in scan {scan.pair_id} that is object {candidate.community_id}, "
                f"which is chosen as {first.name} already; left out"
            )
    return Choice(tuple(chosen.values()), tuple(notes))


def _by_word(scan: _ScanObjects, word: str, least: int) -> ChosenObject:
    if word.isdigit():
        if int(word) >= len(scan.n_points):
            raise DatasetError(
                f"--objects {word}: scan {scan.pair_id} has no such object; ids are 0 to {len(scan.n_points) - 1}"
            )
        return scan.chosen(int(word), f"object {word}", "as asked for")
    chosen = _by_label(scan, word, least)
    if chosen is None:
        known = ", ".join(sorted({label for label in scan.labels if label})) or "none: it has no labels"
        raise DatasetError(f"--objects {word}: scan {scan.pair_id} has no object labelled so; its labels are {known}")
    return chosen


def _by_label(scan: _ScanObjects, name: str, least: int) -> ChosenObject | None:
    is_of_class = np.array([label == name for label in scan.labels])
    if not is_of_class.any():
        return None
    typical = np.flatnonzero(is_of_class & (scan.label_share >= PURE_SHARE) & (scan.n_points >= least))
    if len(typical):
        why = f"median size of {len(typical)} with {least} points and {PURE_SHARE:.0%} of the label or more"
        return scan.chosen(_median_sized(scan, typical), name, why)
    largest = int(np.flatnonzero(is_of_class)[np.argmax(scan.n_points[is_of_class])])
    why = f"the largest; none has {least} points and {PURE_SHARE:.0%} of the label"
    return scan.chosen(largest, name, why)


def _by_shapes(scan: _ScanObjects, least: int, note: str) -> Choice:
    """An object for each shape; first those that are of a shape, then the nearest of the others."""
    is_large = scan.n_points >= least
    is_free = is_large.copy() if is_large.any() else np.ones(len(scan.n_points), dtype=bool)
    chosen: dict[str, ChosenObject] = {}
    for place, shape in enumerate(SHAPES):
        name = SHAPE_NAMES[shape]
        typical = np.flatnonzero((np.argmax(scan.shape, axis=1) == place) & is_large)
        if len(typical):
            why = f"median size of {len(typical)} {name} objects"
            chosen[name] = scan.chosen(_median_sized(scan, typical), name, why)
            is_free[chosen[name].community_id] = False
    for place, shape in enumerate(SHAPES):
        name = SHAPE_NAMES[shape]
        if name not in chosen and is_free.any():
            nearest = int(np.argmax(np.where(is_free, scan.shape[:, place], -np.inf)))
            value = scan.shape[nearest, place]
            rest = "" if is_free.sum() == (is_large.sum() or len(is_large)) else " of the others"
            why = f"none is mostly {name}; this one has the largest {shape}{rest}, {value:.2f}"
            chosen[name] = scan.chosen(nearest, name, why)
            is_free[nearest] = False
    names = [SHAPE_NAMES[shape] for shape in SHAPES]
    absent = [name for name in names if name not in chosen]
    notes = [f"scan {scan.pair_id} has no further object that could stand for {' or '.join(absent)}"] if absent else []
    return Choice(tuple(chosen[name] for name in names if name in chosen), (note, *notes))


def _median_sized(scan: _ScanObjects, candidates: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> int:
    by_size = candidates[np.lexsort((candidates, scan.n_points[candidates]))]
    return int(by_size[(len(by_size) - 1) // 2])
