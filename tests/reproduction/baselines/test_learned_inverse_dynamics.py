"""The learned inverse model and the controller of Eq. 29, on the double pendulum."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from reproduction.baselines.learned_inverse_dynamics import (
    POSITION_GAIN,
    VELOCITY_GAIN,
    InverseDynamics,
    Reference,
    TrackingController,
    accelerations_from_velocities,
)
from tests.helpers.draws import Draws
from tests.helpers.short_run import quick_fits
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.tasks.double_pendulum import double_pendulum_space

U_MAX = torch.tensor([3.5, 3.5], dtype=torch.float64)
HOLD, STEPS = 4, 6


def transitions(draws: Draws, count: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Double pendulums in any pose under any torques, with their mean accelerations."""
    states = draws.uniform(-1, 1, count, 4) * torch.tensor([math.pi, 3.0, 1.5, 3.0])
    torques = draws.uniform(-1, 1, count, 2) * U_MAX
    next_states = DoublePendulumEnv(seed=0).simulate(states, torques)
    return states, next_states, (next_states - states)[:, 1::2] / 0.1, torques


class KnownInverse:
    """Answers with numbers that show what it was asked, and remembers the questions."""

    def __init__(self) -> None:
        self.asked: list[tuple[Tensor, Tensor, Tensor]] = []

    def __call__(self, states: Tensor, next_states: Tensor, accelerations: Tensor) -> Tensor:
        self.asked.append((states, next_states, accelerations))
        return 0.1 * states[..., :2] - 0.2 * next_states[..., 2:] + 0.3 * accelerations


@pytest.fixture
def reference(draws: Draws) -> Reference:
    return Reference(draws.normal(STEPS * HOLD + 1, 4), draws.normal(STEPS + 1, 2))


def test_inverse_of_the_double_pendulum_is_learned(draws: Draws) -> None:
    """Of transitions that it has not seen; the torques have a standard deviation of 2 N·m."""
    inverse = InverseDynamics(double_pendulum_space())
    inverse.fit(*transitions(draws, 100))
    states, next_states, accelerations, torques = transitions(draws, 200)
    assert (inverse(states, next_states, accelerations) - torques).square().mean().sqrt() < 0.3


def test_inverse_model_needs_data_and_does_not_count_full_turns(
    draws: Draws, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    inverse = InverseDynamics(double_pendulum_space())
    with pytest.raises(RuntimeError, match="has no data yet"):
        inverse(torch.zeros(4), torch.zeros(4), torch.zeros(2))
    states, next_states, accelerations, torques = transitions(draws, 20)
    inverse.fit(states, next_states, accelerations, torques)
    turned = 2 * math.pi * torch.tensor([1.0, 0.0, -1.0, 0.0], dtype=torch.float64)
    expected = inverse(states, next_states, accelerations)
    found = inverse(states + turned, next_states + turned, accelerations)
    torch.testing.assert_close(found, expected)


def test_torques_are_those_of_equation_29_within_limits(reference: Reference, draws: Draws) -> None:
    inverse, states = KnownInverse(), draws.normal(STEPS * HOLD, 4)
    controller = TrackingController(inverse, reference, 1e3 * U_MAX)
    for step, state in enumerate(states):
        begun, control_step = step - step % HOLD, step // HOLD
        meant, acceleration = reference.states[begun + HOLD], reference.accelerations
        feedforward = KnownInverse()(states[begun], meant, acceleration[control_step + 1])
        away = reference.states[step] - state
        feedback = 0.5 * away[0::2] + 0.25 * away[1::2]
        torch.testing.assert_close(controller(step, state), feedforward + feedback)
    assert len(inverse.asked) == STEPS
    controller = TrackingController(KnownInverse(), reference, U_MAX)
    torques = controller(0, torch.tensor([100.0, 0.0, -100.0, 0.0], dtype=torch.float64))
    torch.testing.assert_close(torques.abs(), U_MAX)


def test_batch_of_robots_is_a_loop_over_them(reference: Reference, draws: Draws) -> None:
    states = draws.normal(3, 5, 4)
    batched = TrackingController(KnownInverse(), reference, U_MAX)
    together = torch.stack([batched(step, state) for step, state in enumerate(states)])
    for robot in range(5):
        one = TrackingController(KnownInverse(), reference, U_MAX)
        alone = torch.stack([one(step, state[robot]) for step, state in enumerate(states)])
        torch.testing.assert_close(alone, together[:, robot])


def test_accelerations_are_exact_for_cubic_velocities(draws: Draws) -> None:
    t, c = torch.linspace(0, 1, 9, dtype=torch.float64)[:, None], draws.normal(4, 2)
    velocities = c[0] + c[1] * t + c[2] * t**2 + c[3] * t**3
    expected = c[1] + 2 * c[2] * t + 3 * c[3] * t**2
    torch.testing.assert_close(accelerations_from_velocities(velocities, 1 / 8), expected)


@pytest.mark.parametrize(("period", "least", "largest"), [(0.1, 2.2, 2.4), (0.01, 0.9, 1.0)])
def test_feedback_held_for_a_control_step_is_unstable_about_hanging_and_a_fast_one_is_not(
    period: float, least: float, largest: float
) -> None:
    """The spectral radius of one period of the PD controller alone.

    K_d dt is three times the least eigenvalue of the mass matrix at dt = 0.1 s: the velocity error
    of that mode changes its sign and grows.
    """
    env, step = DoublePendulumEnv(control_period=period, seed=0), 1e-5
    unit = step * torch.eye(6, dtype=torch.float64)
    ahead, back = (
        env.simulate(env.initial_mean + sign * unit[:, :4], sign * unit[:, 4:]) for sign in (1, -1)
    )
    slopes = (ahead - back).mT / (2 * step)
    of_states, of_torques = slopes[:, :4], slopes[:, 4:]
    gains = torch.kron(torch.eye(2), torch.tensor([[POSITION_GAIN, VELOCITY_GAIN]])).double()
    radius = torch.linalg.eigvals(of_states - of_torques @ gains).abs().max()
    assert least < radius < largest
