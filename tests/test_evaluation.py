"""How well rollouts agree with the prediction and with the demonstrations."""

from __future__ import annotations

import pytest
import torch

from tests.draws import Draws
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.evaluation import demonstration_spread, rms_error, two_sigma_coverage, two_sigma_coverage_by_entry
from torch_pmil.expert import expert_distribution
from torch_pmil.gaussian import Gaussian

NAMES = ("q", "dq", "ddq")
COUNT = 4000


def test_two_standard_deviations_cover_95_per_cent_of_gaussian_rollouts(draws: Draws) -> None:
    """Entries of one state are correlated: the standard error is that of independent states."""
    predicted = draws.belief(5, 3)
    rollouts = torch.cat([draws.normal(COUNT, 1, 3), predicted.sample(COUNT, draws.generator)], 1)
    standard_error = (0.954 * 0.046 / (5 * COUNT)) ** 0.5
    assert two_sigma_coverage(predicted, rollouts) == pytest.approx(0.9545, abs=4 * standard_error)
    assert (two_sigma_coverage_by_entry(predicted, rollouts) - 0.9545).abs().max() < 4 * standard_error


def test_coverage_counts_entries_within_and_leaves_the_start_out() -> None:
    predicted = Gaussian(torch.zeros(2, 1), torch.full((2, 1, 1), 0.25))
    rollouts = torch.tensor([[[9.0], [1.0], [-1.0]], [[9.0], [1.1], [-1.1]]])
    assert two_sigma_coverage(predicted, rollouts) == 0.5


def test_coverage_is_the_mean_of_that_of_its_entries_and_each_is_its_own(draws: Draws) -> None:
    predicted, rollouts = draws.belief(5, 3), 2 * draws.normal(10, 6, 3)
    by_entry = two_sigma_coverage_by_entry(predicted, rollouts)
    assert by_entry.mean().item() == pytest.approx(two_sigma_coverage(predicted, rollouts))
    for entry in range(3):
        alone = predicted.marginal(torch.tensor([entry]))
        assert by_entry[entry].item() == pytest.approx(two_sigma_coverage(alone, rollouts[..., [entry]]))


def test_rms_error_is_zero_at_the_demonstrated_mean_and_the_offset_elsewhere(draws: Draws) -> None:
    demonstrations = Demonstrations(draws.normal(4, 6, 3), 0.1, NAMES)
    mean = demonstrations.positions.mean(0).expand(7, -1, -1)
    offset = torch.tensor([0.1, -0.2, 0.0], dtype=torch.float64)
    torch.testing.assert_close(rms_error(demonstrations, mean + offset), offset.abs(), rtol=0, atol=1e-12)


def test_start_counts_neither_in_error_nor_in_spread(draws: Draws) -> None:
    demonstrations, executed = Demonstrations(draws.normal(4, 6, 3), 0.1, NAMES), draws.normal(7, 6, 3)
    start = torch.zeros(6, 1, dtype=torch.float64)
    start[0] = 100.0
    shifted = Demonstrations(demonstrations.positions * (1 + start), 0.1, NAMES)
    assert torch.equal(rms_error(shifted, executed + start), rms_error(demonstrations, executed))
    assert torch.equal(demonstration_spread(shifted), demonstration_spread(demonstrations))


def test_spread_is_that_of_the_demonstrated_marginals_without_noise(draws: Draws) -> None:
    demonstrations = Demonstrations(draws.normal(5, 6, 3), 0.1, NAMES)
    variance = expert_distribution(demonstrations, 0.3).std.square().mean(0) - 0.3**2
    torch.testing.assert_close(demonstration_spread(demonstrations).square(), variance)


def test_further_demonstrations_are_off_the_mean_by_the_spread_and_the_error_of_that_mean(draws: Draws) -> None:
    """Over many sets of demonstrations, E[rms²] = (1 + 1/N) E[spread²], to four standard errors of the mean."""
    std = torch.tensor([0.1, 1.0, 10.0], dtype=torch.float64)
    sets = [Demonstrations(std * draws.normal(4, 3, 3), 0.1, NAMES) for _ in range(2000)]
    ratios = torch.stack([rms_error(each, std * draws.normal(1, 3, 3)).square() / std**2 for each in sets])
    spreads = torch.stack([demonstration_spread(each).square() / std**2 for each in sets])
    assert (ratios.mean(0) - 1.25).abs().max() < 4 * ratios.std(0).max() / 2000**0.5
    assert (spreads.mean(0) - 1).abs().max() < 4 * spreads.std(0).max() / 2000**0.5
