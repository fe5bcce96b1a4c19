import ctypes

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigvalsh

from fidpipe.schemas.settings import GraphSettings
from fidpipe.stages.graph import build_graph
from fidpipe.stages.linalg.band_reduction import kernels_from
from fidpipe.stages.linalg.laplacian import normalised_laplacian
from fidpipe.stages.linalg.spectrum import BANDED_FROM_NODES, eigenvalues, spectral_norm
from fidpipe.stages.linalg.subgraph import adjacency


def laplacian(points, k=8):
    return normalised_laplacian(adjacency(len(points), build_graph(points, GraphSettings(k=k))))


def banded(symmetric, **options):
    """The eigenvalues by way of the band, however small the matrix."""
    return eigenvalues(symmetric, banded_from_nodes=0, **options)


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
    dense = np.where(np.abs(row - column) <= np.minimum(reach[row], reach[column]), rng.normal(0, 1, (n, n)), 0)
    dense += dense.T
    np.testing.assert_allclose(banded(sparse.csr_matrix(dense)), np.linalg.eigvalsh(dense), atol=1e-11)


def test_without_the_routines_for_parts_of_matrices_the_direct_way_is_taken(rng):
    L = laplacian(rng.normal(0, 1, (90, 3)))
    direct = eigvalsh(L.toarray(order="F"))
    np.testing.assert_array_equal(banded(L, find_kernels=lambda: None), direct)
    assert not np.array_equal(banded(L), direct)  # to the last bit they do differ


@pytest.mark.parametrize("signature", [b"void (char *, long *, double *)", b"void (char *, double *)"])
def test_routines_with_other_integers_are_not_called(signature):
    assert kernels_from({"dgemm": capsule(signature)}) is None


def capsule(signature):
    """A capsule as Cython exports C functions, with this signature."""
    new = ctypes.pythonapi.PyCapsule_New
    new.restype, new.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    return new(1, signature, None)


def test_a_large_object_takes_the_band_and_agrees_with_the_direct_way(rng):
    L = laplacian(rng.uniform(0, 1, (BANDED_FROM_NODES + 1, 3)) * [20, 2, 1], k=12)
    np.testing.assert_allclose(eigenvalues(L), np.linalg.eigvalsh(L.toarray()), atol=1e-12)


def test_the_norm_of_nothing_is_zero():
    assert spectral_norm(sparse.csr_matrix((100, 100))) == 0


def test_the_largest_negative_eigenvalue_counts_too():
    assert spectral_norm(sparse.diags_array(np.linspace(-3, 1, 90)).tocsr()) == pytest.approx(3)


def test_two_extremes_of_nearly_the_same_size_do_not_confuse_the_norm(rng):
    diagonal = np.concatenate([[-1.0000001, 1.0], rng.uniform(-0.99, 0.99, 300)])
    assert spectral_norm(sparse.diags_array(diagonal).tocsr()) == pytest.approx(1.0000001, rel=1e-9)
