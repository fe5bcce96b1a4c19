"""Graphs, communities and their matching."""

import tracemalloc

import community as python_louvain
import networkx as nx
import numpy as np
import pytest
from sknetwork.clustering import Louvain

import literal_method
from fidpipe.schemas.errors import StageError
from fidpipe.schemas.settings import CommunitySettings, GraphSettings, MatchingSettings
from fidpipe.stages import graph
from fidpipe.stages.communities import find_communities
from fidpipe.stages.graph import build_graph
from fidpipe.stages.linalg.subgraph import Edges, adjacency
from fidpipe.stages.matching import match_communities
from fidpipe.stages.objects import majority_labels
from scenes import box


def as_dict(edges):
    return {
        (i, j): w
        for i, j, w in zip(edges.src.tolist(), edges.dst.tolist(), edges.length_m, strict=True)
    }


def test_tau_is_inclusive():
    # no point has its nearest across the gap
    points = np.array([[0.0, 0, 0], [0.25, 0, 0], [0.75, 0, 0], [1, 0, 0]])
    assert (1, 2) in as_dict(build_graph(points, GraphSettings(k=1, tau_m=0.5)))


def test_one_point_has_no_edges():
    assert len(build_graph(np.zeros((1, 3)), GraphSettings()).src) == 0


@pytest.mark.parametrize("scale", [1e-3, 1e-200])
def test_a_crowd_is_refused_before_its_edges_fill_the_memory(rng, scale):
    crowd = rng.uniform(0, 1, (15_000, 3)) * scale  # 112 million pairs
    with pytest.raises(StageError, match="112492500.*input.voxel_m=0.05.*graph.tau_m"):
        build_graph(crowd, GraphSettings())
    far = np.vstack([crowd, [[9.0, 0, 0]]])  # next to a crowd, which alone lies within tau
    with pytest.raises(StageError, match="got 112492500"):
        build_graph(far, GraphSettings(k=1))


def test_a_crowd_is_only_one_where_its_pairs_are_joined(rng):
    crowd = rng.uniform(0, 0.01, (15_000, 3))
    assert len(build_graph(crowd, GraphSettings(k=1, edges="intersection")).src) < 15_000
    with pytest.raises(StageError, match="within 0 m"):
        build_graph(crowd * 1e-200, GraphSettings(k=1, edges="intersection"))


@pytest.mark.parametrize("edges", ["union", "intersection"])
@pytest.mark.parametrize("ties", ["point_id", "coordinates"])
def test_tiles_change_no_edge(rng, monkeypatch, edges, ties):
    # with ties and repeated points
    points = np.round(rng.uniform(0, 1, (400, 3)) * [6, 1, 1], 1)
    settings = GraphSettings(k=5, tau_m=0.3, edges=edges, ties=ties)
    whole = build_graph(points, settings)
    monkeypatch.setattr(graph, "_TILE_POINTS", 37)
    monkeypatch.setattr(graph, "_TILE_PAIRS", 50)
    tiled = build_graph(points, settings)
    for name in ("src", "dst", "length_m"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(tiled, name))
        assert getattr(tiled, name).dtype.itemsize == 4


def test_memory_goes_with_the_edges(rng):
    points = rng.uniform(0, 1, (20_000, 3)) * [12, 2, 0.01]
    tracemalloc.start()
    edges = build_graph(points, GraphSettings())
    _, graph_bytes = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    find_communities(len(points), edges, CommunitySettings())
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert graph_bytes < 60 * len(edges.src)
    assert peak_bytes - before < 50 * len(edges.src)


BACKENDS = ["scikit-network", "python-louvain"]


@pytest.fixture(scope="module")
def three_boxes():
    points = np.vstack(
        [
            box([0, 0, 0], [1, 1, 1], 60, 1),
            box([9, 0, 0], [1, 2, 1], 90, 2),
            box([0, 9, 0], [1, 1, 1], 30, 3),
        ]
    )
    return points, build_graph(points, GraphSettings(k=8))


def test_the_reference_backend_is_python_louvain_itself(three_boxes):
    points, edges = three_boxes
    labels = find_communities(
        len(points), edges, CommunitySettings(backend="python-louvain", seed=3)
    )
    G = nx.Graph()
    G.add_nodes_from(range(len(points)))
    G.add_weighted_edges_from(
        (i, j, float(length)) for (i, j), length in as_dict(edges).items()
    )
    found = python_louvain.best_partition(G, random_state=3)
    np.testing.assert_array_equal(
        labels, literal_method.canonical([found[i] for i in range(len(points))])
    )


@pytest.mark.parametrize("seed", [0, 7])
def test_nodes_are_shuffled_as_scikit_network_shuffles_them(rng, seed):
    points = rng.uniform(0, 10, (600, 3))
    edges = build_graph(points, GraphSettings(k=12))
    own = Louvain(
        resolution=1,
        shuffle_nodes=True,
        tol_optimization=1e-3,
        tol_aggregation=1e-7,
        random_state=seed,
    ).fit_predict(adjacency(len(points), edges))
    ours = find_communities(len(points), edges, CommunitySettings(seed=seed))
    assert {tuple(np.flatnonzero(ours == label)) for label in set(ours)} == {
        tuple(np.flatnonzero(own == label)) for label in set(own)
    }


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_isolated_node_is_a_community_of_its_own(backend):
    edges = Edges(
        np.array([0, 0, 1], np.int32), np.array([1, 2, 2], np.int32), np.ones(3, np.float32)
    )
    assert find_communities(4, edges, CommunitySettings(backend=backend)).tolist() == [
        0,
        0,
        0,
        1,
    ]


def test_the_majority_names_an_object_and_the_alphabet_breaks_ties():
    labels = np.array([0, 0, 0, 1, 1, 2], np.int32)
    assert majority_labels(labels, ["car", "wall", "car", "wall", "car", None]) == [
        "car",
        "car",
        None,
    ]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("exponent", [-50, -200, -310])
def test_where_no_edge_has_a_length_the_connected_pieces_are_the_communities(
    three_boxes, backend, exponent
):
    points, _ = three_boxes
    edges = build_graph(points * 10.0**exponent, GraphSettings(k=8))
    assert not edges.length_m.any()
    apart = Edges(*(ends[edges.src < 60] for ends in (edges.src, edges.dst, edges.length_m)))
    apart = Edges(*(ends[apart.dst < 60] for ends in (apart.src, apart.dst, apart.length_m)))
    labels = find_communities(90, apart, CommunitySettings(backend=backend))
    assert np.bincount(labels).tolist() == [60] + [1] * 30


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("exponent", [-36, -20, 8])
def test_communities_do_not_depend_on_the_unit(three_boxes, backend, exponent):
    points, edges = three_boxes
    own = CommunitySettings(backend=backend)
    labels = find_communities(len(points), edges, own)
    scaled = Edges(edges.src, edges.dst, edges.length_m * np.float32(10.0**exponent))
    assert len(np.unique(find_communities(len(points), scaled, own))) == len(np.unique(labels))


def test_thousands_of_objects_are_matched_one_row_at_a_time():
    places = np.random.default_rng(0).uniform(0, 1e4, (4000, 3))
    tracemalloc.start()
    matching = match_communities(places, places[::-1], MatchingSettings())
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (matching.sim_ids == np.arange(4000)[::-1][matching.real_ids]).all()
    assert peak_bytes < 8 * 4000**2 / 10  # no matrix of all distances
