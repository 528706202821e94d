"""Records of the trials on the robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Self

from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.envs.rollouts import check_results
from torch_pmil.search.admission import Admission


@dataclass(frozen=True)
class Measurement:
    """Outcome of a trial, whatever method learned.

    Args:
        trial: 1, 2, ...
        experience_s: seconds of experience that was learned from.
        success_rate: that of ``n_eval`` rollouts from fresh starts, which are no experience; None
            if none were measured, and the own rollout alone is judged.
        n_eval: number of these rollouts.
        own_error: error of the trial's own rollout, which becomes experience; the largest of all
            targets.
        own_success: whether the own rollout is a success.
    """

    trial: int
    experience_s: float
    success_rate: float | None
    n_eval: int
    own_error: float
    own_success: bool


@dataclass(frozen=True)
class Trial(Measurement):
    """One turn of Algorithm 1: a search, its policy's rollout on the robot, and a measurement.

    Args:
        predicted_success_rate: by the model on which the policy was searched; None where no success
            can be predicted.
        promised_success_rate: with a confidence of 95 %, by the model that learned from the own
            rollout; None where that was no success, or nothing can be predicted.
        loss: predicted loss over the whole horizon: the KL in nats, or another objective's cost.
        horizon: the last horizon that was searched, in steps; it may not have been trusted.
        refitted: whether a second search was made, from a refitted policy.
        gp_seconds, search_seconds: wall time of the model's fit and of the search, s.
        evaluations: number of evaluations of the objective.
        stop_reason: why the last run of the optimiser ended.
        steps: control steps of the own rollout.
        cut_short: why the own rollout was cut short, a failure of infinite error; "" if it was not.
        leaving_probability: bound on the predicted probability that the own rollout leaves the box
            of the motion; None without a box.
        refused: number of policies that were refused before, since they were likely to leave it.
    """

    predicted_success_rate: float | None
    promised_success_rate: float | None
    loss: float
    horizon: int
    refitted: bool
    gp_seconds: float
    search_seconds: float
    evaluations: int
    stop_reason: str
    steps: int
    cut_short: str
    leaving_probability: float | None
    refused: int

    @classmethod
    def before_its_rollout(
        cls,
        number: int,
        experience_s: float,
        measured: tuple[float | None, int],
        predicted_success_rate: float | None,
        admission: Admission,
        refitted: bool,
        gp_seconds: float,
    ) -> Self:
        """A trial whose policy was found, admitted and measured, and has not run yet."""
        search = admission.result
        return cls(
            trial=number,
            experience_s=experience_s,
            success_rate=measured[0],
            n_eval=measured[1],
            own_error=math.nan,
            own_success=False,
            predicted_success_rate=predicted_success_rate,
            promised_success_rate=None,
            loss=search.loss,
            horizon=search.horizon,
            refitted=refitted,
            gp_seconds=gp_seconds,
            search_seconds=search.seconds,
            evaluations=search.evaluations,
            stop_reason=search.stop_reason,
            steps=0,
            cut_short="" if admission.complete else "it was likely to leave the box",
            leaving_probability=admission.leaving_probability,
            refused=admission.refused,
        )


@dataclass(frozen=True, eq=False)
class Candidate:
    """A policy that ran on the robot: its parameters and the error of its own rollout."""

    trial: int
    parameters: Mapping[str, Tensor]
    own_error: float


def own_error(
    rollout: TensorDictBase,
    cut_short: str,
    horizon: int,
    error: Callable[[TensorDictBase], Tensor],
) -> float:
    """The largest error of a rollout (*robots, T), infinite where it was cut short.

    ``cut_short`` says why the robot ended it early, "" if it did not; a whole rollout has
    ``horizon`` steps. ``error`` maps whole rollouts to (*robots).

    Raises:
        ValueError: it returns something else.
    """
    if cut_short or rollout.shape[-1] < horizon:
        return math.inf
    errors = error(rollout)
    check_results("error", errors, rollout.shape[:-1])
    return errors.max().item()


def success_rate(errors: Tensor, tolerance: float) -> float:
    """Fraction of rollouts whose error (N,) is within the tolerance."""
    return (errors <= tolerance).double().mean().item()
