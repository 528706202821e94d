"""The success rate that a model predicts, against its moments, and the bound of its samples."""

from __future__ import annotations

import copy

import pytest
import torch
from scipy.stats import binom
from torch import Tensor

from tests.helpers.integrator import belief_at_one, damped_integrator, integrator_loss
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.promise import CONFIDENCE, LARGEST, SAMPLES, PredictedSuccess, Promise

HORIZON = 6

INITIAL = belief_at_one(0.04)


def resting_loss(dynamics: GPDynamics | None = None) -> TrajectoryKLLoss:
    """A policy that does nothing, so that the damped integrator moves as a linear system does."""
    policy = RBFPolicy(torch.zeros(2, 1), torch.ones(1), torch.ones(1))
    policy.weights.data.zero_()
    return integrator_loss(policy, torch.zeros(HORIZON).double(), 1.0, dynamics)


@pytest.fixture(scope="module")
def loss() -> TrajectoryKLLoss:
    return resting_loss()


@pytest.mark.parametrize("reach", [0.5, 1.0, 2.0], ids=lambda reach: f"{reach} std")
def test_predicted_rate_is_the_probability_of_the_predicted_marginal(
    loss: TrajectoryKLLoss, reach: float
) -> None:
    """Of a linear system, whose marginals are Gaussian; up to four standard errors."""
    with torch.no_grad():
        last = loss.predict_states(INITIAL)[-1]

    def error(states: Tensor) -> Tensor:
        assert states.shape == (SAMPLES, HORIZON + 1, 1)
        return (states[:, -1, 0] - last.mean).abs()

    expected = torch.erf(torch.tensor(reach / 2**0.5)).item()
    rate = Promise(0.95, error, reach * last.std.item()).predicted(loss, INITIAL).rate
    assert rate == pytest.approx(expected, abs=4 * (expected * (1 - expected) / SAMPLES) ** 0.5)


def test_samples_begin_at_the_robots_starts(loss: TrajectoryKLLoss) -> None:
    seen: list[Tensor] = []

    def error(states: Tensor) -> Tensor:
        seen.append(states)
        return states[:, 0, 0]

    assert Promise(0.95, error, 1e9).predicted(loss, INITIAL).rate == 1.0
    states = seen[0]
    assert states[:, 0].mean().item() == pytest.approx(1.0, abs=4 * 0.2 / SAMPLES**0.5)
    moved = states[:, 1, 0] - states[:, 0, 0]
    slope = torch.linalg.lstsq(states[:, :1, 0] - 1, moved[:, None]).solution.item()
    assert slope == pytest.approx(-0.1, abs=0.05)


def test_policies_are_compared_under_the_same_random_numbers(loss: TrajectoryKLLoss) -> None:
    promise = Promise(0.95, lambda states: states[:, -1, 0].abs(), 0.5)
    assert promise.predicted(loss, INITIAL) == promise.predicted(loss, INITIAL)


def test_error_that_is_no_number_is_a_failure(loss: TrajectoryKLLoss) -> None:
    promise = Promise(0.95, lambda states: states[:, -1, 0] * torch.nan, 0.5)
    assert promise.predicted(loss, INITIAL).successes == 0


@pytest.mark.parametrize("rate", [0.5, 0.8, 0.95, 0.99])
def test_bound_is_above_the_true_rate_at_most_as_often_as_the_confidence_says(rate: float) -> None:
    bounds = [PredictedSuccess(successes).least for successes in range(SAMPLES + 1)]
    above = [successes for successes, bound in enumerate(bounds) if bound > rate]
    assert binom.pmf(above, SAMPLES, rate).sum() <= 1 - CONFIDENCE
    assert sorted(bounds) == bounds
    assert bounds[0] == 0.0 and bounds[-1] == pytest.approx((1 - CONFIDENCE) ** (1 / SAMPLES))


def test_every_rate_that_can_be_promised_can_be_kept() -> None:
    assert Promise(LARGEST, lambda states: states, 0.1).aim <= PredictedSuccess(SAMPLES).least


def test_half_of_the_promised_failures_are_left_to_what_the_model_does_not_know() -> None:
    promise = Promise(0.9, lambda states: states, 0.1)
    assert promise.aim == pytest.approx(0.95)


@pytest.mark.parametrize("rate", [0, 0.99, 1, -0.1, 1.5, "0.9", True, float("nan")])
def test_rate_that_cannot_be_promised_is_an_error(rate: object) -> None:
    with pytest.raises(
        ValueError, match=r"promise must be a number above 0 and at most 0\.98, got"
    ):
        Promise(rate, lambda states: states, 0.1)


def test_more_data_where_the_robot_goes_raise_the_predicted_rate() -> None:
    """What the model does not know counts as failures."""
    rates = []
    for data in (3, 30):
        dynamics = copy.deepcopy(damped_integrator())
        dynamics.set_data(dynamics.train_inputs[:data], dynamics.train_targets[:data])
        loss = resting_loss(dynamics)
        with torch.no_grad():
            mean = loss.predict_states(INITIAL)[-1].mean
        promise = Promise(0.95, lambda states, mean=mean: (states[:, -1, 0] - mean).abs(), 0.2)
        rates.append(promise.predicted(loss, INITIAL).rate)
    assert rates[0] < rates[1]
