import numpy as np
import pytest
from scipy.spatial import cKDTree

from fidpipe.schemas.errors import StageError
from fidpipe.schemas.settings import CommunitySettings, GraphSettings, load
from fidpipe.stages.coverage import below_cut, cover
from fidpipe.stages.graph import build_graph
from fidpipe.stages.matching import match_reference
from fidpipe.stages.method import compare, n_communities, partition
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
        [box([0, 0, 0], [2, 2, 2], 80, 1), box([9, 0, 0], [1, 2, 1], 50, 2), box([0, 9, 0], [1, 1, 1], 30, 3)]
    )


def scores(real, sim, settings=SETTINGS):
    real = partition(real, settings)
    return compare(real, partition(sim, settings, reference=real.reference), settings)


def test_simulated_points_go_to_the_object_of_the_nearest_real_point(boxes, rng):
    real = partition(boxes, SETTINGS)
    invented = np.vstack([box([30, 0, 0], [1, 1, 1], 60, 4), box([33, 0, 0], [1, 1, 1], 70, 5)])
    sim = rng.permutation(np.vstack([boxes + 0.2, invented, [[40.0, 0, 0]], [[-9.0, 0, 0]]]))
    found = assign_to_reference(sim, real.reference, SETTINGS.communities, 0.6)
    new, stray = found > real.labels.max(), sim[:, 0] == -9
    nearest = cKDTree(boxes).query(sim)[1]
    np.testing.assert_array_equal(found[~new], real.labels[nearest][~new])
    assert set(sim[new][:, 0].round()) <= {29, 30, 31, 32, 33, 34}
    assert new.sum() == 130
    assert len(set(found[new])) == 2
    assert not new[stray].any()  # alone, so that it goes to the nearest real object after all


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0]])
def test_a_point_between_two_real_points_goes_to_the_first_by_place_whatever_its_row(order):
    points, labels = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 3, 0]]), np.array([1, 0, 0], dtype=np.int32)
    reference, sim = ReferenceObjects(points[order], labels[order]), np.array([[0.5, 0, 0]])
    assert assign_to_reference(sim, reference, SETTINGS.communities, 0.6)[0] == 1


def test_the_reach_is_inclusive():
    reference = ReferenceObjects(np.zeros((1, 3)), np.zeros(1, dtype=np.int32))
    sim = np.vstack([np.full((8, 3), [1.0, 0, 0]) * np.linspace(1, 1, 8)[:, None], box([50, 0, 0], [0.2, 0.2, 0.2], 8)])
    labels = assign_to_reference(sim, reference, SETTINGS.communities, 0.6)
    assert labels.tolist() == [0] * 8 + [1] * 8


def test_real_objects_with_too_few_simulated_points_are_missing():
    n_real, n_sim = np.array([50, 20, 3, 9], dtype=np.int32), np.array([8, 7, 3, 0, 40], dtype=np.int32)
    places = np.zeros((5, 3))
    matching = match_reference(places[:4], places, n_real, n_sim, 8)
    assert (matching.real_ids.tolist(), matching.missing.tolist()) == ([0, 2], [1, 3])
    assert matching.hallucinated.tolist() == [4]


@pytest.mark.parametrize("backend", ["scikit-network", "python-louvain"])
def test_the_order_of_rows_does_not_change_an_object(boxes, rng, backend):
    settings = load(None, ["graph.k=8", f"communities.backend={backend}"], preset="reference")
    grid = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3) + [20, 0, 0]  # full of ties
    points = np.vstack([boxes, grid])
    order = rng.permutation(len(points))
    first, shuffled = partition(points, settings), partition(points[order], settings)
    assert first.labels[order].tolist() == shuffled.labels.tolist()
    for measure in ("n_points", "centroid", "extent", "shape"):
        np.testing.assert_array_equal(getattr(first.objects, measure), getattr(shuffled.objects, measure))


def test_losing_a_point_leaves_the_order_of_the_others(boxes):
    order = visiting_order(boxes, 3)
    without = visiting_order(np.delete(boxes, 17, axis=0), 3)
    rest = order[order != 17]
    assert without.tolist() == np.where(rest > 17, rest - 1, rest).tolist()
    assert order.tolist() != visiting_order(boxes, 4).tolist()
    assert sorted(order.tolist()) == list(range(len(boxes)))


def test_a_scan_less_one_point_has_all_its_objects(boxes):
    assert scores(boxes, boxes[1:]).summary["match_rate"] == 1.0


def test_a_real_object_that_is_not_simulated_is_missing_and_has_no_place(boxes):
    real = partition(boxes, SETTINGS)
    sim = partition(boxes[:80], SETTINGS, reference=real.reference)
    result = compare(real, sim, SETTINGS)
    assert result.matching.missing.tolist() == np.flatnonzero(sim.objects.n_points == 0).tolist() != []
    assert np.isnan(sim.objects.centroid[result.matching.missing]).all()
    assert n_communities(result.summary)["n_communities_sim"] == len(result.matching.real_ids)


def test_labels_and_instances_of_the_input_are_the_objects():
    cars = np.vstack(
        [box([0, 0, 0], [2, 2, 1], 60, 1), box([2.2, 0, 0], [2, 2, 1], 40, 2), box([30, 0, 0], [2, 2, 1], 50, 3)]
    )
    ground = box([0, -20, 0], [2, 2, 1], 30, 4)
    points = np.vstack([cars, ground])
    labels = np.array(["car"] * 150 + [None] * 30, dtype=object)
    instances = np.array([1] * 60 + [2] * 40 + [3] * 50 + [0] * 30, dtype=np.int32)
    edges = build_graph(points, GraphSettings())
    (by_label, by_instance), (of_cars, _) = (
        [
            find_reference_objects(
                points,
                edges,
                CommunitySettings(objects="reference", reference=kind, leave_out=leave_out),
                Annotation(labels, instances),
            )
            for kind in ("labels", "instances")
        ]
        for leave_out in ((), ("unlabelled",))
    )
    assert by_label.tolist() == [0] * 100 + [1] * 50 + [2] * 30  # the two cars that touch are one piece
    assert by_instance.tolist() == [0] * 60 + [2] * 40 + [1] * 50 + [3] * 30
    assert of_cars.tolist() == [0] * 100 + [1] * 50 + [-1] * 30
    with pytest.raises(StageError, match=r"all object points of the real side \(car, unlabelled\)"):
        everything = CommunitySettings(objects="reference", reference="labels", leave_out=("unlabelled", "Car"))
        find_reference_objects(points, edges, everything, Annotation(labels))


def test_crumbs_of_a_label_go_to_its_nearest_larger_piece():
    points = np.vstack(
        [box([0, 0, 0], [2, 2, 1], 40, 1), box([20, 0, 0], [2, 2, 1], 30, 2), [[13.0, 0, 0], [50, 0, 0]]]
    )
    labels = np.array(["tree"] * 71 + ["pole"], dtype=object)
    settings = CommunitySettings(objects="reference", reference="labels")
    edges = build_graph(points, GraphSettings())
    found = find_reference_objects(points, edges, settings, Annotation(labels))
    assert found.tolist() == [0] * 40 + [1] * 31 + [2]  # the lone pole has no larger piece of its label
    only_things = Annotation(instances=np.repeat([0, 5], [40, 32]).astype(np.int32))
    of_things = CommunitySettings(objects="reference", reference="instances")
    assert find_reference_objects(points, edges, of_things, only_things).tolist() == [0] * 40 + [1] * 32


def test_road_share_is_what_lies_below_the_cut_of_the_other_side():
    up = np.array([np.sin(0.1), 0.0, np.cos(0.1)])  # the other side's road rises towards -x
    on_road = np.array([[10.0, 0.0, -1.0 - 0.05], [-10.0, 0.0, 1.0 - 0.05], [0.0, 3.0, -0.05]])
    points, labels = np.concatenate([on_road, on_road + [0, 0, 1.0]]), np.array([0, 0, 1, 1, 2, 2], dtype=np.int32)
    is_road = below_cut(points, up, 0.1)
    assert is_road.tolist() == [True] * 3 + [False] * 3
    road_share = cover(np.zeros(6), labels, 4, is_road).road_share
    assert road_share[:3].tolist() == [1.0, 0.5, 0.0]
    assert np.isnan(road_share[3])
    assert below_cut(points, up, None) is None
