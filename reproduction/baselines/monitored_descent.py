r"""Adam on the noisy estimates of a cost, until they are seen to decrease no longer.

The steps and the dropout begin large. A signal shows whether the cost still decreases: with d_j the
change of its estimate in step j,

.. math::
    E_j &= \alpha E_{j-1} + (1 - \alpha)\, d_j \\
    V_j &= \alpha \left( V_{j-1} + (1 - \alpha)(d_j - E_{j-1})^2 \right) \\
    s_j &= \alpha s_{j-1} + (1 - \alpha)\, |E_j| / \sqrt{V_j}

After ``patience`` steps in a row with :math:`s_j < \sigma` the learning rate and sigma are
multiplied by ``reduction``, and the dropout becomes less by ``dropout_step``; where it or the
learning rate is at its least already, the descent ends.

Source: F. Amadio, A. Dalla Libera, R. Antonello, D. Nikovski, R. Carli, D. Romeres (2022),
Model-based policy search using Monte Carlo gradient estimation with real systems application, IEEE
Transactions on Robotics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class DescentSettings:
    """Numbers of the descent; the published ones, but for ``most_steps``."""

    most_steps: int
    learning_rate: float = 0.01
    least_learning_rate: float = 0.0025
    dropout: float = 0.25
    dropout_step: float = 0.125
    smoothing: float = 0.99
    threshold: float = 0.08
    reduction: float = 0.5
    patience: int = 200


class Monitor:
    """The signal s of a cost's estimates, and for how many steps it has been below a threshold.

    Example:
        >>> monitor = Monitor(smoothing=0.5)
        >>> for cost in (2.0, 2.0, 2.0):
        ...     monitor.watch(cost, threshold=0.1)
        >>> monitor.quiet
        3
        >>> monitor.watch(1.0, threshold=0.1)
        >>> monitor.quiet
        0
    """

    def __init__(self, smoothing: float) -> None:
        self.smoothing, self.signal, self.quiet = smoothing, 0.0, 0
        self._mean, self._variance = 0.0, 0.0
        self._last: float | None = None

    def watch(self, cost: float, threshold: float) -> None:
        """Take the estimate of another step."""
        change = 0.0 if self._last is None else cost - self._last
        alpha, away, self._last = self.smoothing, change - self._mean, cost
        self._mean = alpha * self._mean + (1 - alpha) * change
        self._variance = alpha * (self._variance + (1 - alpha) * away**2)
        ratio = abs(self._mean) / self._variance**0.5 if self._variance else 0.0
        self.signal = alpha * self.signal + (1 - alpha) * ratio
        self.quiet = self.quiet + 1 if self.signal < threshold else 0


def descend(
    cost: Callable[[float], Tensor], parameters: Iterable[Tensor], settings: DescentSettings
) -> list[float]:
    """Change parameters to a smaller cost, and return the estimates of it, one for each step.

    Args:
        cost: an estimate of the cost, with its graph, at a given dropout.
        parameters: what the cost depends on.
        settings: numbers of the descent.
    """
    optimizer = torch.optim.Adam(parameters, lr=settings.learning_rate)
    monitor, costs = Monitor(settings.smoothing), list[float]()
    dropout, threshold = settings.dropout, settings.threshold
    while len(costs) < settings.most_steps:
        optimizer.zero_grad()
        estimate = cost(dropout)
        estimate.backward()
        optimizer.step()
        costs.append(estimate.item())
        monitor.watch(costs[-1], threshold)
        if monitor.quiet < settings.patience:
            continue
        [group] = optimizer.param_groups
        if dropout <= 0 or group["lr"] <= settings.least_learning_rate:
            break
        monitor.quiet, threshold = 0, threshold * settings.reduction
        group["lr"] = max(group["lr"] * settings.reduction, settings.least_learning_rate)
        dropout = max(dropout - settings.dropout_step, 0.0)
    return costs
