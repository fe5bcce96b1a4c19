"""Reduction of a sparse symmetric matrix to a narrow band with the same eigenvalues.

The nodes of an object, numbered from one end of it to the other, make a band matrix: its neighbours lie near each
other. Blocks of Householder reflections narrow the band, and what they push out of it is chased down and out at the
end, almost all of it in matrix-matrix products on blocks that fit the processor's cache. The direct way (LAPACK's
dsytrd) ignores the zeros and does half of its work in matrix-vector products, which wait for memory, the more so when
several processes share it. Both ways are backward stable and agree to rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy

from ..arrays import FloatArray, IndexArray

Kernel = Callable[..., None]
Kernels = Mapping[str, Kernel]  #: names in BLAS and LAPACK
_SEARCHES = 4  # each breadth-first, from the last node of the one before
_BYTES = 8  # of a float64

#: Characters of BLAS options and scalar factors of BLAS calls, and the addresses of each.
_OPTIONS = np.frombuffer(b"LRUTN", dtype=np.uint8)
_LEFT, _RIGHT, _UPPER, _T, _N = range(_OPTIONS.ctypes.data, _OPTIONS.ctypes.data + 5)
_LOWER = _LEFT
_FACTORS = np.array([0.0, 1.0, -1.0, -0.5])
_END = _FACTORS.ctypes.data + _FACTORS.nbytes
_ZERO, _ONE, _MINUS, _MINUS_HALF = range(_FACTORS.ctypes.data, _END, _BYTES)


def reduce_to_band(
    symmetric: scipy.sparse.csr_matrix, width: int, kernels: Kernels
) -> FloatArray:
    """Band matrix with the eigenvalues of a symmetric one, in LAPACK's lower band storage, (width + 1, n) float64.

    For each block of `width` columns, the QR factorisation of the part below the target band is
    Q = I - V T V^T, which is applied from both sides; the bulge that this makes below is treated the same way, block
    by block, until it leaves the matrix (Bischof, Lang and Sun, "A framework for symmetric band reduction", ACM TOMS
    26, 2000). Each block is as high as the matrix is wide there, not as its widest place. With b the mean of these
    widths this takes about 6 n^2 b operations; (4/3) n^3 without the band.

    Parameters
    ----------
    symmetric : (n, n) CSR float64; with n <= width there is nothing to reduce
    width : of the band, at least 1
    kernels : result of `scipy_kernels`
    """
    lower, reach = _numbered(symmetric)
    blocks, height = _blocks(reach, width)
    band = np.zeros((max(height, width) + 1, symmetric.shape[0]), order="F")
    band[lower.row - lower.col, lower.col] = lower.data
    most_rows = max((max(block.n_rows, block.n_below) for block in blocks), default=0)
    reduction = _Reduction(band, width, most_rows, kernels)
    for block in blocks:
        reduction.eliminate(block)
    return band[: width + 1]


@cache
def scipy_kernels() -> Kernels | None:
    """BLAS and LAPACK routines of the reduction from scipy's tables for C; None if their signatures differ.

    Each takes addresses only. scipy's own wrappers cannot work on a part of a matrix without copying it.
    """
    from scipy.linalg import cython_blas, cython_lapack

    capsules = cython_blas.__pyx_capi__ | cython_lapack.__pyx_capi__
    names = ("dsymm", "dsyr2k", "dgemm", "dtrmm", "dgeqrt3")
    return kernels_from({name: capsules[name] for name in names})


def kernels_from(capsules: Mapping[str, object]) -> Kernels | None:
    """Routines that can be called with addresses; None if a routine does not take 32-bit integers.

    Parameters
    ----------
    capsules : by name, Python capsules whose names are the C signatures, as Cython exports them
    """
    python = ctypes.pythonapi
    name_type = ctypes.PYFUNCTYPE(ctypes.c_char_p, ctypes.py_object)
    name_of = name_type(("PyCapsule_GetName", python))
    address_type = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)
    address_of = address_type(("PyCapsule_GetPointer", python))
    kernels: dict[str, Kernel] = {}
    for name, capsule in capsules.items():
        signature: bytes = name_of(capsule)
        if b"int *" not in signature or b"long" in signature:
            return None
        addresses = [ctypes.c_void_p] * signature.count(b"*")
        kernels[name] = ctypes.CFUNCTYPE(None, *addresses)(address_of(capsule, signature))
    return kernels


class _Block(NamedTuple):
    """Block to be made upper triangular: first row and column, numbers of rows and columns, and of rows below.

    `n_below` rows meet the columns that bear the numbers of this block's rows.
    """

    row: int
    column: int
    n_rows: int
    n_columns: int
    n_below: int


def _blocks(reach: IndexArray, width: int) -> tuple[list[_Block], int]:
    """Blocks in their order, and the largest distance of an element from the diagonal during the reduction.

    Parameters
    ----------
    reach : (n,) last row in which a column, or one before it, has an element
    width : width of the target band
    """
    n = len(reach)
    reach = reach.copy()
    height = int(np.max(reach - np.arange(n)))
    blocks = []
    for start in range(0, n - width - 1, width):
        column = start
        row = start + width
        while row < n:
            n_columns = min(width, row - column)
            n_rows = int(reach[column + n_columns - 1]) - row + 1
            if n_rows <= 0:
                break
            last = int(reach[row + n_rows - 1])
            n_below = last - (row + n_rows) + 1
            blocks.append(_Block(row, column, n_rows, min(n_rows, n_columns), n_below))
            reach[row : row + n_rows] = last
            last_rows = row + np.arange(n_columns)
            reach[column : column + n_columns] = np.minimum(last_rows, row + n_rows - 1)
            height = max(height, row + n_rows - 1 - column, last - row)
            column = row
            row += n_rows
    return blocks, height


class _Reduction:
    """Band matrix whose parts are passed to BLAS, and workspace.

    In band storage element (i, j) lies i + (ld - 1) j after element (0, 0): a part of the matrix is an ordinary
    column-major matrix of leading dimension ld - 1. BLAS takes a part by the addresses of its first element and of its
    leading dimension, no copy, and each number by an address, too: what is called many times must not be wrapped again
    each time.

    v, t : Householder vectors V and the factor T of a block, addresses as BLAS takes them
    x, y, m : products
    """

    def __init__(self, band: FloatArray, width: int, most_rows: int, kernels: Kernels) -> None:
        n_most = max(most_rows, width)
        self.call = kernels
        self.stride: int = band.shape[0] - 1
        self.flat = band.ravel(order="K")
        self.first: int = self.flat.ctypes.data
        self.numbers = np.arange(max(self.stride, n_most) + 1, dtype=np.intc)
        self.first_number: int = self.numbers.ctypes.data
        self.info = np.zeros(1, dtype=np.intc)
        self.is_below = np.tril(np.ones((width, width)), -1)
        self.unit = np.eye(width)
        self.parts = np.empty((5, width * n_most))
        self.vectors = self.parts[0].reshape((n_most, width), order="F")
        self.v = (self.parts[0].ctypes.data, self.number(n_most))
        self.x = (self.parts[1].ctypes.data, self.number(n_most))
        self.y = (self.parts[2].ctypes.data, self.number(width))
        self.t = (self.parts[3].ctypes.data, self.number(width))
        self.m = (self.parts[4].ctypes.data, self.number(width))

    def at(self, row: int, column: int) -> tuple[int, int]:
        """Addresses of an element, and of the leading dimension of parts of the band."""
        return self.first + _BYTES * (row + self.stride * column), self.number(self.stride)

    def number(self, value: int) -> int:
        """Address of a number from 0 to the largest dimension."""
        return self.first_number + self.numbers.itemsize * value

    def part(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """View of a part of the matrix, (n_rows, n_columns)."""
        offset = _BYTES * (row + self.stride * column)
        strides = (_BYTES, _BYTES * self.stride)
        return np.ndarray((n_rows, n_columns), np.float64, self.flat, offset, strides)

    def eliminate(self, block: _Block) -> None:
        """Make a block upper triangular by reflections Q of its rows.

        Q is applied to all that these rows and, by symmetry, columns meet.
        """
        n_beside = block.row - block.column - block.n_columns
        self.factorise(block)
        if n_beside > 0:
            self.apply_beside(block, n_beside)
        self.apply_to_diagonal(block)
        if block.n_below > 0:
            self.apply_below(block)

    def factorise(self, block: _Block) -> None:
        """QR factorisation of the block: R in its place, vectors and T in the workspace."""
        row, column, n_rows, n_columns, _ = block
        rows, k = map(self.number, (n_rows, n_columns))
        self.call["dgeqrt3"](rows, k, *self.at(row, column), *self.t, self.info.ctypes.data)
        panel = self.part(row, column, n_rows, n_columns)
        vectors = self.vectors[:n_rows, :n_columns]
        is_below = self.is_below[:n_columns, :n_columns]
        vectors[:] = panel  # Householder vectors below, R above the diagonal
        vectors[:n_columns] *= is_below
        vectors[:n_columns] += self.unit[:n_columns, :n_columns]
        panel[:n_columns] *= 1.0 - is_below
        panel[n_columns:] = 0.0

    def apply_beside(self, block: _Block, n_beside: int) -> None:
        """From the left, on the columns C between block and diagonal: C - V T^T (V^T C)."""
        rows, k, columns = map(self.number, (block.n_rows, block.n_columns, n_beside))
        beside = self.at(block.row, block.column + block.n_columns)
        dgemm = self.call["dgemm"]
        dgemm(_T, _N, k, columns, rows, _ONE, *self.v, *beside, _ZERO, *self.y)
        self.call["dtrmm"](_LEFT, _UPPER, _T, _N, k, columns, _ONE, *self.t, *self.y)
        dgemm(_N, _N, rows, columns, k, _MINUS, *self.v, *self.y, _ONE, *beside)

    def apply_to_diagonal(self, block: _Block) -> None:
        """From both sides, on the diagonal block A: A - V X^T - X V^T, W = A V T, X = W - V T^T V^T W / 2."""
        rows, k = map(self.number, (block.n_rows, block.n_columns))
        v, t, x, m = self.v, self.t, self.x, self.m
        diagonal = self.at(block.row, block.row)
        dgemm = self.call["dgemm"]
        dtrmm = self.call["dtrmm"]
        self.call["dsymm"](_LEFT, _LOWER, rows, k, _ONE, *diagonal, *v, _ZERO, *x)
        dtrmm(_RIGHT, _UPPER, _N, _N, rows, k, _ONE, *t, *x)
        dgemm(_T, _N, k, k, rows, _ONE, *v, *x, _ZERO, *m)
        dtrmm(_LEFT, _UPPER, _T, _N, k, k, _ONE, *t, *m)
        dgemm(_N, _N, rows, k, k, _MINUS_HALF, *v, *m, _ONE, *x)
        self.call["dsyr2k"](_LOWER, _N, rows, k, _MINUS, *v, *x, _ONE, *diagonal)

    def apply_below(self, block: _Block) -> None:
        """From the right, on the rows C below: C - (C V) T V^T; this makes the bulge."""
        rows, k, rows_below = map(self.number, (block.n_rows, block.n_columns, block.n_below))
        below = self.at(block.row + block.n_rows, block.row)
        dgemm = self.call["dgemm"]
        dgemm(_N, _N, rows_below, k, rows, _ONE, *below, *self.v, _ZERO, *self.x)
        self.call["dtrmm"](_RIGHT, _UPPER, _N, _N, rows_below, k, _ONE, *self.t, *self.x)
        dgemm(_N, _T, rows_below, rows, k, _MINUS, *self.x, *self.v, _ONE, *below)


def _numbered(symmetric: scipy.sparse.csr_matrix) -> tuple[scipy.sparse.coo_matrix, IndexArray]:
    """Lower triangle with nodes numbered from end to end, and the last row of each column, or one before it."""
    pairs = symmetric.tocoo()
    order = _from_end(symmetric)
    place = np.argsort(order)
    row = place[pairs.row]
    column = place[pairs.col]
    is_lower = row >= column
    ends = (row[is_lower], column[is_lower])
    lower = scipy.sparse.coo_matrix((pairs.data[is_lower], ends), pairs.shape)
    reach = np.arange(len(order))
    np.maximum.at(reach, lower.col, lower.row)
    return lower, np.maximum.accumulate(reach)


def _from_end(symmetric: scipy.sparse.csr_matrix) -> IndexArray:
    """Nodes in breadth-first order from a peripheral node; by reverse Cuthill-McKee if they are not connected."""
    search = scipy.sparse.csgraph.breadth_first_order
    last = 0
    for _ in range(_SEARCHES):
        order = search(symmetric, last, directed=False, return_predecessors=False)
        last = int(order[-1])
    if len(order) < symmetric.shape[0]:
        order = scipy.sparse.csgraph.reverse_cuthill_mckee(symmetric, symmetric_mode=True)
    return order.astype(int)
