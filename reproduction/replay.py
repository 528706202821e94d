"""A finished run once more without its robot: what its model expected at each trial.

A run's last checkpoint holds all that its robot did and all policies that ran. The model is fitted
to as much of it as there was at each trial, in the same order and so to the same model. It is asked
before the policy's own rollout, as it was when the policy was searched, and after it has learned
from the rollout.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from reproduction.delay_calibration import calibrations_ahead
from reproduction.failure_causes import ReplayedTrial
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.envs.rollouts import states_of
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.model.calibration import standardised_residuals, two_sigma_coverage
from torch_pmil.model.experience import Experience
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.model.particles import sample_rollouts
from torch_pmil.model.rollout import PredictionError
from torch_pmil.runs.diagnosis.after_a_run import known_steps
from torch_pmil.runs.diagnosis.measures import covered_fraction, first_mismatch, moved_fraction
from torch_pmil.runs.summaries import RunError, read_summary
from torch_pmil.search.kl import gaussian_kl_terms
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.checkpoints import newest_undamaged, rotation_in
from torch_pmil.trainer.trials import success_rate

LARGEST = 100_000  # transitions of a run
SAMPLE_SEED = 1  # all policies start in the same sampled states


@dataclass(frozen=True, eq=False)
class Recording:
    """What a finished run's robot did, and the policies that did it.

    Args:
        trials: as its summary has them.
        explored: transitions of the first motion, (R, T').
        rollouts: own rollout of each trial, (T,).
        parameters: of each trial's policy.
        saved_trial: number of the trial whose policy was saved.
    """

    trials: Sequence[dict[str, Any]]
    explored: TensorDictBase
    rollouts: Sequence[TensorDictBase]
    parameters: Sequence[Mapping[str, Tensor]]
    saved_trial: int

    def policies(self, experiment: Task) -> list[AnyPolicy]:
        """The policy of each trial."""
        policies = []
        for parameters in self.parameters:
            policy = experiment.make_policy(torch.Generator().manual_seed(0))
            policy.load_state_dict(parameters)
            policies.append(policy)
        return policies


def recording(folder: Path, experiment: Task) -> Recording:
    """What a finished run's robot did; its last rollout is still with the collector.

    Args:
        folder: of the run.
        experiment: what it learned.

    Raises:
        RunError: the run is not finished, or left no checkpoint.
    """
    summary = read_summary(folder)
    saved = newest_undamaged(rotation_in(folder / "checkpoints"))
    if saved is None:
        raise RunError(f"{folder} must hold the checkpoints of the run, got none")
    states = saved.states
    progress = states["trainer_module.progress"]
    experience = Experience(LARGEST)
    experience.load_state_dict(states["trainer_module.experience"])
    latest = states["collector"]["latest"]
    experience.extend(TensorDict(latest["entries"], latest["shape"]))
    trials = summary["trials"]
    sizes = [progress["explored"], *(trial["steps"] for trial in trials)]
    explored, *rollouts = experience.transitions.split(sizes)
    parameters = [candidate["parameters"] for candidate in progress["candidates"]]
    return Recording(
        trials=trials,
        explored=explored.reshape(experiment.exploration.rollouts, -1),
        rollouts=rollouts,
        parameters=[*parameters, states["policy"]],
        saved_trial=summary["saved_trial"],
    )


def replayed(folder: Path, experiment: Task, samples: int) -> dict[str, Any]:
    """What a finished run's model expected at each trial, beside what was measured.

    Args:
        folder: of the run.
        experiment: what it learned.
        samples: number of imagined rollouts of which a success rate is predicted.

    Returns:
        - ``moved``: fraction of the demonstrated way that the first motion went.
        - ``predicted_saved``: success rate of the saved policy, by the newest model.
        - ``replayed``: of each trial, the entries of its
          :class:`~reproduction.failure_causes.ReplayedTrial`.

    Raises:
        RunError: the run is not finished, or left no checkpoint.
    """
    recorded = recording(folder, experiment)
    explored = recorded.explored.flatten()
    model = GrowingModel(experiment)
    model.learn(explored)
    policies = recorded.policies(experiment)
    rows = zip(recorded.trials, recorded.rollouts, policies, strict=True)
    trials = [_replayed_trial(experiment, model, *row, samples) for row in rows]
    saved = policies[recorded.saved_trial - 1]
    errors = imagined_errors(experiment, saved, model.dynamics, samples)
    return {
        "moved": _moved(experiment, recorded.explored),
        "predicted_saved": success_rate(errors, experiment.tolerance),
        "replayed": [asdict(trial) for trial in trials],
    }


class GrowingModel:
    """The model of a run, which learns one motion after the other.

    Args:
        experiment: of the run.
    """

    def __init__(self, experiment: Task) -> None:
        self.experiment = experiment
        self.dynamics, self.experience = experiment.make_dynamics(), Experience(LARGEST)

    def learn(self, transitions: TensorDictBase) -> None:
        """Fit the model to these transitions (n,) too."""
        self.experience.extend(transitions)
        experiment, model = self.experiment, self.dynamics
        model.fit(*self.experience.data_for(model, experiment.space))


def _replayed_trial(
    experiment: Task,
    model: GrowingModel,
    trial: Mapping[str, Any],
    rollout: TensorDictBase,
    policy: AnyPolicy,
    samples: int,
) -> ReplayedTrial:
    """A trial; the model then has learned from its own rollout (T,)."""
    before = imagined_errors(experiment, policy, model.dynamics, samples)
    expected = foresight(experiment, policy, model.dynamics, rollout, trial["horizon"])
    model.learn(rollout)
    after = imagined_errors(experiment, policy, model.dynamics, samples)
    measured = ("trial", "success_rate", "n_eval", "own_success")
    return ReplayedTrial(
        **{name: trial[name] for name in measured},
        **expected,
        predicted_before=success_rate(before, experiment.tolerance),
        predicted_after=success_rate(after, experiment.tolerance),
        samples=samples,
        miss=_miss(before, experiment.tolerance),
    )


@torch.no_grad()
def foresight(
    experiment: Task,
    policy: AnyPolicy,
    dynamics: ForwardModel,
    rollout: TensorDictBase,
    horizon: int,
) -> dict[str, Any]:
    """How right the model was about a rollout (T,) from which it has not learned, and how sure.

    It is judged up to the step to which the search trusted it: where nothing led the robot it may
    be wrong. A rollout that ended earlier is judged to its end.

    Args:
        experiment, policy, dynamics: what was learned, by which policy on which model.
        rollout: of that policy.
        horizon: step to which the search trusted the prediction.

    Returns:
        The entries of a :class:`~reproduction.failure_causes.ReplayedTrial` that say so.
    """
    executed = states_of(rollout)[None]
    actions = rollout["action"][None]
    residuals = standardised_residuals(dynamics, experiment.space, executed, actions)
    ahead = calibrations_ahead(executed, policy, dynamics, experiment.space)
    try:
        along = _along_the_trajectory(experiment, policy, dynamics, rollout, horizon)
    except (PredictionError, NotPositiveDefiniteError):
        unknown = ("loss", "followed", "known", "spread_share")
        along = {"complete": False, **dict.fromkeys(unknown)}
    return {
        "covered": covered_fraction(residuals[0, :horizon]).min().item(),
        "coverage_ahead": {str(steps): found.coverage for steps, found in ahead.items()},
        **along,
    }


def _along_the_trajectory(
    experiment: Task,
    policy: AnyPolicy,
    dynamics: ForwardModel,
    rollout: TensorDictBase,
    horizon: int,
) -> dict[str, Any]:
    """Those of the entries that need a prediction of the whole trajectory."""
    loss = experiment.make_loss(policy, dynamics)
    predicted = loss.predict_states(experiment.initial)
    step_loss = loss.step_loss_for_trust(experiment.initial)
    (outcome,) = experiment.outcomes(predicted, rollout[None], torch.zeros(1))
    threshold = experiment.method.search.trust_threshold
    matched = first_mismatch(step_loss, threshold) is None
    judged = min(horizon, len(rollout))
    return {
        "complete": horizon == experiment.horizon and matched,
        "loss": loss.per_step(experiment.initial).sum().item(),
        "followed": two_sigma_coverage(predicted[:judged], outcome.executed[:, : judged + 1]),
        "known": known_steps(experiment, dynamics, outcome)[:, :judged].double().mean().item(),
        "spread_share": _spread_share(experiment, predicted, step_loss > threshold),
    }


def _spread_share(experiment: Task, predicted: Gaussian, untrusted: Tensor) -> float | None:
    """Share of the spread in the KL of the first step that is not trusted; None if all are."""
    if not untrusted.any():
        return None
    step = int(untrusted.nonzero()[0])
    noise = torch.as_tensor(experiment.noise_std, dtype=torch.float64) ** 2
    shown = experiment.space.match_space.moments(predicted[step]).add_noise(noise)
    terms = gaussian_kl_terms(experiment.demonstrated[step], shown)
    return (terms.spread.sum() / (terms.spread + terms.mean).sum()).item()


@torch.no_grad()
def imagined_errors(
    experiment: Task, policy: AnyPolicy, dynamics: ForwardModel, samples: int
) -> Tensor:
    """Errors (samples,) of rollouts that the model imagines, each step drawn from its posterior."""
    generator, robot = torch.Generator().manual_seed(SAMPLE_SEED), (policy, dynamics)
    states = sample_rollouts(
        experiment.initial, *robot, experiment.space, experiment.horizon, samples, generator
    )
    promise = experiment.promised
    assert promise is not None  # of these tasks success can be predicted
    return promise.error(states)


def _miss(errors: Tensor, tolerance: float) -> float | None:
    """Median error of the failures in tolerances; None where there is none, or no tolerance."""
    failures = errors[errors > tolerance]
    if not len(failures) or not tolerance:
        return None
    return (failures.nan_to_num(math.inf).median() / tolerance).item()


def _moved(experiment: Task, explored: TensorDictBase) -> float:
    """The way of the first motion (R, T') over the demonstrated way."""
    noise_std = torch.as_tensor(experiment.noise_std, dtype=torch.float64)
    shown = experiment.space.observe(states_of(explored))
    return moved_fraction(shown, experiment.demonstrations.positions, noise_std)
