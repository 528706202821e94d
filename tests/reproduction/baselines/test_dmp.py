"""Movement primitives: laws of the spring-damper, and the package ``movement_primitives`` as an
independent implementation.
"""

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
    return DMP.from_demonstrations(
        demonstration(times)[0][None], DURATION / (samples - 1), num_basis
    )


@pytest.fixture
def random_dmp(draws: Draws) -> DMP:
    return DMP(
        draws.normal(3), draws.normal(3), draws.normal(3), 100 * draws.normal(12, 3), DURATION
    )


def test_demonstration_is_reproduced_with_its_velocity_and_acceleration() -> None:
    motion = learned(num_basis=60, samples=251)(TIMES)
    for reproduced, demonstrated, tolerance in zip(
        motion, demonstration(TIMES), (1e-4, 1e-3, 1e-2), strict=True
    ):
        assert (reproduced - demonstrated).abs().max() < tolerance * demonstrated.abs().max()


def test_few_samples_are_reproduced_at_their_times() -> None:
    torch.testing.assert_close(learned()(TIMES)[0], demonstration(TIMES)[0], atol=5e-3, rtol=0)


def test_several_demonstrations_give_their_mean(draws: Draws) -> None:
    both = torch.stack([demonstration(TIMES)[0], draws.normal(1, 2) + 2 * demonstration(TIMES)[0]])
    together, mean = (
        DMP.from_demonstrations(positions, 0.1, 20)
        for positions in (both, both.mean(0, keepdim=True))
    )
    torch.testing.assert_close(together(TIMES)[0], mean(TIMES)[0])


def test_motion_solves_its_differential_equation(random_dmp: DMP) -> None:
    """Against an adaptive integrator of the equation as it is printed."""
    w, centres = random_dmp.weights.numpy(), np.exp(-4.605170185988091 * np.linspace(0, 1, 12))
    widths = -math.log(0.8) / np.append(np.diff(centres), np.diff(centres)[-1]) ** 2
    goal = random_dmp.goal.numpy()

    def equation(t: float, state: np.ndarray) -> np.ndarray:
        x = math.exp(-4.605170185988091 * t / DURATION)
        psi = np.exp(-widths * (x - centres) ** 2)
        y, dy = state[:3], state[3:]
        return np.append(
            dy, (25 * (6.25 * (goal - y) - DURATION * dy) + x * (psi @ w) / psi.sum()) / DURATION**2
        )

    start = np.append(random_dmp.start, random_dmp.start_rate / DURATION)
    solution = solve_ivp(
        equation, (0, DURATION), start, "DOP853", TIMES.numpy(), rtol=1e-12, atol=1e-12
    ).y.T
    y, dy, ddy = random_dmp(TIMES)
    np.testing.assert_allclose(torch.cat([y, dy], -1), solution, atol=1e-9)
    np.testing.assert_allclose(ddy[7], equation(TIMES[7].item(), solution[7])[3:], atol=1e-8)


def test_velocity_and_acceleration_are_derivatives_of_the_position(random_dmp: DMP) -> None:
    times, step = TIMES[1:], 1e-4
    before, here, after = (random_dmp(times + shift) for shift in (-step, 0.0, step))
    for order in (0, 1):
        torch.testing.assert_close(
            (after[order] - before[order]) / (2 * step), here[order + 1], atol=1e-4, rtol=1e-5
        )


def test_it_starts_where_and_as_fast_as_told(random_dmp: DMP) -> None:
    y, dy, _ = random_dmp(torch.zeros(1))
    torch.testing.assert_close(y[0], random_dmp.start)
    torch.testing.assert_close(dy[0], random_dmp.start_rate / DURATION)


def test_it_converges_to_the_goal_and_rests_whatever_the_weights(random_dmp: DMP) -> None:
    y, dy, ddy = random_dmp(torch.tensor([6 * DURATION]))
    torch.testing.assert_close(y[0], random_dmp.goal, atol=1e-8, rtol=0)
    assert max(dy.abs().max(), ddy.abs().max()) < 1e-8


def test_twice_the_duration_is_the_same_motion_at_half_the_speed(random_dmp: DMP) -> None:
    slow, fast = replace(random_dmp, duration=2 * DURATION)(2 * TIMES), random_dmp(TIMES)
    for order in range(3):
        torch.testing.assert_close(slow[order] * 2**order, fast[order])


def test_another_goal_draws_the_motion_there_like_a_critically_damped_spring(
    random_dmp: DMP, draws: Draws
) -> None:
    shift = draws.normal(3)
    moved = replace(random_dmp, goal=random_dmp.goal + shift)(TIMES)[0] - random_dmp(TIMES)[0]
    u = 12.5 * TIMES[:, None] / DURATION
    torch.testing.assert_close(moved, shift * (1 - (1 + u) * torch.exp(-u)))


def test_moving_start_and_goal_moves_the_motion(random_dmp: DMP, draws: Draws) -> None:
    shift = draws.normal(3)
    moved = replace(random_dmp, start=random_dmp.start + shift, goal=random_dmp.goal + shift)
    torch.testing.assert_close(moved(TIMES)[0], random_dmp(TIMES)[0] + shift)


def test_motion_is_differentiable_in_the_weights(random_dmp: DMP) -> None:
    def motion(weights: Tensor) -> tuple[Tensor, ...]:
        return replace(random_dmp, weights=weights)(TIMES[::12])

    assert torch.autograd.gradcheck(
        motion, random_dmp.weights.clone().requires_grad_(), fast_mode=True
    )


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
    positions = (10 * u**3 - 15 * u**4 + 6 * u**5) * torch.tensor([3.0, -1.0]) + (
        u * (1 - u)
    ) ** 2 * (10 * u).sin()
    oracle = other_package(2, 30, dt=1e-3)
    oracle.imitate(times.numpy(), positions.numpy())
    ours = DMP.from_demonstrations(positions[None], 1e-3, 30)(times[::100])[0]
    np.testing.assert_allclose(oracle.open_loop()[1][::100], ours, atol=5e-3)
