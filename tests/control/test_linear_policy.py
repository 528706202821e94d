"""A linear policy: its moments in closed form, its gradient, its fit, its file and its export."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.linear_policy import LinearPolicy
from torch_pmil.control.policy_file import PolicyFileError, load_policy, save_policy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.rollout import predict_trajectory
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.reparameterisation import reparameterised
from torch_pmil.torchrl_interop import BeliefPolicy

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))  # three features
SCALE = torch.tensor([1.0, 2.0, 5.0])
U_MAX, U_MIDDLE = torch.tensor([2.0, 0.5]), torch.tensor([0.0, 1.0])
SAMPLES = 1_000_000


@pytest.fixture
def policy(draws: Draws) -> LinearPolicy:
    made = LinearPolicy(SCALE, U_MAX, U_MIDDLE)
    made.gains.data.copy_(draws.normal(2, 3))
    made.offsets.data.copy_(draws.normal(2))
    return made


@torch.no_grad()
def test_action_is_the_squashed_linear_function(policy: LinearPolicy, draws: Draws) -> None:
    x = draws.normal(7, 3)
    linear = torch.einsum("fd,nd->nf", policy.gains, x / SCALE) + policy.offsets
    assert_close(policy(x), U_MIDDLE + U_MAX * linear.sin())


@torch.no_grad()
def test_moments_are_those_of_samples_within_their_standard_errors(
    policy: LinearPolicy, draws: Draws
) -> None:
    root = draws.normal(3, 3)
    belief = Gaussian(draws.normal(3), root @ root.mT)
    action, slope = policy.controller.on_belief(belief)
    x = belief.mean + draws.normal(SAMPLES, 3) @ root.mT
    u = policy(x)
    assert ((u.mean(0) - action.mean).abs() < 5 * u.std(0) / SAMPLES**0.5).all()
    for first, moments in (
        (u - action.mean, action.cov),
        (x - belief.mean, belief.cov @ slope),
    ):
        products = first[:, :, None] * (u - action.mean)[:, None]
        error = products.std(0) / SAMPLES**0.5
        assert ((products.mean(0) - moments).abs() < 5 * error).all()


def test_module_of_torchrl_writes_the_same_belief(policy: LinearPolicy, draws: Draws) -> None:
    belief = Gaussian(draws.normal(2), 0.1 * torch.eye(2).double())
    entries = {"observation": {"mean": belief.mean, "var": belief.cov}}
    written = BeliefPolicy(policy, SPACE)(TensorDict(entries))
    action, _ = policy.controller.on_belief(SPACE.feature_moments(belief)[0])
    assert_close(written["action", "mean"], action.mean)
    assert_close(written["action", "var"], action.cov)


def test_search_knows_value_and_gradient_of_the_predicted_trajectory(
    policy: LinearPolicy, draws: Draws
) -> None:
    dynamics = GPDynamics(5, 2)
    dynamics.set_data(draws.normal(20, 5), draws.normal(20, 2))
    start = Gaussian(draws.normal(2), 0.1 * torch.eye(2).double())
    shown = Gaussian(draws.normal(4, 2), torch.eye(2).double().expand(4, 2, 2))
    loss = TrajectoryKLLoss(policy, dynamics, SPACE, shown, noise_std=0.1)
    assert loss.has_moments and loss.prediction is predict_trajectory
    searched = reparameterised(loss)
    point = torch.cat([variable.detach().flatten() for variable in searched.variables])
    function = searched.as_function(loss.per_step, start, 4)
    _, gradient = function(point)
    step = 1e-6 * torch.eye(len(point)).double()
    slopes = [(function(point + h)[0] - function(point - h)[0]) / 2e-6 for h in step]
    # of central differences: the third derivative times 1e-12, and rounding over 1e-6
    assert_close(gradient, torch.tensor(slopes).double(), rtol=1e-5, atol=1e-7)


def test_given_actions_of_a_linear_policy_are_learned(policy: LinearPolicy, draws: Draws) -> None:
    policy.gains.data *= 0.3  # within the sine's branch
    policy.offsets.data.zero_()
    x, other = draws.normal(50, 3), LinearPolicy(SCALE, U_MAX, U_MIDDLE)
    other.fit_weights(x, policy(x).detach(), ridge=1e-9)
    assert_close(other.gains, policy.gains, rtol=0, atol=1e-6)
    assert_close(other.offsets, policy.offsets, rtol=0, atol=1e-6)


@torch.no_grad()
def test_file_and_exported_program_act_alike(
    policy: LinearPolicy, tmp_path: Path, draws: Draws
) -> None:
    save_policy(tmp_path / "policy.pt", policy, SPACE, control_period=0.1)
    states = draws.normal(20, 2)
    loaded = load_policy(tmp_path / "policy.pt")
    assert isinstance(loaded.policy, LinearPolicy)
    assert torch.equal(loaded(states), policy(SPACE.features(states)))
    StatePolicy(policy, SPACE, control_period=0.1).export(tmp_path / "policy.pt2", batch=True)
    program = torch.export.load(tmp_path / "policy.pt2").module()
    assert_close(program(states), loaded(states))


def test_file_with_other_parameters_is_refused(policy: LinearPolicy, tmp_path: Path) -> None:
    path = tmp_path / "policy.pt"
    save_policy(path, policy, SPACE, control_period=0.1)
    content = torch.load(path)
    content["parameters"]["gains"] = torch.zeros(2, 4, dtype=torch.float64)
    torch.save(content, path)
    with pytest.raises(PolicyFileError, match=r"gains must have shape \(2, 3\), got \(2, 4\)"):
        load_policy(path)
    content["parameters"] |= {
        "gains": torch.full((2, 3), 1e308, dtype=torch.float64),
        "scale": torch.full((3,), 0.1, dtype=torch.float64),
    }
    torch.save(content, path)
    with pytest.raises(PolicyFileError, match="gains / scale must be finite"):
        load_policy(path)
    del content["parameters"]["offsets"]
    torch.save(content, path)
    with pytest.raises(PolicyFileError, match="parameters must be gains, offsets, u_max"):
        load_policy(path)
