import numpy as np
import pytest
from scipy import sparse

from fidpipe.schemas.settings import SelectionSettings
from fidpipe.stages.linalg.subgraph import Subgraph
from fidpipe.stages.metrics import chamfer_density_aware, score_object
from fidpipe.stages.selection import Selection, select_nodes
from scenes import box, moved, rigid, subgraph

SPECTRAL = (
    "r_lambda",
    "r_gap",
    "max_eigenvalue_shift",
    "laplacian_change",
    "eigenspectrum_distance",
    "gap_real",
    "gap_sim",
)


def scored(real, sim, k=8):
    real, sim = subgraph(real, k), subgraph(sim, k)
    selection = select_nodes(real, sim, SelectionSettings())
    return score_object(real, sim, selection), real, sim, selection


def test_two_paths_of_three_nodes_by_hand():
    # Normalised Laplacians of weighted paths a-b-c have the spectrum 0, 1, 2 whatever the weights: only L itself moves.
    scores, *_ = scored(
        np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0.0, 0, 0], [1, 0, 0], [4, 0, 0]]), k=1
    )
    assert scores.max_eigenvalue_shift == pytest.approx(0, abs=1e-12)
    assert scores.laplacian_change > 0.1
    assert (scores.r_lambda, scores.r_gap) == (pytest.approx(0, abs=1e-12), pytest.approx(0, abs=1e-12))
    assert scores.gap_real == pytest.approx(1)


@pytest.mark.parametrize("seed", range(10))
def test_the_largest_change_that_there_is_stays_within_its_bounds(seed):
    # A path has the largest eigenvalue 2, by LAPACK a rounding more; of nodes without edges all are 0.
    rng, nodes = np.random.default_rng(seed), np.arange(5, dtype=np.int32)
    weight, points = rng.uniform(0.1, 3, 4), rng.normal(size=(5, 3))
    path = Subgraph(nodes, points, sparse.csr_matrix(sparse.diags_array([weight, weight], offsets=[-1, 1])))
    alone = Subgraph(nodes, points, sparse.csr_matrix((5, 5)))
    scores = score_object(alone, path, Selection(nodes, nodes, np.ones(5), np.ones(5)))
    for value in (scores.max_eigenvalue_shift, scores.laplacian_change):
        assert 2 - 1e-12 < value <= 2.0
    assert scores.r_lambda == pytest.approx(1.0)


def test_cdc_of_two_single_points_by_hand():
    assert chamfer_density_aware(np.zeros((1, 3)), np.array([[0.0, 2, 0]])) == pytest.approx(2 * (1 - np.exp(-4)))


@pytest.mark.parametrize("seed", range(3))
def test_a_rigid_motion_leaves_an_object_identical_even_when_stored_as_float32(seed):
    points = box([10, 3, 0], [4, 2, 1.5], 150, seed)
    shifted = moved(points, rigid(2, [0.03, 0.04, 0])).astype(np.float32).astype(np.float64)
    scores, *_ = scored(points, shifted)
    assert scores.status == "identical"
    assert scores.laplacian_change < 1e-5
    assert (scores.r_lambda, scores.r_gap) == (0, 0)
    assert scores.cdc > 0


@pytest.mark.parametrize("n", [1, 2])
def test_two_nodes_have_no_spectral_score_but_a_reason(n):
    scores, *_ = scored(np.eye(3)[:n] + 5, np.random.default_rng(0).normal(0, 1, (20, 3)))
    assert scores.status == "too_small"
    assert scores.reason == f"{n} aligned nodes, at least 3 are needed for a spectrum"
    assert all(getattr(scores, name) is None for name in SPECTRAL)
    assert scores.cdc > 0
