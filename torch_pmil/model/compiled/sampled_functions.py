"""Functions drawn from a posterior, at inputs of their own, and their slopes.

A function is a sum of waves and of squared exponentials around the data. Without waves, and with
the posterior's weights, it is the model's mean.
"""

from __future__ import annotations

from math import log
from typing import NamedTuple

import numpy as np

from torch_pmil.model.compiled.arrays import filled_up, zeros
from torch_pmil.model.compiled.building import (
    Array1,
    Array2,
    Array3,
    Array4,
    Kernel,
    compiled,
    part,
)
from torch_pmil.model.compiled.thin_products import fill
from torch_pmil.model.compiled.vectors import (
    WIDTH,
    add,
    load,
    multiply,
    multiply_add,
    power_of_two,
    sines_and_cosines,
    splat,
    spread,
    store,
    total,
)

OF_EXPONENT = -2.0 * log(2.0)  # slope of 2^-x² over x times itself


class Draws(NamedTuple):
    """N functions of D' + F inputs, and of E outputs; rows have W numbers, filled up with zeros."""

    waves: Array3  # frequencies in quarter turns, (E, D' + F, J)
    rows_of_waves: Array3  # the same in rad, (E, J, W)
    cosines: Array3  # weights, (N, E, J)
    sines: Array3
    origin: Array1  # of the data, (D' + F,)
    scales: Array2  # by which inputs are multiplied, (E, D' + F)
    data: Array3  # inputs around the origin times the scales, negative, (E, D' + F, n)
    rows_of_data: Array2  # inputs around the origin, (n, W)
    weights: Array3  # of 2^-|x|², x being a scaled distance from a datum, (N, E, n)
    offset: Array1  # (E,)

    @property
    def most_terms(self) -> int:
        """Those of the longest sum, over waves or data."""
        return max(self.waves.shape[2], len(self.rows_of_data))


def as_rows(values: np.ndarray) -> np.ndarray:
    """Numbers (..., D, n) as n rows, filled up with zeros, (..., n, W)."""
    *shape, size, n = values.shape
    rows = zeros(*shape, n, filled_up(size))
    rows[..., :size] = values.swapaxes(-1, -2)
    return rows


@Kernel
def write_outputs(
    draws: Draws, inputs: Array3, point: Array1, terms: Array1, outputs: Array3, slopes: Array4
) -> bool:
    """Write outputs (N, B, E) of each function at inputs (N, B, D' + F) of its own.

    Args:
        point, terms: scratch arrays, as in :func:`evaluate`.
        slopes: out, of the outputs in the inputs, (N, B, E, W).
    """
    for i in range(inputs.shape[0]):
        for b in range(inputs.shape[1]):
            for a in range(outputs.shape[2]):
                x, slope = inputs[i, b], slopes[i, b, a]
                outputs[i, b, a] = evaluate(draws, i, a, x, slope, point, terms)
    return True


@part
def evaluate(
    draws: Draws, i: int, a: int, inputs: Array1, slope: Array1, point: Array1, terms: Array1
) -> float:
    """Output a of function i, and its slope (W,).

    ``point`` (D' + F,) and ``terms`` are scratch; ``terms`` has at least ``draws.most_terms``
    entries.
    """
    scales, origin = draws.scales[a], draws.origin
    fill(slope, 0.0)
    for d in range(len(inputs)):
        point[d] = scales[d] * (inputs[d] - origin[d])
    of_data = _write_terms_of_data(draws.data[a], draws.weights[i, a], point, terms)
    add_rows(terms, draws.rows_of_data, slope)
    for d in range(len(inputs)):
        sum_of_distances = (inputs[d] - origin[d]) * of_data - slope[d]
        slope[d] = OF_EXPONENT * scales[d] * scales[d] * sum_of_distances
    waves = draws.waves[a], draws.cosines[i, a], draws.sines[i, a]
    of_waves = _write_terms_of_waves(*waves, inputs, terms)
    add_rows(terms, draws.rows_of_waves[a], slope)
    return draws.offset[a] + of_waves + of_data


@compiled
def _write_terms_of_waves(
    waves: Array2, cosines: Array1, sines: Array1, point: Array1, terms: Array1
) -> float:
    """The slopes of waves in their phases, and the sum of the waves."""
    count, value = len(cosines), splat(0.0)
    for j in range(0, count, WIDTH):
        phase = splat(0.0)
        for d in range(len(point)):
            phase = multiply_add(spread(point, d), load(waves, d * count + j), phase)
        sine, cosine = sines_and_cosines(phase)
        of_cosine, of_sine = load(cosines, j), load(sines, j)
        value = multiply_add(of_cosine, cosine, multiply_add(of_sine, sine, value))
        turned = multiply(multiply(splat(-1.0), of_cosine), sine)
        store(terms, j, multiply_add(of_sine, cosine, turned))
    return total(value)


@compiled
def _write_terms_of_data(data: Array2, weights: Array1, point: Array1, terms: Array1) -> float:
    """Weighted kernels around scaled data, and their sum."""
    count, value = len(weights), splat(0.0)
    for j in range(0, count, WIDTH):
        square = splat(0.0)
        for d in range(len(point)):
            distance = add(spread(point, d), load(data, d * count + j))
            square = multiply_add(distance, distance, square)
        term = multiply(load(weights, j), power_of_two(multiply(splat(-1.0), square)))
        store(terms, j, term)
        value = add(value, term)
    return total(value)


@compiled
def add_rows(terms: Array1, rows: Array2, out: Array1) -> None:
    """Add the sum of n rows (n, W), times the first n terms, to ``out`` (W,)."""
    n, width = rows.shape
    for start in range(0, width, WIDTH):
        s0 = s1 = s2 = s3 = splat(0.0)
        for j in range(0, n, 4):
            first = j * width + start
            s0 = multiply_add(spread(terms, j), load(rows, first), s0)
            s1 = multiply_add(spread(terms, j + 1), load(rows, first + width), s1)
            s2 = multiply_add(spread(terms, j + 2), load(rows, first + 2 * width), s2)
            s3 = multiply_add(spread(terms, j + 3), load(rows, first + 3 * width), s3)
        sums = add(add(s0, s1), add(s2, s3))
        store(out, start, add(sums, load(out, start)))
