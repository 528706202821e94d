r"""Sums of sines and cosines of linear combinations of angles, closed under products.

A point of a chain of hinges has a position that is a sum of products of sines and cosines. With
:math:`\cos a \cos b = \tfrac12 [\cos(a - b) + \cos(a + b)]` and the like it is a sum of sines and
cosines of sums of angles, whose moments under a Gaussian are known: a match space.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch

from torch_pmil.control.state_space import MatchSpace

Frequency = tuple[int, ...]


@dataclass(frozen=True)
class TrigonometricPolynomial:
    r"""A function of K angles, :math:`\sum_n c_n e^{i n^\top q}` with :math:`c_{-n} = \bar c_n`.

    Sums and products are polynomials again, the latter with :math:`\sum_{k + l = n} a_k b_l`.

    Args:
        coefficients: c_n by n.

    Example:
        >>> yaw, shoulder = (1, 0), (0, 1)
        >>> (2 * cosine(yaw) * sine(shoulder)).terms  # sin(yaw + shoulder) - sin(yaw - shoulder)
        {(1, -1): (0.0, -1.0), (1, 1): (0.0, 1.0)}
    """

    coefficients: Mapping[Frequency, complex]

    def __add__(self, other: TrigonometricPolynomial) -> TrigonometricPolynomial:
        total = defaultdict(complex, self.coefficients)
        for n, c in other.coefficients.items():
            total[n] += c
        return TrigonometricPolynomial(dict(total))

    def __mul__(self, other: TrigonometricPolynomial | float) -> TrigonometricPolynomial:
        if not isinstance(other, TrigonometricPolynomial):
            return TrigonometricPolynomial({n: c * other for n, c in self.coefficients.items()})
        product: defaultdict[tuple[int, ...], complex] = defaultdict(complex)
        for k, a in self.coefficients.items():
            for m, b in other.coefficients.items():
                product[tuple(i + j for i, j in zip(k, m, strict=True))] += a * b
        return TrigonometricPolynomial(dict(product))

    __rmul__ = __mul__

    @property
    def terms(self) -> dict[Frequency, tuple[float, float]]:
        """Coefficients of cos(n q) and sin(n q) for n = 0 and those n that begin positive."""
        zero = (0,) * len(next(iter(self.coefficients)))
        ordered = sorted(self.coefficients.items())
        once = {n: (1 if n == zero else 2) * c for n, c in ordered if n >= zero and c}
        return {n: (c.real, -c.imag) for n, c in once.items()}


def cosine(frequency: Frequency) -> TrigonometricPolynomial:
    """The cosine of the sum of the angles, each as often as ``frequency`` says."""
    return _with_conjugate(frequency, 0.5 + 0j)


def sine(frequency: Frequency) -> TrigonometricPolynomial:
    """The sine of the sum of the angles, each as often as ``frequency`` says."""
    return _with_conjugate(frequency, -0.5j)


def match_of(
    polynomials: Sequence[TrigonometricPolynomial],
    names: tuple[str, ...],
    units: tuple[str, ...],
    dim: int,
    angles: Sequence[int],
) -> MatchSpace:
    """Match space whose entries are the given polynomials of some entries of the state.

    Args:
        polynomials: one for each entry of the match space, of K angles.
        names, units: of the entries of the match space.
        dim: D, number of entries of the state.
        angles: the K entries of the state that are the angles; ValueError if they do not fit.

    Example:
        >>> x, y = 0.5 * sine((1,)), 0.5 * cosine((1,))
        >>> tip = match_of([x, y], ("x", "y"), ("m", "m"), dim=2, angles=(0,))
        >>> tip(torch.tensor([torch.pi / 2, 3.0], dtype=torch.float64)).round(decimals=3)
        tensor([0.5000, 0.0000], dtype=torch.float64)
    """
    terms = [polynomial.terms for polynomial in polynomials]
    frequencies = sorted({n for entry in terms for n in entry})
    if not set(angles) <= set(range(dim)) or {len(n) for n in frequencies} != {len(angles)}:
        wanted = ", ".join(map(str, sorted({len(n) for n in frequencies})))
        raise ValueError(
            f"angles must be entries below {dim}, as many as polynomials of {wanted} angles have, "
            f"got {tuple(angles)}"
        )
    combinations = torch.zeros(len(frequencies), dim, dtype=torch.float64)
    combinations[:, list(angles)] = torch.tensor(frequencies, dtype=torch.float64)
    pairs = [[entry.get(n, (0.0, 0.0)) for n in frequencies] for entry in terms]
    cosines, sines = torch.tensor(pairs, dtype=torch.float64).unbind(-1)
    plain = torch.zeros(len(terms), dim, dtype=torch.float64)
    return MatchSpace(names, units, combinations, torch.cat([plain, sines, cosines], -1))


def _with_conjugate(frequency: Frequency, coefficient: complex) -> TrigonometricPolynomial:
    negative = tuple(-entry for entry in frequency)
    half = TrigonometricPolynomial({frequency: coefficient})
    return half + TrigonometricPolynomial({negative: coefficient.conjugate()})
