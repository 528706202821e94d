"""A policy of one's own: its range, its file, its export, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import nn
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.module_policy import ModulePolicy
from torch_pmil.control.policy_file import PolicyFileError, load_policy, save_policy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))  # three features
U_MAX, U_MIDDLE = torch.tensor([2.0, 0.5]), torch.tensor([0.0, 1.0])
SCALE = torch.tensor([1.0, 2.0, 5.0])


def two_layers(inputs: int, outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, 8), nn.Tanh(), nn.Linear(8, outputs))


def made(module: nn.Module) -> ModulePolicy:
    return ModulePolicy(module, SCALE, U_MAX, U_MIDDLE)


@pytest.fixture
def policy() -> ModulePolicy:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return made(two_layers(3, 2))


@torch.no_grad()
def test_output_of_one_is_near_the_limit_and_features_are_in_their_sizes() -> None:
    module = nn.Linear(3, 2)
    module.weight.copy_(torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    module.bias.zero_()
    actions = made(module)(torch.tensor([[0.5, 7.0, 5.0], [0.0, 7.0, -1e3]]))
    shares = torch.tensor([[0.5, 1.0], [0.0, -200.0]], dtype=torch.float64).tanh()
    assert_close(actions, U_MIDDLE + U_MAX * shares)


def test_policy_learns_given_actions(policy: ModulePolicy, draws: Draws) -> None:
    features = draws.normal(50, 3)
    shares = torch.stack([0.5 * features[:, 0].sin(), 0.2 + 0 * features[:, 1]], -1)
    wanted = U_MIDDLE + U_MAX * shares
    policy.fit_weights(features, wanted)
    assert ((policy(features) - wanted) / U_MAX).square().mean().sqrt() < 0.02
    assert all(parameter.grad is None for parameter in policy.parameters())


@torch.no_grad()
def test_file_gives_the_same_actions(policy: ModulePolicy, tmp_path: Path, draws: Draws) -> None:
    path = tmp_path / "policy.pt"
    save_policy(path, policy, SPACE, control_period=0.1)
    states = draws.normal(20, 2)
    assert torch.equal(load_policy(path, two_layers)(states), policy(SPACE.features(states)))


def test_file_says_what_it_needs(policy: ModulePolicy, tmp_path: Path) -> None:
    path = tmp_path / "policy.pt"
    save_policy(path, policy, SPACE, control_period=0.1)
    with pytest.raises(PolicyFileError, match="needs the function that makes it: 'Sequential"):
        load_policy(path)
    with pytest.raises(TypeError, match=r"policy must make .*, got a function of \(features\)"):
        load_policy(path, lambda features: nn.Linear(features, 2))
    with pytest.raises(PolicyFileError, match=r"must be those of the module, .*module\.weight"):
        load_policy(path, nn.Linear)
    with pytest.raises(PolicyFileError, match=r"module\.0\.weight must have shape \(9, 3\)"):
        load_policy(path, lambda i, o: nn.Sequential(nn.Linear(i, 9), nn.Tanh(), nn.Linear(9, o)))


@torch.no_grad()
def test_exported_program_acts_alike(policy: ModulePolicy, tmp_path: Path, draws: Draws) -> None:
    path = tmp_path / "policy.pt2"
    StatePolicy(policy, SPACE, control_period=0.1).export(path, batch=True)
    states = draws.normal(20, 2)
    assert_close(torch.export.load(path).module()(states), policy(SPACE.features(states)))


@torch.no_grad()
def test_dropout_is_off_whatever_the_mode(tmp_path: Path) -> None:
    policy = made(nn.Sequential(nn.Linear(3, 8), nn.Dropout(0.5), nn.Tanh(), nn.Linear(8, 2)))
    state_policy = StatePolicy(policy, SPACE, control_period=0.1).train()
    assert torch.equal(state_policy(torch.ones(2)), state_policy(torch.ones(2)))
    without = made(nn.Sequential(policy.module[0], nn.Tanh(), policy.module[3]))  # type: ignore[index]
    assert torch.equal(policy(torch.ones(3)), without(torch.ones(3)))


class _Random(nn.Linear):
    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return super().forward(nn.functional.dropout(features))


class _Detached(nn.Linear):
    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return super().forward(features).detach()


class _OfPairs(nn.Linear):
    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return super().forward(features.view(-1, 3))


class _Words(nn.Linear):
    def forward(self, features: torch.Tensor) -> str:  # type: ignore[override]
        return "none"


@pytest.mark.parametrize(
    ("module", "error", "message"),
    [
        (lambda x: x, TypeError, "policy must be a torch.nn.Module, got function"),
        (nn.Tanh(), ValueError, "must have parameters to search"),
        (nn.Linear(3, 1), ValueError, r"to \(2, 2\), got \(2, 1\)"),
        (nn.Linear(4, 2), ValueError, r"features \(2, 3\) .* its call failed: mat1 and mat2"),
        (_Words(3, 2), TypeError, "got a str"),
        (_Random(3, 2), ValueError, "policy must act alike .* got random actions"),
        (_Detached(3, 2), ValueError, "must be differentiable"),
        (_OfPairs(3, 2), ValueError, r"features \(3,\) to \(2,\), got \(1, 2\)"),
        (nn.Bilinear(3, 3, 2), ValueError, "its call failed: .*missing 1 required"),
    ],
)
def test_module_that_is_no_policy_is_refused(
    module: nn.Module, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        made(module)


def test_module_without_finite_actions_is_refused() -> None:
    module = nn.Linear(3, 2)
    nn.init.constant_(module.bias, torch.nan)
    with pytest.raises(ValueError, match="not finite"):
        made(module)
