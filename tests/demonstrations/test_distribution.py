"""From demonstrations to the demonstrated distribution (Eqs. 10-12)."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.demonstrations.distribution import (
    demonstration_spread,
    expert_distribution,
    rms_error,
)

NAMES = ("x", "y", "z")


def shown(positions: Tensor) -> Demonstrations:
    return Demonstrations(positions, 0.1, NAMES)


def test_marginals_are_the_sample_means_and_unbiased_covariances(draws: Draws) -> None:
    positions = draws.normal(6, 4, 3)
    demonstrated = expert_distribution(shown(positions), noise_std=0.2)
    assert demonstrated.mean.shape == (3, 3)  # t = 1..T, the start is not matched
    for mean, cov, sample in zip(
        demonstrated.mean, demonstrated.cov, positions[:, 1:].unbind(1), strict=True
    ):
        np.testing.assert_allclose(mean, sample.numpy().mean(0), rtol=1e-12)
        expected = np.cov(sample.numpy(), rowvar=False) + 0.2**2 * np.eye(3)
        np.testing.assert_allclose(cov, expected, rtol=1e-12, atol=1e-14)


def test_noise_is_a_floor_under_the_variances(draws: Draws) -> None:
    """Two demonstrations in three dimensions: the sample covariance has rank one."""
    demonstrated = expert_distribution(shown(draws.normal(2, 5, 3)), noise_std=0.05)
    smallest = torch.linalg.eigvalsh(demonstrated.cov)[:, 0]
    floor = torch.full((4,), 0.05**2, dtype=torch.float64)
    torch.testing.assert_close(smallest, floor, rtol=1e-8, atol=0)


def test_each_entry_may_have_a_noise_of_its_own(draws: Draws) -> None:
    demonstrations, noise_std = shown(draws.normal(6, 4, 3)), draws.uniform(0.1, 2.0, 3)
    own, same = (expert_distribution(demonstrations, noise) for noise in (noise_std, 0.5))
    torch.testing.assert_close(own.cov - same.cov, (noise_std**2 - 0.5**2).diag().expand(3, 3, 3))
    assert torch.equal(expert_distribution(demonstrations, torch.full((3,), 0.5)).cov, same.cov)


OTHER_ENTRIES = r"noise_std must be a number or one for each of x, y, z, got \[0.5, 0.5\]"


@pytest.mark.parametrize(
    ("noise_std", "message"),
    [
        (torch.full((2,), 0.5), OTHER_ENTRIES),
        (-0.1, "noise_std must be positive, got"),
        (float("nan"), "noise_std must be positive, got"),
        (torch.tensor([0.1, 0.0, 0.1]), "noise_std must be positive, got"),
    ],
)
def test_noise_that_is_not_positive_or_of_other_entries_is_an_error(
    draws: Draws, noise_std: float | Tensor, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        expert_distribution(shown(draws.normal(2, 5, 3)), noise_std)


def test_rms_error_is_zero_at_the_demonstrated_mean_and_the_offset_elsewhere(draws: Draws) -> None:
    demonstrations = shown(draws.normal(4, 6, 3))
    mean = demonstrations.positions.mean(0).expand(7, -1, -1)
    offset = torch.tensor([0.1, -0.2, 0.0], dtype=torch.float64)
    error = rms_error(demonstrations, mean + offset)
    torch.testing.assert_close(error, offset.abs(), rtol=0, atol=1e-12)


def test_start_counts_neither_in_error_nor_in_spread(draws: Draws) -> None:
    demonstrations, executed = shown(draws.normal(4, 6, 3)), draws.normal(7, 6, 3)
    start = torch.zeros(6, 1, dtype=torch.float64)
    start[0] = 100.0
    shifted = shown(demonstrations.positions * (1 + start))
    assert torch.equal(rms_error(shifted, executed + start), rms_error(demonstrations, executed))
    assert torch.equal(demonstration_spread(shifted), demonstration_spread(demonstrations))


def test_spread_is_that_of_the_demonstrated_marginals_without_noise(draws: Draws) -> None:
    demonstrations = shown(draws.normal(5, 6, 3))
    variance = expert_distribution(demonstrations, 0.3).std.square().mean(0) - 0.3**2
    torch.testing.assert_close(demonstration_spread(demonstrations).square(), variance)


def test_further_demonstrations_are_off_the_mean_by_the_spread_and_the_error_of_that_mean(
    draws: Draws,
) -> None:
    """Over many sets, E[rms²] = (1 + 1/N) E[spread²], to four standard errors of the mean."""
    std = torch.tensor([0.1, 1.0, 10.0], dtype=torch.float64)
    sets = [shown(std * draws.normal(4, 3, 3)) for _ in range(2000)]
    ratios = torch.stack(
        [rms_error(each, std * draws.normal(1, 3, 3)).square() / std**2 for each in sets]
    )
    spreads = torch.stack([demonstration_spread(each).square() / std**2 for each in sets])
    assert (ratios.mean(0) - 1.25).abs().max() < 4 * ratios.std(0).max() / 2000**0.5
    assert (spreads.mean(0) - 1).abs().max() < 4 * spreads.std(0).max() / 2000**0.5
