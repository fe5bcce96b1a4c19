"""Reduces a sparse symmetric matrix to a narrow band with the same eigenvalues.

The nodes of an object, numbered from one end of it to the other, make a band matrix: its neighbours lie near each
other. Blocks of Householder reflections narrow the band, and what they push out of it is chased down and out at the
end, almost all of it in matrix-matrix products on blocks that fit the processor's cache. The direct way (LAPACK's
dsytrd) ignores the zeros and does half of its work in matrix-vector products, which wait for memory, the more so when
several processes share it. Both ways are backward stable and agree to rounding.

Leaves to others: the eigenvalues of the narrow band (`spectrum`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, reverse_cuthill_mckee

from .arrays import FloatArray, IndexArray

Kernel = Callable[..., None]
_SWEEPS = 3


def is_available() -> bool:
    """Whether scipy's BLAS can be called on parts of a matrix here."""
    return _kernels() is not None


def reduce_to_band(symmetric: sparse.csr_matrix, width: int) -> FloatArray:
    """A band matrix with the eigenvalues of a symmetric one, in LAPACK's lower band storage, (width + 1, n) float64.

    For each block of `width` columns, the QR factorisation of what lies below the wanted band gives
    Q = I - V T V^T, which is applied from both sides; the bulge that this makes below the old band is treated the same
    way, block by block, until it leaves the matrix (Bischof, Lang and Sun, "A framework for symmetric band reduction",
    ACM TOMS 26, 2000). With b the bandwidth of the numbered matrix this takes 6 n^2 b operations; (4/3) n^3 without
    the band.

    Parameters
    ----------
    symmetric : (n, n) CSR float64, n > width
    width : of the band, at least 1
    """
    lower, bandwidth = _numbered(symmetric)
    n, bandwidth = symmetric.shape[0], max(bandwidth, width)
    band = np.zeros((min(2 * bandwidth + width, n) + 1, n), order="F")
    band[lower.row - lower.col, lower.col] = lower.data
    work = _Work(band, width, bandwidth)
    for start in range(0, n - width - 1, width):
        column, row = start, start + width
        while row < n:
            rows = min(bandwidth, n - row)
            _eliminate(work, row, column, rows)
            column, row = row, row + rows
    return band[: width + 1]


class _Work:
    """A band matrix whose parts are handed to BLAS, and room for what is computed on the way.

    In band storage element (i, j) lies i + (ld - 1) j after element (0, 0): a part of the matrix is an ordinary
    column-major matrix of leading dimension ld - 1.
    """

    def __init__(self, band: FloatArray, width: int, bandwidth: int) -> None:
        self.n = band.shape[1]
        self.width = width
        self.bandwidth = bandwidth
        self.stride = band.shape[0] - 1
        self.flat = band.ravel(order="K")
        self.tau, self.scratch = np.empty(width), np.empty(64 * bandwidth)
        self.t, self.m = np.empty((width, width), order="F"), np.empty((width, width), order="F")
        self.x, self.y = np.empty((bandwidth, width), order="F"), np.empty((width, bandwidth), order="F")
        self.v = np.empty((bandwidth, width), order="F")
        kernels = _kernels()
        if kernels is None:
            raise RuntimeError("scipy's BLAS routines have other signatures here; ask is_available first")
        self.call = kernels

    def at(self, row: int, column: int) -> ctypes.c_void_p:
        """The address of an element: BLAS takes a part of a matrix by its first element, no copy."""
        return ctypes.c_void_p(self.flat.ctypes.data + 8 * (row + self.stride * column))

    def part(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """A part of the matrix, (n_rows, n_columns), a view."""
        first = self.flat[row + self.stride * column :]
        return as_strided(first, (n_rows, n_columns), (8, 8 * self.stride))


def _eliminate(work: _Work, row: int, column: int, rows: int) -> None:
    """Makes the block of `rows` x `width` at (row, column) upper triangular, by reflections Q of these rows.

    Q is applied to all that these rows and, by symmetry, columns meet inside the band.
    """
    call, width, ld, b = work.call, work.width, work.stride, work.bandwidth
    k = min(rows, width)
    call["dgeqrf"](rows, width, work.at(row, column), ld, work.tau, work.scratch, len(work.scratch), 0)
    panel, v = work.part(row, column, rows, k), work.v
    v[:rows, :k] = panel
    for i in range(k):  # Householder vectors below, R above the diagonal
        v[:i, i] = 0.0
        v[i, i] = 1.0
        panel[i + 1 :, i] = 0.0
    call["dlarft"](b"F", b"C", rows, k, v, b, work.tau, work.t, width)

    # From the left, on the columns between the panel and the diagonal block: C - V T^T (V^T C)
    beside, n_beside = column + width, row - column - width
    if n_beside > 0:
        y = work.y
        call["dgemm"](b"T", b"N", k, n_beside, rows, 1.0, v, b, work.at(row, beside), ld, 0.0, y, width)
        call["dtrmm"](b"L", b"U", b"T", b"N", k, n_beside, 1.0, work.t, width, y, width)
        call["dgemm"](b"N", b"N", rows, n_beside, k, -1.0, v, b, y, width, 1.0, work.at(row, beside), ld)

    # From both sides, on the diagonal block: A - V X^T - X V^T with W = A V T, X = W - V T^T V^T W / 2
    x, m, diagonal = work.x, work.m, work.at(row, row)
    call["dsymm"](b"L", b"L", rows, k, 1.0, diagonal, ld, v, b, 0.0, x, b)
    call["dtrmm"](b"R", b"U", b"N", b"N", rows, k, 1.0, work.t, width, x, b)
    call["dgemm"](b"T", b"N", k, k, rows, 1.0, v, b, x, b, 0.0, m, width)
    call["dtrmm"](b"L", b"U", b"T", b"N", k, k, 1.0, work.t, width, m, width)
    call["dgemm"](b"N", b"N", rows, k, k, -0.5, v, b, m, width, 1.0, x, b)
    call["dsyr2k"](b"L", b"N", rows, k, -1.0, v, b, x, b, 1.0, diagonal, ld)

    # From the right, on the rows below: C - (C V) T V^T; this makes the bulge
    n_below = min(b, work.n - row - rows)
    if n_below > 0:
        below = work.at(row + rows, row)
        call["dgemm"](b"N", b"N", n_below, k, rows, 1.0, below, ld, v, b, 0.0, x, b)
        call["dtrmm"](b"R", b"U", b"N", b"N", n_below, k, 1.0, work.t, width, x, b)
        call["dgemm"](b"N", b"T", n_below, rows, k, -1.0, x, b, v, b, 1.0, below, ld)


def _numbered(symmetric: sparse.csr_matrix) -> tuple[sparse.coo_matrix, int]:
    """The lower triangle with nodes numbered from end to end, and its bandwidth: the better of two numberings."""
    pairs = symmetric.tocoo()
    orders = reverse_cuthill_mckee(symmetric, symmetric_mode=True), _from_end(symmetric)
    best_row, best_column = min((_places(pairs, order) for order in orders), key=_bandwidth)
    is_lower = best_row >= best_column
    lower = sparse.coo_matrix((pairs.data[is_lower], (best_row[is_lower], best_column[is_lower])), pairs.shape)
    return lower, _bandwidth((best_row, best_column))


def _places(pairs: sparse.coo_matrix, order: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Row and column of each entry when nodes stand in this order."""
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order))
    return place[pairs.row], place[pairs.col]


def _bandwidth(places: tuple[IndexArray, IndexArray]) -> int:
    return int(np.max(np.abs(places[0] - places[1]), initial=0))


def _from_end(symmetric: sparse.csr_matrix) -> IndexArray:
    """All nodes in breadth-first order from one that is far from others; parts that hang apart one after the other."""
    start = 0
    for _ in range(_SWEEPS):
        order = breadth_first_order(symmetric, start, directed=False, return_predecessors=False)
        start = int(order[-1])
    order = breadth_first_order(symmetric, start, directed=False, return_predecessors=False)
    others = np.setdiff1d(np.arange(symmetric.shape[0]), order)
    found: IndexArray = np.concatenate([order, others]).astype(np.intp)
    return found


@cache
def _kernels() -> dict[str, Kernel] | None:
    """The BLAS and LAPACK routines of the reduction, from the tables that scipy has for C; None if they are others.

    scipy's own wrappers cannot work on a part of a matrix without copying it.
    """
    from scipy.linalg import cython_blas, cython_lapack

    homes: dict[str, Any] = dict.fromkeys(("dsymm", "dsyr2k", "dgemm", "dtrmm"), cython_blas)
    homes |= dict.fromkeys(("dgeqrf", "dlarft"), cython_lapack)
    kernels = {}
    for name, home in homes.items():
        capsule = home.__pyx_capi__[name]
        signature: bytes = _capsule("GetName", ctypes.c_char_p, capsule)
        if b"int *" not in signature or b"long" in signature:
            return None
        address = _capsule("GetPointer", ctypes.c_void_p, capsule, signature)
        kernels[name] = _by_reference(ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * signature.count(b"*"))(address))
    return kernels


def _capsule(what: str, result: Any, capsule: object, *more: bytes) -> Any:
    function = getattr(ctypes.pythonapi, f"PyCapsule_{what}")
    function.restype, function.argtypes = result, [ctypes.py_object, *[ctypes.c_char_p] * len(more)]
    return function(capsule, *more)


def _by_reference(routine: Callable[..., None]) -> Kernel:
    """The routine, taking plain numbers, characters and arrays: Fortran wants the address of each."""
    kinds: dict[type, Any] = {int: ctypes.c_int, float: ctypes.c_double, bytes: ctypes.c_char}

    def call(*values: Any) -> None:
        arguments: list[Any] = []
        for value in values:
            if isinstance(value, np.ndarray):
                arguments.append(ctypes.c_void_p(value.ctypes.data))
            elif isinstance(value, ctypes.c_void_p):
                arguments.append(value)
            else:
                arguments.append(ctypes.byref(kinds[type(value)](value)))
        routine(*arguments)

    return call
