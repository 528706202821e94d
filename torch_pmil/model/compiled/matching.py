r"""Exact moments of GPs and RBF networks at one Gaussian input (Eqs. 14-18).

The symbols are those of :mod:`torch_pmil.gp.gaussian_integrals`: each integral of a kernel, or of a
product of two, has a matrix :math:`B = (\Sigma + P^{-1})^{-1}`, and its derivatives by the mean of
the belief are moments of :math:`B \nu` (:mod:`torch_pmil.model.compiled.matching_adjoints`).
"""

from __future__ import annotations

from math import isnan, sqrt

import numpy as np

from torch_pmil.model.compiled.arrays import Functions, Record, Workspace
from torch_pmil.model.compiled.building import Array1, Array2, Kernel, compiled, part
from torch_pmil.model.compiled.pair_sums import sum_own_pairs, sum_pairs
from torch_pmil.model.compiled.small_matrices import invert, product, times_vector
from torch_pmil.model.compiled.thin_products import (
    add_multiple,
    multiply_entries,
    outer_sums,
    scale_columns,
    sum_entries,
    sum_products,
    transform,
    write_exponentials,
    write_forms,
)


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
    """Moments of the functions at a belief, into ``record`` and ``cov_of_f`` (E, E).

    False where the covariance of the belief is none.
    """
    E = len(f.weights)
    centre(f.inputs, mean, work)
    for a in range(E):
        if not _match_one(f, a, cov, record, t, work):
            return False
    for a in range(E):
        for b in range(a, E):
            if len(f.own_weights):
                second = _match_pair_of_gp(f, a, b, cov, record, t, work)
            else:
                second = _match_pair_of_network(f, a, b, cov, record, t, work)
                if a != b:
                    _match_pair_of_network(f, b, a, cov, record, t, work)
            if isnan(second):
                return False
            cov_of_f[a, b] = cov_of_f[b, a] = second - record.total[t, a] * record.total[t, b]
        cov_of_f[a, a] += f.variance[a]
    return True


@compiled
def centre(inputs, mean, work):
    """Write the inputs less a mean into ``work``."""
    D, n = inputs.shape[0], inputs.shape[1]
    for d in range(D):
        for i in range(n):
            work.nu[d, i] = work.points[i, d] = inputs[d, i] - mean[d]
    for i in range(n):
        work.points[i, D] = 1.0


@part
def _match_one(f, a, cov, record, t, work):
    B, q, slope = record.precision[t, a], record.q[t, a], work.vectors[0]
    half_log_det = regularised_precision(cov, f.squares[a], B)
    if isnan(half_log_det):
        return False
    transform(B, work.nu, work.moved)
    write_forms(work.nu, work.moved, f.log_signal[a] - half_log_det, work.f)
    write_exponentials(work.f, q)
    record.total[t, a] = sum_products(f.weights[a], q)
    multiply_entries(f.weights[a], q, work.single)
    for d in range(len(cov)):
        work.vectors[1, d] = sum_products(work.nu[d], work.single)
    times_vector(B, work.vectors[1], slope)
    for d in range(len(cov)):
        record.slope[t, d, a] = slope[d]
    return True


@compiled
def regularised_precision(cov, squares, B):
    """Write B = (Sigma + P^-1)^-1 for a diagonal P^-1 into ``B``; return log|I + Sigma P| / 2.

    It is exact at Sigma = 0, and NaN where I + Sigma P has no Cholesky factor.
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


@compiled
def _exponents(f, a, b, cov, B, work):
    """Exponents of a pair of outputs into ``work``; False where the covariance is none."""
    harmonic, shares = work.vectors[0], work.shares
    write_shares(f.squares[a], f.squares[b], shares)
    for d in range(len(B)):
        harmonic[d] = f.squares[a, d] * shares[0, d]
    half_log_det = regularised_precision(cov, harmonic, B)
    if isnan(half_log_det):
        return False
    _write_terms(shares[0], B, shares[2], f.log_signal[a] - half_log_det / 2, work, work.f)
    _write_terms(shares[1], B, shares[2], f.log_signal[b] - half_log_det / 2, work, work.g)
    cross_form(shares[0], B, shares[1], shares[2], -1.0, work.small[0])
    transform(work.small[0], work.nu, work.right)
    return True


@compiled
def write_shares(squares, others, shares):
    """Write the shares of two outputs in their pair, and (Lambda_a + Lambda_b)^-1."""
    for d in range(len(squares)):
        distance = 1.0 / (squares[d] + others[d])
        shares[0, d], shares[1, d] = others[d] * distance, squares[d] * distance
        shares[2, d] = distance


@compiled
def cross_form(of_a, B, of_b, distance, sign, out):
    """Write sign (S_a B S_b - D) into ``out``, with diagonal matrices S and D."""
    for d in range(len(B)):
        for e in range(len(B)):
            out[d, e] = sign * of_a[d] * B[d, e] * of_b[e]
        out[d, d] -= sign * distance[d]


@compiled
def own_form(share, B, distance, sign, out):
    """Write sign (S B S + D) into ``out``, with diagonal matrices S and D."""
    for d in range(len(B)):
        for e in range(len(B)):
            out[d, e] = sign * share[d] * B[d, e] * share[e]
        out[d, d] += sign * distance[d]


@compiled
def _write_terms(share, B, distance, constant, work, terms):
    own_form(share, B, distance, 1.0, work.small[0])
    transform(work.small[0], work.nu, work.moved)
    write_forms(work.nu, work.moved, constant, terms)


@part
def _match_pair_of_network(f, a, b, cov, record, t, work):
    """E[f_a f_b] of a network; NaN where the covariance is none."""
    left = record.products[t, a, b]
    if not _exponents(f, a, b, cov, record.pair_precision[t, a, b], work):
        return np.nan
    weights, others = f.weights[a], f.weights[b]
    sum_pairs(work.points, work.right, work.f, work.g, weights, others, left, work.rows)
    return sum_products(others, left[len(cov)])


@part
def _match_pair_of_gp(f, a, b, cov, record, t, work):
    """E[f_a f_b] of a GP, and its derivatives; NaN where the covariance is none."""
    B = record.pair_precision[t, a, b]
    if not _exponents(f, a, b, cov, B, work):
        return np.nan
    if a == b:
        _sum_own_pair(f, a, work)
    else:
        _sum_pair(f, a, b, work)
    total, first, second = sum_entries(work.rows), work.vectors[1], work.small[3]
    times_vector(B, first, record.gradient[t, a, b])
    write_hessian(B, total, second, work.small[0], record.hessian[t, a, b])
    return total


@part
def _sum_own_pair(f, a, work):
    """Row sums of W into ``work.rows``, sum W nu_ij and sum W nu_ij nu_ij' into ``work``."""
    D, nu = len(work.nu), work.nu
    sum_own_pairs(work.points, work.right, work.f, f.own_weights[a], work.left, work.rows)
    add_multiple(1.0, work.left[D], work.rows)
    own, mixed, first, second = work.small[0], work.small[1], work.vectors[1], work.small[3]
    write_squares(nu, work.rows, work.weighted, own, first)
    outer_sums(work.left, nu, mixed)
    for d in range(D):
        for e in range(D):
            second[d, e] = (own[d, e] + mixed[d, e] + mixed[e, d]) / 2


@part
def _sum_pair(f, a, b, work):
    """:func:`_sum_own_pair` for two different outputs."""
    w, z, nu = f.weights[a], f.weights[b], work.nu
    sum_pairs(work.points, work.right, work.f, work.g, w, z, work.left, work.rows)
    scale_columns(work.left, z, work.left)
    multiply_entries(w, work.rows, work.rows)
    of_i, of_j, mixed = work.small[0], work.small[1], work.small[2]
    write_squares(nu, work.rows, work.weighted, of_i, work.vectors[2])
    write_squares(nu, work.left[len(nu)], work.weighted, of_j, work.vectors[3])
    outer_sums(work.left, nu, mixed)
    combine_pair(work.shares, of_i, of_j, mixed, work.small[3])
    for d in range(len(nu)):
        of_a, of_b = work.shares[0, d], work.shares[1, d]
        work.vectors[1, d] = of_a * work.vectors[2, d] + of_b * work.vectors[3, d]


@compiled
def write_squares(nu, weights, weighted, squares, first):
    """Write sum_i w_i nu_i nu_i' into ``squares``, sum_i w_i nu_i into ``first``."""
    scale_columns(nu, weights, weighted)
    outer_sums(weighted, nu, squares)
    for d in range(len(nu)):
        first[d] = sum_products(nu[d], weights)


@compiled
def combine_pair(shares, of_i, of_j, mixed, second):
    """Write sum W nu_ij nu_ij' into ``second``, from the sums of the squares of nu_i and nu_j."""
    of_a, of_b = shares[0], shares[1]
    for d in range(len(second)):
        for e in range(len(second)):
            own = of_a[d] * of_a[e] * of_i[d, e] + of_b[d] * of_b[e] * of_j[d, e]
            both = of_a[d] * of_b[e] * mixed[d, e] + of_b[d] * of_a[e] * mixed[e, d]
            second[d, e] = own + both


@compiled
def write_hessian(B, total, second, scratch, out):
    """Write (B M B - s B) / 2 into ``out``, the derivative of an integral by the covariance."""
    product(B, second, scratch)
    product(scratch, B, out)
    for d in range(len(B)):
        for e in range(len(B)):
            out[d, e] = (out[d, e] - total * B[d, e]) / 2
