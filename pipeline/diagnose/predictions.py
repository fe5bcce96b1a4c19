"""A user's model on both sides of a run: agreement by class and by object, and which scores go with a loss.

Predictions are files named after the pairs: `PAIR.label` (a class for each point of the scan file),
`PAIR.txt` (boxes, as KITTI's label files have them) or `PAIR.json` (boxes, as in nuScenes' results).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...schemas.columns import Row
from ...schemas.errors import DatasetError
from ...schemas.metric_catalogue import OBJECT_METRICS
from ...stages.arrays import BoolArray
from ...stages.predictions import (
    Boxes,
    inside,
    jackknife_interval,
    lost_auc,
    match_detections,
)
from ...stages.tasks import counterparts
from ..datasets.pairs import read_label_names
from ..datasets.readers.scan import read_label_file
from ..results.finished import FinishedRun
from ..results.object_frame import plain_rows
from ..storage.table_files import file_stem

if TYPE_CHECKING:
    import pandas as pd

_XYZ = ["x", "y", "z"]
_LOST_BELOW = 0.5  #: share of agreeing points below which an object is lost


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
    return _boxes(names, rows)


def read_nuscenes_boxes(path: Path) -> Boxes:
    """Boxes of one sample as in the results of nuScenes: a list, or the one list in `results`.

    A box has detection_name, translation (x, y, z of its centre), size (width, length, height) and
    rotation (quaternion w, x, y, z), in the axes of the real sensor.
    """
    names: list[str] = []
    rows: list[list[float]] = []
    try:
        boxes = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(boxes, dict):
            (boxes,) = boxes["results"].values()
        for box in boxes:
            width, length, height = map(float, box["size"])
            w, x, y, z = map(float, box["rotation"])
            yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            names.append(box["detection_name"])
            rows.append([*map(float, box["translation"]), length, width, height, yaw])
        return _boxes(names, rows)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DatasetError(
            f"{path}: expected boxes of one sample as in the results of nuScenes (detection_name, "
            f"translation, size, rotation), got {type(error).__name__}: {error}"
        ) from error


def _boxes(names: list[str], rows: list[list[float]]) -> Boxes:
    """Boxes of rows x, y, z, length, width, height, yaw."""
    values = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return Boxes(np.array(names, dtype=np.str_), values[:, :3], values[:, 3:6], values[:, 6])


_BOX_READERS = {".txt": read_kitti_boxes, ".json": read_nuscenes_boxes}


@dataclass(frozen=True)
class Agreement:
    """Predictions of one model on both sides.

    kind : "labels" or "boxes"
    classes : one row per class; boxes: n_real, n_sim, n_found, place_m; labels: n_real, n_sim (points
        on common surface), iou
    objects : one row per real object with a prediction: its scores, what was predicted, `agreement`
        (labels) and `fate`, kept or lost
    scores : one row per score of matched objects, as a classifier of lost ones: `auc`, the probability
        that a lost object has the larger score (None if none or all are lost); `low` and `high`, its
        95 % interval from leaving out scans (None for fewer than three); n_lost, n_kept
    left_out : scored pairs without predictions on both sides
    """

    kind: str
    classes: tuple[Row, ...]
    objects: tuple[Row, ...]
    scores: tuple[Row, ...]
    left_out: tuple[str, ...]


def compare_predictions(run: FinishedRun, real: Path, sim: Path) -> Agreement:
    """Compare the predictions of a model on the real and on the simulated scans of a run.

    Parameters
    ----------
    real, sim : folders of files named after the pairs, `.label`, `.txt` or `.json`. `labels.toml`
        in the first one names classes

    Raises
    ------
    DatasetError
        No pair has files on both sides, or a file is not what it should be.
    """
    suffix, files = _files(run, real, sim)
    left_out = tuple(row["pair_id"] for row in run.scored if row["pair_id"] not in files)
    if suffix == ".label":
        kind = "labels"
        classes, objects = _compare_labels(run, files, read_label_names(real))
    else:
        kind = "boxes"
        classes, objects = _compare_boxes(run, files, _BOX_READERS[suffix])
    return Agreement(
        kind,
        classes=tuple(plain_rows(classes)),
        objects=tuple(plain_rows(objects)),
        scores=_scores_of_lost(objects),
        left_out=left_out,
    )


def _files(run: FinishedRun, real: Path, sim: Path) -> tuple[str, dict[str, tuple[Path, Path]]]:
    """The suffix of the predictions, and the files of both sides by pair."""
    for suffix in (".label", *_BOX_READERS):
        files = {}
        for row in run.scored:
            name = f"{file_stem(row['pair_id'])}{suffix}"
            if (real / name).is_file() and (sim / name).is_file():
                files[row["pair_id"]] = (real / name, sim / name)
        if files:
            return suffix, files
    example = run.scored[0]["pair_id"] if run.scored else "PAIR"
    raise DatasetError(
        f"{real} and {sim}: no predictions of a scored pair found on both sides; expected files "
        f"such as {example}.label, .txt or .json"
    )


def _compare_labels(
    run: FinishedRun, files: Mapping[str, tuple[Path, Path]], label_names: Mapping[int, str]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Agreement by class, and the real objects that both sides see with the class of most points."""
    import pandas as pd

    parts = []
    objects = []
    for pair_id, (real_path, sim_path) in files.items():
        real = _labelled_points(run, pair_id, "real", real_path)
        sim = _labelled_points(run, pair_id, "sim", sim_path)
        nearest = counterparts(real[_XYZ].to_numpy(), sim[_XYZ].to_numpy())
        seen = real[nearest >= 0].reset_index(drop=True)
        seen["counterpart"] = sim["predicted"].to_numpy()[nearest[nearest >= 0]]
        parts.append(seen)
        objects.append(_labelled_objects(run, pair_id, seen))
    points = pd.concat(parts)
    same = points[points["agreement"]]
    numbers = {
        "n_real": points["predicted"],
        "n_sim": points["counterpart"],
        "n_same": same["predicted"],
    }
    counts = {name: classes.value_counts() for name, classes in numbers.items()}
    classes = pd.DataFrame(counts).fillna(0).astype(int)
    n_same = classes.pop("n_same")
    classes["iou"] = n_same / (classes["n_real"] + classes["n_sim"] - n_same)
    names = {number: label_names.get(number, str(number)) for number in classes.index}
    objects_of_all = pd.concat(objects).replace(
        {"predicted_real": names, "predicted_sim": names}
    )
    return classes.rename(index=names).reset_index(names="class"), objects_of_all


def _labelled_points(run: FinishedRun, pair_id: str, side: str, path: Path) -> pd.DataFrame:
    """The points of a side with the predicted class of each."""
    points = run.points(pair_id, side)
    classes, _ = read_label_file(path, run.row(pair_id)[f"n_{side}_raw"])
    return points.assign(predicted=classes[points["point_id"]])


def _labelled_objects(run: FinishedRun, pair_id: str, seen: pd.DataFrame) -> pd.DataFrame:
    """The real objects among points that both sides see."""
    seen["agreement"] = seen["predicted"] == seen["counterpart"]
    by_object = seen.groupby("community_id")  # without ground, which has none
    objects = by_object[["agreement"]].mean()
    objects["predicted_real"] = by_object["predicted"].agg(_most_frequent)
    objects["predicted_sim"] = by_object["counterpart"].agg(_most_frequent)
    objects["fate"] = np.where(objects["agreement"] < _LOST_BELOW, "lost", "kept")
    return _real_objects(run, pair_id).join(objects, on="community_id", how="inner")


def _most_frequent(numbers: pd.Series) -> int:
    return int(numbers.mode()[0])


def _compare_boxes(
    run: FinishedRun, files: Mapping[str, tuple[Path, Path]], read: Callable[[Path], Boxes]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Agreement by class, and the real objects that are in a real box."""
    import pandas as pd

    parts = []
    objects = []
    for pair_id, (real_path, sim_path) in files.items():
        real = read(real_path)
        sim = read(sim_path)
        partner = match_detections(real, sim)
        is_found = partner >= 0
        offset_m = real.centre[is_found] - sim.centre[partner[is_found]]
        place_m = np.full(len(partner), np.nan)
        place_m[is_found] = np.linalg.norm(offset_m[:, :2], axis=1)
        parts.append(pd.DataFrame({"class": real.names, "n_real": 1, "place_m": place_m}))
        parts.append(pd.DataFrame({"class": sim.names, "n_sim": 1}))
        objects.append(_boxed_objects(run, pair_id, real, is_found))
    by_class = pd.concat(parts).groupby("class")
    classes = by_class[["n_real", "n_sim"]].sum().astype(int)
    classes["n_found"] = by_class["place_m"].count()
    classes["place_m"] = by_class["place_m"].median()
    return classes.reset_index(), pd.concat(objects)


def _boxed_objects(
    run: FinishedRun,
    pair_id: str,
    real: Boxes,
    is_found: BoolArray,
) -> pd.DataFrame:
    """The object with the most points inside of each real box that has any."""
    import pandas as pd

    points = run.points(pair_id, "real").dropna(subset="community_id")
    xyz = points[_XYZ].to_numpy()
    boxes = pd.DataFrame(
        {"predicted_real": real.names, "fate": np.where(is_found, "kept", "lost")}
    )
    boxes["community_id"] = [
        points.loc[inside(xyz, real, i), "community_id"].mode().min() for i in range(len(boxes))
    ]
    boxes = boxes.dropna(subset="community_id").astype({"community_id": np.int32})
    return _real_objects(run, pair_id).merge(boxes, on="community_id")


def _real_objects(run: FinishedRun, pair_id: str) -> pd.DataFrame:
    """Place, size and scores of the real objects of a pair."""
    columns = ["label", "range_m", *OBJECT_METRICS]
    objects = run.objects_of([pair_id], columns)
    chosen = objects.loc[objects["side"] == "real", ["community_id", "n_points", *columns]]
    chosen.insert(0, "pair_id", pair_id)
    return chosen


def _scores_of_lost(objects: pd.DataFrame) -> tuple[Row, ...]:
    """Area under the ROC curve of each score of matched objects, for their loss."""
    rows = []
    for score in OBJECT_METRICS:
        known = objects.dropna(subset=[score])
        values = known[score].to_numpy(dtype=np.float64)
        is_lost = (known["fate"] == "lost").to_numpy()
        scan_of = known["pair_id"].to_numpy()
        low, high = jackknife_interval(values, is_lost, scan_of) or (None, None)
        row = {"score": score, "auc": lost_auc(values, is_lost), "low": low, "high": high}
        n_lost = int(is_lost.sum())
        rows.append(row | {"n_lost": n_lost, "n_kept": len(known) - n_lost})
    return tuple(rows)
