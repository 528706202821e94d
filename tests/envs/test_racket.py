"""The racket's way along predicted states, against the simulation that the states are from."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

from torch_pmil.envs import BioRobEnv
from torch_pmil.envs.biorob import START, holding_torques
from torch_pmil.envs.racket import distance_along
from torch_pmil.envs.rollouts import states_of

ROBOTS, STEPS = 40, 18


def random_motions() -> TensorDictBase:
    """Rollouts of torques that hold the arm, and vary by several N·m, without a hit."""
    generator = torch.Generator().manual_seed(0)
    spread = torch.tensor([4.0, 8.0, 4.0], dtype=torch.float64)

    def policy(tensordict: TensorDictBase) -> TensorDictBase:
        noise = torch.randn(ROBOTS, 3, generator=generator, dtype=torch.float64)
        holding = holding_torques(tensordict["observation"][..., :3])
        tensordict["action"] = (holding + spread * noise).clamp(-10, 10)
        return tensordict

    return BioRobEnv(num_envs=ROBOTS, seed=0).rollout(STEPS, policy)


def test_distance_is_that_of_the_simulation() -> None:
    """To what a cubic misses of a motion between two states, at accelerations of some rad/s²."""
    rollouts = random_motions()
    assert not rollouts["next", "info", "hit"].any()
    simulated = rollouts["next", "info", "racket_ball_distance"][..., 0].amin(-1)
    apart = (distance_along(states_of(rollouts)) - simulated).abs()
    assert apart.max() < 0.03
    assert apart.median() < 0.005


def test_arm_that_is_led_through_the_ball_touches_it() -> None:
    start = torch.tensor(START, dtype=torch.float64)
    rollouts = random_motions()
    nearest = rollouts["next", "info", "racket_ball_distance"][..., 0].amin(-1).argmin()
    missed = states_of(rollouts)[nearest]
    distances = []
    for turned in torch.linspace(-0.3, 0.3, 25):  # rad, of the yaw: past the ball on both sides
        states = missed.clone()
        states[:, 0] += turned
        distances.append(distance_along(states).item())
    assert min(distances) == 0.0
    assert max(distances) > 0.05
    assert distance_along(start.expand(2, 5, STEPS + 1, 6)).shape == (2, 5)
