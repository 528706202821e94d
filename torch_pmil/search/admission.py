"""Admission of a policy to the robot: no rollout that is predicted to leave the box."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from torch_pmil.control.state_box import StateBox
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.lbfgs import MakeOptimizer, NotFiniteError
from torch_pmil.search.policy_search import (
    Report,
    SearchResult,
    SearchSettings,
    evaluate_steps,
    search_policy,
)
from torch_pmil.search.trajectory_loss import TrajectoryLoss

PENALTY_WEIGHTS = (1.0, 10.0, 100.0)  # of the searches that follow a refusal, one after the other


@dataclass(frozen=True, eq=False)
class Admission:
    """What the robot may do with a policy.

    Args:
        result: outcome of the search that found it, with the work of all searches.
        leaving_probability: bound on the predicted probability that its rollout leaves the box;
            None without a box.
        refused: number of policies that were refused before it.
        steps: number of first steps that the robot may do: all of an admitted policy, otherwise
            those up to which the accumulated probability is below the threshold.
    """

    result: SearchResult
    leaving_probability: float | None
    refused: int
    steps: int

    @property
    def complete(self) -> bool:
        """Whether the robot may do all steps."""
        return self.steps == len(self.result.per_step)


def admit(
    loss: TrajectoryLoss,
    initial: Gaussian,
    box: StateBox | None,
    settings: SearchSettings,
    result: SearchResult,
    report: Report = lambda stage, loss: None,
    optimizer: MakeOptimizer = torch.optim.LBFGS,
) -> Admission:
    """Predict whether the policy of ``loss`` leaves a box; search on with a penalty where it may.

    The penalty is :meth:`StateBox.penalty` with the weights 1, 10 and 100, one after the other, in
    the unit of the loss.

    Args:
        loss, initial, settings, report, optimizer: as for :func:`search_policy`.
        box: limits of the motion; None admits every policy.
        result: outcome of the search that found the policy.
    """
    if box is None:
        return Admission(result, None, 0, loss.horizon)
    leaving, refused = _leaving(loss, initial, box), 0
    for weight in PENALTY_WEIGHTS:
        if leaving.sum() <= box.threshold:
            break
        refused += 1
        if not loss.has_moments:  # which the penalty is a function of
            break
        try:
            with loss.penalised(partial(box.penalty, weight=weight)):
                again = search_policy(loss, initial, settings, report, optimizer=optimizer)
        except NotFiniteError:  # so far outside that no search can begin
            break
        per_step = evaluate_steps(loss.per_step, initial, loss.horizon)  # without the penalty
        again = replace(again, loss=per_step.sum().item(), per_step=per_step)
        result = again.with_work_of(result)
        leaving = _leaving(loss, initial, box)
    steps = int((leaving.cumsum(-1) <= box.threshold).sum())
    return Admission(result, min(leaving.sum().item(), 1.0), refused, steps)


def _leaving(loss: TrajectoryLoss, initial: Gaussian, box: StateBox) -> Tensor:
    """Bound on the probability to be outside at each step, (T,), or 1 without a prediction.

    It is the largest of all targets.
    """

    def largest(initial: Gaussian, horizon: int) -> Tensor:
        leaving = box.leaving_by_step(loss.predict_states(initial, horizon))
        return leaving.reshape(-1, horizon).amax(0)

    return evaluate_steps(largest, initial, loss.horizon).clamp(max=1)
