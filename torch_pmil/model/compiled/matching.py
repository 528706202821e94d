r"""Exact moments of GPs and RBF networks at one Gaussian input (Eqs. 14-18).

The symbols are those of :mod:`torch_pmil.gp.gaussian_integrals`; derivatives are in
:mod:`torch_pmil.model.compiled.matching_adjoints`.
"""

from __future__ import annotations

from math import isnan, sqrt

from torch_pmil.model.compiled.arrays import Functions, Record, Workspace
from torch_pmil.model.compiled.building import Array1, Array2, Array4, Kernel, compiled, part
from torch_pmil.model.compiled.pair_sums import (
    sum_own_pairs,
    sum_pairs,
    sum_pairs_both_ways,
    sum_tied_pairs,
)
from torch_pmil.model.compiled.small_matrices import invert, product, times_vector
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
from torch_pmil.model.compiled.vectors import LOG2_E


@Kernel
def match(
    f: Functions,
    mean: Array1,
    cov: Array2,
    record: Record,
    t: int,
    work: Workspace,
    cov_of_f: Array2,
) -> bool:
    """Moments of E functions at a belief over D inputs, ``mean`` and ``cov``.

    Mean without offsets, slope, and what the adjoint needs go to the record at ``t``; the
    covariance goes to ``cov_of_f``. Returns whether all I + Sigma P have Cholesky factors.
    """
    totals = record.total[t]
    centre(f.inputs, mean, work.nu)
    write_points(work.nu, work.points)
    for a in range(len(totals)):
        if not _match_one(f, a, cov, record, t, work):
            return False
    if f.tied:
        matched = _match_tied_pairs(f, cov, record, t, work, cov_of_f)
    else:
        matched = _match_pairs(f, cov, record, t, work, cov_of_f)
    for a in range(len(totals)):
        for b in range(len(totals)):
            cov_of_f[a, b] -= totals[a] * totals[b]
        cov_of_f[a, a] += f.variance[a]
    return matched


@compiled
def centre(inputs: Array2, mean: Array1, nu: Array2) -> None:
    """Write the inputs (D, n) less a mean (D,) into ``nu``."""
    for d in range(len(inputs)):
        for i in range(inputs.shape[1]):
            nu[d, i] = inputs[d, i] - mean[d]


@compiled
def write_points(nu: Array2, points: Array2) -> None:
    """Write [nu_i, 1] into ``points`` (n, D + 1)."""
    D, n = nu.shape
    for i in range(n):
        for d in range(D):
            points[i, d] = nu[d, i]
        points[i, D] = 1.0


@part
def _match_one(f: Functions, a: int, cov: Array2, record: Record, t: int, work: Workspace) -> bool:
    """Mean and slope of output a; False where the covariance of the belief is not valid."""
    B, q, slopes, beta = record.precision[t, a], record.q[t, a], record.slope[t], f.weights[a]
    nu, exponents, weighted, vectors = work.nu, work.f, work.single, work.vectors
    half_log_det = regularised_precision(cov, f.squares[a], B)
    if isnan(half_log_det):
        return False
    transform(B, nu, work.moved)
    write_forms(nu, work.moved, f.log_signal[a] - half_log_det, exponents)
    write_powers(exponents, q)
    record.total[t, a] = sum_products(beta, q)
    multiply_entries(beta, q, weighted)
    for d in range(len(nu)):
        vectors[1, d] = sum_products(nu[d], weighted)
    times_vector(B, vectors[1], vectors[0])
    for d in range(len(nu)):
        slopes[d, a] = vectors[0, d]
    return True


@compiled
def regularised_precision(cov: Array2, squares: Array1, B: Array2) -> float:
    """Write (Sigma + P^-1)^-1, exact at Sigma = 0, into ``B``; return log|I + Sigma P| / 2.

    It is NaN where I + Sigma P has no Cholesky factor.
    """
    D = len(squares)
    for d in range(D):
        for e in range(D):
            B[d, e] = cov[d, e] / sqrt(squares[d] * squares[e])
        B[d, d] += 1.0
    half_log_det = invert(B)
    for d in range(D):
        for e in range(D):
            B[d, e] /= sqrt(squares[d] * squares[e])
    return half_log_det


@part
def _match_pairs(
    f: Functions, cov: Array2, record: Record, t: int, work: Workspace, seconds: Array2
) -> bool:
    """E[f_a f_b] of all pairs of outputs; False where the covariance is not valid."""
    gp = len(f.own_weights) > 0
    for a in range(len(seconds)):
        for b in range(a, len(seconds)):
            B = record.pair_precision[t, a, b]
            half_log_det = _pair_precision(f.squares[a], f.squares[b], cov, work, B)
            if isnan(half_log_det):
                return False
            write_exponents(f, a, b, B, half_log_det, work)
            if gp:
                gradient, hessian = record.gradient[t, a, b], record.hessian[t, a, b]
                second = _match_pair_of_gp(f, a, b, B, work, gradient, hessian)
            else:
                second = _match_pair_of_network(f, a, b, work, record.products[t])
            seconds[a, b] = seconds[b, a] = second
    return True


@part
def _match_tied_pairs(
    f: Functions, cov: Array2, record: Record, t: int, work: Workspace, seconds: Array2
) -> bool:
    """:func:`_match_pairs` of a GP with one Q for all pairs; its adjoint finds the derivatives."""
    B, columns, by_output = record.pair_precision[t, 0, 0], work.columns, work.by_output
    half_log_det = _pair_precision(f.squares[0], f.squares[0], cov, work, B)
    record.half_log_det[t] = half_log_det
    if isnan(half_log_det):
        return False
    write_exponents(f, 0, 0, B, half_log_det, work)
    for i in range(len(columns)):
        for a in range(len(seconds)):
            columns[i, a] = f.weights[a, i]
    exponents = work.points, work.right, work.f
    sum_tied_pairs(*exponents, columns, f.own_weights, by_output, work.sums, seconds)
    for a in range(len(seconds)):
        for b in range(a):
            seconds[a, b] = seconds[b, a] = sum_products(f.weights[a], by_output[b])
    return True


@part
def _pair_precision(of_a: Array1, of_b: Array1, cov: Array2, work: Workspace, B: Array2) -> float:
    """:func:`regularised_precision` of a product of two kernels, whose shares go to ``work``."""
    shares, harmonic = work.shares, work.vectors[0]
    write_shares(of_a, of_b, shares)
    for d in range(len(B)):
        harmonic[d] = of_a[d] * shares[0, d]
    return regularised_precision(cov, harmonic, B)


@part
def write_exponents(
    f: Functions, a: int, b: int, B: Array2, half_log_det: float, work: Workspace
) -> None:
    """Exponents of two, of a pair of outputs, into ``work``, which has their shares."""
    nu, moved, small, shares = work.nu, work.moved, work.small, work.shares
    constants = f.log_signal[a] - half_log_det / 2, f.log_signal[b] - half_log_det / 2
    _write_terms(shares[0], B, shares[2], constants[0], nu, small[0], moved, work.f)
    _write_terms(shares[1], B, shares[2], constants[1], nu, small[0], moved, work.g)
    cross_form(shares[0], B, shares[1], shares[2], -LOG2_E, small[0])
    transform(small[0], nu, work.right)


@compiled
def _write_terms(
    share: Array1,
    B: Array2,
    distance: Array1,
    constant: float,
    nu: Array2,
    form: Array2,
    moved: Array2,
    out: Array1,
) -> None:
    """Write a constant less half the forms nu_i' (S B S + D) nu_i, as exponents of two."""
    own_form(share, B, distance, 1.0, form)
    transform(form, nu, moved)
    write_forms(nu, moved, constant, out)


@compiled
def write_shares(squares: Array1, others: Array1, shares: Array2) -> None:
    """Write the shares of two outputs in their pair, and (Lambda_a + Lambda_b)^-1."""
    for d in range(len(squares)):
        distance = 1.0 / (squares[d] + others[d])
        shares[0, d], shares[1, d] = others[d] * distance, squares[d] * distance
        shares[2, d] = distance


@compiled
def cross_form(
    of_a: Array1, B: Array2, of_b: Array1, distance: Array1, factor: float, out: Array2
) -> None:
    """Write a factor times (S_a B S_b - D) into ``out``; S and D come as their diagonals."""
    for d in range(len(B)):
        for e in range(len(B)):
            out[d, e] = factor * of_a[d] * B[d, e] * of_b[e]
        out[d, d] -= factor * distance[d]


@compiled
def own_form(share: Array1, B: Array2, distance: Array1, factor: float, out: Array2) -> None:
    """Write a factor times (S B S + D) into ``out``; S and D come as their diagonals."""
    for d in range(len(B)):
        for e in range(len(B)):
            out[d, e] = factor * share[d] * B[d, e] * share[e]
        out[d, d] += factor * distance[d]


@part
def _match_pair_of_network(
    f: Functions, a: int, b: int, work: Workspace, products: Array4
) -> float:
    """E[f_a f_b] of a network, and sum_i w_i [nu_i, 1] Q_ij of (a, b), (b, a) into ``products``."""
    w, z, scaled, D = f.weights[a], f.weights[b], work.left, len(work.nu)
    scale_columns(work.nu, z, scaled)
    fill(scaled[D], 0.0)
    add_multiple(1.0, z, scaled[D])
    exponents = work.points, work.right, work.f, work.g
    of_columns, of_rows = products[a, b], products[b, a]
    sum_pairs_both_ways(*exponents, w, scaled, a == b, work.strip, of_columns, of_rows)
    return sum_products(z, of_columns[D])


@part
def _match_pair_of_gp(
    f: Functions, a: int, b: int, B: Array2, work: Workspace, gradient: Array1, hessian: Array2
) -> float:
    """E[f_a f_b] of a GP, with its derivatives by mean and covariance of the belief."""
    if a == b:
        sum_own_pair(f.own_weights[a], work)
    else:
        _sum_pair(f.weights[a], f.weights[b], work)
    total = sum_entries(work.rows)
    times_vector(B, work.vectors[1], gradient)
    write_hessian(B, total, work.small[3], work.small[0], hessian)
    return total


@part
def sum_own_pair(weights: Array2, work: Workspace) -> None:
    """Sums of W, Q times the weights of an output with itself, with nu_ij the centre of a pair.

    Row sums go to ``work.rows``, W nu_ij to ``work.vectors[1]``, W nu_ij nu_ij' to
    ``work.small[3]``.
    """
    nu, left, rows, small = work.nu, work.left, work.rows, work.small
    own, mixed, second = small[0], small[1], small[3]
    sum_own_pairs(work.points, work.right, work.f, weights, left, rows)
    add_multiple(1.0, left[len(nu)], rows)
    write_squares(nu, rows, work.weighted, own, work.vectors[1])
    outer_sums(left, nu, mixed)
    for d in range(len(nu)):
        for e in range(len(nu)):
            second[d, e] = (own[d, e] + mixed[d, e] + mixed[e, d]) / 2


@part
def _sum_pair(w: Array1, z: Array1, work: Workspace) -> None:
    """:func:`sum_own_pair` for two different outputs."""
    nu, left, rows, weighted, small = work.nu, work.left, work.rows, work.weighted, work.small
    shares, vectors = work.shares, work.vectors
    sum_pairs(work.points, work.right, work.f, work.g, w, z, left, rows)
    scale_columns(left, z, left)
    multiply_entries(w, rows, rows)
    write_squares(nu, rows, weighted, small[0], vectors[2])
    write_squares(nu, left[len(nu)], weighted, small[1], vectors[3])
    outer_sums(left, nu, small[2])
    combine_pair(shares, small[0], small[1], small[2], small[3])
    for d in range(len(nu)):
        vectors[1, d] = shares[0, d] * vectors[2, d] + shares[1, d] * vectors[3, d]


@compiled
def write_squares(
    nu: Array2, weights: Array1, weighted: Array2, squares: Array2, first: Array1
) -> None:
    """Write sums of w_i nu_i nu_i' and of w_i nu_i, and w_i nu_i itself into ``weighted``."""
    scale_columns(nu, weights, weighted)
    outer_sums(weighted, nu, squares)
    for d in range(len(nu)):
        first[d] = sum_products(nu[d], weights)


@compiled
def combine_pair(shares: Array2, of_i: Array2, of_j: Array2, mixed: Array2, second: Array2) -> None:
    """Write sum W nu_ij nu_ij' from the sums of nu_i nu_i', nu_j nu_j' and nu_i nu_j'."""
    of_a, of_b = shares[0], shares[1]
    for d in range(len(second)):
        for e in range(len(second)):
            own = of_a[d] * of_a[e] * of_i[d, e] + of_b[d] * of_b[e] * of_j[d, e]
            both = of_a[d] * of_b[e] * mixed[d, e] + of_b[d] * of_a[e] * mixed[e, d]
            second[d, e] = own + both


@compiled
def write_hessian(B: Array2, total: float, second: Array2, scratch: Array2, out: Array2) -> None:
    """Write (B M B - s B) / 2 into ``out``, the derivative of an integral by the covariance."""
    product(B, second, scratch)
    product(scratch, B, out)
    for d in range(len(B)):
        for e in range(len(B)):
            out[d, e] = (out[d, e] - total * B[d, e]) / 2
