"""Products and factors of the small matrices of one time step."""

from __future__ import annotations

from math import log, nan, sqrt

from torch_pmil.model.compiled.building import Array1, Array2, compiled


@compiled
def product(a: Array2, b: Array2, out: Array2) -> None:
    """Write a b into ``out``."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            entry = 0.0
            for k in range(a.shape[1]):
                entry += a[i, k] * b[k, j]
            out[i, j] = entry


@compiled
def product_of_transpose(a: Array2, b: Array2, out: Array2) -> None:
    """Write a' b into ``out``."""
    for i in range(a.shape[1]):
        for j in range(b.shape[1]):
            entry = 0.0
            for k in range(a.shape[0]):
                entry += a[k, i] * b[k, j]
            out[i, j] = entry


@compiled
def product_with_transpose(a: Array2, b: Array2, out: Array2) -> None:
    """Write a b' into ``out``."""
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            entry = 0.0
            for k in range(a.shape[1]):
                entry += a[i, k] * b[j, k]
            out[i, j] = entry


@compiled
def times_vector(a: Array2, x: Array1, out: Array1) -> None:
    """Write a x into ``out``."""
    for i in range(a.shape[0]):
        entry = 0.0
        for k in range(a.shape[1]):
            entry += a[i, k] * x[k]
        out[i] = entry


@compiled
def make_symmetric(a: Array2) -> None:
    """Replace a square matrix by its symmetric part."""
    for i in range(a.shape[0]):
        for j in range(i):
            a[i, j] = a[j, i] = (a[i, j] + a[j, i]) / 2


@compiled
def scale(a: Array2, factor: float) -> None:
    """Multiply a matrix by a factor."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            a[i, j] *= factor


@compiled
def add(a: Array2, out: Array2) -> None:
    """Add a matrix to ``out``."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] += a[i, j]


@compiled
def copy(a: Array2, out: Array2) -> None:
    """Write a matrix into ``out``."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j]


@compiled
def invert(a: Array2) -> float:
    """Replace a symmetric positive definite matrix by its inverse; return half its log determinant.

    NaN where it has no Cholesky factor; the matrix is then of no use.
    """
    size, half_log_det = a.shape[0], 0.0
    for j in range(size):
        pivot = a[j, j]
        for k in range(j):
            pivot -= a[j, k] * a[j, k]
        if not pivot > 0.0:
            return nan
        pivot = sqrt(pivot)
        half_log_det += log(pivot)
        a[j, j] = 1.0 / pivot
        for i in range(j + 1, size):
            entry = a[i, j]
            for k in range(j):
                entry -= a[i, k] * a[j, k]
            a[i, j] = entry / pivot
    _invert_factor(a)
    return half_log_det


@compiled
def _invert_factor(a: Array2) -> None:
    """From a factor L, with inverse diagonal, in the lower triangle to (L L')^-1."""
    size = a.shape[0]
    for j in range(size):
        for i in range(j + 1, size):
            entry = 0.0
            for k in range(j, i):
                entry -= a[i, k] * a[k, j]
            a[i, j] = entry * a[i, i]
    for i in range(size):
        for j in range(i + 1):
            entry = 0.0
            for k in range(i, size):
                entry += a[k, i] * a[k, j]
            a[i, j] = a[j, i] = entry
