import numpy as np
import pytest

from fidpipe.schemas.errors import StageError
from fidpipe.schemas.settings import GraphSettings
from fidpipe.stages.graph import build_graph


def as_dict(edges):
    return {(i, j): w for i, j, w in zip(edges.src.tolist(), edges.dst.tolist(), edges.length_m, strict=True)}


def test_tau_is_inclusive():
    points = np.array([[0.0, 0, 0], [0.25, 0, 0], [0.75, 0, 0], [2, 0, 0], [2, 0.25, 0]])
    edges = build_graph(points, GraphSettings(k=1, tau_m=0.5))
    assert (1, 2) in as_dict(edges)


def test_edges_are_sorted_and_each_stands_once(rng):
    edges = build_graph(rng.normal(0, 1, (300, 3)), GraphSettings(k=8))
    codes = edges.src.astype(np.int64) * 300 + edges.dst
    assert (edges.src < edges.dst).all()
    assert (np.diff(codes) > 0).all()
    assert edges.length_m.dtype == np.float32


def test_one_point_has_no_edges():
    assert len(build_graph(np.zeros((1, 3)), GraphSettings()).src) == 0


def test_point_order_changes_ids_only(rng):
    points = rng.normal(0, 1, (150, 3))
    order = rng.permutation(150)
    a = build_graph(points, GraphSettings(k=6))
    b = build_graph(points[order], GraphSettings(k=6))
    renamed = {tuple(sorted((int(order[i]), int(order[j])))): w for (i, j), w in as_dict(b).items()}
    assert renamed == as_dict(a)


@pytest.mark.parametrize("scale", [1e-3, 1e-200])
def test_a_crowd_is_refused_before_its_edges_fill_the_memory(rng, scale):
    crowd = rng.uniform(0, 1, (15_000, 3)) * scale  # 112 million pairs
    with pytest.raises(StageError, match=r"within 0.2 m of each other, got 112492500; lower graph.tau_m \(now 0.2\)"):
        build_graph(crowd, GraphSettings())
    far = np.vstack([crowd, [[9.0, 0, 0]]])  # next to a crowd, which alone lies within tau
    with pytest.raises(StageError, match="got 112492500"):
        build_graph(far, GraphSettings(k=1))


def test_a_crowd_is_only_one_where_its_pairs_are_joined(rng):
    crowd = rng.uniform(0, 0.01, (15_000, 3))
    assert len(build_graph(crowd, GraphSettings(k=1, edges="intersection")).src) < 15_000
    with pytest.raises(StageError, match="pairs of points within 0 m"):
        build_graph(crowd * 1e-200, GraphSettings(k=1, edges="intersection"))
