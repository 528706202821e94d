"""Costs of predicted states and their gradients, beside the formulas in PyTorch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from tests.helpers.draws import Draws
from tests.helpers.losses import HORIZON, make_cost, make_kl
from tests.helpers.two_ways import assert_told_alike
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.compiled.prediction import costs_of_beliefs, costs_of_states
from torch_pmil.search.kl import gaussian_cross_entropy
from torch_pmil.search.trajectory_loss import TrajectoryLoss

losses = pytest.mark.parametrize("make", [make_kl, make_cost], ids=["KL", "saturating cost"])
batches = pytest.mark.parametrize("batch", [(), (3,), (2, 3)], ids=str)
Make = Callable[..., TrajectoryLoss]


def foretold(loss: TrajectoryLoss, states: Gaussian) -> TrajectoryLoss:
    """The loss with a prediction that is these states, whatever the policy."""
    loss.prediction = lambda *_: states
    return loss


def beliefs(draws: Draws, *batch: int) -> Gaussian:
    return draws.belief(*batch, HORIZON, 2, scale=0.1)


@losses
def test_gradients_are_difference_quotients(draws: Draws, make: Make) -> None:
    comparison, root = make(seed=1)._comparison(HORIZON), 0.3 * draws.normal(HORIZON, 2, 3)

    def costs(mean: Tensor, root: Tensor) -> Tensor:
        found = costs_of_beliefs(Gaussian(mean, root @ root.mT), comparison)
        assert found is not None
        return found

    mean = draws.normal(HORIZON, 2).requires_grad_()
    assert gradcheck(costs, (mean, root.requires_grad_()))
    assert gradcheck(lambda mean: costs_of_states(mean, comparison), mean)


def test_cost_of_a_certain_state_is_that_of_its_mean(draws: Draws) -> None:
    comparison, mean = make_cost(seed=1)._comparison(HORIZON), draws.normal(HORIZON, 2)
    certain = Gaussian(mean, torch.zeros(HORIZON, 2, 2, dtype=torch.float64))
    torch.testing.assert_close(
        costs_of_beliefs(certain, comparison), costs_of_states(mean, comparison)
    )


def test_cross_entropy_and_its_gradients_are_those_of_the_formula(draws: Draws) -> None:
    loss, mean, root = make_kl(seed=1), draws.normal(HORIZON, 2), 0.3 * draws.normal(HORIZON, 2, 3)
    comparison = replace(loss._comparison(HORIZON), cross_entropy=True)
    inputs, weights = (mean.requires_grad_(), root.requires_grad_()), draws.normal(HORIZON)

    def by_formula(states: Gaussian) -> Tensor:
        return gaussian_cross_entropy(loss._observe(states), loss._demonstrated(HORIZON))

    def by_kernels(states: Gaussian) -> Tensor:
        return costs_of_beliefs(states, comparison)

    found, expected = (
        (costs, *torch.autograd.grad((weights * costs).sum(), inputs))
        for costs in (way(Gaussian(mean, root @ root.mT)) for way in (by_kernels, by_formula))
    )
    torch.testing.assert_close(found, expected)


# --- what has no cost ---


@losses
@pytest.mark.parametrize("variance", [-3.0, -0.1])
@pytest.mark.parametrize("step", [0, 2])
def test_predicted_covariance_that_is_none_is_named(
    draws: Draws, make: Make, variance: float, step: int
) -> None:
    """Also where the saturating cost could be computed, for I + S has a Cholesky factor."""
    states = beliefs(draws, 3)
    states.cov[1, step] = variance * torch.eye(2)
    loss = foretold(make(seed=1), states)
    message = f"comparison of step {step + 1} of {HORIZON} failed"
    assert_told_alike(lambda: loss.per_step(draws.belief(3, 2)), message)


@losses
@pytest.mark.parametrize(
    ("part", "entry"), [("cov", torch.nan), ("cov", torch.inf), ("mean", torch.nan)]
)
def test_predicted_state_that_is_not_finite_is_named(
    draws: Draws, make: Make, part: str, entry: float
) -> None:
    states = beliefs(draws)
    getattr(states, part)[2].view(-1)[0] = entry
    loss = foretold(make(seed=1), states)
    assert_told_alike(lambda: loss.per_step(draws.belief(2)), "must be finite, got nan")


@pytest.mark.parametrize("entry", [0.0, -1.0, torch.nan])
def test_demonstrated_covariance_without_cholesky_factor_is_named(
    draws: Draws, entry: float
) -> None:
    loss, start = foretold(make_kl(seed=1), beliefs(draws)), draws.belief(2, scale=0.05)
    loss.demonstrated_cov[2] = entry * torch.eye(2)
    assert_told_alike(lambda: loss.per_step(start), f"comparison of step 3 of {HORIZON} failed")
    assert_told_alike(lambda: loss.mean_per_step(start), "demonstrated covariance must be positive")
