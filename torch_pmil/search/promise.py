"""The success rate that a policy must reach from all of the robot's starts, by its model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import scipy
import torch
from torch import Tensor

from torch_pmil.checks import check_positive
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.forward_model import ForwardModel, Functions
from torch_pmil.model.sampled_rollouts import sample_consistent_rollouts
from torch_pmil.search.trajectory_loss import TrajectoryLoss

SAMPLES = 500
CONFIDENCE = 0.95
LARGEST = 0.98  # rate that can be promised: if all samples succeed, the bound is 99.4 %
# of functions, and of starts and noise: policies are compared under the same random numbers
SEEDS = 0, 1


@dataclass(frozen=True)
class PredictedSuccess:
    """How many sampled trajectories of a policy succeed, of ``SAMPLES``."""

    successes: int

    @property
    def rate(self) -> float:
        """Predicted success rate."""
        return self.successes / SAMPLES

    @property
    def least(self) -> float:
        """Lower bound of the rate with a confidence of 95 % (Clopper and Pearson 1934).

        Example:
            >>> round(PredictedSuccess(500).least, 3), PredictedSuccess(0).least
            (0.994, 0.0)
        """
        if not self.successes:
            return 0.0
        failures = SAMPLES - self.successes
        return float(scipy.special.betaincinv(self.successes, failures + 1, 1 - CONFIDENCE))


@dataclass(frozen=True, eq=False)
class Promise:
    """A success rate from fresh starts, and the error by which trajectories are judged.

    Starts are drawn from p(x_0), and functions from the model's posterior, so that what the model
    does not know makes trajectories differ and fail. Moment matching would hide the few that go
    elsewhere. A policy keeps the promise if :attr:`PredictedSuccess.least` is at least :attr:`aim`.

    Args:
        rate: the success rate, above 0 and at most ``LARGEST``.
        error: of states x_0..x_T, (N, T + 1, D) to (N).
        tolerance: error up to which a trajectory is a success.

    Raises:
        ValueError: a number is out of range.
    """

    rate: float
    error: Callable[[Tensor], Tensor]
    tolerance: float

    def __post_init__(self) -> None:
        number = isinstance(self.rate, int | float) and not isinstance(self.rate, bool)
        if not number or not 0 < self.rate <= LARGEST:
            raise ValueError(
                f"promise must be a number above 0 and at most {LARGEST}, got {self.rate!r}"
            )
        tolerance = check_positive("tolerance", self.tolerance, zero=True)
        object.__setattr__(self, "tolerance", tolerance)

    @property
    def aim(self) -> float:
        """Rate that the model must predict: half the failures are for what it does not know."""
        return (1 + self.rate) / 2

    @torch.no_grad()
    def predicted(self, loss: TrajectoryLoss, initial: Gaussian) -> PredictedSuccess:
        """Successes of the policy of ``loss`` under its model, from p(x_0)."""
        start, policy = loss.begin(initial)
        functions = _functions_of(loss.dynamics, loss.dynamics.train_inputs)
        generator = torch.Generator().manual_seed(SEEDS[1])
        given = functions, SAMPLES, loss.dynamics, loss.space, loss.horizon, generator
        states = sample_consistent_rollouts(start, policy, *given)
        return PredictedSuccess(int((self.error(states) <= self.tolerance).sum()))


@lru_cache(1)  # policies that are compared share them
def _functions_of(dynamics: ForwardModel, data: Tensor) -> Functions:
    """Functions drawn from a model with its present data."""
    return dynamics.functions(SAMPLES, torch.Generator().manual_seed(SEEDS[0]))
