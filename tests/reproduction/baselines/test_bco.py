"""Cloning from observation: the inverse model, and the policy that is cloned from it."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from reproduction.baselines.bco import BCO
from reproduction.baselines.networks import to_unit
from torch_pmil.envs.rollouts import rollout_of
from torch_pmil.tasks.registry import load_experiment

SEED = 100


def linear_system(seed: int, steps: int = 400) -> TensorDict:
    """Transitions in which each torque (N·m) adds half of itself to a velocity (rad/s)."""
    generator = torch.Generator().manual_seed(seed)
    states = torch.randn(steps, 4, dtype=torch.float64, generator=generator)
    torques = 3 * (2 * torch.rand(steps, 2, dtype=torch.float64, generator=generator) - 1)
    following = states.clone()
    following[:, 1::2] += torques / 2
    own = rollout_of(torch.zeros(steps + 1, 4, dtype=torch.float64))
    own["observation"], own["next", "observation"], own["action"] = states, following, torques
    return own


def learned() -> BCO:
    peer = BCO(load_experiment("double_pendulum"), SEED, steps=600, learning_rate=3e-3)
    peer.add(linear_system(seed=1))
    peer.fit()
    return peer


def test_inverse_model_recovers_a_linear_system() -> None:
    peer, other = learned(), linear_system(seed=2)
    inferred = peer.infer(other["observation"], other["next", "observation"])
    actions = to_unit(other["action"], peer.experiment.actions)
    assert (inferred - actions).square().mean() < 0.01 * actions.square().mean()


def test_policy_does_in_the_demonstrated_states_what_the_inverse_model_infers() -> None:
    peer = learned()
    states, following = peer.demonstrated_transitions
    actions = to_unit(peer.act(0, states), peer.experiment.actions)
    inferred = peer.infer(states, following)
    assert (actions - inferred).square().mean() < 0.3 * inferred.var()


def test_exploration_stays_within_limits() -> None:
    peer = BCO(load_experiment("double_pendulum"), SEED, noise=10.0)
    actions = peer.explore(0, torch.zeros(50, 4, dtype=torch.float64))
    assert actions.abs().max() <= 3.5
    assert actions.std() > 1
