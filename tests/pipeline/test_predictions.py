"""A user's model on both sides: a segmenter trained here, and boxes of clusters."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree
from sklearn.ensemble import RandomForestClassifier

import fidpipe
from fidpipe.pipeline.diagnose import predictions
from fidpipe.pipeline.diagnose.predictions import (
    compare_predictions,
    read_kitti_boxes,
    read_nuscenes_boxes,
)
from fidpipe.pipeline.diagnose.predictions_view import agreement_view
from fidpipe.schemas.errors import DatasetError, ScanError
from fidpipe.schemas.settings import TaskSettings, load
from fidpipe.stages.pieces import CutScan
from fidpipe.stages.predictions import (
    Boxes,
    inside,
    jackknife_interval,
    lost_auc,
    match_detections,
)
from fidpipe.stages.tasks import find_obstacles
from reports import text_of
from runs import command, run
from scenes import street, write_dataset

ROAD, CAR, CROWN, WALL, POLE = range(1, 6)
N_PAIRS = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("predictions")
    write_dataset(folder / "streets", N_PAIRS)
    run(
        folder / "streets",
        folder / "run",
        load(None, ["graph.k=20", "tasks.names=all"], preset="reference"),
    )
    return folder


def scans(folder):
    """Side, name and points of every file."""
    for path in sorted((folder / "streets").glob("*/*.bin")):
        yield (
            path.parent.name,
            path.stem,
            np.fromfile(path, "<f4").reshape(-1, 4)[:, :3].astype(float),
        )


def eigenfeatures(points):
    """Shape of the 12 nearest neighbours of each point, and its height."""
    _, near = cKDTree(points).query(points, k=12)
    apart = points[near] - points[near].mean(axis=1, keepdims=True)
    values = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", apart, apart))
    return np.column_stack(
        [
            values / values.sum(axis=1, keepdims=True),
            points[:, 2],
            np.ptp(points[near, 2], axis=1),
        ]
    )


@pytest.fixture(scope="module")
def labels(folder):
    """Predictions of a segmenter that was trained on another street."""
    points = street(seed=77)
    truth = np.repeat([ROAD, CAR, CROWN, WALL, POLE], [1200, 150, 150, 300, 75])
    model = RandomForestClassifier(30, random_state=0).fit(eigenfeatures(points), truth)
    for side, name, points in scans(folder):
        path = folder / "labels" / side / f"{name}.label"
        path.parent.mkdir(parents=True, exist_ok=True)
        model.predict(eigenfeatures(points)).astype("<u4").tofile(path)
    (folder / "labels" / "real" / "labels.toml").write_text("1 = 'road'\n2 = 'car'\n")
    return folder / "labels"


def kitti_line(centre, size):
    """A box along the axes as KITTI writes it."""
    x, y, z = centre
    length, width, height = size
    numbers = (height, width, length, -y, height / 2 - z, x, -np.pi / 2)
    return f"Car 0 0 0 0 0 0 0 {' '.join(f'{number:.4f}' for number in numbers)}"


@pytest.fixture(scope="module")
def boxes(folder):
    """Boxes of clusters above the road."""
    for side, name, points in scans(folder):
        height_m = points[:, 2] + 1.7
        found = find_obstacles(CutScan(points, height_m < 0.3, height_m), TaskSettings())
        path = folder / "boxes" / side / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = [kitti_line(*box) for box in zip(found.centre, found.size_m, strict=True)]
        path.write_text(
            "\n".join([*lines, "DontCare -1 -1 -10 0 0 0 0 -1 -1 -1 -1000 -1000 -1000 -10"])
            + "\n"
        )
    return folder / "boxes"


def test_a_segmenter_is_compared_by_class_and_by_object(folder, labels):
    result = compare_predictions(
        fidpipe.open_run(folder / "run"), labels / "real", labels / "sim"
    )
    by_class = {row["class"]: row for row in result.classes}
    assert by_class["road"]["iou"] > 0.9
    assert {"car", "3"} <= set(by_class)
    names = [(row["pair_id"], row["community_id"]) for row in result.objects]
    assert len(names) == len(set(names)) >= 2 * N_PAIRS
    for row in result.objects:
        assert (row["fate"] == "lost") == (row["agreement"] < 0.5)
    assert not result.left_out
    words = ("tasks", folder / "run", "--predictions", labels / "real", labels / "sim")
    assert "IoU" in command(*words, code=0).stdout
    values = json.loads(command(*words, "--json", code=0).stdout)
    assert (values["kind"], len(values["objects"])) == ("labels", len(names))
    rows = values["objects"]
    assert [(row["pair_id"], row["community_id"]) for row in rows] == names


def test_sides_without_common_surface_have_no_classes(folder, labels, monkeypatch):
    monkeypatch.setattr(predictions, "counterparts", lambda points, _: np.full(len(points), -1))
    result = compare_predictions(
        fidpipe.open_run(folder / "run"), labels / "real", labels / "sim"
    )
    assert (result.classes, result.objects) == ((), ())
    assert "0 objects with predictions" in text_of(agreement_view(result))


def test_boxes_of_clusters_are_compared_and_joined_with_the_objects(folder, boxes):
    finished = fidpipe.open_run(folder / "run")
    result = compare_predictions(finished, boxes / "real", boxes / "sim")
    (cars,) = result.classes
    n_lost = sum(row["fate"] == "lost" for row in result.objects)
    assert n_lost > 0
    assert cars["n_found"] == len(result.objects) - n_lost
    assert cars["n_real"] >= len(result.objects)
    lost = {row["pair_id"] for row in result.objects if row["fate"] == "lost"}
    assert lost == {f"{i:03}" for i in range(N_PAIRS)}  # the pole
    of_cdc = next(score for score in result.scores if score["score"] == "cdc")
    assert of_cdc["n_kept"] > 0


def nuscenes_boxes(path):
    """The boxes of a KITTI file as nuScenes writes them, turned by 180 degrees."""
    boxes = read_kitti_boxes(path)
    rows = []
    for name, centre, (length, width, height) in zip(
        boxes.names, boxes.centre, boxes.size, strict=True
    ):
        box = {
            "detection_name": str(name),
            "translation": centre.tolist(),
            "rotation": [0.0, 0.0, 0.0, 1.0],
        }
        rows.append(box | {"size": [width, length, height]})
    return rows


def test_boxes_of_nuscenes_are_the_same_as_those_of_kitti(folder, boxes, tmp_path):
    for path in boxes.glob("*/*.txt"):
        found = nuscenes_boxes(path)
        content = {"meta": {}, "results": {path.stem: found}} if path.stem == "000" else found
        other = tmp_path / path.parent.name / f"{path.stem}.json"
        other.parent.mkdir(exist_ok=True)
        other.write_text(json.dumps(content))
    found = read_nuscenes_boxes(tmp_path / "real" / "000.json")
    assert found.size == pytest.approx(read_kitti_boxes(boxes / "real" / "000.txt").size)
    assert found.yaw == pytest.approx(np.pi)
    finished = fidpipe.open_run(folder / "run")
    result = compare_predictions(finished, tmp_path / "real", tmp_path / "sim")
    assert (
        result.classes == compare_predictions(finished, boxes / "real", boxes / "sim").classes
    )
    assert len(result.objects) > 2 * N_PAIRS
    for content in ("[{}]", "3", "{", '[{"size": [1, 2]}]', '{"results": {}}'):
        (tmp_path / "a.json").write_text(content)
        with pytest.raises(DatasetError, match="a.json: expected boxes of one sample"):
            read_nuscenes_boxes(tmp_path / "a.json")


def test_a_side_without_boxes_loses_all(folder, tmp_path):
    for side, content in (("real", kitti_line((8, 4, -0.9), (4, 1.8, 1.2))), ("sim", "")):
        (tmp_path / side).mkdir()
        (tmp_path / side / "000.txt").write_text(content)
    result = compare_predictions(
        fidpipe.open_run(folder / "run"), tmp_path / "real", tmp_path / "sim"
    )
    (cars,) = result.classes
    assert cars == {"class": "Car", "n_real": 1, "n_sim": 0, "n_found": 0, "place_m": None}
    assert [row["fate"] for row in result.objects] == ["lost"]
    assert {score["auc"] for score in result.scores} == {None}
    assert result.left_out == ("001", "002", "003")


def test_a_pair_whose_boxes_hold_no_points_has_classes_but_no_objects(folder, tmp_path):
    for side in ("real", "sim"):
        (tmp_path / side).mkdir()
        (tmp_path / side / "000.txt").write_text(kitti_line((8, 4, 300), (4, 1.8, 1.2)))
    result = compare_predictions(
        fidpipe.open_run(folder / "run"), tmp_path / "real", tmp_path / "sim"
    )
    assert [row["n_found"] for row in result.classes] == [1]
    assert result.objects == ()


def test_the_tasks_of_a_run_are_a_command_of_their_own(folder):
    assert "wrongly_free" in command("tasks", folder / "run", code=0).stdout
    rows = json.loads(command("tasks", folder / "run", "--json", code=0).stdout)
    assert rows[0]["measure"] == "lost"


def test_missing_and_damaged_predictions_are_named(folder, tmp_path):
    finished = fidpipe.open_run(folder / "run")
    with pytest.raises(DatasetError, match="no predictions of a scored pair"):
        compare_predictions(finished, tmp_path, tmp_path)
    (tmp_path / "000.label").write_bytes(bytes(8))
    with pytest.raises(ScanError, match="000.label: expected .* bytes"):
        compare_predictions(finished, tmp_path, tmp_path)
    (tmp_path / "a.txt").write_text("Car 0 0\n")
    with pytest.raises(DatasetError, match="line 1: expected a line of a KITTI label file"):
        read_kitti_boxes(tmp_path / "a.txt")


def test_a_box_of_kitti_lies_in_the_axes_of_the_sensor(tmp_path):
    (tmp_path / "a.txt").write_text(kitti_line((10, 2, -0.5), (4, 1.8, 1.5)) + " 0.9\n")
    box = read_kitti_boxes(tmp_path / "a.txt")
    assert box.centre == pytest.approx(np.array([[10, 2, -0.5]]))
    assert box.size == pytest.approx(np.array([[4, 1.8, 1.5]]))
    assert box.yaw == pytest.approx([0], abs=1e-4)
    points = np.array([[11.9, 2.8, 0.2], [10, 3, -0.5], [12.1, 2, -0.5]])
    assert inside(points, box, 0).tolist() == [True, False, False]
    turned = Boxes(box.names, box.centre, box.size, np.array([np.pi / 2]))
    assert inside(points, turned, 0).tolist() == [False, True, False]


def test_boxes_of_one_class_within_two_metres_are_the_same():
    places = np.array([[0.0, 0, 0], [1.5, 0, 0], [9, 0, 0]])
    real = Boxes(np.array(["car", "car", "car"]), places, np.ones((3, 3)), np.zeros(3))
    sim = Boxes(
        np.array(["car", "bus"]),
        np.array([[1.4, 0, 5], [9.0, 0, 0]]),
        np.ones((2, 3)),
        np.zeros(2),
    )
    assert match_detections(real, sim).tolist() == [-1, 0, -1]
    assert (
        match_detections(
            real, Boxes(sim.names[:0], places[:0], places[:0], places[:0, 0])
        ).tolist()
        == [-1] * 3
    )


def test_the_interval_of_an_auc_comes_from_leaving_out_scans():
    scores, is_lost = (
        np.array([0.1, 0.9, 0.2, 0.8, 0.3, 0.7]),
        np.array([0, 1, 0, 1, 0, 1], bool),
    )
    scans_of = np.array([0, 0, 1, 1, 2, 2])
    assert lost_auc(scores, is_lost) == 1
    assert jackknife_interval(scores, is_lost, scans_of) == (1, 1)
    assert jackknife_interval(scores, is_lost, scans_of // 2) is None
    assert lost_auc(scores, ~is_lost) == 0
    assert lost_auc(scores, np.zeros(6, bool)) is None
    assert lost_auc(np.ones(6), is_lost) == 0.5
