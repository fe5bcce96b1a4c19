import numpy as np
import pytest
import scipy.linalg
from scipy import sparse

from fidpipe.stages.baselines.netlsd import heat_trace_distance
from fidpipe.stages.baselines.r_h import diffusion_change
from fidpipe.stages.linalg.heat import heat_row_sums
from fidpipe.stages.linalg.laplacian import normalised_laplacian

TIMES = np.geomspace(0.01, 100, 50)


def random_laplacian(rng, n, density=0.3):
    weights = np.triu(rng.uniform(0.1, 1, (n, n)) * (rng.random((n, n)) < density), 1)
    return normalised_laplacian(sparse.csr_matrix(weights + weights.T))


def path(n):
    return normalised_laplacian(sparse.csr_matrix(np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)))


@pytest.mark.parametrize("t", [0.1, 1.0, 7.0, 100.0])
def test_the_heat_row_sums_agree_with_the_dense_exponential(rng, t):
    pieces = random_laplacian(rng, 60), sparse.csr_matrix((1, 1))  # and an isolated node
    L = sparse.block_diag(pieces, format="csr")
    np.testing.assert_allclose(heat_row_sums(L, t), scipy.linalg.expm(-t * L.toarray()).sum(axis=1), atol=1e-12)


def test_heat_traces_of_an_edge_and_of_a_path_by_hand():
    # spectra 0, 2 and 0, 1, 2
    edge, three = (1 + np.exp(-2 * TIMES)) / 2, (1 + np.exp(-TIMES) + np.exp(-2 * TIMES)) / 3
    assert heat_trace_distance(path(2), path(3), TIMES) == pytest.approx(np.linalg.norm(edge - three))


def test_heat_traces_do_not_depend_on_how_nodes_are_numbered(rng):
    a = random_laplacian(rng, 20)
    order = rng.permutation(20)
    assert heat_trace_distance(a, a[order][:, order], TIMES) == pytest.approx(0, abs=1e-12)


def test_the_diffusion_change_of_a_small_change_in_a_short_time_is_nearly_one():
    # d exp(-tL) = -t dL + O(t^2)
    a = path(6)
    length = 1 + 0.1 * np.arange(5)
    b = normalised_laplacian(sparse.csr_matrix(np.diag(length, 1) + np.diag(length, -1)))
    assert diffusion_change(a, b, 1e-4, 1e-5) == pytest.approx(1, abs=1e-3)


def test_identical_laplacians_have_no_diffusion_change(rng):
    a = random_laplacian(rng, 90)
    assert diffusion_change(a, a.copy(), 1.0, 1e-5) == 0
