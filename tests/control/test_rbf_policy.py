"""The RBF policy, on a state and on a belief."""

from __future__ import annotations

import pytest
import torch
from torch.autograd import gradcheck
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import Controller, RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.kernel_expansion import KernelExpansion

U_MAX, U_MIDDLE = torch.tensor([[3.5, 2.0], [0.5, -1.0]], dtype=torch.float64)


@pytest.fixture
def policy(draws: Draws) -> RBFPolicy:
    """Ten centres, three inputs, two actions."""
    policy = RBFPolicy(draws.normal(10, 3), U_MAX, draws.uniform(0.5, 2.0, 3), U_MIDDLE)
    with torch.no_grad():
        policy.weights.copy_(draws.normal(10, 2))
        policy.log_widths.copy_(0.3 * draws.normal(2, 3))
    return policy


@pytest.mark.parametrize(
    ("centres", "inputs", "actions", "count"),
    [(100, 6, 2, 812), (80, 6, 3, 738), (250, 8, 3, 2774)],
)
def test_number_of_parameters_is_that_of_the_paper(
    centres: int, inputs: int, actions: int, count: int
) -> None:
    policy = RBFPolicy(torch.zeros(centres, inputs), torch.ones(actions), torch.ones(inputs))
    assert sum(parameter.numel() for parameter in policy.parameters()) == count


def test_action_is_the_formula_of_the_paper(policy: RBFPolicy, draws: Draws) -> None:
    """Eqs. 25-27, in the units of the inputs, around the middle of the range."""
    x = draws.normal(3)
    centres, widths = policy.centres * policy.scale, policy.log_widths.exp() * policy.scale
    for a in range(2):
        raw = sum(
            policy.weights[i, a] * torch.exp(-(((x - centres[i]) / widths[a]) ** 2).sum() / 2)
            for i in range(10)
        )
        assert_close(policy(x)[a], U_MIDDLE[a] + U_MAX[a] * torch.sin(raw))


def test_belief_without_covariance_is_a_state(policy: RBFPolicy, draws: Draws) -> None:
    x = draws.normal(4, 3)
    certain = Gaussian(x, torch.zeros(4, 3, 3, dtype=torch.float64))
    action, slope = policy.controller.on_belief(certain)
    assert_close(action.mean, policy(x))
    assert_close(action.cov, torch.zeros(4, 2, 2, dtype=torch.float64))
    for i in range(4):
        assert_close(slope[i], torch.autograd.functional.jacobian(policy, x[i]).mT)


def test_narrow_belief_has_the_moments_of_the_linearised_policy(
    policy: RBFPolicy, draws: Draws
) -> None:
    narrow = draws.belief(3, scale=1e-8)
    jacobian = torch.autograd.functional.jacobian(policy, narrow.mean)
    action, slope = policy.controller.on_belief(narrow)
    linearised = jacobian @ narrow.cov @ jacobian.mT
    assert_close(action.cov, linearised, rtol=1e-4, atol=1e-12)
    assert_close(slope, jacobian.mT, rtol=1e-5, atol=1e-6)


def test_action_stays_within_the_limits(policy: RBFPolicy, draws: Draws) -> None:
    with torch.no_grad():
        policy.weights.mul_(5)
    assert ((policy(2 * draws.normal(1000, 3)) - U_MIDDLE).abs() <= U_MAX).all()
    action, _ = policy.controller.on_belief(draws.belief(100, 3))
    assert ((action.mean - U_MIDDLE).abs() <= U_MAX).all()
    assert (action.std <= U_MAX).all()


def test_scale_is_a_choice_of_units(draws: Draws) -> None:
    """One policy in degrees and in rad: equal actions and equal gradients of its parameters."""
    centres, weights, x = draws.normal(5, 2), draws.normal(5, 2), draws.normal(2)
    actions, gradients = [], []
    for unit in (torch.ones(2), torch.tensor([180 / torch.pi, 1000.0])):
        policy = RBFPolicy(centres * unit, U_MAX, unit)
        with torch.no_grad():
            policy.weights.copy_(weights)
        actions.append(policy(x * unit.double()))
        gradients.append(torch.autograd.grad(actions[-1].sum(), list(policy.parameters())))
    assert_close(actions[0], actions[1])
    for one, other in zip(*gradients, strict=True):
        assert_close(one, other)


def test_gradient_of_the_belief_over_the_action(draws: Draws) -> None:
    belief = draws.belief(2, 2)

    def moments(centres, weights, widths, mean):
        network = KernelExpansion(centres, weights, widths, torch.ones(2, dtype=torch.float64))
        action, slope = Controller(network, U_MAX, U_MIDDLE).on_belief(Gaussian(mean, belief.cov))
        return action.mean, action.cov, slope

    variables = draws.normal(4, 2), draws.normal(2, 4), draws.uniform(0.5, 2.0, 2, 2), belief.mean
    assert gradcheck(moments, tuple(variable.requires_grad_() for variable in variables))


def test_gradient_reaches_all_parameters(policy: RBFPolicy, draws: Draws) -> None:
    action, _ = policy.controller.on_belief(draws.belief(3))
    total = action.mean.sum() + action.cov.sum()
    gradients = torch.autograd.grad(total, list(policy.parameters()))
    assert all((gradient != 0).all() for gradient in gradients)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"scale": torch.ones(3)}, r"scale must have shape \(2,\), got \(3,\)"),
        ({"scale": torch.zeros(2)}, "scale must be positive, got 0"),
        ({"centres": torch.zeros(3)}, r"centres must have shape \(m, inputs\), got \(3,\)"),
        ({"u_max": torch.tensor(1.0)}, r"u_max must have shape \(F,\), got \(\)"),
        ({"u_max": torch.ones(0)}, r"u_max must have shape \(F,\), got \(0,\)"),
    ],
)
def test_policy_of_numbers_that_do_not_fit_is_an_error(wrong: dict, message: str) -> None:
    fit = {"centres": torch.zeros(4, 2), "u_max": torch.ones(1), "scale": torch.ones(2)}
    with pytest.raises(ValueError, match=message):
        RBFPolicy(**(fit | wrong))
