"""The choice among the policies that ran on the robot."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.rollout import PredictionError
from torch_pmil.search.improving_loss import ImprovingKLLoss
from torch_pmil.search.promise import Promise
from torch_pmil.search.sample_search import expected_cost
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.trainer.trials import Candidate, Trial

SEED = 0  # of the trajectories by which expected costs are compared
SETTLED = 0.98  # of the cost of the policy before, above which an improvement has come to its end
WEIGHT = 10  # rollouts that count as much as the model's prediction, which may be wrong


def best_candidate(
    candidates: Sequence[Candidate],
    trials: Sequence[Trial],
    loss: TrajectoryLoss,
    initial: Gaussian,
    promise: Promise | None,
    tolerance: float,
) -> Candidate:
    """The best of the policies that ran, which the loss then holds.

    Among those whose own rollout was not cut short it has the highest success rate by all that is
    known: its rollouts from fresh starts, its own rollout, and the predicted rate, up to
    :attr:`Promise.aim`, which counts as much as ``WEIGHT`` rollouts. If several are alike, it has
    the smallest error of the own rollout, where all successes count the same. Next come the longest
    own rollout and the smallest predicted loss.

    If the loss is improving, all policies that keep the promised rate, both as known and as
    predicted, count as equal. The last criterion is then the smallest expected cost, estimated from
    trajectories that each follow one function of the model.

    Args:
        candidates: one at least.
        trials: all of the run.
        loss: objective with the policy (changed in place) and a model of all experience.
        initial: p(x_0).
        promise: by which success is predicted; None if it is not.
        tolerance: largest error of a success.
    """

    def merit(candidate: Candidate) -> tuple[float, ...]:
        loss.actor_network.load_state_dict(candidate.parameters)
        trial, predicted = trials[candidate.trial - 1], None
        if promise is not None:
            predicted = min(promise.predicted(loss, initial).least, promise.aim)
        error = max(candidate.own_error, tolerance)
        rate = _known_rate(trial, error <= tolerance, predicted)
        if isinstance(loss, ImprovingKLLoss) and loss.improving:
            if promise is not None and predicted is not None:
                rate = min(rate, predicted, promise.rate)
            expected = expected_cost(loss.cost, initial, SEED)
        else:
            expected = _predicted_loss(loss, initial)
        return error < math.inf, rate, -error, trial.steps, -expected

    chosen = max(candidates, key=merit)
    loss.actor_network.load_state_dict(chosen.parameters)
    return chosen


def is_settled(candidates: Sequence[Candidate], loss: ImprovingKLLoss, initial: Gaussian) -> bool:
    """Whether the newest policy costs hardly less than the one before; the loss then holds it.

    Args:
        candidates: two at least.
        loss: with a model of all experience.
        initial: p(x_0).
    """
    costs = []
    for candidate in candidates[-2:]:
        loss.actor_network.load_state_dict(candidate.parameters)
        costs.append(expected_cost(loss.cost, initial, SEED))
    return costs[0] - costs[1] <= (1 - SETTLED) * abs(costs[0])


def _known_rate(trial: Trial, own_success: bool, predicted: float | None) -> float:
    """Success rate by the rollouts of a policy and, if it is not None, the model's prediction."""
    successes = own_success + (trial.success_rate or 0.0) * trial.n_eval
    if predicted is None:
        return successes / (1 + trial.n_eval)
    return (successes + WEIGHT * predicted) / (1 + trial.n_eval + WEIGHT)


@torch.no_grad()
def _predicted_loss(loss: TrajectoryLoss, initial: Gaussian) -> float:
    try:
        return loss.per_step(initial).sum().item()
    except PredictionError:
        return math.inf
