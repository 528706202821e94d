r"""Adjoints of :mod:`torch_pmil.model.compiled.matching`: gradients in the belief and in a network.

For a Gaussian a derivative by the covariance is half a second derivative by the mean (Price's
theorem). A sum :math:`\sum_i u_i e^{-\nu_i^\top B \nu_i / 2}` has the gradient :math:`B \sum_i u_i
\nu_i` by the mean, and :math:`\tfrac12 (B M B - s B)` by the covariance, with :math:`M = \sum_i u_i
\nu_i \nu_i^\top`. B depends on the sum of covariance and squared lengthscales, so that the latter
have the same derivative, beside those by what they normalise.
"""

from __future__ import annotations

from torch_pmil.model.compiled.arrays import Functions, NetworkGradient, Record, Workspace
from torch_pmil.model.compiled.building import Array1, Array2, Kernel, compiled, part
from torch_pmil.model.compiled.matching import (
    centre,
    combine_pair,
    cross_form,
    own_form,
    write_hessian,
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
    """Cotangents of a belief from those of a GP's moments.

    Args:
        f, record, t, work: as in :func:`match`.
        mean: of the belief, (D,).
        d_total, d_cov, d_slope: cotangents of the moments' mean, covariance (symmetric) and slope.
        d_mean, d_belief: out, cotangents of mean (D,) and covariance (D, D).
    """
    centre(f.inputs, mean, work)
    _clear(d_mean, d_belief)
    for a in range(len(f.weights)):
        _adjoint_of_one(f, a, record, t, d_total, d_cov, d_slope, work, d_mean, d_belief)
        for b in range(a, len(f.weights)):
            scale = d_cov[a, b] if a == b else 2.0 * d_cov[a, b]
            gradient, hessian = record.gradient[t, a, b], record.hessian[t, a, b]
            _add(scale, gradient, hessian, d_mean, d_belief)
    return True


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
    """:func:`adjoint_of_gp` for a network, whose own gradients are added to ``out``."""
    centre(f.inputs, mean, work)
    _clear(d_mean, d_belief)
    for a in range(len(f.weights)):
        _adjoint_of_one(f, a, record, t, d_total, d_cov, d_slope, work, d_mean, d_belief)
        _adjoint_of_single_parameters(f, a, record, t, work, out)
        for b in range(a, len(f.weights)):
            scale = d_cov[a, b] if a == b else 2.0 * d_cov[a, b]
            _adjoint_of_pair(f, a, b, record, t, scale, work, d_mean, d_belief, out)
    return True


@compiled
def _clear(d_mean, d_belief):
    for d in range(len(d_mean)):
        d_mean[d] = 0.0
        for e in range(len(d_mean)):
            d_belief[d, e] = 0.0


@compiled
def _add(scale, gradient, hessian, d_mean, d_belief):
    for d in range(len(d_mean)):
        d_mean[d] += scale * gradient[d]
        for e in range(len(d_mean)):
            d_belief[d, e] += scale * hessian[d, e]


@compiled
def _adjoint_of_one(f, a, record, t, d_total, d_cov, d_slope, work, d_mean, d_belief):
    """Adjoint of the mean of output a, its slope, and its square that the covariance lacks.

    It leaves h_i = d_total + d_slope' B nu_i in ``work.f``, w_i h_i in ``work.g``, their sum in
    ``work.shares[0, 0]``, B d_slope in ``work.vectors[0]``, and the covariance's cotangent in
    ``work.small[2]``.
    """
    D, B, q, nu = len(d_mean), record.precision[t, a], record.q[t, a], work.nu
    by_slope, moved, first = work.vectors[0], work.vectors[1], work.vectors[2]
    total, h, u = d_total[a], work.f, work.g
    for b in range(len(d_total)):
        total -= 2.0 * d_cov[a, b] * record.total[t, b]
    for d in range(D):
        first[d] = d_slope[d, a]
    times_vector(B, first, by_slope)
    fill(h, total)
    for d in range(D):
        add_multiple(by_slope[d], nu[d], h)
    multiply_entries(f.weights[a], q, u)
    multiply_entries(u, h, u)
    work.shares[0, 0] = sum_entries(u)
    write_squares(nu, u, work.weighted, work.small[0], first)
    times_vector(B, first, moved)
    write_hessian(B, work.shares[0, 0], work.small[0], work.small[1], work.small[2])
    for d in range(D):
        for e in range(D):
            crossed = by_slope[d] * record.slope[t, e, a] + by_slope[e] * record.slope[t, d, a]
            work.small[2, d, e] -= crossed / 2
        moved[d] -= by_slope[d] * record.total[t, a]
    _add(1.0, moved, work.small[2], d_mean, d_belief)


@part
def _adjoint_of_single_parameters(f, a, record, t, work, out):
    B, q, h, by_slope = record.precision[t, a], record.q[t, a], work.f, work.vectors[0]
    multiply_entries(q, h, work.left[0])
    add_multiple(1.0, work.left[0], out.weights[a])
    transform(B, work.weighted, work.moved)
    multiply_entries(f.weights[a], q, work.rows)
    for d in range(len(B)):
        add_multiple(-1.0, work.moved[d], out.inputs[d])
        add_multiple(by_slope[d], work.rows, out.inputs[d])
        out.squares[a, d] += work.small[2, d, d] + work.shares[0, 0] / f.squares[a, d] / 2


@part
def _adjoint_of_pair(f, a, b, record, t, scale, work, d_mean, d_belief, out):
    """Adjoint of E[f_a f_b], of which both outputs, the inputs and the lengthscales have a part."""
    D, nu, B = len(d_mean), work.nu, record.pair_precision[t, a, b]
    by_b, by_a = record.products[t, a, b], record.products[t, b, a]
    shares, form, first, other = work.shares, work.small[4], work.vectors[0], work.vectors[1]
    of_i, of_j, mixed, second = work.small[0], work.small[1], work.small[2], work.small[3]
    add_multiple(scale, by_a[D], out.weights[a])
    add_multiple(scale, by_b[D], out.weights[b])
    write_shares(f.squares[a], f.squares[b], shares)
    multiply_entries(f.weights[a], by_a[D], work.f)
    write_squares(nu, work.f, work.weighted, of_i, first)
    own_form(shares[0], B, shares[2], -scale, form)
    _add_transformed(form, work.weighted, work.right, out.inputs)
    multiply_entries(f.weights[b], by_b[D], work.f)
    total = sum_entries(work.f)
    write_squares(nu, work.f, work.weighted, of_j, other)
    own_form(shares[1], B, shares[2], -scale, form)
    _add_transformed(form, work.weighted, work.right, out.inputs)
    scale_columns(by_a, f.weights[a], work.left)
    cross_form(shares[0], B, shares[1], shares[2], -scale, form)
    _add_transformed(form, work.left, work.right, out.inputs)
    scale_columns(by_b, f.weights[b], work.left)
    outer_sums(work.left, nu, mixed)
    cross_form(shares[1], B, shares[0], shares[2], -scale, form)
    _add_transformed(form, work.left, work.right, out.inputs)
    combine_pair(shares, of_i, of_j, mixed, second)
    for d in range(D):
        first[d] = shares[0, d] * first[d] + shares[1, d] * other[d]
    times_vector(B, first, other)
    write_hessian(B, total, second, work.small[5], form)
    _add(scale, other, form, d_mean, d_belief)
    for d in range(D):
        harmonic = f.squares[a, d] * shares[0, d]
        through_harmonic = form[d, d] + total / harmonic / 2.0
        apart = (of_i[d, d] + of_j[d, d]) / 2.0 - mixed[d, d]
        through_distance = shares[2, d] * shares[2, d] * apart
        through_centre = 0.0
        for e in range(D):
            of_first = shares[0, e] * (mixed[e, d] - of_i[e, d])
            of_second = shares[1, e] * (of_j[e, d] - mixed[d, e])
            through_centre += shares[2, d] * B[d, e] * (of_first + of_second)
        for output, share, sign in ((a, 0, -1.0), (b, 1, 1.0)):
            own = shares[share, d]
            out.squares[output, d] += scale * (
                own * own * through_harmonic + sign * own * through_centre + through_distance
            )


@compiled
def _add_transformed(matrix, values, scratch, out):
    """Add a matrix (D, D) times values (D, n) to ``out``."""
    transform(matrix, values, scratch)
    add_multiple(1.0, scratch, out)
