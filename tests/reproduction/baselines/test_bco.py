"""Cloning from observation: the inverse model, and the policy that is cloned from it."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from reproduction.baselines.bco import BCO, ToldBCO
from reproduction.baselines.networks import to_unit
from reproduction.baselines.peer import Peer
from torch_pmil.envs.rollouts import rollout_of
from torch_pmil.experiments import load_experiment

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
    peer = BCO(load_experiment("double_pendulum"), SEED)
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


def test_told_velocities_are_those_with_which_the_demonstrator_moved() -> None:
    """Between two steps the angles move by the mean velocity, but for the change of its slope."""
    experiment = load_experiment("double_pendulum")
    peer, period = ToldBCO(experiment, SEED), experiment.demonstrations.time_step
    states = peer.demonstrated_states
    observed = experiment.space.observe(states)
    torch.testing.assert_close(observed, experiment.demonstrations.positions)
    moved, velocities = states[:, 1:, ::2] - states[:, :-1, ::2], states[..., 1::2]
    off = moved - period * (velocities[:, 1:] + velocities[:, :-1]) / 2
    differenced = Peer.demonstrated_states.fget(peer)
    assert off.abs().max() < 0.1 * moved.abs().max()
    assert (states - differenced)[..., 1::2].abs().max() > 1  # rad/s


def test_velocities_of_other_recordings_are_not_told() -> None:
    with pytest.raises(ValueError, match=r"of double_pendulum, .* got those of biorob"):
        ToldBCO(load_experiment("biorob"), SEED)


def test_exploration_stays_within_the_limits() -> None:
    peer = BCO(load_experiment("double_pendulum"), SEED, noise=10.0)
    peer.add(linear_system(seed=1, steps=40))
    peer.fit()
    actions = peer.explore(0, torch.zeros(50, 4, dtype=torch.float64))
    assert actions.abs().max() <= 3.5
    assert actions.std() > 1
