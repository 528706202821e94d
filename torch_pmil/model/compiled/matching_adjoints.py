r"""Adjoints of :mod:`torch_pmil.model.compiled.matching`: gradients in the belief and in a network.

A derivative by the covariance is half a second derivative by the mean (Price's theorem). A sum s
of :math:`u_i e^{-\nu_i^\top B \nu_i / 2}` has the gradients :math:`B \sum_i u_i \nu_i` and
:math:`\tfrac12 (B M B - s B)` by mean and covariance, with :math:`M = \sum_i u_i \nu_i \nu_i^\top`.
Squared lengthscales, which B adds to the covariance, have the latter too.
"""

from __future__ import annotations

from torch_pmil.model.compiled.arrays import Functions, NetworkGradient, Record, Workspace
from torch_pmil.model.compiled.building import Array1, Array2, Kernel, compiled, part
from torch_pmil.model.compiled.matching import (
    centre,
    combine_pair,
    cross_form,
    own_form,
    sum_own_pair,
    write_exponents,
    write_hessian,
    write_points,
    write_shares,
    write_squares,
)
from torch_pmil.model.compiled.small_matrices import times_vector
from torch_pmil.model.compiled.thin_products import (
    add_multiple,
    fill,
    multiply_entries,
    outer_sums,
    scale_columns,
    sum_entries,
    transform,
)
from torch_pmil.model.compiled.vectors import WIDTH


@Kernel
def adjoint_of_gp(
    f: Functions,
    record: Record,
    t: int,
    mean: Array1,
    d_total: Array1,
    d_cov: Array2,
    d_slope: Array2,
    work: Workspace,
    d_mean: Array1,
    d_belief: Array2,
) -> bool:
    """Cotangents of a belief from those of a GP's moments, of which :func:`match` left a record.

    Args:
        mean: of the belief, (D,).
        d_total, d_cov, d_slope: cotangents of mean (E,), covariance (E, E), symmetric, and slope.
        d_mean, d_belief: out, cotangents of mean (D,) and covariance (D, D) of the belief.
    """
    gradient, hessian = record.gradient[t], record.hessian[t]
    centre(f.inputs, mean, work.nu)
    clear_cotangents(d_mean, d_belief)
    if f.tied:
        _adjoint_of_tied_pairs(f, record, t, d_cov, work, d_mean, d_belief)
    for a in range(len(f.weights)):
        _adjoint_of_one(f, a, record, t, d_total, d_cov, d_slope, work, d_mean, d_belief)
        for b in range(a, 0 if f.tied else len(f.weights)):
            scale = d_cov[a, b] if a == b else 2.0 * d_cov[a, b]
            add_cotangents(scale, gradient[a, b], hessian[a, b], d_mean, d_belief)
    return True


@part
def _adjoint_of_tied_pairs(
    f: Functions,
    record: Record,
    t: int,
    d_cov: Array2,
    work: Workspace,
    d_mean: Array1,
    d_belief: Array2,
) -> None:
    """Adjoint of E[f_a f_b] of all pairs: one sum over pairs of data, weighted for all of them."""
    B, moved, small = record.pair_precision[t, 0, 0], work.vectors[0], work.small
    write_points(work.nu, work.points)
    write_shares(f.squares[0], f.squares[0], work.shares)
    write_exponents(f, 0, 0, B, record.half_log_det[t], work)
    _write_weights_of_pairs(f, d_cov, work.by_output, work.pairs)
    sum_own_pair(work.pairs, work)
    times_vector(B, work.vectors[1], moved)
    write_hessian(B, sum_entries(work.rows), small[3], small[0], small[2])
    add_cotangents(1.0, moved, small[2], d_mean, d_belief)


@compiled
def _write_weights_of_pairs(f: Functions, d_cov: Array2, factors: Array2, out: Array2) -> None:
    """Write the weights of Q in sum_ab d_ab E[f_a f_b] into ``out`` (n, n), for `sum_own_pairs`.

    ``factors`` receives sum_b d_ab beta_b over the other outputs b, (E, n).
    """
    E, n = f.weights.shape
    fill(factors, 0.0)
    for a in range(E):
        for b in range(E):
            if b != a:
                add_multiple(d_cov[a, b], f.weights[b], factors[a])
    for i in range(n):
        first = i // WIDTH * WIDTH
        row = out[i, first:]
        fill(row, 0.0)
        for a in range(E):
            add_multiple(f.weights[a, i], factors[a, first:], row)
        for j in range(first, i):
            out[i, j] = 0.0
        out[i, i] /= 2.0
        for a in range(E):
            add_multiple(d_cov[a, a], f.own_weights[a, i, first:], row)


@Kernel
def adjoint_of_network(
    f: Functions,
    record: Record,
    t: int,
    mean: Array1,
    d_total: Array1,
    d_cov: Array2,
    d_slope: Array2,
    work: Workspace,
    d_mean: Array1,
    d_belief: Array2,
    out: NetworkGradient,
) -> bool:
    """:func:`adjoint_of_gp` for a network, whose gradient is added to ``out``."""
    centre(f.inputs, mean, work.nu)
    clear_cotangents(d_mean, d_belief)
    for a in range(len(f.weights)):
        moments = d_total, d_cov, d_slope
        total = _adjoint_of_one(f, a, record, t, *moments, work, d_mean, d_belief)
        _adjoint_of_single_parameters(f, a, record, t, total, work, out)
        for b in range(a, len(f.weights)):
            scale = d_cov[a, b] if a == b else 2.0 * d_cov[a, b]
            _adjoint_of_pair(f, a, b, record, t, scale, work, d_mean, d_belief, out)
    return True


@compiled
def clear_cotangents(d_mean: Array1, d_belief: Array2) -> None:
    """Fill cotangents of mean (D,) and covariance (D, D) with zeros."""
    for d in range(len(d_mean)):
        d_mean[d] = 0.0
        for e in range(len(d_mean)):
            d_belief[d, e] = 0.0


@compiled
def add_cotangents(
    scale: float, gradient: Array1, hessian: Array2, d_mean: Array1, d_belief: Array2
) -> None:
    """Add the scale times derivatives by mean and covariance to the cotangents."""
    for d in range(len(d_mean)):
        d_mean[d] += scale * gradient[d]
        for e in range(len(d_mean)):
            d_belief[d, e] += scale * hessian[d, e]


@compiled
def _adjoint_of_one(
    f: Functions,
    a: int,
    record: Record,
    t: int,
    d_total: Array1,
    d_cov: Array2,
    d_slope: Array2,
    work: Workspace,
    d_mean: Array1,
    d_belief: Array2,
) -> float:
    """Adjoint of output a's mean, its slope, and the squared mean that the covariance subtracts.

    Returns the sum of w_i q_i h_i with h_i = d_total + d_slope' B nu_i. It leaves h_i in
    ``work.f``, B d_slope in ``work.vectors[0]``, w_i q_i h_i nu_i in ``work.weighted``, and the
    cotangent of the covariance in ``work.small[2]``.
    """
    D, B, q, beta = len(d_mean), record.precision[t, a], record.q[t, a], f.weights[a]
    totals, slopes, nu, h, u = record.total[t], record.slope[t], work.nu, work.f, work.g
    by_slope, moved, first = work.vectors[0], work.vectors[1], work.vectors[2]
    squares, scratch, by_cov = work.small[0], work.small[1], work.small[2]
    by_total = d_total[a]
    for b in range(len(d_total)):
        by_total -= 2.0 * d_cov[a, b] * totals[b]
    for d in range(D):
        first[d] = d_slope[d, a]
    times_vector(B, first, by_slope)
    fill(h, by_total)
    for d in range(D):
        add_multiple(by_slope[d], nu[d], h)
    multiply_entries(beta, q, u)
    multiply_entries(u, h, u)
    sum_of_u = sum_entries(u)
    write_squares(nu, u, work.weighted, squares, first)
    times_vector(B, first, moved)
    write_hessian(B, sum_of_u, squares, scratch, by_cov)
    for d in range(D):
        for e in range(D):
            by_cov[d, e] -= (by_slope[d] * slopes[e, a] + by_slope[e] * slopes[d, a]) / 2
        moved[d] -= by_slope[d] * totals[a]
    add_cotangents(1.0, moved, by_cov, d_mean, d_belief)
    return sum_of_u


@part
def _adjoint_of_single_parameters(
    f: Functions,
    a: int,
    record: Record,
    t: int,
    total: float,
    work: Workspace,
    out: NetworkGradient,
) -> None:
    """Gradient in the network from what :func:`_adjoint_of_one` returned and left."""
    B, q, h, by_slope = record.precision[t, a], record.q[t, a], work.f, work.vectors[0]
    scratch, moved, u = work.left[0], work.moved, work.rows
    of_inputs, of_squares, squares = out.inputs, out.squares[a], f.squares[a]
    by_cov = work.small[2]
    multiply_entries(q, h, scratch)
    add_multiple(1.0, scratch, out.weights[a])
    transform(B, work.weighted, moved)
    multiply_entries(f.weights[a], q, u)
    for d in range(len(B)):
        add_multiple(-1.0, moved[d], of_inputs[d])
        add_multiple(by_slope[d], u, of_inputs[d])
        of_squares[d] += by_cov[d, d] + total / squares[d] / 2


@part
def _adjoint_of_pair(
    f: Functions,
    a: int,
    b: int,
    record: Record,
    t: int,
    scale: float,
    work: Workspace,
    d_mean: Array1,
    d_belief: Array2,
    out: NetworkGradient,
) -> None:
    """Adjoint of E[f_a f_b] in both outputs, the inputs and the lengthscales."""
    D, nu, B = len(d_mean), work.nu, record.pair_precision[t, a, b]
    by_b, by_a = record.products[t, a, b], record.products[t, b, a]
    shares, form, first, other = work.shares, work.small[4], work.vectors[0], work.vectors[1]
    of_i, of_j, mixed, second = work.small[0], work.small[1], work.small[2], work.small[3]
    u, left, weighted, scratch, of_inputs = work.f, work.left, work.weighted, work.right, out.inputs
    add_multiple(scale, by_a[D], out.weights[a])
    add_multiple(scale, by_b[D], out.weights[b])
    write_shares(f.squares[a], f.squares[b], shares)
    multiply_entries(f.weights[a], by_a[D], u)
    write_squares(nu, u, weighted, of_i, first)
    own_form(shares[0], B, shares[2], -scale, form)
    _add_transformed(form, weighted, scratch, of_inputs)
    multiply_entries(f.weights[b], by_b[D], u)
    total = sum_entries(u)
    write_squares(nu, u, weighted, of_j, other)
    own_form(shares[1], B, shares[2], -scale, form)
    _add_transformed(form, weighted, scratch, of_inputs)
    scale_columns(by_a, f.weights[a], left)
    cross_form(shares[0], B, shares[1], shares[2], -scale, form)
    _add_transformed(form, left, scratch, of_inputs)
    scale_columns(by_b, f.weights[b], left)
    outer_sums(left, nu, mixed)
    cross_form(shares[1], B, shares[0], shares[2], -scale, form)
    _add_transformed(form, left, scratch, of_inputs)
    combine_pair(shares, of_i, of_j, mixed, second)
    for d in range(D):
        first[d] = shares[0, d] * first[d] + shares[1, d] * other[d]
    times_vector(B, first, other)
    write_hessian(B, total, second, work.small[5], form)
    add_cotangents(scale, other, form, d_mean, d_belief)
    _adjoint_of_squares(f.squares[a], a, b, B, total, scale, work, out.squares)


@part
def _adjoint_of_squares(
    squares: Array1,
    a: int,
    b: int,
    B: Array2,
    total: float,
    scale: float,
    work: Workspace,
    out: Array2,
) -> None:
    """Gradients in the squared lengthscales, from the sums :func:`_adjoint_of_pair` left.

    They act through the harmonic mean of both outputs (as a covariance does), the distance of two
    data, and their centre.
    """
    shares, form = work.shares, work.small[4]
    of_i, of_j, mixed = work.small[0], work.small[1], work.small[2]
    for d in range(len(B)):
        harmonic = squares[d] * shares[0, d]
        through_harmonic = form[d, d] + total / harmonic / 2.0
        apart = (of_i[d, d] + of_j[d, d]) / 2.0 - mixed[d, d]
        through_distance = shares[2, d] * shares[2, d] * apart
        through_centre = 0.0
        for e in range(len(B)):
            of_first = shares[0, e] * (mixed[e, d] - of_i[e, d])
            of_second = shares[1, e] * (of_j[e, d] - mixed[d, e])
            through_centre += shares[2, d] * B[d, e] * (of_first + of_second)
        for output, share, sign in ((a, 0, -1.0), (b, 1, 1.0)):
            own = shares[share, d]
            out[output, d] += scale * (
                own * own * through_harmonic + sign * own * through_centre + through_distance
            )


@compiled
def _add_transformed(matrix: Array2, values: Array2, scratch: Array2, out: Array2) -> None:
    """Add a matrix (D, D) times values (D, n) to ``out``."""
    transform(matrix, values, scratch)
    add_multiple(1.0, scratch, out)
