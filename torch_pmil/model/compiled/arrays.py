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


def filled_up(count: int) -> int:
    """The next multiple of eight."""
    return count + -count % WIDTH


class Functions(NamedTuple):
    """The E functions of a :class:`KernelExpansion` of D inputs, as kernels read them.

    Data are filled up with weights of zero, so that n is a multiple of eight.
    """

    inputs: Array2  # (D, n)
    weights: Array2  # beta, (E, n)
    squares: Array2  # diagonals of Lambda_a, (E, D)
    log_signal: Array1  # log alpha_a^2, (E,)
    offset: Array1  # c_a, (E,)
    variance: Array1  # prior of a GP, with noise if asked for, (E,); 0 for a network
    # beta_a beta_a' - K_a^-1 with half its diagonal and zeros below, (E, n, n), or (0, 0, 0)
    own_weights: Array3
    # a GP whose outputs share lengthscales: weights hold the signal variances, and log_signal is 0
    tied: bool


class Record(NamedTuple):
    """What the moments at T beliefs leave for their adjoints."""

    q: Array3  # integrals of the kernels, (T, E, n)
    precision: Array4  # B of the kernels, (T, E, D, D)
    total: Array2  # means without offsets, (T, E)
    slope: Array3  # Sigma^-1 cov(x, f), (T, D, E)
    pair_precision: Array5  # B of the products of the kernels, (T, E, E, D, D)
    # of a GP whose outputs are not tied: derivatives of E[f_a f_b] by mean and covariance
    gradient: Array4  # (T, E, E, D)
    hessian: Array5  # (T, E, E, D, D)
    products: Array5  # of a network, sum_i w_i [nu_i, 1] Q_ij, (T, E, E, D + 1, n)
    half_log_det: Array1  # of tied outputs, log|I + Sigma P| / 2 of a product of two, (T,)

    @classmethod
    def of(cls, f: Functions, times: int) -> Record:
        """Room for so many beliefs."""
        (D, n), E, gp = f.inputs.shape, len(f.weights), len(f.own_weights) > 0
        pairs_of_gp, pairs_of_network = (0 if f.tied else E, 0) if gp else (0, E)
        of_gp = (pairs_of_gp, E, D), (pairs_of_gp, E, D, D)
        of_network = (pairs_of_network, E, D + 1, n)
        shapes = (E, n), (E, D, D), (E,), (D, E), (E, E, D, D), *of_gp, of_network, ()
        return cls(*(zeros(times, *shape) for shape in shapes))


class Workspace(NamedTuple):
    """Arrays for the moments at one belief, which the next one overwrites."""

    nu: Array2  # inputs less the mean of the belief, (D, n)
    points: Array2  # [nu_i, 1], (n, D + 1)
    right: Array2  # this and f, g: exponents of a pair of outputs, as in `sum_pairs`
    f: Array1
    g: Array1
    left: Array2  # this and rows: results of `sum_pairs`
    rows: Array1
    moved: Array2  # scratch, (D, n)
    weighted: Array2  # scratch, (D, n)
    single: Array1  # scratch, (n,)
    shares: Array2  # of both outputs in a pair, and (Lambda_a + Lambda_b)^-1, (3, D)
    small: Array3  # scratch, (6, D, D)
    vectors: Array2  # scratch, (4, D)
    strip: Array2  # four rows of Q, (4, n)
    # of tied outputs
    columns: Array2  # weights, (n, E)
    sums: Array2  # scratch, (E, 8)
    by_output: Array2  # sums of Q, and factors of the weights, (E, n)
    pairs: Array2  # weights of pairs of data, (n, n)

    @classmethod
    def of(cls, f: Functions) -> Workspace:
        """Arrays for these functions."""
        (D, n), E = f.inputs.shape, len(f.weights)
        tied = ((n, E), (E, WIDTH), (E, n), (n, n)) if f.tied else 4 * ((0, 0),)
        shapes = (
            *((D, n), (n, D + 1), (D, n), (n,), (n,), (D + 1, n), (n,), (D, n), (D, n)),
            *((n,), (3, D), (6, D, D), (4, D), (4, n), *tied),
        )
        return cls(*(zeros(*shape) for shape in shapes))


class NetworkGradient(NamedTuple):
    """Gradients in a network, in the layout of its :class:`Functions`."""

    inputs: Array2
    weights: Array2
    squares: Array2

    @classmethod
    def zero(cls, f: Functions) -> NetworkGradient:
        """Gradients to which others are added."""
        return cls(*(zeros(*values.shape) for values in (f.inputs, f.weights, f.squares)))
