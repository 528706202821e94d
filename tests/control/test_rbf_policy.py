"""The RBF policy, on a state and on a belief."""

from __future__ import annotations

import pytest
import torch
from torch.autograd import gradcheck

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
    x, centres, widths = (
        draws.normal(3),
        policy.centres * policy.scale,
        policy.log_widths.exp() * policy.scale,
    )
    for a in range(2):
        raw = sum(
            policy.weights[i, a] * torch.exp(-(((x - centres[i]) / widths[a]) ** 2).sum() / 2)
            for i in range(10)
        )
        torch.testing.assert_close(policy(x)[a], U_MIDDLE[a] + U_MAX[a] * torch.sin(raw))


def test_belief_without_covariance_is_a_state(policy: RBFPolicy, draws: Draws) -> None:
    x = draws.normal(4, 3)
    action, slope = policy.controller.on_belief(
        Gaussian(x, torch.zeros(4, 3, 3, dtype=torch.float64))
    )
    torch.testing.assert_close(action.mean, policy(x))
    torch.testing.assert_close(action.cov, torch.zeros(4, 2, 2, dtype=torch.float64))
    for i in range(4):
        torch.testing.assert_close(slope[i], torch.autograd.functional.jacobian(policy, x[i]).mT)


def test_narrow_belief_has_the_moments_of_the_linearised_policy(
    policy: RBFPolicy, draws: Draws
) -> None:
    narrow = draws.belief(3, scale=1e-8)
    jacobian = torch.autograd.functional.jacobian(policy, narrow.mean)
    action, slope = policy.controller.on_belief(narrow)
    torch.testing.assert_close(
        action.cov, jacobian @ narrow.cov @ jacobian.mT, rtol=1e-4, atol=1e-12
    )
    torch.testing.assert_close(slope, jacobian.mT, rtol=1e-5, atol=1e-6)


def test_action_stays_within_the_limits(policy: RBFPolicy, draws: Draws) -> None:
    with torch.no_grad():
        policy.weights.mul_(5)
    assert ((policy(2 * draws.normal(1000, 3)) - U_MIDDLE).abs() <= U_MAX).all()
    action, _ = policy.controller.on_belief(draws.belief(100, 3))
    assert ((action.mean - U_MIDDLE).abs() <= U_MAX).all()
    assert (action.std <= U_MAX).all()


def test_each_output_has_its_own_widths(policy: RBFPolicy, draws: Draws) -> None:
    x = draws.normal(3)
    before = policy(x)
    with torch.no_grad():
        policy.log_widths[0] += 0.5
    assert policy(x)[0] != before[0]
    assert policy(x)[1] == before[1]


def test_scale_is_a_choice_of_units(draws: Draws) -> None:
    """One policy in degrees and in rad: equal actions and equal gradients of its parameters."""
    centres, weights, x, units = (
        draws.normal(5, 2),
        draws.normal(5, 2),
        draws.normal(2),
        torch.tensor([180 / torch.pi, 1000.0]),
    )
    actions, gradients = [], []
    for unit in (torch.ones(2), units):
        policy = RBFPolicy(centres * unit, U_MAX, unit)
        with torch.no_grad():
            policy.weights.copy_(weights)
        actions.append(policy(x * unit.double()))
        gradients.append(torch.autograd.grad(actions[-1].sum(), list(policy.parameters())))
    torch.testing.assert_close(actions[0], actions[1])
    for one, other in zip(*gradients, strict=True):
        torch.testing.assert_close(one, other)


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
    for gradient in torch.autograd.grad(
        action.mean.sum() + action.cov.sum(), list(policy.parameters())
    ):
        assert (gradient != 0).all()


@pytest.mark.parametrize("scale", [torch.ones(3), torch.zeros(2), -torch.ones(2)])
def test_scale_that_does_not_fit_is_an_error(scale: torch.Tensor) -> None:
    with pytest.raises(ValueError, match="scale must hold 2 positive numbers"):
        RBFPolicy(torch.zeros(4, 2), torch.ones(1), scale)


@pytest.mark.parametrize("u_max", [torch.tensor(1.0), torch.zeros(1)])
def test_limits_that_are_none_are_an_error(u_max: torch.Tensor) -> None:
    with pytest.raises(ValueError, match="u_max must be a vector of positive numbers"):
        RBFPolicy(torch.zeros(4, 2), u_max, torch.ones(2))


@pytest.mark.parametrize(
    ("centres", "u_max", "scale", "message"),
    [
        (torch.full((3, 2), torch.nan), torch.ones(1), torch.ones(2), "centres must be finite"),
        (torch.zeros(0, 2), torch.ones(1), torch.ones(2), r"m >= 1, got shape \(0, 2\)"),
        (torch.zeros(3), torch.ones(1), torch.ones(2), r"got shape \(3,\)"),
        (torch.zeros(3, 2), torch.tensor([torch.inf]), torch.ones(2), "u_max must be"),
        (torch.zeros(3, 2), torch.ones(0), torch.ones(2), "u_max must be"),
        (torch.zeros(3, 2), torch.ones(1), torch.tensor([1.0, torch.inf]), "scale must hold"),
    ],
)
def test_policy_of_numbers_that_are_none_is_an_error(
    centres: torch.Tensor, u_max: torch.Tensor, scale: torch.Tensor, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        RBFPolicy(centres, u_max, scale)
