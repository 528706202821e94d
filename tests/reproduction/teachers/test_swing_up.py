"""The recorded demonstrator: its starts, its imprecision, its limits."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from reproduction.teachers.swing_up import STEPS, demonstrate
from reproduction.teachers.trajectory_optimization import Plan, TrackingController
from torch_pmil.envs.double_pendulum import DoublePendulumEnv

COUNT = 40


def lazy_teacher(torque: float) -> TrackingController:
    """Always means the same torque, whatever it sees."""
    plan = Plan(np.zeros((STEPS + 1, 4)), np.full((STEPS, 2), torque), cost=0.0, converged=True)
    gains, holding = np.zeros((STEPS, 2, 4)), np.zeros((2, 4))
    return TrackingController(plan, gains, holding, STEPS, np.zeros(4), np.full(2, 3.5))


def record(seed: int, torque: float = 1.0, torque_noise: float = 0.1) -> tuple[Tensor, Tensor]:
    env = DoublePendulumEnv(num_envs=COUNT, seed=seed)
    return demonstrate(env, lazy_teacher(torque), seed, torque_noise)


def test_demonstrations_start_where_the_environment_does() -> None:
    """And the recorded torques are those that moved the robot."""
    states, torques = record(seed=3)
    starts = DoublePendulumEnv(num_envs=COUNT, seed=3).reset()["observation"]
    torch.testing.assert_close(states[:, 0], starts)
    assert (states.shape, torques.shape) == ((COUNT, STEPS + 1, 4), (COUNT, STEPS, 2))
    env = DoublePendulumEnv(seed=0)
    for step in (0, 7, STEPS - 1):
        after = env.simulate(states[:, step], torques[:, step])
        torch.testing.assert_close(after, states[:, step + 1], rtol=0, atol=1e-12)


def test_imprecision_has_the_given_standard_deviation_and_is_drawn_anew_at_each_step() -> None:
    noise = record(seed=3)[1] - 1.0
    assert abs(noise.std().item() / 0.1 - 1) < 4 / (2 * noise.numel()) ** 0.5
    successive = torch.stack([noise[:, 1:].flatten(), noise[:, :-1].flatten()])
    assert abs(torch.corrcoef(successive)[0, 1]) < 4 / noise.numel() ** 0.5
    assert (record(seed=3, torque_noise=0.0)[1] == 1.0).all()
    assert record(seed=3, torque=3.45)[1].max() == 3.5  # the limit


def test_same_seed_gives_the_same_demonstrations() -> None:
    torch.testing.assert_close(record(seed=3), record(seed=3), rtol=0, atol=0)
    assert not torch.equal(record(seed=3)[1], record(seed=4)[1])
