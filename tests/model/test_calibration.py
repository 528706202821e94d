"""How sure a model is against how right it is: what a model that is right must show."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.model.calibration import (
    observed_coverage,
    standardised_residuals,
    two_sigma_coverage,
    two_sigma_coverage_by_entry,
)
from torch_pmil.model.dynamics import GPDynamics

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (), joint_match(NAMES, UNITS))
NOISE = 0.1


def robot(states: Tensor, actions: Tensor) -> Tensor:
    """Changes of a damped pendulum in a control period, (*batch, 2)."""
    q, dq = states.unbind(-1)
    return torch.stack([0.1 * dq, 0.1 * (actions[..., 0] - q.sin() - dq)], -1)


def rollouts(draws: Draws, count: int, steps: int) -> tuple[Tensor, Tensor]:
    """States and actions of a pendulum whose every step is disturbed."""
    states, actions = [draws.normal(count, 2)], draws.normal(count, steps, 1)
    for action in actions.unbind(1):
        states.append(states[-1] + robot(states[-1], action) + NOISE * draws.normal(count, 2))
    return torch.stack(states, 1), actions


@pytest.mark.parametrize("targets", ["difference", "successor"])
def test_residuals_of_a_fitted_model_are_standard_normal(draws: Draws, targets: str) -> None:
    states, actions = rollouts(draws, 20, 10)
    model = GPDynamics(3, 2, targets)
    inputs = torch.cat([SPACE.features(states[:, :-1]), actions], -1).flatten(0, 1)
    outputs = states[:, 1:] - states[:, :-1] if targets == "difference" else states[:, 1:]
    model.fit(inputs, outputs.flatten(0, 1))
    residuals = standardised_residuals(model, SPACE, *rollouts(draws, 200, 10))
    assert residuals.shape == (200, 10, 2)
    assert residuals.mean((0, 1)).abs().max() < 0.25  # 200 data leave the function itself uncertain
    spread = residuals.square().mean((0, 1)).sqrt()
    assert_close(spread, torch.ones(2).double(), rtol=0.1, atol=0)


def test_residual_counts_the_uncertainty_of_the_function_and_the_noise(draws: Draws) -> None:
    model = GPDynamics(3, 2)
    model.set_data(draws.normal(6, 3), draws.normal(6, 2))
    states, actions = rollouts(draws, 1, 1)
    model.gp.eval()
    inputs = torch.cat([SPACE.features(states[:, 0]), actions[:, 0]], -1)
    observed = model.gp.likelihood(model.gp(inputs.expand(2, 1, 3)))
    expected = (states[0, 1] - states[0, 0] - observed.mean[:, 0]) / observed.stddev[:, 0]
    residuals = standardised_residuals(model, SPACE, states, actions)[0, 0]
    assert_close(residuals, expected.detach(), rtol=1e-6, atol=1e-6)


def test_entries_of_which_nothing_is_learned_have_no_error(draws: Draws) -> None:
    shift = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    gain = torch.tensor([[1.0], [0.0]], dtype=torch.float64)
    model = GPDynamics(3, 1, KnownPart.of_readings(shift, gain, [0]))
    model.set_data(draws.normal(6, 3), draws.normal(6, 1))
    residuals = standardised_residuals(model, SPACE, *rollouts(draws, 4, 3))
    assert (residuals[..., 0] != 0).all() and (residuals[..., 1] == 0).all()


def test_coverage_of_standard_normal_errors_is_the_probability(draws: Draws) -> None:
    probabilities = torch.linspace(0, 1, 11).double()
    observed = observed_coverage(draws.normal(100, 200, 3), probabilities)
    tolerance = 4 * math.sqrt(0.25 / 20_000)
    expected = probabilities[:, None].expand(11, 3)
    assert_close(observed, expected, rtol=0, atol=tolerance)


def test_two_standard_deviations_cover_95_per_cent_of_gaussian_rollouts(draws: Draws) -> None:
    """Entries of one state are correlated: the standard error is that of independent states."""
    predicted = draws.belief(5, 3)
    rollouts = torch.cat([draws.normal(4000, 1, 3), predicted.sample(4000, draws.generator)], 1)
    standard_error = (0.954 * 0.046 / (5 * 4000)) ** 0.5
    assert two_sigma_coverage(predicted, rollouts) == pytest.approx(0.9545, abs=4 * standard_error)
    by_entry = two_sigma_coverage_by_entry(predicted, rollouts)
    assert (by_entry - 0.9545).abs().max() < 4 * standard_error


def test_coverage_is_the_mean_of_that_of_its_entries_and_each_is_its_own(draws: Draws) -> None:
    predicted, rollouts = draws.belief(5, 3), 2 * draws.normal(10, 6, 3)
    by_entry = two_sigma_coverage_by_entry(predicted, rollouts)
    assert by_entry.mean().item() == pytest.approx(two_sigma_coverage(predicted, rollouts))
    for entry in range(3):
        alone = predicted.marginal(torch.tensor([entry]))
        expected = two_sigma_coverage(alone, rollouts[..., [entry]])
        assert by_entry[entry].item() == pytest.approx(expected)
