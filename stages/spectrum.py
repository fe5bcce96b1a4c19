"""All eigenvalues, and the spectral norm, of sparse symmetric matrices.

Leaves to others: which matrices (`laplacian`), what their spectra say (`metrics`).

Large matrices are tridiagonalised in two stages: blocks of Householder reflections reduce the dense matrix to a band,
almost all of it in matrix-matrix products; LAPACK then takes the narrow band. The direct way (LAPACK's dsytrd) does
half of its work in matrix-vector products, which wait for memory, the more so when several processes share it. Both
ways are backward stable and agree to rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigvals_banded, eigvalsh
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from .arrays import FloatArray

_TWO_STAGE_NODES = 2200
_BAND_WIDTH = 40
_DENSE_NORM_NODES = 64

Kernel = Callable[..., None]


def eigenvalues(symmetric: sparse.csr_matrix) -> FloatArray:
    """All eigenvalues in ascending order, (n,) float64, to working precision.

    Parameters
    ----------
    symmetric : (n, n) CSR float64
    """
    dense: FloatArray = symmetric.toarray(order="F")
    kernels = _kernels() if len(dense) >= _TWO_STAGE_NODES else None
    if kernels is None:
        found: FloatArray = eigvalsh(dense, overwrite_a=True, check_finite=False)
    else:
        band = _reduce_to_band(dense, _BAND_WIDTH, kernels)
        found = eigvals_banded(band, lower=True, overwrite_a_band=True, check_finite=False)
    return found


def spectral_norm(symmetric: sparse.csr_matrix) -> float:
    """The largest absolute eigenvalue, by Lanczos iteration to machine precision.

    Parameters
    ----------
    symmetric : (n, n) CSR float64
    """
    n = symmetric.shape[0]
    if symmetric.count_nonzero() == 0:
        return 0.0
    if n > _DENSE_NORM_NODES:
        start = np.random.default_rng(0).standard_normal(n)
        try:
            return float(abs(eigsh(symmetric, k=1, which="LM", v0=start, return_eigenvectors=False)[0]))
        except ArpackNoConvergence:
            pass  # a crowded edge of the spectrum; the dense way always ends
    return float(np.max(np.abs(eigvalsh(symmetric.toarray(), check_finite=False))))


def _reduce_to_band(a: FloatArray, width: int, kernels: dict[str, Kernel]) -> FloatArray:
    """A band matrix with the eigenvalues of a symmetric one, in LAPACK's lower band storage, (width + 1, n).

    For each block of `width` columns, the QR factorisation of what lies below the band gives Q = I - V T V^T, and the
    rest of the matrix becomes Q^T A Q = A - V X^T - X V^T with W = A V T, X = W - V T^T V^T W / 2 (Bischof, Lang and
    Sun, ACM TOMS 26, 2000, algorithm 807; LAPACK's dsytrd_sy2sb).

    Parameters
    ----------
    a : (n, n) float64, Fortran order; overwritten, only the lower triangle is read
    """
    n = len(a)
    width = min(width, n - 1)
    tau, work, t, m = np.empty(width), np.empty(64 * n), np.empty((width, width), order="F"), np.empty((width, width))
    x = np.empty((n, width), order="F")
    for start in range(0, n - width - 1, width):
        row = start + width
        rest = n - row
        p = min(rest, width)
        panel, trailing = _at(a, row, start), _at(a, row, row)
        kernels["dgeqrf"](rest, width, panel, n, tau, work, len(work), 0)
        v = np.asfortranarray(np.tril(a[row:, start : start + p], -1))
        v[np.arange(p), np.arange(p)] = 1.0
        kernels["dlarft"](b"F", b"C", rest, p, v, rest, tau, t, width)
        kernels["dsymm"](b"L", b"L", rest, p, 1.0, trailing, n, v, rest, 0.0, x, n)
        kernels["dtrmm"](b"R", b"U", b"N", b"N", rest, p, 1.0, t, width, x, n)
        kernels["dgemm"](b"T", b"N", p, p, rest, 1.0, v, rest, x, n, 0.0, m, width)
        kernels["dtrmm"](b"L", b"U", b"T", b"N", p, p, 1.0, t, width, m, width)
        kernels["dgemm"](b"N", b"N", rest, p, p, -0.5, v, rest, m, width, 1.0, x, n)
        kernels["dsyr2k"](b"L", b"N", rest, p, -1.0, v, rest, x, n, 1.0, trailing, n)
    band = np.zeros((width + 1, n), order="F")
    for below in range(width + 1):
        band[below, : n - below] = np.diagonal(a, -below)
    return band


def _at(a: FloatArray, row: int, column: int) -> ctypes.c_void_p:
    """The address of an element: BLAS takes a part of a matrix by its first element, no copy."""
    return ctypes.c_void_p(a.ctypes.data + a.strides[0] * row + a.strides[1] * column)


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
