"""Scores of an object by hand, Laplacians, and eigenvalues against LAPACK, also where they are hard to tell apart."""

import ctypes

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigvals_banded, eigvalsh, qr

import literal_method
from fidpipe.schemas.settings import GraphSettings, SelectionSettings
from fidpipe.stages.graph import build_graph
from fidpipe.stages.linalg import spectrum
from fidpipe.stages.linalg.band_reduction import kernels_from, reduce_to_band, scipy_kernels
from fidpipe.stages.linalg.laplacian import normalised_laplacian
from fidpipe.stages.linalg.spectrum import eigenvalues, spectral_norm
from fidpipe.stages.linalg.subgraph import Subgraph, adjacency
from fidpipe.stages.metrics import chamfer_density_aware, score_object
from fidpipe.stages.selection import Selection, select_nodes
from scenes import box, moved, rigid, subgraph


def scored(real, sim, k=8):
    real, sim = subgraph(real, k), subgraph(sim, k)
    selection = select_nodes(real, sim, SelectionSettings())
    return score_object(real, sim, selection), real, sim, selection


def test_two_paths_of_three_nodes_by_hand():
    # Normalised Laplacians of weighted paths a-b-c have the spectrum 0, 1, 2 whatever the weights: only L itself moves.
    scores, *_ = scored(
        np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [4, 0, 0]]),
        k=1,
    )
    assert scores.max_eigenvalue_shift == pytest.approx(0, abs=1e-12)
    assert scores.laplacian_change > 0.1
    assert (scores.r_lambda, scores.r_gap) == (
        pytest.approx(0, abs=1e-12),
        pytest.approx(0, abs=1e-12),
    )
    assert scores.gap_real == pytest.approx(1)


@pytest.mark.parametrize("seed", range(10))
def test_the_largest_change_that_there_is_stays_within_its_bounds(seed):
    # A path has the largest eigenvalue 2, by LAPACK a rounding more; of nodes without edges all are 0.
    rng = np.random.default_rng(seed)
    nodes = np.arange(5, dtype=np.int32)
    weight = rng.uniform(0.1, 3, 4)
    points = rng.normal(size=(5, 3))
    path = Subgraph(
        nodes, points, sparse.csr_matrix(sparse.diags_array([weight, weight], offsets=[-1, 1]))
    )
    alone = Subgraph(nodes, points, sparse.csr_matrix((5, 5)))
    scores = score_object(alone, path, Selection(nodes, nodes, np.ones(5), np.ones(5)))
    for value in (scores.max_eigenvalue_shift, scores.laplacian_change):
        assert 2 - 1e-12 < value <= 2.0
    assert scores.r_lambda == pytest.approx(1.0)


def test_cdc_of_two_single_points_by_hand():
    assert chamfer_density_aware(np.zeros((1, 3)), np.array([[0.0, 2, 0]])) == pytest.approx(
        2 * (1 - np.exp(-4))
    )


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
    assert scores.reason.startswith(f"{n} aligned nodes")
    assert all(getattr(scores, name) is None for name in literal_method.SPECTRAL)
    assert scores.cdc > 0


def laplacian(points, k=8):
    return normalised_laplacian(adjacency(len(points), build_graph(points, GraphSettings(k=k))))


def banded(symmetric, width=spectrum.BAND_WIDTH):
    """The eigenvalues by way of the band, however small the matrix."""
    return eigvals_banded(reduce_to_band(symmetric, width, scipy_kernels()), lower=True)


@pytest.mark.parametrize("n", [3, 20, 41, 42, 43, 81, 82, 120, 333])
def test_the_band_has_the_eigenvalues_of_the_matrix(rng, n):
    dense = rng.normal(0, 1, (n, n))
    dense += dense.T
    values = banded(sparse.csr_matrix(dense))
    np.testing.assert_allclose(values, np.linalg.eigvalsh(dense), atol=1e-12 * n)


@pytest.mark.parametrize("bandwidth", [1, 39, 40, 41, 90, 130])
def test_a_shuffled_band_matrix_has_the_eigenvalues_of_the_ordered_one(rng, bandwidth):
    n = 401
    dense = np.triu(np.tril(rng.normal(0, 1, (n, n)), bandwidth), -bandwidth)
    dense += dense.T
    order = rng.permutation(n)
    values = banded(sparse.csr_matrix(dense[np.ix_(order, order)]))
    np.testing.assert_allclose(values, np.linalg.eigvalsh(dense), atol=1e-11)


@pytest.mark.parametrize("half", [[2, 120, 5], [90, 3, 90, 1, 60], [0, 45, 0, 33]])
def test_a_band_of_uneven_width_has_the_same_eigenvalues(rng, half):
    reach = np.repeat(half, 400 // len(half))
    n = len(reach)
    row, column = np.indices((n, n))
    dense = np.where(
        np.abs(row - column) <= np.minimum(reach[row], reach[column]),
        rng.normal(0, 1, (n, n)),
        0,
    )
    dense += dense.T
    np.testing.assert_allclose(
        banded(sparse.csr_matrix(dense)), np.linalg.eigvalsh(dense), atol=1e-11
    )


def test_without_the_routines_for_parts_of_matrices_the_direct_way_is_taken(rng, monkeypatch):
    L = laplacian(rng.normal(0, 1, (90, 3)))
    direct = eigvalsh(L.toarray(order="F"))
    monkeypatch.setattr(spectrum, "BANDED_FROM_NODES", 0)
    assert not np.array_equal(eigenvalues(L), direct)  # to the last bit they do differ
    np.testing.assert_array_equal(eigenvalues(L), banded(L))
    monkeypatch.setattr(spectrum, "scipy_kernels", lambda: None)
    np.testing.assert_array_equal(eigenvalues(L), direct)


@pytest.mark.parametrize(
    "signature", [b"void (char *, long *, double *)", b"void (char *, double *)"]
)
def test_routines_with_other_integers_are_not_called(signature):
    assert kernels_from({"dgemm": capsule(signature)}) is None


def capsule(signature):
    """A capsule as Cython exports C functions, with this signature."""
    new = ctypes.pythonapi.PyCapsule_New
    new.restype = ctypes.py_object
    new.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    return new(1, signature, None)


def test_the_norm_of_nothing_is_zero():
    assert spectral_norm(sparse.csr_matrix((100, 100))) == 0


def test_two_extremes_of_nearly_the_same_size_do_not_confuse_the_norm(rng):
    diagonal = np.concatenate([[-1.0000001, 1.0], rng.uniform(-0.99, 0.99, 300)])
    assert spectral_norm(sparse.diags_array(diagonal).tocsr()) == pytest.approx(
        1.0000001, rel=1e-9
    )


# Both ways are backward stable: each finds the exact eigenvalues of a matrix within some eps |A|_2 of the given one,
# and by Weyl's inequality no eigenvalue is farther off than that.
EPS = np.finfo(np.float64).eps


def weighted(rng, n, mean_degree, weights):
    """The adjacency matrix of a random graph, shuffled, with the given weights of its edges."""
    src, dst = rng.integers(0, n, (2, n * mean_degree // 2))
    keep = src != dst
    half = sparse.coo_matrix(
        (weights(np.count_nonzero(keep)), (src[keep], dst[keep])), shape=(n, n)
    ).tocsr()
    return (half + half.T).tocsr()


def ring(n, reach=3):
    steps = [k for k in range(-reach, reach + 1) if k]
    return sum(sparse.csr_matrix(np.roll(np.eye(n), k, axis=1)) for k in steps).tocsr()


def rotated(rng, values):
    """A dense matrix with these eigenvalues."""
    Q, _ = qr(rng.normal(0, 1, (len(values), len(values))))
    dense = (Q * values) @ Q.T
    return sparse.csr_matrix((dense + dense.T) / 2)


def wilkinson(n):
    """W_n^+, whose largest eigenvalues come in pairs that agree to rounding."""
    return sparse.diags_array(
        [np.abs(np.arange(n) - n // 2), np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1, -1]
    ).tocsr()


def decades(rng, size):
    return 10.0 ** rng.uniform(-15, 0, size)


HARD = {
    "each eigenvalue of a ring twice": lambda rng, n: normalised_laplacian(ring(n)),
    "twenty equal pieces": lambda rng, n: sparse.block_diag(
        [normalised_laplacian(ring(n // 20))] * 20, format="csr"
    ),
    "a complete graph": lambda rng, n: normalised_laplacian(
        sparse.csr_matrix(np.ones((n, n)) - np.eye(n))
    ),
    "a star": lambda rng, n: normalised_laplacian(
        sparse.csr_matrix(
            (
                np.ones(2 * n - 2),
                ([0] * (n - 1) + [*range(1, n)], [*range(1, n)] + [0] * (n - 1)),
            )
        )
    ),
    "one eigenvalue and rounding": lambda rng, n: rotated(rng, 1 + EPS * rng.normal(0, 1, n)),
    "clusters 1e-12 wide": lambda rng, n: rotated(
        rng, rng.integers(0, 5, n) / 2 + 1e-12 * rng.normal(0, 1, n)
    ),
    "geometric over fifteen decades": lambda rng, n: rotated(rng, np.geomspace(1e-15, 1, n)),
    "Wilkinson's": lambda rng, n: wilkinson(n),
    "half of the nodes alone": lambda rng, n: sparse.block_diag(
        [
            normalised_laplacian(
                weighted(rng, n // 2, 8, lambda size: rng.uniform(0.1, 1, size))
            ),
            sparse.csr_matrix((n // 2, n // 2)),
        ],
        format="csr",
    ),
    "pieces of five nodes": lambda rng, n: sparse.block_diag(
        [
            normalised_laplacian(weighted(rng, 5, 4, lambda size: rng.uniform(0.1, 1, size)))
            for _ in range(n // 5)
        ],
        format="csr",
    ),
    "weights over fifteen decades": lambda rng, n: weighted(
        rng, n, 12, lambda size: decades(rng, size)
    ),
    "Laplacian of weights over fifteen decades": lambda rng, n: normalised_laplacian(
        weighted(rng, n, 12, lambda size: decades(rng, size))
    ),
    "change of such a Laplacian": lambda rng, n: (
        normalised_laplacian(weighted(rng, n, 12, lambda size: decades(rng, size)))
        - normalised_laplacian(weighted(rng, n, 12, lambda size: decades(rng, size)))
    ),
    "tiny": lambda rng, n: weighted(rng, n, 12, lambda size: 1e-200 * decades(rng, size)),
    "huge": lambda rng, n: weighted(rng, n, 12, lambda size: 1e100 * decades(rng, size)),
}


def error_in_eps(symmetric, width=spectrum.BAND_WIDTH):
    """The largest error of an eigenvalue against LAPACK's dense solver, over eps |A|_2.

    The usual bound of Householder's method is the number of nodes n; the largest error met is 0.7 n.
    """
    wanted = eigvalsh(symmetric.toarray())
    return np.abs(banded(symmetric, width) - wanted).max() / (EPS * np.abs(wanted).max())


@pytest.mark.parametrize("n", [100, 600])
@pytest.mark.parametrize("name", HARD)
def test_by_way_of_the_band_a_hard_spectrum_is_that_of_lapack(rng, name, n):
    assert error_in_eps(HARD[name](rng, n)) < n


@pytest.mark.parametrize("name", HARD)
def test_the_norm_of_a_hard_spectrum_is_that_of_lapack(rng, name):
    symmetric = HARD[name](rng, 200)
    wanted = np.abs(eigvalsh(symmetric.toarray())).max()
    assert abs(spectral_norm(symmetric) - wanted) < 100 * EPS * wanted


def test_ties_in_influence_go_by_point_id():
    # In a regular ring every node has the same influence.
    angle = 2 * np.pi * np.arange(12) / 12
    ring = subgraph(np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)]), k=2)
    small = subgraph(np.random.default_rng(0).normal(0, 1, (5, 3)), k=2)
    assert select_nodes(ring, small, SelectionSettings()).real_nodes.tolist() == [0, 1, 2, 3, 4]
