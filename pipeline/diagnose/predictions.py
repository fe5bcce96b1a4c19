"""A user's model on both sides of a run: agreement by class and by object, and which scores go with a loss.

Predictions are files named after the pairs: `PAIR.label` (a class for each point of the scan file)
or `PAIR.txt` (boxes, as KITTI's label files have them).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.errors import DatasetError
from ...schemas.metric_catalogue import OBJECT_METRICS
from ...schemas.results import JsonObject
from ...stages.arrays import BoolArray, IntArray
from ...stages.predictions import (
    Boxes,
    counterparts,
    inside,
    jackknife_interval,
    lost_auc,
    match_detections,
)
from ..datasets.pairs import read_label_names
from ..results.finished import FinishedRun
from ..results.object_frame import plain_rows
from ..storage.table_files import file_stem

if TYPE_CHECKING:
    import pandas as pd

_SUFFIXES = (".label", ".txt")
_LOST_BELOW = 0.5  #: share of agreeing points below which an object is lost


@dataclass(frozen=True)
class ScoreOfLost:
    """Area under the ROC curve of a score as a classifier of lost objects.

    auc : probability that a lost object has the larger score; None if none or all are lost
    low, high : 95 % interval from leaving out scans; None for fewer than three
    """

    score: str
    auc: float | None
    low: float | None
    high: float | None
    n_lost: int
    n_kept: int


@dataclass(frozen=True)
class Agreement:
    """Predictions of one model on both sides.

    kind : "labels" or "boxes"
    classes : one row per class; boxes: n_real, n_sim, n_found, place_m; labels: n_real, n_sim (points
        on common surface), iou
    objects : one row per real object with a prediction: its scores, what was predicted, `agreement`
        (labels) and `fate`, kept or lost
    scores : of matched objects
    left_out : scored pairs without predictions on both sides
    """

    kind: str
    classes: tuple[Row, ...]
    objects: tuple[Row, ...]
    scores: tuple[ScoreOfLost, ...]
    left_out: tuple[str, ...]

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON."""
        values: JsonObject = asdict(self)
        return values


def compare_predictions(run: FinishedRun, real: Path, sim: Path) -> Agreement:
    """Compare the predictions of a model on the real and on the simulated scans of a run.

    Parameters
    ----------
    real, sim : folders of `PAIR.label` or `PAIR.txt` files; boxes in the real sensor's frame with
        the axes of KITTI's camera. `labels.toml` in the first one names classes

    Raises
    ------
    DatasetError
        No pair has files on both sides, or a file is not what it should be.
    """
    names = [row["pair_id"] for row in run.scored]
    for suffix in _SUFFIXES:
        files = {}
        for name in names:
            both = [folder / f"{file_stem(name)}{suffix}" for folder in (real, sim)]
            if all(path.is_file() for path in both):
                files[name] = both
        if files:
            break
    else:
        raise DatasetError(
            f"{real} and {sim}: no predictions of a scored pair found on both sides; expected files "
            f"such as {names[0] if names else 'PAIR'}.label or .txt"
        )
    left_out = tuple(name for name in names if name not in files)
    if suffix == ".label":
        return _compare_labels(run, files, read_label_names(real), left_out)
    return _compare_boxes(run, files, left_out)


def _compare_labels(
    run: FinishedRun,
    files: Mapping[str, Sequence[Path]],
    label_names: Mapping[int, str],
    left_out: tuple[str, ...],
) -> Agreement:
    both: list[IntArray] = []
    objects: list[Row] = []
    for name, paths in files.items():
        points = {}
        for side, path in zip(SIDES, paths, strict=True):
            frame = run.points(name, side)
            labels = read_point_labels(path, run.row(name)[f"n_{side}_raw"])
            frame["predicted"] = labels[frame["point_id"]]
            points[side] = frame
        xyz = [points[side][["x", "y", "z"]].to_numpy() for side in SIDES]
        nearest = counterparts(*xyz)
        seen = points["real"][nearest >= 0].reset_index(drop=True)
        seen["counterpart"] = points["sim"]["predicted"].to_numpy()[nearest[nearest >= 0]]
        both.append(seen[["predicted", "counterpart"]].to_numpy())
        objects += _object_labels(run, name, seen, label_names)
    pairs_of_labels = np.vstack(both)
    classes: list[Row] = []
    for number in np.unique(pairs_of_labels).tolist():
        is_class = pairs_of_labels == number
        n_common = int(is_class.all(axis=1).sum())
        n_real, n_sim = is_class.sum(axis=0).tolist()
        iou = n_common / (n_real + n_sim - n_common)
        named = label_names.get(number, str(number))
        classes.append({"class": named, "n_real": n_real, "n_sim": n_sim, "iou": iou})
    scores = _scores_of_lost(objects)
    return Agreement("labels", tuple(classes), tuple(objects), scores, left_out)


def _object_labels(run: FinishedRun, name: str, seen: pd.DataFrame, label_names: Mapping[int, str]) -> list[Row]:
    """The real objects of a pair that both sides see, with the class that most points have."""
    rows_of = _real_objects(run, name)
    rows = []
    in_objects = seen.dropna(subset="community_id").astype({"community_id": int})
    for number in sorted(in_objects["community_id"].unique().tolist()):
        points = in_objects[in_objects["community_id"] == number]
        classes = {
            side: int(points[column].mode()[0]) for side, column in (("real", "predicted"), ("sim", "counterpart"))
        }
        agreement = float((points["predicted"] == points["counterpart"]).mean())
        named = {side: label_names.get(value, str(value)) for side, value in classes.items()}
        predicted = {"predicted_real": named["real"], "predicted_sim": named["sim"]}
        fate = "lost" if agreement < _LOST_BELOW else "kept"
        rows.append(rows_of[number] | predicted | {"agreement": agreement, "fate": fate})
    return rows


def _compare_boxes(run: FinishedRun, files: Mapping[str, Sequence[Path]], left_out: tuple[str, ...]) -> Agreement:
    counts: dict[str, Row] = {}
    apart_m: dict[str, list[float]] = {}
    objects: list[Row] = []
    for name, paths in files.items():
        real, sim = map(read_kitti_boxes, paths)
        partner = match_detections(real, sim)
        for boxes, column in ((real, "n_real"), (sim, "n_sim")):
            for kind in boxes.names.tolist():
                row = counts.setdefault(kind, {"n_real": 0, "n_sim": 0, "n_found": 0})
                row[column] += 1
        for i in np.flatnonzero(partner >= 0).tolist():
            kind = str(real.names[i])
            counts[kind]["n_found"] += 1
            offset = real.centre[i] - sim.centre[partner[i]]
            apart_m.setdefault(kind, []).append(float(np.hypot(*offset[:2])))
        objects += _object_boxes(run, name, real, partner >= 0)
    classes: list[Row] = []
    for kind, row in sorted(counts.items()):
        place_m = float(np.median(apart_m[kind])) if kind in apart_m else None
        classes.append({"class": kind} | row | {"place_m": place_m})
    scores = _scores_of_lost(objects)
    return Agreement("boxes", tuple(classes), tuple(objects), scores, left_out)


def _object_boxes(run: FinishedRun, name: str, real: Boxes, is_found: BoolArray) -> list[Row]:
    """The object with the most points inside of each real box."""
    frame = run.points(name, "real").dropna(subset="community_id")
    points = frame[["x", "y", "z"]].to_numpy()
    communities = frame["community_id"].to_numpy(dtype=np.int32)
    rows_of = _real_objects(run, name)
    rows = []
    for i, kind in enumerate(real.names.tolist()):
        n_inside = np.bincount(communities[inside(points, real, i)], minlength=1)
        if n_inside.any():
            fate = "kept" if is_found[i] else "lost"
            rows.append(rows_of[int(n_inside.argmax())] | {"predicted_real": kind, "fate": fate})
    return rows


def _real_objects(run: FinishedRun, name: str) -> dict[int, Row]:
    """Place, size and scores of the real objects of a pair, by number."""
    columns = ["label", "range_m", *OBJECT_METRICS]
    frame = run.objects_of([name], columns)
    frame = frame[frame["side"] == "real"]
    rows = frame[["community_id", "n_points", *columns]]
    return {row["community_id"]: {"pair_id": name} | row for row in plain_rows(rows)}


def _scores_of_lost(objects: Sequence[Row]) -> tuple[ScoreOfLost, ...]:
    """Area under the ROC curve of each score of matched objects, for their loss."""
    scan_of = {name: i for i, name in enumerate(sorted({row["pair_id"] for row in objects}))}
    results = []
    for score in OBJECT_METRICS:
        known = [row for row in objects if row[score] is not None]
        values = np.array([row[score] for row in known], dtype=np.float64)
        is_lost = np.array([row["fate"] == "lost" for row in known], dtype=np.bool_)
        scans = np.array([scan_of[row["pair_id"]] for row in known], dtype=np.intp)
        low, high = jackknife_interval(values, is_lost, scans) or (None, None)
        n_lost = int(is_lost.sum())
        auc = lost_auc(values, is_lost)
        results.append(ScoreOfLost(score, auc, low, high, n_lost, len(known) - n_lost))
    return tuple(results)


def read_point_labels(path: Path, n_points: int) -> IntArray:
    """Classes of the points of a scan file, (n,): the low 16 bits of uint32, as in SemanticKITTI."""
    n_bytes = path.stat().st_size
    if n_bytes != 4 * n_points:
        raise DatasetError(
            f"{path}: expected {4 * n_points} bytes (one uint32 for each of the {n_points} points "
            f"of the scan file), got {n_bytes}"
        )
    return (np.fromfile(path, dtype="<u4") & 0xFFFF).astype(np.int32)


def read_kitti_boxes(path: Path) -> Boxes:
    """Boxes of a label file of KITTI, without those of the type DontCare.

    A line is: type, truncation, occlusion, alpha, four numbers of the image, height, width, length,
    x, y, z of the middle of the floor (camera's axes: right, down, forward), rotation about y, and
    perhaps a score. The camera is taken to be at the sensor, looking along x.
    """
    names: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        words = line.split()
        if not words or words[0] == "DontCare":
            continue
        try:
            h, w, length, x, y, z, turn = map(float, words[8:15])
        except ValueError as error:
            raise DatasetError(
                f"{path}, line {number}: expected a line of a KITTI label file (type and at least "
                f"14 numbers), got {len(words)} words"
            ) from error
        names.append(words[0])
        rows.append([z, -x, h / 2 - y, length, w, h, -turn - np.pi / 2])
    values = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return Boxes(np.array(names, dtype=np.str_), values[:, :3], values[:, 3:6], values[:, 6])
