"""A policy with targets beside states, in every form in which a policy is used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.helpers.draws import Draws
from torch_pmil.control.policy_file import PolicyFileError, load_policy, save_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.trainer.collector import RobotActor

NAMES, UNITS, TARGET = ("q", "dq"), ("rad", "rad/s"), ("y", "z")
SPACE = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))


@pytest.fixture
def network(draws: Draws) -> RBFPolicy:
    network = RBFPolicy(draws.normal(7, 5), torch.tensor([3.5, 2.0]), torch.ones(5))
    network.weights.data.copy_(draws.normal(7, 2))
    return network.requires_grad_(False)


@pytest.fixture
def policy(network: RBFPolicy) -> StatePolicy:
    return StatePolicy(network, SPACE, 0.1, TARGET)


def test_network_sees_features_then_target(policy: StatePolicy, draws: Draws) -> None:
    states, targets = draws.normal(6, 2), draws.normal(6, 2)
    expected = policy.policy(torch.cat([SPACE.features(states), targets], -1))
    assert torch.equal(policy(states, targets), expected)
    assert (policy(states.numpy(), targets.numpy()) == expected.numpy()).all()


def test_one_target_is_that_of_all_states(policy: StatePolicy, draws: Draws) -> None:
    states, target = draws.normal(3, 6, 2), draws.normal(2)
    assert torch.equal(policy(states, target), policy(states, target.expand(3, 6, 2)))


def test_module_and_actor_read_the_target_of_each_robot(policy: StatePolicy, draws: Draws) -> None:
    seen = TensorDict({"observation": draws.normal(6, 2), "target": draws.normal(6, 2)}, [6])
    expected = policy(seen["observation"], seen["target"])
    assert torch.equal(policy.as_tensordict_module()(seen)["action"], expected)
    actor = RobotActor(policy.policy, SPACE, motion=None)
    actor.exploring = False
    assert torch.equal(actor(seen["observation"], seen["target"]), expected)


def test_saved_policy_knows_its_target(policy: StatePolicy, tmp_path: Path, draws: Draws) -> None:
    save_policy(tmp_path / "policy.pt", policy.policy, SPACE, 0.1, TARGET)
    loaded = load_policy(tmp_path / "policy.pt")
    states, targets = draws.normal(6, 2), draws.normal(6, 2)
    assert loaded.target_names == TARGET
    assert "target y, z" in repr(loaded)
    assert torch.equal(loaded(states, targets), policy(states, targets))


@pytest.mark.parametrize("batch", [False, True])
def test_exported_program_takes_both(
    policy: StatePolicy, tmp_path: Path, draws: Draws, batch: bool
) -> None:
    policy.export(tmp_path / "policy.pt2", batch)
    program = torch.export.load(tmp_path / "policy.pt2").module()
    shape = (5, 2) if batch else (2,)
    state, target = draws.normal(*shape), draws.normal(*shape)
    torch.testing.assert_close(program(state, target), policy(state, target), rtol=0, atol=1e-14)
    with pytest.raises(RuntimeError, match="target must be finite"):
        program(state, torch.full(shape, torch.nan, dtype=torch.float64))


@pytest.mark.parametrize(
    ("target", "kind", "message"),
    [
        (np.zeros(3), ValueError, r"target must have shape \(\*batch, 2\) for y, z, got \(3,\)"),
        (np.array([0.0, np.inf]), ValueError, "target must be finite, got z = inf"),
        ("00", TypeError, "target must be a NumPy array, a PyTorch tensor or a list, got str"),
        (None, TypeError, "policy must be called with a state and a target, got a state alone"),
    ],
)
def test_malformed_target_is_an_error(
    policy: StatePolicy, target: object, kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        policy(np.zeros(2), target)


def test_policy_of_another_number_of_inputs_is_refused(network: RBFPolicy, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="must see the features dq, sin q, cos q, y, got one of 5"):
        StatePolicy(network, SPACE, 0.1, TARGET[:1])
    save_policy(tmp_path / "policy.pt", network, SPACE, 0.1, TARGET)
    content = torch.load(tmp_path / "policy.pt", weights_only=True)
    torch.save({**content, "target_names": ["y"]}, tmp_path / "policy.pt")
    with pytest.raises(PolicyFileError, match=r"centres must have shape \(7, 4\), got \(7, 5\)"):
        load_policy(tmp_path / "policy.pt")
