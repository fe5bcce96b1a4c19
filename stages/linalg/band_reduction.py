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
from typing import Any, NamedTuple

import numpy as np
import scipy

from ..arrays import FloatArray, IndexArray

Kernel = Callable[..., None]
Kernels = Mapping[str, Kernel]  #: names in BLAS and LAPACK
_SWEEPS = 3

#: Characters of the BLAS options left, right, upper, transposed and not transposed, as addresses.
_WORDS = np.frombuffer(b"LRUTN", dtype=np.uint8)
_L, _R, _U, _T, _N = (_WORDS.ctypes.data + i for i in range(len(_WORDS)))

#: Scalar factors of BLAS calls, as addresses.
_FACTORS = np.array([0.0, 1.0, -1.0, -0.5])
_ZERO, _ONE, _MINUS, _MINUS_HALF = (_FACTORS.ctypes.data + _FACTORS.itemsize * i for i in range(len(_FACTORS)))


def reduce_to_band(symmetric: scipy.sparse.csr_matrix, width: int, kernels: Kernels) -> FloatArray:
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
    work = _Work(band, width, most_rows, kernels)
    for block in blocks:
        _eliminate(work, block)
    return band[: width + 1]


@cache
def scipy_kernels() -> Kernels | None:
    """BLAS and LAPACK routines of the reduction from scipy's tables for C; None if their signatures differ.

    Each takes addresses only. scipy's own wrappers cannot work on a part of a matrix without copying it.
    """
    from scipy.linalg import cython_blas, cython_lapack

    homes: dict[str, Any] = dict.fromkeys(("dsymm", "dsyr2k", "dgemm", "dtrmm"), cython_blas)
    homes["dgeqrt3"] = cython_lapack
    return kernels_from({name: home.__pyx_capi__[name] for name, home in homes.items()})


def kernels_from(capsules: Mapping[str, object]) -> Kernels | None:
    """Routines that can be called with addresses; None if a routine does not take 32-bit integers.

    Parameters
    ----------
    capsules : by name, Python capsules whose names are the C signatures, as Cython exports them
    """
    kernels: dict[str, Kernel] = {}
    for name, capsule in capsules.items():
        signature: bytes = _capsule("GetName", ctypes.c_char_p, capsule)
        if b"int *" not in signature or b"long" in signature:
            return None
        address = _capsule("GetPointer", ctypes.c_void_p, capsule, signature)
        kernels[name] = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * signature.count(b"*"))(address)
    return kernels


def _capsule(what: str, result: Any, capsule: object, *more: bytes) -> Any:
    """The result of one of Python's C functions on capsules."""
    function = getattr(ctypes.pythonapi, f"PyCapsule_{what}")
    function.restype, function.argtypes = result, [ctypes.py_object, *[ctypes.c_char_p] * len(more)]
    return function(capsule, *more)


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
    n, reach = len(reach), reach.copy()
    height = int(np.max(reach - np.arange(n)))
    blocks = []
    for start in range(0, n - width - 1, width):
        column, row = start, start + width
        while row < n:
            n_columns = min(width, row - column)
            n_rows = int(reach[column + n_columns - 1]) - row + 1
            if n_rows <= 0:
                break
            last = int(reach[row + n_rows - 1])
            n_below = last - (row + n_rows) + 1
            blocks.append(_Block(row, column, n_rows, min(n_rows, n_columns), n_below))
            reach[row : row + n_rows] = last
            reach[column : column + n_columns] = np.minimum(row + np.arange(n_columns), row + n_rows - 1)
            height = max(height, row + n_rows - 1 - column, last - row)
            column, row = row, row + n_rows
    return blocks, height


class _Work:
    """Band matrix whose parts are passed to BLAS, and workspace.

    In band storage element (i, j) lies i + (ld - 1) j after element (0, 0): a part of the matrix is an ordinary
    column-major matrix of leading dimension ld - 1. BLAS takes a part by the address of its first element, no copy,
    and each number by an address, too: what is called many times must not be wrapped again each time.
    """

    def __init__(self, band: FloatArray, width: int, most_rows: int, kernels: Kernels) -> None:
        self.width, self.most_rows = width, max(most_rows, width)
        self.stride: int = band.shape[0] - 1
        self.flat = band.ravel(order="K")
        self.t, self.m = (np.empty((width, width), order="F") for _ in range(2))
        self.x, self.v = (np.empty((self.most_rows, width), order="F") for _ in range(2))
        self.y = np.empty((width, self.most_rows), order="F")
        self.is_below = np.tril(np.ones((width, width)), -1)
        self.unit = np.eye(width)
        self.info = np.zeros(1, dtype=np.intc)
        self.numbers = np.arange(max(self.stride, self.most_rows) + 1, dtype=np.intc)
        self._first: int = self.flat.ctypes.data
        self._first_number: int = self.numbers.ctypes.data
        self._bytes_per_number = self.numbers.itemsize
        self.call = kernels

    def at(self, row: int, column: int) -> int:
        """Address of an element."""
        return self._first + 8 * (row + self.stride * column)

    def number(self, value: int) -> int:
        """Address of a number from 0 to the largest dimension."""
        return self._first_number + self._bytes_per_number * value

    def part(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """View of a part of the matrix, (n_rows, n_columns)."""
        offset = 8 * (row + self.stride * column)
        return np.ndarray((n_rows, n_columns), np.float64, self.flat, offset, (8, 8 * self.stride))


def _eliminate(work: _Work, block: _Block) -> None:
    """Make a block upper triangular by reflections Q of its rows.

    Q is applied to all that these rows and, by symmetry, columns meet.
    """
    call, number, stride, width, most = work.call, work.number, work.stride, work.width, work.most_rows
    row, column, n_rows, n_columns, n_below = block
    x, y, v, t, m = (array.ctypes.data for array in (work.x, work.y, work.v, work.t, work.m))
    rows, k, ld, b, w = (number(value) for value in (n_rows, n_columns, stride, most, width))
    dgemm, dtrmm = call["dgemm"], call["dtrmm"]

    call["dgeqrt3"](rows, k, work.at(row, column), ld, t, w, work.info.ctypes.data)
    panel, vectors = work.part(row, column, n_rows, n_columns), work.v[:n_rows, :n_columns]
    is_below = work.is_below[:n_columns, :n_columns]
    vectors[:] = panel  # Householder vectors below, R above the diagonal
    vectors[:n_columns] *= is_below
    vectors[:n_columns] += work.unit[:n_columns, :n_columns]
    panel[:n_columns] *= 1.0 - is_below
    panel[n_columns:] = 0.0

    # From the left, on the columns between the panel and the diagonal block: C - V T^T (V^T C)
    n_beside = row - column - n_columns
    if n_beside > 0:
        columns, beside = number(n_beside), work.at(row, column + n_columns)
        dgemm(_T, _N, k, columns, rows, _ONE, v, b, beside, ld, _ZERO, y, w)
        dtrmm(_L, _U, _T, _N, k, columns, _ONE, t, w, y, w)
        dgemm(_N, _N, rows, columns, k, _MINUS, v, b, y, w, _ONE, beside, ld)

    # From both sides, on the diagonal block: A - V X^T - X V^T with W = A V T, X = W - V T^T V^T W / 2
    diagonal = work.at(row, row)
    call["dsymm"](_L, _L, rows, k, _ONE, diagonal, ld, v, b, _ZERO, x, b)
    dtrmm(_R, _U, _N, _N, rows, k, _ONE, t, w, x, b)
    dgemm(_T, _N, k, k, rows, _ONE, v, b, x, b, _ZERO, m, w)
    dtrmm(_L, _U, _T, _N, k, k, _ONE, t, w, m, w)
    dgemm(_N, _N, rows, k, k, _MINUS_HALF, v, b, m, w, _ONE, x, b)
    call["dsyr2k"](_L, _N, rows, k, _MINUS, v, b, x, b, _ONE, diagonal, ld)

    # From the right, on the rows below: C - (C V) T V^T; this makes the bulge
    if n_below > 0:
        others, below = number(n_below), work.at(row + n_rows, row)
        dgemm(_N, _N, others, k, rows, _ONE, below, ld, v, b, _ZERO, x, b)
        dtrmm(_R, _U, _N, _N, others, k, _ONE, t, w, x, b)
        dgemm(_N, _T, others, rows, k, _MINUS, x, b, v, b, _ONE, below, ld)


def _numbered(symmetric: scipy.sparse.csr_matrix) -> tuple[scipy.sparse.coo_matrix, IndexArray]:
    """Lower triangle with nodes numbered from end to end, and the last row of each column.

    Of two numberings the one of the narrower band, in the mean.
    """
    pairs = symmetric.tocoo()
    orders = scipy.sparse.csgraph.reverse_cuthill_mckee(symmetric, symmetric_mode=True), _from_end(symmetric)
    numberings = [_renumbered(pairs, order) for order in orders]
    return min(numberings, key=lambda numbering: int(numbering[1].sum()))


def _renumbered(pairs: scipy.sparse.coo_matrix, order: IndexArray) -> tuple[scipy.sparse.coo_matrix, IndexArray]:
    """Lower triangle with nodes in this order, and the last row of an element in each column or one before it."""
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order))
    row, column = place[pairs.row], place[pairs.col]
    is_lower = row >= column
    lower = scipy.sparse.coo_matrix((pairs.data[is_lower], (row[is_lower], column[is_lower])), pairs.shape)
    reach = np.arange(len(order))
    np.maximum.at(reach, lower.col, lower.row)
    return lower, np.maximum.accumulate(reach)


def _from_end(symmetric: scipy.sparse.csr_matrix) -> IndexArray:
    """Nodes in breadth-first order from a peripheral node; connected components one after the other."""
    start = 0
    for _ in range(_SWEEPS):
        order = scipy.sparse.csgraph.breadth_first_order(symmetric, start, directed=False, return_predecessors=False)
        start = int(order[-1])
    order = scipy.sparse.csgraph.breadth_first_order(symmetric, start, directed=False, return_predecessors=False)
    others = np.setdiff1d(np.arange(symmetric.shape[0]), order)
    return np.concatenate([order, others]).astype(np.intp)
