import numpy as np
import pytest

from fidpipe.pipeline.engine.worker import run_in_memory
from fidpipe.pipeline.jobs.scoring import PARTITION, ground_table, score_pair
from fidpipe.schemas.errors import StageError
from fidpipe.schemas.settings import CommunitySettings, GraphSettings, load
from fidpipe.stages.graph import build_graph
from fidpipe.stages.reference import (
    Annotation,
    ReferenceObjects,
    assign_to_reference,
    find_reference_objects,
    visiting_order,
)
from scenes import box

SETTINGS = load(None, ["graph.k=8"], preset="reference")


@pytest.fixture(scope="module")
def boxes():
    """Three objects far apart."""
    return np.vstack(
        [
            box([0, 0, 0], [2, 2, 2], 80, 1),
            box([9, 0, 0], [1, 2, 1], 50, 2),
            box([0, 9, 0], [1, 1, 1], 30, 3),
        ]
    )


def scores(real, sim, settings=SETTINGS):
    tables = {("ground", "real"): ground_table(real), ("ground", "sim"): ground_table(sim)}
    return score_pair(settings, tables)


def objects_of(points, settings):
    """Object of each point of the real side, and the table of objects."""
    ground = {("ground", "real"): ground_table(points)}
    tables, _ = run_in_memory(PARTITION, settings, tables=ground)
    labels = tables["communities", "real"].column("community_id").to_numpy()
    return labels, tables["objects", "real"]


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0]])
def test_a_point_between_two_real_points_goes_to_the_first_by_place_whatever_its_row(order):
    points, labels = (
        np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 3, 0]]),
        np.array([1, 0, 0], dtype=np.int32),
    )
    reference = ReferenceObjects(points[order], labels[order])
    sim = np.array([[0.5, 0, 0]])
    assert assign_to_reference(sim, reference, SETTINGS.communities, 0.6)[0] == 1


def test_the_reach_is_inclusive():
    reference = ReferenceObjects(np.zeros((1, 3)), np.zeros(1, dtype=np.int32))
    sim = np.vstack(
        [
            np.full((8, 3), [1.0, 0, 0]) * np.linspace(1, 1, 8)[:, None],
            box([50, 0, 0], [0.2, 0.2, 0.2], 8),
        ]
    )
    labels = assign_to_reference(sim, reference, SETTINGS.communities, 0.6)
    assert labels.tolist() == [0] * 8 + [1] * 8


@pytest.mark.parametrize("backend", ["scikit-network", "python-louvain"])
def test_the_order_of_rows_does_not_change_an_object(boxes, rng, backend):
    settings = load(None, ["graph.k=8", f"communities.backend={backend}"], preset="reference")
    # full of ties
    grid = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3) + [
        20,
        0,
        0,
    ]
    points = np.vstack([boxes, grid])
    order = rng.permutation(len(points))
    labels, objects = objects_of(points, settings)
    shuffled_labels, shuffled_objects = objects_of(points[order], settings)
    assert labels[order].tolist() == shuffled_labels.tolist()
    assert objects.equals(shuffled_objects)


def test_losing_a_point_leaves_the_order_of_the_others(boxes):
    order = visiting_order(boxes, 3)
    without = visiting_order(np.delete(boxes, 17, axis=0), 3)
    rest = order[order != 17]
    assert without.tolist() == np.where(rest > 17, rest - 1, rest).tolist()
    assert order.tolist() != visiting_order(boxes, 4).tolist()
    assert sorted(order.tolist()) == list(range(len(boxes)))


def test_a_scan_less_one_point_has_all_its_objects(boxes):
    assert scores(boxes, boxes[1:])["match_rate"] == 1.0


def test_a_side_of_which_all_is_left_out_is_refused_with_its_labels():
    points = box([0, 0, 0], [2, 2, 1], 60, 1)
    labels = np.array(["car"] * 40 + [None] * 20, dtype=object)
    everything = CommunitySettings(
        objects="reference", reference="labels", leave_out=("unlabelled", "Car")
    )
    with pytest.raises(StageError, match="car, unlabelled"):
        find_reference_objects(
            points, build_graph(points, GraphSettings()), everything, Annotation(labels)
        )


def test_crumbs_of_a_label_go_to_its_nearest_larger_piece():
    points = np.vstack(
        [
            box([0, 0, 0], [2, 2, 1], 40, 1),
            box([20, 0, 0], [2, 2, 1], 30, 2),
            [[13.0, 0, 0], [50, 0, 0]],
        ]
    )
    labels = np.array(["tree"] * 71 + ["pole"], dtype=object)
    settings = CommunitySettings(objects="reference", reference="labels")
    edges = build_graph(points, GraphSettings())
    found = find_reference_objects(points, edges, settings, Annotation(labels))
    # the lone pole has no larger piece of its label
    assert found.tolist() == [0] * 40 + [1] * 31 + [2]
    only_things = Annotation(instances=np.repeat([0, 5], [40, 32]).astype(np.int32))
    of_things = CommunitySettings(objects="reference", reference="instances")
    assert (
        find_reference_objects(points, edges, of_things, only_things).tolist()
        == [0] * 40 + [1] * 32
    )
