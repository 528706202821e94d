"""The search for one output's hyper-parameters: its starts, its penalties, and what it finds."""

from __future__ import annotations

import itertools
import math

import gpytorch
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.gp.test_marginal_likelihood import model_of
from tests.helpers.draws import Draws
from torch_pmil.gp.gaussian import NotPositiveDefiniteError
from torch_pmil.gp.hyperparameters import (
    find_hyperparameters,
    joined,
    of_outputs,
    penalty,
    pilco_starts,
)
from torch_pmil.gp.lbfgs import NotFiniteError
from torch_pmil.gp.marginal_likelihood import negative_log_likelihood

NOISE = 0.05


def make_data(draws: Draws, n: int, D: int) -> tuple[Tensor, Tensor]:
    """A smooth function of D inputs, with noise."""
    inputs = draws.uniform(-2, 2, n, D)
    targets = (inputs @ draws.normal(D, 2) / math.sqrt(D)).sin().sum(-1)
    return inputs, targets + NOISE * draws.normal(n)


@pytest.fixture
def data(draws: Draws) -> tuple[Tensor, Tensor]:
    return make_data(draws, 40, 2)


def of_plain_gpytorch(inputs: Tensor, target: Tensor) -> float:
    """Least negative log likelihood, nats, that L-BFGS finds from PILCO's start by GPyTorch's own
    means.
    """
    model = model_of(inputs, target, pilco_starts(inputs, target)[0])
    objective = gpytorch.mlls.ExactMarginalLogLikelihood(model.likelihood, model)
    optimizer = torch.optim.LBFGS(model.parameters(), max_iter=100, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = -len(target) * objective(model(inputs), target)
        loss.backward()
        return loss

    optimizer.step(closure)
    return closure().item()


@pytest.mark.parametrize(("n", "D"), [(20, 1), (40, 2), (60, 3), (100, 5)])
def test_optimum_is_no_worse_than_that_of_plain_gpytorch(draws: Draws, n: int, D: int) -> None:
    inputs, target = make_data(draws, n, D)
    found = find_hyperparameters(inputs, target, pilco_starts(inputs, target), max_iterations=100)
    assert found.negative_log_likelihood < of_plain_gpytorch(inputs, target) + 1e-2


def test_likelihood_is_that_of_the_parameters_without_penalties(draws: Draws) -> None:
    """Without noise in the data the signal-to-noise ratio is held by its penalty."""
    inputs = draws.uniform(-2, 2, 30, 1)
    found = find_hyperparameters(
        inputs, inputs[:, 0].sin(), pilco_starts(inputs, inputs[:, 0].sin()), max_iterations=100
    )
    expected, _ = negative_log_likelihood(inputs, inputs[:, 0].sin(), found.log_parameters)
    assert penalty(found.log_parameters, inputs.std(0).log())[0] > 0.1
    assert found.negative_log_likelihood == pytest.approx(expected, abs=1e-9)


def test_best_of_several_starts_is_kept(data: tuple[Tensor, Tensor]) -> None:
    """A few iterations lead nowhere near the optimum from where all is noise."""
    near, far = pilco_starts(*data)[0], torch.tensor([2.0, 2.0, 0.0, 4.0], dtype=torch.float64)
    good, poor = (find_hyperparameters(*data, [start], max_iterations=4) for start in (near, far))
    assert poor.negative_log_likelihood > good.negative_log_likelihood + 10
    for starts in ([far, near], [near, far]):
        best = find_hyperparameters(*data, starts, max_iterations=4)
        assert torch.equal(best.log_parameters, good.log_parameters)
        assert best.negative_log_likelihood == good.negative_log_likelihood
        assert best.stop_reason == good.stop_reason
        assert best.evaluations == poor.evaluations + good.evaluations


def test_starts_are_left_as_they_were(data: tuple[Tensor, Tensor]) -> None:
    starts = pilco_starts(*data)
    find_hyperparameters(*data, starts, max_iterations=3)
    assert all(map(torch.equal, starts, pilco_starts(*data)))


FAILING = {  # data too near to each other for their lengthscales; 10^13 standard deviations away
    "no noise": ([4.0, 4.0, 0.0, -300.0], NotPositiveDefiniteError),
    "little of everything": ([0.0, 0.0, -60.0, -64.0], NotFiniteError),
}


@pytest.mark.parametrize("name", FAILING)
def test_start_without_a_value_is_passed_over(data: tuple[Tensor, Tensor], name: str) -> None:
    failing, error = torch.tensor(FAILING[name][0], dtype=torch.float64), FAILING[name][1]
    expected = find_hyperparameters(*data, pilco_starts(*data), max_iterations=100)
    found = find_hyperparameters(*data, [failing, *pilco_starts(*data)], max_iterations=100)
    assert torch.equal(found.log_parameters, expected.log_parameters)
    with pytest.raises(error):
        find_hyperparameters(*data, [failing], max_iterations=100)


def test_pilco_starts_are_in_the_units_of_the_data(draws: Draws) -> None:
    inputs, target = draws.normal(50, 3) * torch.tensor([0.1, 1.0, 100.0]) + 5, 7 * draws.normal(50)
    for start, (factor, ratio) in zip(
        pilco_starts(inputs, target), itertools.product((1, 2), (0.1, 0.01)), strict=True
    ):
        assert_close(start[:3].exp(), factor * inputs.std(0))
        assert_close(
            start[3:].exp().sqrt(), target.std() * torch.tensor([1.0, ratio], dtype=torch.float64)
        )


def test_many_data_have_two_starts(draws: Draws) -> None:
    assert [len(pilco_starts(draws.normal(n, 1), draws.normal(n))) for n in (99, 100)] == [4, 2]


def test_column_that_never_changes_is_of_its_own_size(draws: Draws) -> None:
    """It may change by rounding; a small column keeps its standard deviation."""
    inputs = torch.stack(
        [0.7 + 1e-15 * draws.normal(50), torch.zeros(50), 1e-8 * draws.normal(50)], -1
    )
    start, *_ = pilco_starts(inputs, torch.full((50,), 4.0, dtype=torch.float64))
    expected = torch.tensor([0.7, 1.0, inputs[:, 2].std(), 16.0, 0.16], dtype=torch.float64)
    assert_close(start.exp(), expected, rtol=1e-6, atol=0)


def log_of(length: float, signal_to_noise: float) -> Tensor:
    """Log parameters of one input and a noise std of 0.1."""
    noise = math.log(0.01)
    return torch.tensor(
        [math.log(length), noise + 2 * math.log(signal_to_noise), noise], dtype=torch.float64
    )


@pytest.mark.parametrize(
    ("length", "ratio", "least", "most"),
    [
        (10, 5, 0, 1e-4),
        (10, 50, 0, 0.02),
        (2, 100, 1, 1.01),
        (2, 200, 60, 80),
        (2 / 30, 10, 1 - 1e-6, 1 + 1e-6),
        (60, 10, 1 - 1e-6, 1 + 1e-6),
    ],
)
def test_penalty_begins_at_a_ratio_of_100_or_lengthscales_a_factor_30_from_the_spread(
    length: float, ratio: float, least: float, most: float
) -> None:
    log_spread = torch.tensor([math.log(2)], dtype=torch.float64)
    assert least <= penalty(log_of(length, ratio), log_spread)[0] <= most


def test_slope_of_the_penalty_is_that_by_automatic_differentiation(draws: Draws) -> None:
    """At two lengthscales near their bounds, and a signal-to-noise ratio near its own."""
    log_spread = draws.normal(2)
    parameters = torch.cat([log_spread + math.log(27) * torch.tensor([1, -1]), log_of(1, 96)[1:]])
    parameters.requires_grad_()
    ratio = (parameters[2] - parameters[3]) / 2 / math.log(100)
    plain = ratio**30 + (((parameters[:2] - log_spread) / math.log(30)) ** 30).sum()
    (expected,) = torch.autograd.grad(plain, parameters)
    value, slope = penalty(parameters.detach(), log_spread)
    assert value == pytest.approx(plain.item(), rel=1e-12)
    assert_close(slope, expected, rtol=1e-12, atol=0)


def test_joined_is_the_adjoint_of_of_outputs(draws: Draws) -> None:
    parameters, cotangents = draws.normal(3 + 2 * 4), draws.normal(4, 5)
    by_outputs = (of_outputs(parameters, 3) * cotangents).sum()
    assert_close(parameters @ joined(cotangents), by_outputs)


def test_twins_have_the_lengthscales_of_one_and_variances_in_their_units(
    data: tuple[Tensor, Tensor],
) -> None:
    inputs, target = data
    twins = torch.stack([target, 10 * target], -1)
    one = find_hyperparameters(*data, pilco_starts(*data), max_iterations=100)
    both = find_hyperparameters(inputs, twins, pilco_starts(inputs, twins), max_iterations=100)
    expected = one.log_parameters.expand(2, -1).clone()
    expected[1, -2:] += 2 * math.log(10)
    assert_close(of_outputs(both.log_parameters, 2), expected, atol=1e-2, rtol=0)
    shift = torch.tensor([0.0, len(target) * math.log(10)], dtype=torch.float64)
    assert_close(
        both.negative_log_likelihood, one.negative_log_likelihood + shift, atol=1e-4, rtol=0
    )


def test_same_lengthscales_explain_no_more_than_own_ones(draws: Draws) -> None:
    inputs = draws.uniform(-2, 2, 40, 2)
    targets = torch.stack([(3 * inputs[:, 0]).sin(), inputs[:, 1].sin()], -1)
    targets = targets + NOISE * draws.normal(40, 2)
    both = find_hyperparameters(inputs, targets, pilco_starts(inputs, targets), max_iterations=100)
    own = [
        find_hyperparameters(inputs, target, pilco_starts(inputs, target), max_iterations=100)
        for target in targets.mT
    ]
    lost = both.negative_log_likelihood - torch.cat([each.negative_log_likelihood for each in own])
    assert (lost > 1).all()
