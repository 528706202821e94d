"""Why a run of an experiment did not learn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torch_pmil.demonstration_checks import FEW
from torch_pmil.diagnosis import (
    LEARNED,
    LITTLE,
    Reason,
    check_experience,
    check_model,
    check_motion,
    check_search,
    check_torques,
    first_mismatch,
    group,
    unexplained,
    worst_entry,
)
from torch_pmil.dynamics import GPDynamics
from torch_pmil.experiments.checks import check, needed_torques
from torch_pmil.experiments.experiment import Experiment, Outcome
from torch_pmil.kl import gaussian_kl
from torch_pmil.objective import TrajectoryKLLoss
from torch_pmil.trajectory_loss import TrajectoryLoss
from torch_pmil.trials import Trial


@torch.no_grad()
def likely_reasons(experiment: Experiment, loss: TrajectoryLoss, outcomes: Sequence[Outcome], trials: Sequence[Trial]) -> list[Reason]:
    """Likely reasons why a run did not learn, the most likely first: what comes first brings about what comes after it.

    Wrong demonstrations mislead everything that follows, a robot that is too weak or does not move teaches nothing, a wrong model misleads
    the search. Few demonstrations alone seldom keep a robot from learning. Of several targets, the one that is worst is looked at.

    Args:
        experiment: what was to be learned.
        loss: with the saved policy and the newest model.
        outcomes: what that policy was predicted to do, and did.
        trials: all of them.

    Returns:
        None for a run that learned, at least one for any other.
    """
    failures = [experiment.error(outcome.rollouts) > experiment.tolerance for outcome in outcomes]
    failed = torch.cat(failures)
    if (~failed).double().mean() >= LEARNED:
        return []
    outcome = outcomes[max(range(len(outcomes)), key=lambda number: failures[number].sum())]
    found = group(check(experiment))
    where = f"at {outcome.label}, " if outcome.label else ""
    executed = [*_of_the_robot(experiment, outcome), *_of_the_model(experiment, loss.dynamics, outcome)]
    reasons = [
        *(reason for reason in found if reason.cause != FEW),
        *(replace(reason, message=where + reason.message) for reason in executed),
        *_of_the_search(experiment, loss, outcomes, trials),
        *(reason for reason in found if reason.cause == FEW),
    ]
    return reasons or [unexplained(int(failed.sum()), len(failed), experiment.tolerance)]


def _of_the_robot(experiment: Experiment, outcome: Outcome) -> list[Reason]:
    """What its motors cannot do."""
    torques = needed_torques(experiment)
    needed = None if torques is None else torques.abs().amax((0, 1))
    names = experiment.first_robot(seed=0).motor_names
    noise_std = torch.as_tensor(experiment.noise_std, dtype=torch.float64)
    return _found(
        check_torques(outcome.rollouts["action"], experiment.u_max, names, needed),
        check_motion(experiment.space.match(outcome.executed), outcome.demonstrations.positions, noise_std),
    )


def _of_the_model(experiment: Experiment, dynamics: GPDynamics, outcome: Outcome) -> list[Reason]:
    """What it says of rollouts that it was not fitted to; transitions that an experiment does not learn from are no errors of its."""
    errors, little = one_step_errors(experiment, dynamics, outcome)
    within = (outcome.rollouts["observation"].abs() <= experiment.limits).all(-1)
    names, time_step = experiment.space.names, outcome.demonstrations.time_step
    return _found(
        check_model(errors[within], outcome.predicted, outcome.executed, names, time_step),
        check_experience(little | ~within, len(dynamics.train_inputs), time_step),
    )


def one_step_errors(experiment: Experiment, dynamics: GPDynamics, outcome: Outcome) -> tuple[Tensor, Tensor]:
    r"""What a model says of each step of the executed rollouts, from where the robot was and what its motors did.

    .. math:: \frac{y - \mu(x)}{\sqrt{\sigma^2(x) + \sigma_\epsilon^2}}

    Returns:
        Errors in predicted standard deviations (Eqs. 6 and 7, noise included), (N, T, D); and where the model knows little: its standard
        deviation of some entry is more than half of what it is without data, bool, (N, T).
    """
    before, after = outcome.executed[:, :-1], outcome.executed[:, 1:]
    expansion = dynamics.expansion
    mean, variance = expansion.predict(torch.cat([experiment.space.features(before), outcome.rollouts["action"]], -1))
    targets = after if dynamics.targets == "successor" else after - before
    little = (variance > LITTLE**2 * expansion.signal_variance).any(-1)
    return (targets - mean) / (variance + expansion.noise).sqrt(), little


def _of_the_search(experiment: Experiment, loss: TrajectoryLoss, outcomes: Sequence[Outcome], trials: Sequence[Trial]) -> list[Reason]:
    """The step at which the newest model says that it is stuck, of the target that is worst there."""
    doubt = loss.doubt(experiment.initial)
    step = first_mismatch(doubt, experiment.search.trusted)
    if step is None:
        return []
    name, mismatch = "cost of the predicted spread", "more than the search follows"
    if isinstance(loss, TrajectoryKLLoss):
        match = experiment.space.match
        compared = [(o.expert[step - 1], match.belief(o.predicted[step - 1]).add_noise(experiment.noise_std**2), o.label) for o in outcomes]
        expert, predicted, label = max(compared, key=lambda beliefs: gaussian_kl(*beliefs[:2]).item())
        name, mismatch = "KL (nats)", worst_entry(expert, predicted, match.names, match.units) + (f" at {label}" if label else "")
    horizons = [trial.horizon for trial in trials]
    return [check_search(doubt, step, name, mismatch, horizons, experiment.demonstrations.time_step)]


def _found(*reasons: Reason | None) -> list[Reason]:
    return [reason for reason in reasons if reason is not None]
