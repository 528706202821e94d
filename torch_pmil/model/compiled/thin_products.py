"""Products of small matrices with arrays as long as the data, (d, n) with n a multiple of eight."""

from __future__ import annotations

from torch_pmil.model.compiled.building import Array, Array1, Array2, compiled
from torch_pmil.model.compiled.vectors import (
    LOG2_E,
    WIDTH,
    add,
    load,
    multiply,
    multiply_add,
    power_of_two,
    splat,
    spread,
    store,
    total,
)


@compiled
def fill(values: Array, number: float) -> None:
    """Write a number into all entries, as many as a multiple of eight."""
    for j in range(0, values.size, WIDTH):
        store(values, j, splat(number))


@compiled
def transform(matrix: Array2, values: Array2, out: Array2) -> None:
    """Write a matrix (k, d) times values (d, n) into ``out`` (k, n)."""
    rows, size, n = matrix.shape[0], matrix.shape[1], values.shape[1]
    for k in range(0, rows, 2):
        other = k + 1 if k + 1 < rows else k
        a, b = k * size, other * size
        for j in range(0, n, WIDTH):
            first = second = splat(0.0)
            for d in range(size):
                x = load(values, d * n + j)
                first = multiply_add(spread(matrix, a + d), x, first)
                second = multiply_add(spread(matrix, b + d), x, second)
            store(out, k * n + j, first)
            store(out, other * n + j, second)


@compiled
def outer_sums(a: Array2, b: Array2, out: Array2) -> None:
    """Write a b', the sums of a (k, n) times b (d, n) over the data, into ``out`` (k, d).

    Further rows of ``a`` are left out.
    """
    n, last = a.shape[1], out.shape[1] - 1
    for k in range(out.shape[0]):
        for d in range(0, last + 1, 4):
            d1 = d + 1 if d < last else last
            d2 = d + 2 if d + 1 < last else last
            d3 = d + 3 if d + 2 < last else last
            s0 = s1 = s2 = s3 = splat(0.0)
            for j in range(0, n, WIDTH):
                x = load(a, k * n + j)
                s0 = multiply_add(x, load(b, d * n + j), s0)
                s1 = multiply_add(x, load(b, d1 * n + j), s1)
                s2 = multiply_add(x, load(b, d2 * n + j), s2)
                s3 = multiply_add(x, load(b, d3 * n + j), s3)
            out[k, d], out[k, d1] = total(s0), total(s1)
            out[k, d2], out[k, d3] = total(s2), total(s3)


@compiled
def sum_products(a: Array1, b: Array1) -> float:
    """The sum of a (n,) times b (n,)."""
    sums = splat(0.0)
    for j in range(0, len(a), WIDTH):
        sums = multiply_add(load(a, j), load(b, j), sums)
    return total(sums)


@compiled
def scale_columns(values: Array2, factors: Array1, out: Array2) -> None:
    """Write values (d, n) times factors (n,) into ``out`` (d, n)."""
    n = values.shape[1]
    for d in range(values.shape[0]):
        for j in range(0, n, WIDTH):
            store(out, d * n + j, multiply(load(values, d * n + j), load(factors, j)))


@compiled
def write_forms(nu: Array2, transformed: Array2, constant: float, out: Array1) -> None:
    """Write a constant less half the forms nu_i' A nu_i into ``out`` (n,), A nu being known.

    They are exponents of e, and in ``out`` those of two.
    """
    n = nu.shape[1]
    for j in range(0, n, WIDTH):
        forms = splat(0.0)
        for d in range(nu.shape[0]):
            forms = multiply_add(load(nu, d * n + j), load(transformed, d * n + j), forms)
        store(out, j, multiply_add(splat(-0.5 * LOG2_E), forms, splat(LOG2_E * constant)))


@compiled
def write_powers(exponents: Array1, out: Array1) -> None:
    """Write two to the power of (n,) numbers into ``out``."""
    for j in range(0, len(out), WIDTH):
        store(out, j, power_of_two(load(exponents, j)))


@compiled
def multiply_entries(a: Array1, b: Array1, out: Array1) -> None:
    """Write a times b, entry by entry, into ``out`` (n,)."""
    for j in range(0, len(a), WIDTH):
        store(out, j, multiply(load(a, j), load(b, j)))


@compiled
def sum_entries(a: Array1) -> float:
    """The sum of a (n,)."""
    sums = splat(0.0)
    for j in range(0, len(a), WIDTH):
        sums = add(load(a, j), sums)
    return total(sums)


@compiled
def add_multiple(factor: float, a: Array, out: Array) -> None:
    """Add the factor times a to ``out``, of the same shape, with a multiple of eight entries."""
    for j in range(0, a.size, WIDTH):
        store(out, j, multiply_add(splat(factor), load(a, j), load(out, j)))
