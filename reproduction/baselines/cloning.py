"""Cloned policies and exact tracking, from swing-ups recorded with torques (Section 5.1.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from reproduction.baselines.behavioral_cloning import clone_behavior
from reproduction.teachers.exact_tracking import motion_of
from reproduction.teachers.swing_up import demonstrate, swing_up_teacher
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, double_pendulum_model
from torch_pmil.envs.joint_torques import tracking_torques
from torch_pmil.tasks.registry import load_experiment

FIRST_LINK = 0.5  # kg, of all robots
DEMONSTRATED = 0.5  # kg, second link of the demonstrator
DEMONSTRATIONS = 5


def record_pairs(seeds: Sequence[int]) -> Iterator[tuple[Tensor, Tensor]]:
    """Five swing-ups with each seed: states (5, T + 1, 4) and torques (5, T, 2), in N·m.

    Those of seed 0 are the demonstrations that come with the package.
    """
    teacher = swing_up_teacher((FIRST_LINK, DEMONSTRATED))
    for seed in seeds:
        env = DoublePendulumEnv((FIRST_LINK, DEMONSTRATED), num_envs=DEMONSTRATIONS, seed=seed)
        yield demonstrate(env, teacher, seed)


def clone_double_pendulum(states: Tensor, torques: Tensor) -> StatePolicy:
    """The policy that imitates the torques of recorded swing-ups."""
    experiment = load_experiment("double_pendulum")
    return clone_behavior(
        states[:, :-1].flatten(0, 1),
        torques.flatten(0, 1),
        experiment.space,
        experiment.actions.half_range,
        experiment.demonstrations.time_step,
    )


def peak_tracking_torques(states: Tensor, torques: Tensor, masses: Sequence[float]) -> Tensor:
    """Largest absolute torque with which robots would move exactly as in the demonstrations.

    Args:
        states: of N demonstrations, (N, T + 1, 4).
        torques: that the demonstrator applied, N·m, (N, T, 2).
        masses: K second links, kg.

    Returns:
        N·m, (N, K).
    """
    env = DoublePendulumEnv((FIRST_LINK, DEMONSTRATED), seed=0)
    motions = [motion_of(env, *rollout)[:2] for rollout in zip(states, torques, strict=True)]
    models = [double_pendulum_model((FIRST_LINK, mass)) for mass in masses]
    return torch.tensor(
        [[tracking_torques(model, *motion).abs().max() for model in models] for motion in motions]
    )
