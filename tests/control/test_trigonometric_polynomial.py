"""Polynomials of sines and cosines: products, and the match space that is made of them."""

from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from torch_pmil.control.trigonometric_polynomial import (
    TrigonometricPolynomial,
    cosine,
    match_of,
    sine,
)

ANGLES = torch.tensor([[0.3, -1.1, 2.0], [-2.5, 0.7, 0.1]], dtype=torch.float64)
FIRST, SECOND, ALL, NONE = (1, 0, 0), (0, 1, 0), (2, -1, 1), (0, 0, 0)


def value(polynomial: TrigonometricPolynomial, q: torch.Tensor) -> torch.Tensor:
    return match_of([polynomial], ("f",), ("m",), dim=3, angles=(0, 1, 2))(q)[..., 0]


def test_products_and_sums_are_those_of_the_values() -> None:
    f = 0.7 * sine(FIRST) * cosine(ALL) + 2.0 * cosine(NONE)
    g = sine(SECOND) * sine(ALL) + -0.3 * cosine(FIRST)
    u, v, w = ANGLES[:, 0], ANGLES[:, 1], ANGLES @ torch.tensor(ALL, dtype=torch.float64)
    f_value, g_value = 0.7 * u.sin() * w.cos() + 2.0, v.sin() * w.sin() - 0.3 * u.cos()
    assert_close(value(f, ANGLES), f_value)
    assert_close(value(f + g, ANGLES), f_value + g_value)
    assert_close(value(f * g * f, ANGLES), f_value * g_value * f_value)


def test_square_of_sine_and_cosine_sum_to_one() -> None:
    one = sine(ALL) * sine(ALL) + cosine(ALL) * cosine(ALL)
    assert one.terms == {NONE: (1.0, 0.0)}


@pytest.mark.parametrize("wave", [sine, cosine])
def test_a_frequency_and_its_negative_are_the_same_wave(wave) -> None:
    sign = -1.0 if wave is sine else 1.0
    negative = tuple(-n for n in ALL)
    assert_close(value(wave(negative), ANGLES), sign * value(wave(ALL), ANGLES))


def test_angles_may_be_any_entries_of_the_state() -> None:
    match = match_of([sine((1, 1))], ("f",), ("m",), dim=4, angles=(0, 2))
    state = torch.tensor([0.4, 9.0, 0.5, -9.0], dtype=torch.float64)
    assert_close(match(state)[0], torch.tensor(0.9, dtype=torch.float64).sin())
