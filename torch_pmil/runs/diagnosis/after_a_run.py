"""Why a run of an experiment did not learn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.model.calibration import standardised_residuals
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.runs.diagnosis.before_a_run import check, needed_torques
from torch_pmil.runs.diagnosis.causes import (
    LEARNED,
    LITTLE,
    Reason,
    check_chance,
    check_experience,
    check_model,
    check_motion,
    check_past,
    check_saturation,
    check_search,
    first_mismatch,
    group,
    unexplained,
    worst_entry,
)
from torch_pmil.runs.diagnosis.demonstration_checks import FEW
from torch_pmil.runs.diagnosis.hidden_past import evidence_of_the_past
from torch_pmil.search.kl import gaussian_kl
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.task import Task


@torch.no_grad()
def likely_reasons(
    experiment: Task,
    loss: TrajectoryLoss,
    outcomes: Sequence[Outcome],
    horizons: Sequence[int],
    recorded: Sequence[TensorDictBase],
) -> list[Reason]:
    """Likely reasons why a run did not learn, the most likely first.

    An earlier reason brings about the later ones.

    Wrong demonstrations mislead everything that follows; a robot that is too weak or does not move
    teaches nothing; a model that is wrong up to the step at which the search is stuck misleads it,
    and one that is wrong beyond it alone does not: there the policy goes where nothing leads it.
    Where the past tells more of the motion than the present, no model of the present is right. Few
    demonstrations alone seldom keep a robot from learning. Of several targets, the worst one is
    looked at.

    Args:
        experiment: what was to be learned.
        loss: with the saved policy and the newest model.
        outcomes: what that policy was predicted to do, and did.
        horizons: steps up to which the search of each trial went.
        recorded: whole rollouts that are experience, (N, T) each, in their order.

    Returns:
        An empty list for a run that learned, at least one reason for any other.
    """
    failures = [outcome.errors > experiment.tolerance for outcome in outcomes]
    failed = torch.cat(failures)
    if (~failed).double().mean() >= LEARNED:
        return []
    outcome = outcomes[max(range(len(outcomes)), key=lambda number: failures[number].sum())]
    found = group(check(experiment))
    evidence = evidence_of_the_past(experiment, loss.dynamics.targets, recorded)
    past = check_past(evidence) if evidence else None
    step_loss = loss.step_loss_for_trust(experiment.initial)
    step = first_mismatch(step_loss, experiment.method.search.trust_threshold)
    led = _of_the_model(experiment, loss.dynamics, outcome, step or experiment.horizon)
    beyond = [] if led else _of_the_model(experiment, loss.dynamics, outcome, experiment.horizon)
    reasons = [
        *(reason for reason in found if reason.cause != FEW),
        *_of_the_robot(experiment, outcome),
        *([past] if past else []),
        *led,
        *([_of_the_search(experiment, loss, outcomes, step_loss, horizons, step)] if step else []),
        *beyond,
        *(reason for reason in found if reason.cause == FEW),
    ]
    if reasons:
        return reasons
    promise, counted = experiment.promised, (int(failed.sum()), len(failed))
    promised = promise.predicted(loss, experiment.initial).least if promise else None
    if chance := check_chance(*counted, promised):
        return [chance]
    largest = _largest(experiment, loss, outcomes, step_loss)
    return [unexplained(*counted, experiment.tolerance, largest, experiment.adjustable)]


def _of_the_robot(experiment: Task, outcome: Outcome) -> list[Reason]:
    """Reasons that lie in the robot's motors."""
    outcome, torques = outcome.compared, needed_torques(experiment)
    needed = None if torques is None else torques.abs().amax((0, 1))
    noise_std = torch.as_tensor(experiment.noise_std, dtype=torch.float64)
    return _found(
        outcome,
        check_saturation(outcome.rollouts["action"], experiment.actions, needed),
        check_motion(
            experiment.space.observe(outcome.executed),
            outcome.demonstrations.positions,
            noise_std,
            experiment.adjustable,
        ),
    )


def _of_the_model(
    experiment: Task, dynamics: GPDynamics, outcome: Outcome, steps: int
) -> list[Reason]:
    """Reasons that lie in the model, by the first steps of rollouts that it was not fitted to."""
    outcome = outcome.compared
    actions, time_step = outcome.rollouts["action"], outcome.demonstrations.time_step
    residuals = standardised_residuals(dynamics, experiment.space, outcome.executed, actions)
    residuals, known = residuals[:, :steps], known_steps(experiment, dynamics, outcome)[:, :steps]
    predicted, executed = outcome.predicted[:steps], outcome.executed[:, : steps + 1]
    names, settings = experiment.space.names, experiment.adjustable
    return _found(
        outcome,
        check_model(residuals[known], predicted, executed, names, time_step, settings),
        check_experience(~known, len(dynamics.train_inputs), time_step, settings),
    )


def known_steps(experiment: Task, dynamics: GPDynamics, outcome: Outcome) -> Tensor:
    """The steps t = 0..T-1 of executed rollouts at which the model knows something, bool, (N, T).

    That is within the limits of the states that it learns from, or within the largest values of
    its data where these go further, and with a standard deviation of no entry above half of that
    without data.
    """
    before, expansion = outcome.executed[:, :-1], dynamics.expansion
    inputs = torch.cat([experiment.space.features(before), outcome.rollouts["action"]], -1)
    _, variance = expansion.predict(inputs)
    sure = (variance <= LITTLE**2 * expansion.signal_variance).all(-1)
    plain = list(experiment.space.plain)  # the first features; angles have no limit
    reached = dynamics.train_inputs[:, : len(plain)].abs().amax(0)
    limits = torch.maximum(experiment.limits[plain], reached)
    return sure & (before[..., plain].abs() <= limits).all(-1)


def _of_the_search(
    experiment: Task,
    loss: TrajectoryLoss,
    outcomes: Sequence[Outcome],
    step_loss: Tensor,
    horizons: Sequence[int],
    step: int,
) -> Reason:
    """The step at which the search is stuck, by the newest model."""
    mismatch = _mismatch(experiment, loss, outcomes, step)
    time_step, settings = experiment.demonstrations.time_step, experiment.adjustable
    return check_search(step_loss, step, *_named(loss), mismatch, horizons, time_step, settings)


def _largest(
    experiment: Task, loss: TrajectoryLoss, outcomes: Sequence[Outcome], step_loss: Tensor
) -> str:
    """The largest loss of a step under the newest model, in words."""
    name, unit = _named(loss)
    step = int(step_loss.argmax()) + 1
    said = (
        f"the {name} of a step is at most {step_loss[step - 1]:.3g} {unit}, at "
        f"{step * experiment.demonstrations.time_step:.2f} s"
    )
    return f"{said}, {_mismatch(experiment, loss, outcomes, step)}"


def _named(loss: TrajectoryLoss) -> tuple[str, str]:
    """Name and unit of :meth:`TrajectoryLoss.step_loss_for_trust`."""
    if isinstance(loss, TrajectoryKLLoss):
        return loss.label, loss.unit
    return "cost of the predicted spread", "of 1"


def _mismatch(
    experiment: Task, loss: TrajectoryLoss, outcomes: Sequence[Outcome], step: int
) -> str:
    """The entry in which prediction and demonstrations differ most at a step.

    Of several targets, the one that is worst there is looked at.
    """
    if not isinstance(loss, TrajectoryKLLoss):
        return "where the prediction is too wide to be followed"
    match_space, noise_std = experiment.space.match_space, experiment.noise_std
    demonstrated = [outcome.demonstrated[step - 1] for outcome in outcomes]
    predicted = [
        match_space.moments(outcome.predicted[step - 1]).add_noise(noise_std**2)
        for outcome in outcomes
    ]
    losses = [gaussian_kl(*pair).item() for pair in zip(demonstrated, predicted, strict=True)]
    worst = losses.index(max(losses))
    entry = worst_entry(demonstrated[worst], predicted[worst], match_space.names, match_space.units)
    label = outcomes[worst].label
    return f"{entry} at {label}" if label else entry


def _found(outcome: Outcome, *reasons: Reason | None) -> list[Reason]:
    """The reasons that are not None, each with the name of the target if there are several."""
    where = f"at {outcome.label}, " if outcome.label else ""
    found = [reason for reason in reasons if reason is not None]
    return [replace(reason, message=where + reason.message) for reason in found]
