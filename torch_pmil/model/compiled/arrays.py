"""The arrays from which moments are matched, and those that matching leaves for its adjoint."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from torch_pmil.model.compiled.building import Array1, Array2, Array3, Array4, Array5
from torch_pmil.model.compiled.vectors import WIDTH


def zeros(*shape: int) -> Any:
    """An array of zeros that begins with a cache line, so that no vector lies in two of them."""
    count = math.prod(shape)
    memory = np.zeros(count + WIDTH)
    start = -memory.ctypes.data // memory.itemsize % WIDTH
    return memory[start : start + count].reshape(shape)


class Functions(NamedTuple):
    """The E functions of a :class:`KernelExpansion` of D inputs, as kernels read them.

    Their n data are filled up to a multiple of eight by some of weight zero.

    Args:
        inputs: (D, n).
        weights: beta, (E, n).
        squares: squared lengthscales, the diagonals of Lambda_a, (E, D).
        log_signal: log alpha_a^2, (E,).
        offset: c_a, (E,).
        variance: what a GP's variance is subtracted from, noise included, (E,); 0 for a network.
        own_weights: beta_a beta_a' - K_a^-1 with half its diagonal and zeros below, (E, n, n);
            (0, 0, 0) for a network.
        tied: whether it is a GP whose outputs have the same lengthscales. Its weights then hold
            the signal variances too, and log_signal is 0.
    """

    inputs: Array2
    weights: Array2
    squares: Array2
    log_signal: Array1
    offset: Array1
    variance: Array1
    own_weights: Array3
    tied: bool


class Record(NamedTuple):
    """What the moments at T beliefs leave for their adjoints.

    Args:
        q: integrals of the kernels, (T, E, n).
        precision: B of the kernels, (T, E, D, D).
        total, slope: means without offsets (T, E), and Sigma^-1 cov(x, f), (T, D, E).
        pair_precision: B of the products of the kernels, (T, E, E, D, D).
        gradient, hessian: of a GP, the derivatives of E[f_a f_b] by the mean and by the covariance,
            (T, E, E, D) and (T, E, E, D, D); not where its outputs are tied.
        products: of a network, sum_i w_i [nu_i, 1] Q_ij, (T, E, E, D + 1, n).
        half_log_det: where outputs are tied, log|I + Sigma P| / 2 of any product of two, (T,).
    """

    q: Array3
    precision: Array4
    total: Array2
    slope: Array3
    pair_precision: Array5
    gradient: Array4
    hessian: Array5
    products: Array5
    half_log_det: Array1

    @classmethod
    def of(cls, f: Functions, times: int) -> Record:
        """Room for the moments at so many beliefs."""
        (D, n), E, gp = f.inputs.shape, len(f.weights), len(f.own_weights) > 0
        pairs_of_gp, pairs_of_network = (0 if f.tied else E, 0) if gp else (0, E)
        shapes = (
            (E, n),
            (E, D, D),
            (E,),
            (D, E),
            (E, E, D, D),
            (pairs_of_gp, E, D),
            (pairs_of_gp, E, D, D),
            (pairs_of_network, E, D + 1, n),
            (),
        )
        return cls(*(zeros(times, *shape) for shape in shapes))


class Workspace(NamedTuple):
    """Arrays for the moments at one belief, which the next one overwrites.

    Args:
        nu: inputs less the mean of the belief, (D, n).
        points: [nu_i, 1], (n, D + 1).
        right, f, g: exponents of a pair of outputs, as in :func:`sum_pairs`.
        left, rows: results of :func:`sum_pairs`.
        moved, weighted: scratch, (D, n).
        single: scratch, (n,).
        shares: of the first and the second output in a pair, and (Lambda_a + Lambda_b)^-1, (3, D).
        small: scratch, (6, D, D).
        vectors: scratch, (4, D).
        columns, sums: of tied outputs, their weights (n, E) and scratch, (E, 8).
        by_output: of tied outputs, sums of Q and factors of the weights, (E, n).
        pairs: of tied outputs, weights of pairs of data, (n, n).
    """

    nu: Array2
    points: Array2
    right: Array2
    f: Array1
    g: Array1
    left: Array2
    rows: Array1
    moved: Array2
    weighted: Array2
    single: Array1
    shares: Array2
    small: Array3
    vectors: Array2
    columns: Array2
    sums: Array2
    by_output: Array2
    pairs: Array2

    @classmethod
    def of(cls, f: Functions) -> Workspace:
        """Arrays for these functions."""
        (D, n), E = f.inputs.shape, len(f.weights)
        tied = ((n, E), (E, WIDTH), (E, n), (n, n)) if f.tied else 4 * ((0, 0),)
        shapes = (
            *((D, n), (n, D + 1), (D, n), (n,), (n,), (D + 1, n), (n,), (D, n), (D, n)),
            *((n,), (3, D), (6, D, D), (4, D), *tied),
        )
        return cls(*(zeros(*shape) for shape in shapes))


class NetworkGradient(NamedTuple):
    """Gradients in a network, in the layout of its :class:`Functions`.

    Args:
        inputs: (D, n).
        weights: (E, n).
        squares: (E, D).
    """

    inputs: Array2
    weights: Array2
    squares: Array2

    @classmethod
    def zero(cls, f: Functions) -> NetworkGradient:
        """Gradients to which others are added."""
        return cls(*(zeros(*values.shape) for values in (f.inputs, f.weights, f.squares)))
