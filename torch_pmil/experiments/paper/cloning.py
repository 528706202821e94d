"""Behavioural cloning on robots of other masses, and the torques that exact tracking would need there (Section 5.1.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torch_pmil.baselines.behavioral_cloning import clone_behavior
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, double_pendulum_model, link_positions
from torch_pmil.envs.exact_tracking import motion_of, tracking_torques
from torch_pmil.envs.swing_up import demonstrate_swing_up, swing_up_expert
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.paper.learned import measured_success
from torch_pmil.experiments.paper.reproduction import PaperExperiment, Report, Run
from torch_pmil.plotting import plot_success_over_mass
from torch_pmil.state_policy import StatePolicy

FIRST_LINK = 0.5  # kg, of all robots
DEMONSTRATED = 0.5  # kg, second link of the demonstrator
MASSES = (0.15, 0.3, 0.4, 0.5, 0.57, 0.65, 0.8, 1.0)  # kg, second link of the robots
DEMONSTRATIONS = 5
SEEDS = range(10)  # of the demonstrations; 0 are those that come with the package
STARTS = 100
START_SEED = 5_000_000


def record_pairs(seeds: Sequence[int]) -> Iterator[tuple[Tensor, Tensor]]:
    """Five swing-ups with each seed: states (5, T + 1, 4) and the torques that the expert applied, (5, T, 2), in N·m."""
    expert = swing_up_expert((FIRST_LINK, DEMONSTRATED))
    for seed in seeds:
        env = DoublePendulumEnv((FIRST_LINK, DEMONSTRATED), num_envs=DEMONSTRATIONS, seed=seed)
        yield demonstrate_swing_up(env, expert, seed)


def clone_double_pendulum(states: Tensor, torques: Tensor) -> StatePolicy:
    """The policy that imitates the torques of recorded swing-ups."""
    experiment = load_experiment("double_pendulum")
    return clone_behavior(
        states[:, :-1].flatten(0, 1), torques.flatten(0, 1), experiment.space, experiment.u_max, experiment.demonstrations.time_step
    )


def success_over_mass(policy: StatePolicy, masses: Sequence[float], starts: int, seed: int) -> list[float]:
    """Success rate of a policy on the double pendulum with each mass of the second link.

    Args:
        policy: of the double pendulum's states.
        masses: of the second link, kg.
        starts: number of rollouts on each robot.
        seed: of the starts, which are the same for all robots.

    Returns:
        Fractions from 0 to 1, one for each mass.
    """
    experiment = load_experiment("double_pendulum")
    robots = [replace(experiment, make_env=partial(DoublePendulumEnv, (FIRST_LINK, mass))) for mass in masses]
    return [measured_success(policy, robot, starts, seed) for robot in robots]


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
    return torch.tensor([[tracking_torques(model, *motion).abs().max() for model in models] for motion in motions])


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """None: cloning learns in a second."""
    return []


def report(folders: Sequence[Path], quick: bool) -> Report:
    """Success over the mass with several sets of demonstrations; peak torques of the set that comes with the package."""
    seeds, starts = (SEEDS[:2], 20) if quick else (SEEDS, STARTS)
    pairs = list(record_pairs(seeds))
    rates = np.array([success_over_mass(clone_double_pendulum(*pair), MASSES, starts, START_SEED) for pair in pairs])
    peaks = peak_tracking_torques(*pairs[0], MASSES).numpy()
    difference = link_positions(pairs[0][0]) - shipped_demonstrations("double_pendulum").positions
    limit = load_experiment("double_pendulum").u_max.max().item()
    headline = {
        **{f"success_rate_{mass:g}kg": rate for mass, rate in zip(MASSES, rates.mean(0).tolist(), strict=True)},
        **{f"peak_torque_{mass:g}kg": peak for mass, peak in zip(MASSES, peaks.max(0).tolist(), strict=True)},
        "difference_from_shipped_demonstrations_m": difference.abs().max().item(),
    }
    settings = {"seeds": list(seeds), "starts": starts, "masses": list(MASSES)}
    details = {**settings, "success_rates": rates.tolist(), "peak_torques": peaks.tolist()}
    figure = plot_success_over_mass(MASSES, {"behavioural cloning": rates}, peaks, limit, DEMONSTRATED)
    return Report(headline, {"cloning": figure}, details)


CLONING = PaperExperiment("cloning", "behavioural cloning, and the torques of exact tracking, over the second mass", needed_runs, report)
