"""What the formulas refuse is refused by both ways alike: the same error, message and step."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.losses import HORIZON, SPACE, make_cost, make_kl, make_parts
from tests.helpers.two_ways import assert_told_alike, formulas_alone
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.compiled import kernels
from torch_pmil.model.compiled.plans import Plan
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.rollout import predict_mean_trajectory, predict_trajectory

STEPS = 5
NOT_FINITE = pytest.mark.parametrize("entry", [torch.nan, torch.inf])


@pytest.fixture
def parts(draws: Draws) -> tuple[RBFPolicy, GPDynamics]:
    return make_parts(draws)


def belief(variance: float, *batch: int) -> Gaussian:
    identity = torch.eye(2, dtype=torch.float64)
    mean = torch.zeros(*batch, 2, dtype=torch.float64)
    return Gaussian(mean, (variance * identity).expand(*batch, 2, 2))


def with_posterior(dynamics: GPDynamics, **changed: Tensor) -> GPDynamics:
    """The model with other arrays in its posterior."""
    dynamics._expansion = replace(dynamics.expansion, **changed)
    return dynamics


def overconfident(dynamics: GPDynamics, excess: float) -> GPDynamics:
    """The model with variances that are too small, and negative after some steps."""
    inverse = dynamics.expansion.gram_inverse
    return with_posterior(dynamics, gram_inverse=inverse + excess * torch.eye(inverse.shape[-1]))


@pytest.mark.parametrize(
    ("excess", "variance", "step"),
    [(0.1, 0.01, 2), (0.1, 1.0, 3), (0.01, 0.1, 4), (0.03, 1.0, 5), (30.0, 0.01, 2)],
)
def test_step_without_cholesky_factor_is_named(
    parts: tuple[RBFPolicy, GPDynamics], excess: float, variance: float, step: int
) -> None:
    policy, dynamics = parts
    task = belief(variance), policy, overconfident(dynamics, excess), SPACE, STEPS
    message = f"prediction of step {step} of {STEPS} failed: I + Sigma P (last element: kernel, "
    assert assert_told_alike(lambda: predict_trajectory(*task), message) == step


def test_kernels_have_no_answer_where_the_formulas_raise(
    parts: tuple[RBFPolicy, GPDynamics],
) -> None:
    policy, dynamics = parts
    model = overconfident(dynamics, 0.1).expansion
    plan = Plan(model, dynamics.known_part(SPACE), SPACE, policy.controller, STEPS)
    assert kernels().predict_beliefs(belief(0.01, 1), plan) is None


def test_failure_at_one_belief_of_a_batch_is_named(parts: tuple[RBFPolicy, GPDynamics]) -> None:
    """Only the second is so narrow that its variances become negative."""
    policy, dynamics = parts
    start = belief(1.0, 3)
    start = Gaussian(start.mean, torch.cat([start.cov[:1], belief(0.01, 1).cov, start.cov[:1]]))
    task = start, policy, overconfident(dynamics, 0.03), SPACE, STEPS
    assert_told_alike(lambda: predict_trajectory(*task), "at batch element (1, ")


@pytest.mark.parametrize("objective", [make_kl, make_cost])
def test_failed_prediction_of_a_loss_is_named(objective) -> None:
    loss = objective(seed=1)
    overconfident(loss.dynamics, 0.1)
    message = f"prediction of step 2 of {HORIZON} failed"
    assert assert_told_alike(lambda: loss.per_step(belief(0.01)), message) == 2


@pytest.mark.parametrize(
    ("offset", "horizon", "said"),
    [
        (torch.inf, 1, "step 1 of 1 failed: dq is not finite"),
        (-torch.inf, 1, "step 1 of 1 failed: dq is not finite"),
        (1e308, 2, "step 2 of 2 failed: I + Sigma P (last element: kernel, then pair of kernels)"),
    ],
)
def test_state_that_overflows_is_named(
    parts: tuple[RBFPolicy, GPDynamics], offset: float, horizon: int, said: str
) -> None:
    """By itself, or by the moments that cannot be computed from it."""
    policy, dynamics = parts
    offsets = torch.tensor([0.0, offset], dtype=torch.float64)
    task = belief(0.1), policy, with_posterior(dynamics, offset=offsets), SPACE, horizon
    assert assert_told_alike(lambda: predict_trajectory(*task), said) == horizon


@NOT_FINITE
@pytest.mark.parametrize("horizon", [1, 3])
@pytest.mark.parametrize("place", [0, -1])
@pytest.mark.parametrize("name", ["inputs", "weights", "gram_inverse", "signal_variance", "offset"])
def test_number_of_a_model_that_is_not_finite_is_named(
    parts: tuple[RBFPolicy, GPDynamics], name: str, place: int, horizon: int, entry: float
) -> None:
    policy, dynamics = parts
    values = getattr(dynamics.expansion, name).clone()
    values[(place,) * values.ndim] = entry
    task = belief(0.1), policy, with_posterior(dynamics, **{name: values}), SPACE, horizon
    assert_told_alike(lambda: predict_trajectory(*task), f" of {horizon} failed: ")


@NOT_FINITE
@pytest.mark.parametrize("name", ["centres", "weights", "log_widths"])
def test_number_of_a_policy_that_is_not_finite_is_named_or_makes_the_mean_alike(
    parts: tuple[RBFPolicy, GPDynamics], name: str, entry: float
) -> None:
    policy, dynamics = parts
    getattr(policy, name).data[-1, -1] = entry
    task = policy, dynamics, SPACE, 3
    assert_told_alike(lambda: predict_trajectory(belief(0.1), *task), " of 3 failed: ")
    task = belief(0.1).mean, *task
    with formulas_alone():
        expected = predict_mean_trajectory(*task)
    torch.testing.assert_close(predict_mean_trajectory(*task), expected, equal_nan=True)


@pytest.mark.parametrize(
    ("cov", "said"),
    [
        ([[torch.inf, 0.0], [0.0, 1.0]], "must be finite"),
        ([[-1.0, 0.0], [0.0, 1.0]], "must be positive definite"),
        ([[1.0, 0.5], [0.0, 1.0]], "must be symmetric"),
    ],
)
def test_start_that_is_none_is_named(
    parts: tuple[RBFPolicy, GPDynamics], cov: list[list[float]], said: str
) -> None:
    start = Gaussian(belief(0.1).mean, torch.tensor(cov, dtype=torch.float64))
    message = f"prediction of step 1 of {STEPS} failed: covariance of initial {said}"
    assert_told_alike(lambda: predict_trajectory(start, *parts, SPACE, STEPS), message)


def test_start_whose_mean_is_not_finite_is_named(parts: tuple[RBFPolicy, GPDynamics]) -> None:
    start = Gaussian(torch.nan * belief(0.1).mean, belief(0.1).cov)
    message = "mean of initial must be finite, got nan"
    assert_told_alike(lambda: predict_trajectory(start, *parts, SPACE, STEPS), message)


@pytest.mark.parametrize("inputs", [2, 4])
def test_policy_of_other_inputs_is_refused_by_both_ways_alike(
    parts: tuple[RBFPolicy, GPDynamics], inputs: int
) -> None:
    """The kernels, which check no shapes, would read beyond their arrays."""
    _, dynamics = parts
    policy = RBFPolicy(torch.zeros(5, inputs), torch.ones(1), torch.ones(inputs))
    start, task = belief(0.1), (policy, dynamics, SPACE, STEPS)
    assert_told_alike(lambda: predict_trajectory(start, *task), "inputs")
    told = assert_told_alike(lambda: predict_mean_trajectory(start.mean, *task), "inputs")
    assert told is None
