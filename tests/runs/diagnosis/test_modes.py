"""Two modes: false alarms are as rare as stated, and clear modes are found with their members."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.runs.diagnosis.modes import split_in_two

SETS = 500
STEPS = 26


def smooth_sets(count: int, sets: int, lengthscale: float, seed: int) -> Tensor:
    """Trajectories of a Gaussian process in four entries, (sets, count, STEPS, 4)."""
    time = torch.linspace(0, 1, STEPS, dtype=torch.float64)
    cov = (-0.5 * ((time[:, None] - time) / lengthscale).square()).exp() + 1e-6 * torch.eye(STEPS)
    return torch.linalg.cholesky(cov) @ Draws(seed).normal(sets, count, STEPS, 4)


def two_ways(count: int, sets: int, separation: float, seed: int) -> Tensor:
    """Every other one goes around on the other side, halfway by so many standard deviations."""
    bump = torch.linspace(0, math.pi, STEPS, dtype=torch.float64).sin()[:, None]
    side = (torch.arange(count) % 2)[:, None, None]
    return smooth_sets(count, sets, 0.3, seed) + separation * side * bump


def one_apart(count: int, sets: int, separation: float, seed: int) -> Tensor:
    """The second one goes around on the other side, the others do not."""
    apart = two_ways(2, 1, separation, seed)[0] - smooth_sets(2, 1, 0.3, seed)[0]
    moved = smooth_sets(count, sets, 0.3, seed)
    moved[:, 1] += apart[1]
    return moved


@pytest.mark.parametrize("count", [3, 4, 5, 7, 10])
@pytest.mark.parametrize("lengthscale", [0.1, 0.5, 5.0])
def test_one_gaussian_mode_is_seldom_called_two(count: int, lengthscale: float) -> None:
    level, sets = 0.05, smooth_sets(count, SETS, lengthscale, seed=count)
    alarms = sum(split_in_two(each).p_value < level for each in sets) / SETS
    assert alarms <= level + 3 * math.sqrt(level * (1 - level) / SETS)


@pytest.mark.parametrize("count", [3, 5, 10])
def test_probability_of_uniform_samples_is_uniform(count: int) -> None:
    samples = Draws(0).uniform(0, 1, SETS, count, 1)
    probabilities = torch.tensor([split_in_two(each).p_value for each in samples]).sort().values
    distance = (probabilities - (torch.arange(SETS) + 0.5) / SETS).abs().max().item()
    assert distance < 1.95 / math.sqrt(SETS)  # Kolmogorov and Smirnov, 0.1 %


@pytest.mark.parametrize(
    ("kind", "count", "separation", "found"),
    [
        *((two_ways, *case) for case in ((5, 16.0, 0.9), (7, 12.0, 0.95), (10, 8.0, 0.95))),
        *((one_apart, *case) for case in ((4, 50.0, 0.95), (5, 20.0, 0.95), (7, 12.0, 0.9))),
        (one_apart, 10, 10.0, 0.95),
    ],
)
def test_two_modes_are_found_with_their_members(
    kind: Callable[..., Tensor], count: int, separation: float, found: float
) -> None:
    splits = [split_in_two(each) for each in kind(count, 200, separation, seed=1)]
    clear = [split for split in splits if split.p_value < 0.01 and split.explained > 0.75]
    assert len(clear) >= found * len(splits)
    second = tuple(range(1, count, 2)) if kind is two_ways else (1,)
    first = tuple(number for number in range(count) if number not in second)
    assert all(split.parts == (first, second) for split in clear)


def test_split_of_points_on_a_line_is_the_best_of_all() -> None:
    halves = [part for size in range(1, 4) for part in itertools.combinations(range(7), size)]
    for seed in range(20):
        points = Draws(seed).normal(7, 1)
        scatter = {}
        for part in halves:
            parts = tuple(sorted((part, tuple(sorted(set(range(7)) - set(part))))))
            both = (points[list(each)] for each in parts)
            scatter[parts] = sum((each - each.mean()).square().sum().item() for each in both)
        split = split_in_two(points)
        assert split.parts == min(scatter, key=scatter.get)
        total = (points - points.mean()).square().sum().item()
        assert math.isclose(1 - split.explained, min(scatter.values()) / total, rel_tol=1e-9)


def test_turning_shifting_and_scaling_all_changes_nothing() -> None:
    one = smooth_sets(6, 1, 0.3, seed=0)[0].flatten(1)
    turn = torch.linalg.qr(Draws(0).normal(104, 104))[0]
    plain, moved = split_in_two(one), split_in_two(3 * one @ turn + 7)
    assert (plain.parts, plain.p_value) == (moved.parts, moved.p_value)
    assert math.isclose(plain.explained, moved.explained)


def test_two_trajectories_or_copies_have_no_split() -> None:
    assert split_in_two(torch.randn(2, 5)) is None
    assert split_in_two(torch.ones(5, 5)) is None
