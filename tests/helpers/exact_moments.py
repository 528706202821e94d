"""Moments of a Gaussian process at a Gaussian input (Eqs. 14-18) with fifty digits, by mpmath."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.gp.gaussian import Gaussian

BITS = 192  # of every number, and behind the point where matrices are inverted
Array = np.ndarray[Any, Any]  # of mpf
exp = np.frompyfunc(mpmath.exp, 1, 1)


def exact(values: Tensor | float) -> Array:
    """The same numbers as an array of mpf."""
    return np.frompyfunc(mpmath.mpf, 1, 1)(np.asarray(values, dtype=float)).astype(object)


def inverse(matrix: Array) -> Array:
    """Inverse of a positive definite matrix whose entries are of order one, by Gauss and Jordan.

    Integers of :data:`BITS` bits behind the point are ten times as fast as mpf.
    """
    one = 1 << BITS
    A = np.frompyfunc(lambda value: int(mpmath.ldexp(value, BITS)), 1, 1)(matrix)
    for k in range(len(A)):
        pivot = (one << BITS) // A[k, k]
        row, column = (A[k] * pivot) >> BITS, A[:, k].copy()
        row[k], column[k] = pivot, 0
        A[:, k] = 0
        A = A - ((column[:, None] * row) >> BITS)
        A[k] = row
    return np.frompyfunc(lambda value: mpmath.ldexp(mpmath.mpf(value), -BITS), 1, 1)(A)


def _inverse_and_det(matrix: Array) -> tuple[Array, Any]:
    M = mpmath.matrix(matrix.tolist())
    D = len(matrix)
    return np.array((M**-1).tolist(), dtype=object).reshape(D, D), mpmath.det(M)


class ExactMoments:
    """The posterior of E outputs given data, and its moments at a belief.

    Arguments as in ``KernelExpansion.from_data``, whose formulas these are, with other arithmetic:
    each float64 stands for itself.
    """

    def __init__(
        self, inputs: Tensor, targets: Tensor, lengthscales: Tensor, signal: Tensor, noise: Tensor
    ) -> None:
        mpmath.mp.prec = BITS
        self.x, y = exact(inputs), exact(targets)
        self.alpha2, sigma2 = exact(signal), exact(noise)
        self.precision = 1 / exact(lengthscales) ** 2
        self.gram_inverse, self.beta = [], []
        for a, precision in enumerate(self.precision):
            scaled = self.x * np.array([mpmath.sqrt(p) for p in precision])
            squares = (scaled**2).sum(-1)
            K = exp(scaled @ scaled.T - squares[:, None] / 2 - squares / 2)
            K = K + sigma2[a] / self.alpha2[a] * np.eye(len(K), dtype=int)
            self.gram_inverse.append(inverse(K) / self.alpha2[a])
            self.beta.append(self.gram_inverse[a] @ y[a])

    def at(self, mean: Array, cov: Array) -> tuple[Array, Array, Array]:
        """Mean (E,), covariance (E, E) and Sigma^-1 cov(x, f) (D, E) at a belief of mpf."""
        nu, eye = self.x - mean, np.eye(self.x.shape[1], dtype=int)
        E = len(self.beta)
        mu, slope = np.zeros(E, dtype=object), np.zeros((nu.shape[1], E), dtype=object)
        second = np.zeros((E, E), dtype=object)
        for a, p in enumerate(self.precision):
            inv, det = _inverse_and_det(eye + cov * p)
            B = p[:, None] * inv  # (Sigma + Lambda)^-1
            q = self.alpha2[a] / mpmath.sqrt(det) * exp(((nu @ B) * nu).sum(-1) / -2)
            mu[a], slope[:, a] = self.beta[a] @ q, B @ (nu.T @ (self.beta[a] * q))
        for a in range(E):
            for b in range(a, E):
                Q = self._product(nu, cov, a, b)
                second[a, b] = second[b, a] = self.beta[a] @ Q @ self.beta[b]
                if a == b:
                    second[a, a] += self.alpha2[a] - (self.gram_inverse[a] * Q).sum()
        return mu, second - mu[:, None] * mu, slope

    def _product(self, nu: Array, cov: Array, a: int, b: int) -> Array:
        """The integrals Q_ij of Eq. 17."""
        pa, pb = self.precision[a], self.precision[b]
        inv, det = _inverse_and_det(np.eye(len(pa), dtype=int) + cov * (pa + pb))
        T = inv @ cov  # z_ij' T z_ij / 2 with z_ij = Lambda_a^-1 nu_i + Lambda_b^-1 nu_j
        zi, zj = nu * pa, nu * pb
        i_terms = ((zi @ T) * zi - zi * nu).sum(-1) / 2
        j_terms = ((zj @ T) * zj - zj * nu).sum(-1) / 2
        exponents = zi @ T @ zj.T + i_terms[:, None] + j_terms
        return self.alpha2[a] * self.alpha2[b] / mpmath.sqrt(det) * exp(exponents)

    def at_belief(self, belief: Gaussian) -> tuple[Array, Array, Array]:
        """:meth:`at` for a belief of one batch element."""
        return self.at(exact(belief.mean), exact(belief.cov))


def hard_problem(
    seed: int, most_data: int = 150, signal_to_noise: tuple[float, float] = (10.0, 5000.0)
) -> tuple[tuple[Tensor, ...], Gaussian]:
    """Data and hyper-parameters of one or two outputs, as ``KernelExpansion.from_data`` takes
    them, and a belief: inputs with units, signals from 1e-3 to 1e4, targets that the prior expects
    or that contradict it, a belief that is certain or wider than the data.
    """
    draws = Draws(seed)

    def number(low: float, high: float) -> float:
        return draws.uniform(low, high, 1).item()

    def logarithmic(low: float, high: float, *shape: int) -> Tensor:
        return draws.uniform(math.log(low), math.log(high), *shape).exp()

    n, D, E = int(logarithmic(20, most_data, 1)), int(number(1, 7)), int(number(1, 3))
    x = draws.normal(n, D) * logarithmic(0.3, 3, D) + 3 * draws.normal(D)
    spread = x.std(0)
    lengthscales = spread * logarithmic(0.5, 6, E, D)
    signal = logarithmic(1e-3, 1e4, E)
    noise = signal / logarithmic(*signal_to_noise, E) ** 2
    white = (x - x.mean(0)) / spread
    shape = {
        0: ((x - x.mean(0)) / lengthscales[:, None]).sin().sum(-1),  # as the prior expects
        1: (3 * white).sin().sum(-1).expand(E, n),  # rougher
        2: white.sum(-1).expand(E, n),  # larger
        3: draws.normal(E, n),  # noise
    }[int(number(0, 4))]
    y = signal.sqrt()[:, None] * shape + noise.sqrt()[:, None] * draws.normal(E, n)
    cov = (0.0, 1e-6, 1e-2, 0.1, 0.5)[int(number(0, 5))] * draws.cov(D, scale=1.0)
    mean = x[int(number(0, n))] + number(0, 1) * spread * draws.normal(D)
    return (x, y, lengthscales, signal, noise), Gaussian(mean, (cov + cov.mT) / 2)
