"""Exponentials and sums of eight numbers at a time, and of small matrices."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from torch_pmil.model.compiled.building import KERNELS, Array1, Array2, Kernel
from torch_pmil.model.compiled.small_matrices import (
    invert,
    make_symmetric,
    product,
    product_of_transpose,
    product_with_transpose,
    times_vector,
)
from torch_pmil.model.compiled.thin_products import (
    add_multiple,
    fill,
    multiply_entries,
    outer_sums,
    scale_columns,
    sum_entries,
    sum_products,
    transform,
    write_forms,
    write_powers,
)
from torch_pmil.model.compiled.vectors import (
    _BEYOND,
    _LEAST,
    LOG2_E,
    WIDTH,
    load,
    sines_and_cosines,
    store,
)

Array = NDArray[np.float64]


@Kernel
def powers(exponents: Array1, out: Array1) -> bool:
    write_powers(exponents, out)
    return True


@Kernel
def waves(turns: Array1, sines: Array1, cosines: Array1) -> bool:
    for j in range(0, len(turns), WIDTH):
        sine, cosine = sines_and_cosines(load(turns, j))
        store(sines, j, sine)
        store(cosines, j, cosine)
    return True


@Kernel
def matrix_products(
    a: Array2, b: Array2, c: Array2, x: Array1, ab: Array2, ac: Array2, cb: Array2, ax: Array1
) -> bool:
    product(a, b, ab)
    product_of_transpose(a, c, ac)
    product_with_transpose(c, b, cb)
    times_vector(a, x, ax)
    return True


@Kernel
def inverted(a: Array2, half_log_det: Array1) -> bool:
    make_symmetric(a)
    half_log_det[0] = invert(a)
    return True


@Kernel
def sums_over_data(
    matrix: Array2, a: Array2, b: Array2, transformed: Array2, outer: Array2, sums: Array1
) -> bool:
    transform(matrix, a, transformed)
    outer_sums(a, b, outer)
    sums[0], sums[1] = sum_products(a[0], b[0]), sum_entries(a[0])
    return True


@Kernel
def entry_by_entry(a: Array2, b: Array1, scaled: Array2, products: Array1, forms: Array1) -> bool:
    scale_columns(a, b, scaled)
    multiply_entries(a[0], b, products)
    fill(forms, 7.0)
    write_forms(a, scaled, 3.0, forms)
    add_multiple(-1.5, a[0], forms)
    return True


del KERNELS[-6:]  # they are no part of the prediction


def powers_of(exponents: Array) -> Array:
    padded = np.zeros(len(exponents) + -len(exponents) % 8)
    padded[: len(exponents)] = exponents
    out = np.empty_like(padded)
    powers(padded, out)
    return out[: len(exponents)]


def errors_in_ulp(exponents: Array) -> Array:
    """Errors of 2^x beside fifty digits, in units of the last place of the double next to it."""
    with mpmath.workdps(50):
        truth = [mpmath.mpf(2) ** float(x) for x in exponents]
        units = np.spacing(np.array([float(value) for value in truth]))
        ours = powers_of(exponents)
        pairs = zip(ours, truth, units, strict=True)
        return np.array([float(abs((mpmath.mpf(y) - t) / u)) for y, t, u in pairs])


def neighbours(x: Array) -> Array:
    """Numbers, and those next to them."""
    return np.concatenate([np.nextafter(x, -np.inf), x, np.nextafter(x, np.inf)])


LARGEST = np.nextafter(_BEYOND, -np.inf)


def test_power_of_two_is_within_two_ulp_of_all_that_are_normal() -> None:
    ends = np.arange(-1021, 1024) + 0.5  # of the interval to which x is reduced
    grid = np.linspace(_LEAST, LARGEST, 30_011)
    near_zero = np.concatenate([sign * np.logspace(-320, -1, 640) for sign in (-1, 1)])
    x = np.concatenate([grid, neighbours(ends), near_zero])
    x = x[(x >= _LEAST) & (x <= LARGEST)]
    errors = errors_in_ulp(x)
    print(f"largest error {errors.max():.2f} ulp at {x[errors.argmax()]!r}")
    assert errors.max() <= 2


def test_power_of_two_at_the_ends_of_its_range() -> None:
    assert (errors_in_ulp(np.array([_LEAST, 0.0, LARGEST])) <= 2).all()
    beyond = np.array([_BEYOND, 1025.0, 1e300, np.inf])
    below = np.array([np.nextafter(_LEAST, -np.inf), -1023.0, -1075.2, -1e300, -np.inf])
    assert not np.isfinite(powers_of(beyond)).any()
    assert (powers_of(below) == powers_of(np.array([_LEAST]))).all()
    assert np.exp2(below[0]) < 3e-308  # what is lost


def test_power_of_two_of_nan_is_nan_and_leaves_its_neighbours() -> None:
    x = np.arange(16.0)
    x[5], x[9] = np.nan, -np.nan
    known = ~np.isnan(x)
    assert (np.isnan(powers_of(x)) == ~known).all()
    np.testing.assert_allclose(powers_of(x)[known], np.exp2(x[known]), rtol=5e-16)


def test_sines_and_cosines_are_those_of_fifty_digits() -> None:
    """In all quarters, on both sides of their borders, and after many turns."""
    borders = np.arange(-9, 10) / 2
    many = np.array([1e3 + 0.3, -1e6 + 0.7, 2.0**40 + 0.5, -(2.0**50) + 1.0])
    turns = np.concatenate([np.linspace(-5, 5, 1001), neighbours(borders), many])
    turns = np.concatenate([turns, np.zeros(-len(turns) % WIDTH)])
    sines, cosines = np.empty_like(turns), np.empty_like(turns)
    waves(turns, sines, cosines)
    with mpmath.workdps(50):
        angles = [mpmath.pi / 2 * mpmath.mpf(float(turn)) for turn in turns]
        for ours, exact in ((sines, mpmath.sin), (cosines, mpmath.cos)):
            errors = [abs(mpmath.mpf(y) - exact(a)) for y, a in zip(ours, angles, strict=True)]
            assert max(errors) <= 2 * np.finfo(float).eps


def test_sine_and_cosine_of_nan_are_nan() -> None:
    turns = np.where(np.arange(8) == 3, np.nan, 1.0)
    sines, cosines = np.empty(8), np.empty(8)
    waves(turns, sines, cosines)
    for each in (sines, cosines):
        assert (np.isnan(each) == np.isnan(turns)).all()


def assert_rounded(ours: Array, expected: Array, of_magnitudes: Array, terms: int) -> None:
    """The difference of two sums is within a rounding of each of their terms."""
    unit = np.finfo(float).eps
    assert (abs(ours - expected) <= 2 * terms * unit * of_magnitudes).all()


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 4), (5, 2, 7), (8, 8, 8)])
def test_products_of_matrices_are_those_of_numpy(shape: tuple[int, int, int]) -> None:
    rng, (k, m, n) = np.random.default_rng(0), shape
    a, b, c = (rng.normal(size=size) for size in ((k, m), (m, n), (k, n)))
    x, out = rng.normal(size=m), [np.empty(size) for size in ((k, n), (m, n), (k, m), (k,))]
    matrix_products(a, b, c, x, *out)
    factors = (a, b), (a.T, c), (c, b.T), (a, x)
    for ours, (left, right) in zip(out, factors, strict=True):
        assert_rounded(ours, left @ right, abs(left) @ abs(right), left.shape[1])


@pytest.mark.parametrize("size", range(1, 12))
def test_inverse_and_determinant_are_those_of_numpy(size: int) -> None:
    root = np.random.default_rng(size).normal(size=(size, 2 * size))
    a, half_log_det = root @ root.T, np.empty(1)
    ours = np.array(a)
    inverted(ours, half_log_det)
    unit = size * np.linalg.cond(a) * np.finfo(float).eps
    np.testing.assert_allclose(ours @ a, np.eye(size), atol=unit)
    np.testing.assert_allclose(half_log_det, np.linalg.slogdet(a)[1] / 2, rtol=unit, atol=unit)
    assert (ours == ours.T).all()


@pytest.mark.parametrize("entry", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("place", range(3))
def test_matrix_without_cholesky_factor_is_told(entry: float, place: int) -> None:
    a, half_log_det = np.eye(3), np.empty(1)
    a[place, place] = entry
    inverted(a, half_log_det)
    assert np.isnan(half_log_det)


@pytest.mark.parametrize("rows", range(1, 10))
@pytest.mark.parametrize("n", [8, 16, 104])
def test_sums_over_data_are_those_of_numpy(rows: int, n: int) -> None:
    rng = np.random.default_rng(rows)
    a, b, matrix = rng.normal(size=(rows, n)), rng.normal(size=(3, n)), rng.normal(size=(5, rows))
    transformed, outer, sums = np.empty((5, n)), np.empty((rows, 3)), np.empty(2)
    sums_over_data(matrix, a, b, transformed, outer, sums)
    assert_rounded(transformed, matrix @ a, abs(matrix) @ abs(a), rows)
    assert_rounded(outer, a @ b.T, abs(a) @ abs(b).T, n)
    expected, magnitudes = ([x @ y, x.sum()] for x, y in ((a[0], b[0]), (abs(a[0]), abs(b[0]))))
    assert_rounded(sums, np.array(expected), np.array(magnitudes), n)


def test_further_rows_are_left_out_of_outer_sums() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 6, 8))
    transformed, outer = np.empty((1, 8)), np.empty((2, 5))
    sums_over_data(np.ones((1, 6)), a, b, transformed, outer, np.empty(2))
    np.testing.assert_allclose(outer, a[:2] @ b[:5].T)


@pytest.mark.parametrize("rows", range(1, 6))
def test_what_is_done_entry_by_entry_is_done_to_all(rows: int) -> None:
    rng = np.random.default_rng(rows)
    a, b = rng.normal(size=(rows, 24)), rng.normal(size=24)
    scaled, products, forms = np.empty_like(a), np.empty(24), np.empty(24)
    entry_by_entry(a, b, scaled, products, forms)
    assert (scaled == a * b).all() and (products == a[0] * b).all()
    of_two = LOG2_E * np.stack([0 * b + 3, *(-0.5 * a * a * b)])
    terms = np.stack([*of_two, -1.5 * a[0]])
    assert_rounded(forms, terms.sum(0), abs(terms).sum(0), len(terms) + 1)
