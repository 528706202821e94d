"""Cloning from observation with given velocities and Gaussian processes."""

from __future__ import annotations

import pytest
import torch

from reproduction.baselines.bco_with_velocities import BCOWithVelocities
from reproduction.baselines.networks import to_unit
from reproduction.baselines.peer import Peer
from tests.reproduction.baselines.test_bco import linear_system
from torch_pmil.tasks.registry import load_experiment

SEED = 100


def test_inverse_model_and_clone_are_right_about_a_linear_system() -> None:
    peer, other = BCOWithVelocities(load_experiment("double_pendulum"), SEED), linear_system(seed=2)
    peer.add(linear_system(seed=1, steps=100))
    peer.fit()
    actions = to_unit(other["action"], peer.experiment.actions)
    inferred = peer.infer(other["observation"], other["next", "observation"])
    assert (inferred - actions).square().mean() < 1e-4 * actions.square().mean()
    states, following = peer.demonstrated_transitions
    cloned = to_unit(peer.act(0, states), peer.experiment.actions)
    wanted = peer.infer(states, following)
    assert (cloned - wanted).square().mean() < 0.3 * wanted.var()


def test_velocities_are_those_with_which_the_demonstrator_moved() -> None:
    """Between two steps the angles move by the mean velocity, but for the change of its slope."""
    experiment = load_experiment("double_pendulum")
    peer, period = BCOWithVelocities(experiment, SEED), experiment.demonstrations.time_step
    states = peer.demonstrated_states
    observed = experiment.space.observe(states)
    torch.testing.assert_close(observed, experiment.demonstrations.positions)
    moved, velocities = states[:, 1:, ::2] - states[:, :-1, ::2], states[..., 1::2]
    off = moved - period * (velocities[:, 1:] + velocities[:, :-1]) / 2
    differenced = Peer.demonstrated_states.fget(peer)
    assert off.abs().max() < 0.1 * moved.abs().max()
    assert (states - differenced)[..., 1::2].abs().max() > 1  # rad/s


def test_velocities_of_other_recordings_and_actions_before_a_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"of double_pendulum, .* got those of biorob"):
        BCOWithVelocities(load_experiment("biorob"), SEED)
    peer = BCOWithVelocities(load_experiment("double_pendulum"), SEED)
    with pytest.raises(RuntimeError, match="call fit first"):
        peer.act(0, peer.demonstrated_states[:, 0])
