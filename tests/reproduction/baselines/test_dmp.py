"""Movement primitives: laws of the spring-damper, and an independent implementation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from reproduction.baselines.dmp import DMP
from tests.helpers.draws import Draws

DURATION = 2.5
TIMES = torch.linspace(0, DURATION, 26, dtype=torch.float64)


def demonstration(times: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Two joints that start in motion and come to rest, with their velocities and accelerations."""
    u = times[:, None] / DURATION
    size, turns = torch.tensor([3.0, 0.5]), torch.tensor([1.0, 4.0])
    wave = math.pi * turns * (1 - u) ** 3
    rate = -3 * math.pi * turns * (1 - u) ** 2
    curvature = 6 * math.pi * turns * (1 - u)
    y = size * wave.sin() + u
    dy = size * wave.cos() * rate + 1
    ddy = size * (wave.cos() * curvature - wave.sin() * rate**2)
    return y, dy / DURATION, ddy / DURATION**2


def learned(num_basis: int = 30, samples: int = 26) -> DMP:
    times = torch.linspace(0, DURATION, samples, dtype=torch.float64)
    shown = demonstration(times)[0][None]
    return DMP.from_demonstrations(shown, DURATION / (samples - 1), num_basis)


@pytest.fixture
def random_dmp(draws: Draws) -> DMP:
    start, goal, rate = (draws.normal(3) for _ in range(3))
    return DMP(start, goal, rate, 100 * draws.normal(12, 3), DURATION)


def test_demonstration_is_reproduced_with_its_velocity_and_acceleration() -> None:
    motion, shown = learned(num_basis=60, samples=251)(TIMES), demonstration(TIMES)
    for reproduced, demonstrated, tolerance in zip(motion, shown, (1e-4, 1e-3, 1e-2), strict=True):
        assert (reproduced - demonstrated).abs().max() < tolerance * demonstrated.abs().max()
    # few samples, at their times
    torch.testing.assert_close(learned()(TIMES)[0], demonstration(TIMES)[0], atol=5e-3, rtol=0)


def test_several_demonstrations_give_their_mean(draws: Draws) -> None:
    both = torch.stack([demonstration(TIMES)[0], draws.normal(1, 2) + 2 * demonstration(TIMES)[0]])
    given = both, both.mean(0, keepdim=True)
    together, mean = (DMP.from_demonstrations(shown, 0.1, 20)(TIMES)[0] for shown in given)
    torch.testing.assert_close(together, mean)


def test_motion_solves_its_differential_equation(random_dmp: DMP) -> None:
    """Against an adaptive integrator of the equation as it is printed."""
    w, centres = random_dmp.weights.numpy(), np.exp(-4.605170185988091 * np.linspace(0, 1, 12))
    widths = -math.log(0.8) / np.append(np.diff(centres), np.diff(centres)[-1]) ** 2
    goal = random_dmp.goal.numpy()

    def equation(t: float, state: np.ndarray) -> np.ndarray:
        x = math.exp(-4.605170185988091 * t / DURATION)
        psi = np.exp(-widths * (x - centres) ** 2)
        y, dy = state[:3], state[3:]
        spring, force = 25 * (6.25 * (goal - y) - DURATION * dy), x * (psi @ w) / psi.sum()
        return np.append(dy, (spring + force) / DURATION**2)

    start = np.append(random_dmp.start, random_dmp.start_rate / DURATION)
    given = equation, (0, DURATION), start, "DOP853", TIMES.numpy()
    solution = solve_ivp(*given, rtol=1e-12, atol=1e-12).y.T
    y, dy, ddy = random_dmp(TIMES)
    np.testing.assert_allclose(torch.cat([y, dy], -1), solution, atol=1e-9)
    np.testing.assert_allclose(ddy[7], equation(TIMES[7].item(), solution[7])[3:], atol=1e-8)


def test_velocity_and_acceleration_are_derivatives_of_the_position(random_dmp: DMP) -> None:
    times, step = TIMES[1:], 1e-4
    before, here, after = (random_dmp(times + shift) for shift in (-step, 0.0, step))
    for order in (0, 1):
        slope = (after[order] - before[order]) / (2 * step)
        torch.testing.assert_close(slope, here[order + 1], atol=1e-4, rtol=1e-5)


def test_it_starts_as_given_and_converges_to_the_goal_whatever_the_weights(random_dmp: DMP) -> None:
    y, dy, _ = random_dmp(torch.zeros(1))
    torch.testing.assert_close(y[0], random_dmp.start)
    torch.testing.assert_close(dy[0], random_dmp.start_rate / DURATION)
    y, dy, ddy = random_dmp(torch.tensor([6 * DURATION]))
    torch.testing.assert_close(y[0], random_dmp.goal, atol=1e-8, rtol=0)
    assert max(dy.abs().max(), ddy.abs().max()) < 1e-8


def test_twice_the_duration_is_the_same_motion_at_half_the_speed(random_dmp: DMP) -> None:
    slow, fast = replace(random_dmp, duration=2 * DURATION)(2 * TIMES), random_dmp(TIMES)
    for order in range(3):
        torch.testing.assert_close(slow[order] * 2**order, fast[order])


def test_another_goal_draws_the_motion_there_and_another_start_with_it_moves_all(
    random_dmp: DMP, draws: Draws
) -> None:
    """To a goal alone it is drawn like a critically damped spring."""
    shift, motion = draws.normal(3), random_dmp(TIMES)[0]
    drawn = replace(random_dmp, goal=random_dmp.goal + shift)
    u = 12.5 * TIMES[:, None] / DURATION
    expected = shift * (1 - (1 + u) * torch.exp(-u))
    torch.testing.assert_close(drawn(TIMES)[0] - motion, expected)
    moved = replace(drawn, start=random_dmp.start + shift)
    torch.testing.assert_close(moved(TIMES)[0], motion + shift)


def test_motion_is_differentiable_in_the_weights(random_dmp: DMP) -> None:
    def motion(weights: Tensor) -> tuple[Tensor, ...]:
        return replace(random_dmp, weights=weights)(TIMES[::12])

    weights = random_dmp.weights.clone().requires_grad_()
    assert torch.autograd.gradcheck(motion, weights, fast_mode=True)


def test_times_may_come_in_any_order(random_dmp: DMP) -> None:
    order = torch.randperm(len(TIMES), generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(random_dmp(TIMES[order])[0], random_dmp(TIMES)[0][order])


def other_package(num_dims: int, num_basis: int, dt: float) -> object:
    """A primitive of ``movement_primitives``, which starts from rest."""
    return pytest.importorskip("movement_primitives.dmp").DMP(num_dims, DURATION, dt, num_basis)


def test_motion_is_that_of_movement_primitives(random_dmp: DMP) -> None:
    """That package integrates step by step: the difference falls with its step."""
    at_rest = replace(random_dmp, start_rate=torch.zeros(3, dtype=torch.float64))
    differences = []
    for dt in (1e-3, 2e-4):
        oracle = other_package(3, len(at_rest.weights), dt)
        oracle.configure(start_y=at_rest.start.numpy(), goal_y=at_rest.goal.numpy())
        oracle.set_weights(at_rest.weights.T.numpy())
        times, positions = (array[:: round(0.1 / dt)] for array in oracle.open_loop())
        differences.append(np.abs(at_rest(torch.from_numpy(times))[0].numpy() - positions).max())
    assert differences[1] < 2e-3
    assert differences[1] < 0.3 * differences[0]


def test_what_is_learned_is_what_movement_primitives_learns() -> None:
    times = torch.linspace(0, DURATION, 2501, dtype=torch.float64)
    u = times[:, None] / DURATION
    smooth, bump = 10 * u**3 - 15 * u**4 + 6 * u**5, (u * (1 - u)) ** 2
    positions = smooth * torch.tensor([3.0, -1.0]) + bump * (10 * u).sin()
    oracle = other_package(2, 30, dt=1e-3)
    oracle.imitate(times.numpy(), positions.numpy())
    ours = DMP.from_demonstrations(positions[None], 1e-3, 30)(times[::100])[0]
    np.testing.assert_allclose(oracle.open_loop()[1][::100], ours, atol=5e-3)
