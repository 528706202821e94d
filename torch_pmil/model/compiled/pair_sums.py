r"""Sums of the exponentials Q_ij of all pairs of data (Eq. 17): the O(n^2) work of a prediction.

With :math:`\log_2 Q_{ij} = f_i + g_j + \nu_i^\top r_j`, four rows and eight columns of Q at a time
stay in registers. A power of two takes three multiplications less than one of e.
"""

from __future__ import annotations

from typing import Any

from torch_pmil.model.compiled.building import Array1, Array2, Array3, compiled, part
from torch_pmil.model.compiled.thin_products import fill
from torch_pmil.model.compiled.vectors import (
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


@part
def _exponentials(
    points: Array2, right: Array2, f: Array1, g: Array1, i: int, j: int
) -> tuple[Any, Any, Any, Any]:
    """Q of the rows i to i + 3 and of eight columns from j on; the large terms come last."""
    D, n = right.shape[0], right.shape[1]
    p0 = i * (D + 1)
    p1, p2, p3 = p0 + D + 1, p0 + 2 * D + 2, p0 + 3 * D + 3
    q0 = q1 = q2 = q3 = splat(0.0)
    for d in range(D):
        r = load(right, d * n + j)
        q0 = multiply_add(spread(points, p0 + d), r, q0)
        q1 = multiply_add(spread(points, p1 + d), r, q1)
        q2 = multiply_add(spread(points, p2 + d), r, q2)
        q3 = multiply_add(spread(points, p3 + d), r, q3)
    of_j = load(g, j)
    q0, q1 = add(q0, add(spread(f, i), of_j)), add(q1, add(spread(f, i + 1), of_j))
    q2, q3 = add(q2, add(spread(f, i + 2), of_j)), add(q3, add(spread(f, i + 3), of_j))
    return power_of_two(q0), power_of_two(q1), power_of_two(q2), power_of_two(q3)


@part
def _add_columns(
    points: Array2, i: int, j: int, q0: Any, q1: Any, q2: Any, q3: Any, left: Array2
) -> None:
    """Add [nu_i, 1] times weighted Q, of the rows i to i + 3, to eight columns from j on."""
    n, entries = left.shape[1], points.shape[1]
    p0 = i * entries
    p1, p2, p3 = p0 + entries, p0 + 2 * entries, p0 + 3 * entries
    for d in range(entries):
        sums = load(left, d * n + j)
        sums = multiply_add(spread(points, p0 + d), q0, sums)
        sums = multiply_add(spread(points, p1 + d), q1, sums)
        sums = multiply_add(spread(points, p2 + d), q2, sums)
        sums = multiply_add(spread(points, p3 + d), q3, sums)
        store(left, d * n + j, sums)


@compiled
def sum_pairs(
    points: Array2,
    right: Array2,
    f: Array1,
    g: Array1,
    w: Array1,
    z: Array1,
    left: Array2,
    rows: Array1,
) -> None:
    """Sums over a whole Q.

    Args:
        points, right: [nu_i, 1], (n, D + 1), and r_j, (D, n), with n a multiple of eight.
        f, g: terms of i and of j in the exponents, (n,).
        w, z: factors of the rows and of the columns, (n,).
        left: out, sum_i w_i [nu_i, 1] Q_ij, (D + 1, n).
        rows: out, sum_j Q_ij z_j, (n,).
    """
    n = right.shape[1]
    fill(left, 0.0)
    for i in range(0, n, 4):
        s0 = s1 = s2 = s3 = splat(0.0)
        for j in range(0, n, WIDTH):
            q0, q1, q2, q3 = _exponentials(points, right, f, g, i, j)
            factor = load(z, j)
            s0, s1 = multiply_add(q0, factor, s0), multiply_add(q1, factor, s1)
            s2, s3 = multiply_add(q2, factor, s2), multiply_add(q3, factor, s3)
            q0, q1 = multiply(q0, spread(w, i)), multiply(q1, spread(w, i + 1))
            q2, q3 = multiply(q2, spread(w, i + 2)), multiply(q3, spread(w, i + 3))
            _add_columns(points, i, j, q0, q1, q2, q3, left)
        rows[i], rows[i + 1], rows[i + 2], rows[i + 3] = total(s0), total(s1), total(s2), total(s3)


@part
def _add_rows(strip: Array2, scaled: Array2, i: int, start: int, out: Array2) -> None:
    """Add Q, of the rows i to i + 3 and the columns from ``start`` on, times ``scaled``."""
    n = out.shape[1]
    for d in range(len(out)):
        s0 = s1 = s2 = s3 = splat(0.0)
        for j in range(start, n, WIDTH):
            factor = load(scaled, d * n + j)
            s0 = multiply_add(load(strip, j), factor, s0)
            s1 = multiply_add(load(strip, n + j), factor, s1)
            s2 = multiply_add(load(strip, 2 * n + j), factor, s2)
            s3 = multiply_add(load(strip, 3 * n + j), factor, s3)
        out[d, i] += total(s0)
        out[d, i + 1] += total(s1)
        out[d, i + 2] += total(s2)
        out[d, i + 3] += total(s3)


@compiled
def sum_pairs_both_ways(
    points: Array2,
    right: Array2,
    f: Array1,
    g: Array1,
    w: Array1,
    scaled: Array2,
    own: bool,
    strip: Array2,
    of_columns: Array2,
    of_rows: Array2,
) -> None:
    """Sums over the columns and over the rows of a Q.

    The Q of an output with itself is symmetric: what is below its diagonal is not computed.

    Args:
        points, right, f, g, w: as in :func:`sum_pairs`.
        scaled: z_j [nu_j, 1], with the factors z of the columns, (D + 1, n).
        own: whether the two outputs are the same.
        strip: scratch, four rows of Q, (4, n).
        of_columns: out, sum_i w_i [nu_i, 1] Q_ij, (D + 1, n).
        of_rows: out, sum_j z_j [nu_j, 1] Q_ij, (D + 1, n); of the same output the same array.
    """
    n = right.shape[1]
    fill(of_columns, 0.0)
    fill(of_rows, 0.0)
    for i in range(0, n, 4):
        diagonal = i // WIDTH * WIDTH if own else -WIDTH
        for j in range(max(0, diagonal), n, WIDTH):
            q0, q1, q2, q3 = _exponentials(points, right, f, g, i, j)
            store(strip, j, q0)
            store(strip, n + j, q1)
            store(strip, 2 * n + j, q2)
            store(strip, 3 * n + j, q3)
            q0, q1 = multiply(q0, spread(w, i)), multiply(q1, spread(w, i + 1))
            q2, q3 = multiply(q2, spread(w, i + 2)), multiply(q3, spread(w, i + 3))
            _add_columns(points, i, j, q0, q1, q2, q3, of_columns)
        _add_rows(strip, scaled, i, diagonal + WIDTH, of_rows)


@compiled
def sum_tied_pairs(
    points: Array2,
    right: Array2,
    f: Array1,
    columns: Array2,
    own_weights: Array3,
    left: Array2,
    sums: Array2,
    seconds: Array2,
) -> None:
    """Sums over the one Q of all pairs of outputs with the same lengthscales.

    Args:
        columns: weights of the outputs, (n, E).
        own_weights: of each output with itself, as in :func:`sum_own_pairs`, (E, n, n).
        left: out, sum_i w_i Q_ij, (E, n).
        sums: scratch, (E, 8): sums over four rows, added at their end to lose few digits.
        seconds: out, on its diagonal, the sums of U + U' for the own weights times Q, (E, E).
    """
    n, size = right.shape[1], right.shape[1] * right.shape[1]
    fill(left, 0.0)
    for a in range(len(seconds)):
        seconds[a, a] = 0.0
    for i in range(0, n, 4):
        fill(sums, 0.0)
        for j in range(0, n, WIDTH):
            q0, q1, q2, q3 = _exponentials(points, right, f, f, i, j)
            _add_columns(columns, i, j, q0, q1, q2, q3, left)
            if j + WIDTH > i:
                for a in range(len(seconds)):
                    at, s = a * size + i * n + j, load(sums, a * WIDTH)
                    s = multiply_add(q0, load(own_weights, at), s)
                    s = multiply_add(q1, load(own_weights, at + n), s)
                    s = multiply_add(q2, load(own_weights, at + 2 * n), s)
                    s = multiply_add(q3, load(own_weights, at + 3 * n), s)
                    store(sums, a * WIDTH, s)
        for a in range(len(seconds)):
            seconds[a, a] += 2.0 * total(load(sums, a * WIDTH))


@compiled
def sum_own_pairs(
    points: Array2, right: Array2, f: Array1, weights: Array2, left: Array2, rows: Array1
) -> None:
    """Sums over U, the weighted Q above the diagonal, of an output with itself.

    There Q is symmetric, and with half its diagonal in U all sums are those of U + U'.

    Args:
        f: the terms of i, and of j, in the exponents, (n,).
        weights: factors of Q, (n, n): halved on the diagonal, zero below.
        left: out, sum_i [nu_i, 1] U_ij, (D + 1, n).
        rows: out, sum_j U_ij, (n,).
    """
    n = right.shape[1]
    fill(left, 0.0)
    for i in range(0, n, 4):
        s0 = s1 = s2 = s3 = splat(0.0)
        for j in range(i // WIDTH * WIDTH, n, WIDTH):
            q0, q1, q2, q3 = _exponentials(points, right, f, f, i, j)
            at = i * n + j
            q0, q1 = multiply(q0, load(weights, at)), multiply(q1, load(weights, at + n))
            q2 = multiply(q2, load(weights, at + 2 * n))
            q3 = multiply(q3, load(weights, at + 3 * n))
            s0, s1, s2, s3 = add(s0, q0), add(s1, q1), add(s2, q2), add(s3, q3)
            _add_columns(points, i, j, q0, q1, q2, q3, left)
        rows[i], rows[i + 1], rows[i + 2], rows[i + 3] = total(s0), total(s1), total(s2), total(s3)
