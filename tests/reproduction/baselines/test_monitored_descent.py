"""The descent ends where a noisy cost decreases no longer, and not before."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from reproduction.baselines.monitored_descent import DescentSettings, Monitor, descend


def test_signal_of_a_steady_decrease_is_high_and_of_noise_low() -> None:
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(2000, dtype=torch.float64, generator=generator)
    for slope, threshold, above in ((-0.3, 0.08, True), (0.0, 0.02, False)):
        monitor = Monitor(smoothing=0.99)
        for cost in (noise + slope * torch.arange(2000)).tolist():
            monitor.watch(cost, threshold)
        assert (monitor.signal > threshold) == above
        assert (monitor.quiet == 0) == above


def test_cost_that_changes_not_ends_after_patience_at_each_dropout() -> None:
    seen, x = [], torch.zeros(1, requires_grad=True)

    def cost(dropout: float) -> Tensor:
        seen.append(dropout)
        return 0 * x.sum() + 1

    costs = descend(cost, [x], DescentSettings(most_steps=1000))
    assert len(costs) == 600
    assert seen == [0.25] * 200 + [0.125] * 200 + [0.0] * 200


@pytest.mark.parametrize("most", [1, 50, 700])
def test_no_more_than_so_many_steps_and_as_many_below_no_threshold(most: int) -> None:
    """The threshold becomes less with the dropout; no signal is below one of zero."""
    x = torch.ones(1, requires_grad=True)
    settings = DescentSettings(most, reduction=0.0)
    assert len(descend(lambda _: 0 * x.sum(), [x], settings)) == most
    if most < 200:
        assert len(descend(lambda _: x.square().sum(), [x], DescentSettings(most))) == most


def test_minimum_of_a_noisy_quadratic_is_found() -> None:
    generator = torch.Generator().manual_seed(0)
    x, best = torch.zeros(3, requires_grad=True), torch.tensor([1.0, -2.0, 0.5])

    def cost(dropout: float) -> Tensor:
        noise = 0.1 * (0.1 + dropout) * torch.randn(3, generator=generator)
        return (x - best + noise).square().sum()

    costs = descend(cost, [x], DescentSettings(most_steps=3000))
    assert 600 < len(costs) < 3000
    torch.testing.assert_close(x.detach(), best, rtol=0, atol=0.05)
