"""From demonstrations to the demonstrated distribution (Eqs. 10-12)."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.helpers.draws import Draws
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.demonstrations.distribution import (
    demonstration_spread,
    expert_distribution,
    rms_error,
)

NAMES = ("x", "y", "z")


def test_marginals_are_the_sample_means_and_unbiased_covariances(draws: Draws) -> None:
    positions = draws.normal(6, 4, 3)
    demonstrated = expert_distribution(Demonstrations(positions, 0.1, NAMES), noise_std=0.2)
    assert demonstrated.mean.shape == (3, 3)  # t = 1..T, the start is not matched
    for t in range(1, 4):
        np.testing.assert_allclose(
            demonstrated.mean[t - 1], positions[:, t].numpy().mean(0), rtol=1e-12
        )
        expected = np.cov(positions[:, t].numpy(), rowvar=False) + 0.2**2 * np.eye(3)
        np.testing.assert_allclose(demonstrated.cov[t - 1], expected, rtol=1e-12, atol=1e-14)


def test_noise_is_a_floor_under_the_variances(draws: Draws) -> None:
    """Two demonstrations in three dimensions: the sample covariance has rank one."""
    demonstrated = expert_distribution(
        Demonstrations(draws.normal(2, 5, 3), 0.1, NAMES), noise_std=0.05
    )
    smallest = torch.linalg.eigvalsh(demonstrated.cov)[:, 0]
    torch.testing.assert_close(
        smallest, torch.full((4,), 0.05**2, dtype=torch.float64), rtol=1e-8, atol=0
    )


def test_each_entry_may_have_a_noise_of_its_own(draws: Draws) -> None:
    demonstrations, noise_std = (
        Demonstrations(draws.normal(6, 4, 3), 0.1, NAMES),
        draws.uniform(0.1, 2.0, 3),
    )
    own, same = (
        expert_distribution(demonstrations, noise_std),
        expert_distribution(demonstrations, 0.5),
    )
    torch.testing.assert_close(own.cov - same.cov, (noise_std**2 - 0.5**2).diag().expand(3, 3, 3))
    assert torch.equal(expert_distribution(demonstrations, torch.full((3,), 0.5)).cov, same.cov)


def test_noise_of_other_entries_is_an_error(draws: Draws) -> None:
    with pytest.raises(
        ValueError, match=r"noise_std must be a number or one for each of x, y, z, got \[0.5, 0.5\]"
    ):
        expert_distribution(
            Demonstrations(draws.normal(2, 5, 3), 0.1, NAMES), torch.full((2,), 0.5)
        )


@pytest.mark.parametrize("noise_std", [0.0, -0.1, float("nan"), torch.tensor([0.1, 0.0, 0.1])])
def test_noise_that_is_not_positive_is_an_error(
    draws: Draws, noise_std: float | torch.Tensor
) -> None:
    with pytest.raises(ValueError, match="noise_std must be positive, got"):
        expert_distribution(Demonstrations(draws.normal(2, 5, 3), 0.1, NAMES), noise_std)


def test_rms_error_is_zero_at_the_demonstrated_mean_and_the_offset_elsewhere(draws: Draws) -> None:
    demonstrations = Demonstrations(draws.normal(4, 6, 3), 0.1, NAMES)
    mean = demonstrations.positions.mean(0).expand(7, -1, -1)
    offset = torch.tensor([0.1, -0.2, 0.0], dtype=torch.float64)
    torch.testing.assert_close(
        rms_error(demonstrations, mean + offset), offset.abs(), rtol=0, atol=1e-12
    )


def test_start_counts_neither_in_error_nor_in_spread(draws: Draws) -> None:
    demonstrations, executed = (
        Demonstrations(draws.normal(4, 6, 3), 0.1, NAMES),
        draws.normal(7, 6, 3),
    )
    start = torch.zeros(6, 1, dtype=torch.float64)
    start[0] = 100.0
    shifted = Demonstrations(demonstrations.positions * (1 + start), 0.1, NAMES)
    assert torch.equal(rms_error(shifted, executed + start), rms_error(demonstrations, executed))
    assert torch.equal(demonstration_spread(shifted), demonstration_spread(demonstrations))


def test_spread_is_that_of_the_demonstrated_marginals_without_noise(draws: Draws) -> None:
    demonstrations = Demonstrations(draws.normal(5, 6, 3), 0.1, NAMES)
    variance = expert_distribution(demonstrations, 0.3).std.square().mean(0) - 0.3**2
    torch.testing.assert_close(demonstration_spread(demonstrations).square(), variance)


def test_further_demonstrations_are_off_the_mean_by_the_spread_and_the_error_of_that_mean(
    draws: Draws,
) -> None:
    """Over many sets of demonstrations, E[rms²] = (1 + 1/N) E[spread²], to four standard errors of
    the mean.
    """
    std = torch.tensor([0.1, 1.0, 10.0], dtype=torch.float64)
    sets = [Demonstrations(std * draws.normal(4, 3, 3), 0.1, NAMES) for _ in range(2000)]
    ratios = torch.stack(
        [rms_error(each, std * draws.normal(1, 3, 3)).square() / std**2 for each in sets]
    )
    spreads = torch.stack([demonstration_spread(each).square() / std**2 for each in sets])
    assert (ratios.mean(0) - 1.25).abs().max() < 4 * ratios.std(0).max() / 2000**0.5
    assert (spreads.mean(0) - 1).abs().max() < 4 * spreads.std(0).max() / 2000**0.5
