"""The band solver against LAPACK where eigenvalues are hard to tell apart; errors in units of eps |A|_2.

Both ways are backward stable: each finds the exact eigenvalues of a matrix within some eps |A|_2 of the given one, and
by Weyl's inequality no eigenvalue is farther off than that, however the spectrum lies.
"""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigvalsh, qr

from fidpipe.stages.linalg.laplacian import normalised_laplacian
from fidpipe.stages.linalg.spectrum import eigenvalues, spectral_norm

EPS = np.finfo(np.float64).eps


def weighted(rng, n, mean_degree, weights):
    """The adjacency matrix of a random graph, shuffled, with the given weights of its edges."""
    src, dst = rng.integers(0, n, (2, n * mean_degree // 2))
    keep = src != dst
    half = sparse.coo_matrix((weights(np.count_nonzero(keep)), (src[keep], dst[keep])), shape=(n, n)).tocsr()
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
    "twenty equal pieces": lambda rng, n: sparse.block_diag([normalised_laplacian(ring(n // 20))] * 20, format="csr"),
    "a complete graph": lambda rng, n: normalised_laplacian(sparse.csr_matrix(np.ones((n, n)) - np.eye(n))),
    "a star": lambda rng, n: normalised_laplacian(
        sparse.csr_matrix((np.ones(2 * n - 2), ([0] * (n - 1) + [*range(1, n)], [*range(1, n)] + [0] * (n - 1))))
    ),
    "one eigenvalue and rounding": lambda rng, n: rotated(rng, 1 + EPS * rng.normal(0, 1, n)),
    "clusters 1e-12 wide": lambda rng, n: rotated(rng, rng.integers(0, 5, n) / 2 + 1e-12 * rng.normal(0, 1, n)),
    "geometric over fifteen decades": lambda rng, n: rotated(rng, np.geomspace(1e-15, 1, n)),
    "Wilkinson's": lambda rng, n: wilkinson(n),
    "half of the nodes alone": lambda rng, n: sparse.block_diag(
        [
            normalised_laplacian(weighted(rng, n // 2, 8, lambda size: rng.uniform(0.1, 1, size))),
            sparse.csr_matrix((n // 2, n // 2)),
        ],
        format="csr",
    ),
    "pieces of five nodes": lambda rng, n: sparse.block_diag(
        [normalised_laplacian(weighted(rng, 5, 4, lambda size: rng.uniform(0.1, 1, size))) for _ in range(n // 5)],
        format="csr",
    ),
    "weights over fifteen decades": lambda rng, n: weighted(rng, n, 12, lambda size: decades(rng, size)),
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


def most_eps(n):
    """Bound of the error: n eps |A|, the usual bound of Householder's method (the largest error met is 0.7 n)."""
    return n


def error_in_eps(symmetric, **options):
    """The largest error of an eigenvalue against LAPACK's dense solver, over eps |A|_2."""
    wanted = eigvalsh(symmetric.toarray())
    return np.abs(eigenvalues(symmetric, banded_from_nodes=0, **options) - wanted).max() / (EPS * np.abs(wanted).max())


@pytest.mark.parametrize("n", [100, 600])
@pytest.mark.parametrize("name", HARD)
def test_by_way_of_the_band_a_hard_spectrum_is_that_of_lapack(rng, name, n):
    assert error_in_eps(HARD[name](rng, n)) < most_eps(n)


@pytest.mark.parametrize("width", [1, 5, 64])
@pytest.mark.parametrize("name", ["twenty equal pieces", "clusters 1e-12 wide", "weights over fifteen decades"])
def test_so_it_is_whatever_the_width_of_the_band(rng, name, width):
    assert error_in_eps(HARD[name](rng, 200), band_width=width) < most_eps(200)


@pytest.mark.parametrize("name", HARD)
def test_the_norm_of_a_hard_spectrum_is_that_of_lapack(rng, name):
    symmetric = HARD[name](rng, 200)
    wanted = np.abs(eigvalsh(symmetric.toarray())).max()
    assert abs(spectral_norm(symmetric) - wanted) < 100 * EPS * wanted


def test_a_wrong_eigenvalue_would_be_seen(rng):
    symmetric = HARD["clusters 1e-12 wide"](rng, 100)
    spoilt = symmetric + sparse.coo_matrix(([1e-13], ([3], [3])), shape=symmetric.shape)
    wanted = eigvalsh(symmetric.toarray())
    assert np.abs(eigenvalues(spoilt.tocsr(), banded_from_nodes=0) - wanted).max() < 1e-12
    spoilt = symmetric + sparse.coo_matrix(([1e-11], ([3], [3])), shape=symmetric.shape)
    far = np.abs(eigenvalues(spoilt.tocsr(), banded_from_nodes=0) - wanted).max()
    assert far > most_eps(100) * EPS * np.abs(wanted).max()
