"""The PILCO baseline of the double pendulum: what it learns from, and what not."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.envs.double_pendulum import link_positions
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.target_losses import ExpectedSaturatingCost
from torch_pmil.tasks.cost_task import CostTask
from torch_pmil.tasks.registry import load_experiment


@pytest.fixture(scope="module")
def pilco() -> CostTask:
    return load_experiment("double_pendulum_pilco")


def policy_of(pilco: CostTask, seed: int = 0) -> RBFPolicy:
    return pilco.make_policy(torch.Generator().manual_seed(seed))


def make_loss(pilco: CostTask, draws: Draws) -> ExpectedSaturatingCost:
    dynamics = GPDynamics(8, 4)
    dynamics.set_data(draws.normal(5, 8), draws.normal(5, 4))
    return pilco.make_loss(policy_of(pilco), dynamics)


def cost_of(loss: ExpectedSaturatingCost, state: Tensor) -> float:
    return loss.rollout_loss(state.expand(1, 4), torch.zeros(1, 4, 4, dtype=torch.float64)).item()


def test_cost_is_that_of_equation_28_at_the_upright_link_ends(
    pilco: CostTask, draws: Draws
) -> None:
    """1 - exp(-|x - x_target|² / 8), the link ends 1 and 2 m below the target when hanging."""
    loss = make_loss(pilco, draws)
    upright = torch.zeros(4, dtype=torch.float64)
    hanging = torch.tensor([math.pi, 0.0, 0.0, 0.0], dtype=torch.float64)
    assert torch.equal(loss.target, link_positions(upright))
    assert cost_of(loss, upright) == pytest.approx(0, abs=1e-15)
    assert cost_of(loss, hanging) == pytest.approx(1 - math.exp(-5 / 8), rel=1e-12)
    assert loss.horizon == pilco.horizon == 25


def test_robot_model_and_policy_class_are_those_of_imitation(pilco: CostTask) -> None:
    imitation = load_experiment("double_pendulum").with_settings(velocities_alone=False)
    for same in ("make_env", "tolerance", "error", "horizon"):
        assert getattr(pilco, same) == getattr(imitation, same)
    ours, theirs = pilco.method.adjustable, imitation.method.adjustable
    others = [name for name in theirs if ours[name] != theirs[name]]
    assert others and all(name.startswith("search.") for name in others)
    assert torch.equal(pilco.actions.high, imitation.actions.high)
    assert torch.equal(pilco.initial.cov, imitation.initial.cov)
    assert sum(p.numel() for p in policy_of(pilco).parameters()) == 812


def test_policies_are_random_and_seeded(pilco: CostTask) -> None:
    policies = [policy_of(pilco, seed) for seed in (0, 0, 1)]
    first, again, other = (parameters_to_vector(policy.parameters()) for policy in policies)
    assert torch.equal(first, again)
    assert not torch.isclose(first[:600], other[:600]).any()


def test_centres_are_spread_over_all_angles_and_the_given_velocities(pilco: CostTask) -> None:
    """Of 400 centres: means to four standard errors of 100, deviations to a fifth."""
    policy = policy_of(pilco.with_settings(num_centres=400))
    centres = (policy.centres * policy.scale).detach()
    std = torch.tensor([3.0] * 2 + [0.5**0.5] * 4, dtype=torch.float64)  # dq, sin q, cos q
    assert (centres.mean(0).abs() < 4 * std / 10).all()
    assert_close(centres.std(0), std, rtol=0.2, atol=0)
    assert_close(policy.scale, std, rtol=0.2, atol=0)


def test_settings_name_what_the_cost_depends_on(pilco: CostTask) -> None:
    target = {"x1": 0.0, "y1": 0.5, "x2": 0.0, "y2": 1.0}
    cost = {"cost": "SaturatingCost", "target": target, "width": 2.0}
    assert {"cost": cost, "centre_std": [3.0] * 4}.items() <= pilco.settings.items()
    of_imitation = load_experiment("double_pendulum").settings.keys() - {"noise_std"}
    assert pilco.settings.keys() >= of_imitation
    assert pilco.with_settings(**{"cost.width": 1.0}).cost.width == 1.0
