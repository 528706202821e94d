"""The results of a finished run, as its summary holds them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from statistics import fmean
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.demonstrations.distribution import demonstration_spread, rms_error
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.model.calibration import two_sigma_coverage, two_sigma_coverage_by_entry
from torch_pmil.model.rollout import PredictionError
from torch_pmil.runs.diagnosis.after_a_run import likely_reasons
from torch_pmil.runs.diagnosis.causes import check_cut_short, unpredictable
from torch_pmil.runs.diagnosis.measures import LEARNED, saturated_fraction
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.trainer import PMILTrainer
from torch_pmil.trainer.trials import Candidate, Trial, success_rate


@torch.no_grad()
def results_of(
    trainer: PMILTrainer, best: Candidate, task: Task
) -> tuple[dict[str, Any], list[Outcome]]:
    """The results of a run whose saved policy is ``best``, and its outcome for each target."""
    predicted, failure = _predict(trainer, task)
    outcomes = task.outcomes(predicted, *_executed(trainer, best))
    results = {
        **_measured(trainer, best, task, outcomes),
        **(failure or _compared(trainer, task, outcomes)),
    }
    results["diagnosis"] = _diagnosis(trainer, task, outcomes, results)
    results["trials"] = [_plain(trial) for trial in trainer.trials]
    return results, outcomes


def _predict(trainer: PMILTrainer, task: Task) -> tuple[Gaussian, dict[str, object]]:
    """The saved policy's predicted states; NaN, and why, if the newest model cannot predict it."""
    try:
        return trainer.loss_module.predict_states(task.initial), {}
    except PredictionError as error:
        start, _ = trainer.loss_module.begin(task.initial)
        leading, D = (*start.batch_shape, task.horizon), task.space.dim
        unknown = torch.full((*leading, D, D), torch.nan, dtype=torch.float64)
        return Gaussian(unknown[..., 0], unknown), {"prediction_error": str(error)}


def _executed(trainer: PMILTrainer, best: Candidate) -> tuple[TensorDictBase, Tensor]:
    """Rollouts of the saved policy and their errors: from fresh starts, or else its own."""
    if trainer.evaluation_env is not None:
        rollouts = trainer.evaluation_env.rollout(trainer.loss_module.horizon, trainer.robot_policy)
        return rollouts, trainer.error(rollouts)
    rollouts = trainer.own_rollout(best)
    if not rollouts.batch_size.numel():
        cut_short = trainer.trials[best.trial - 1].cut_short
        raise RuntimeError(f"no policy made a step on the robot: {cut_short}")
    return rollouts, torch.full(rollouts.shape[:1], best.own_error, dtype=torch.float64)


def _measured(
    trainer: PMILTrainer, best: Candidate, task: Task, outcomes: list[Outcome]
) -> dict[str, object]:
    """The results of the saved policy's rollouts, averaged over targets."""
    match_space, measured = task.space.match_space, trainer.evaluation_env is not None
    rates = {outcome.label: success_rate(outcome.errors, task.tolerance) for outcome in outcomes}
    saturated = torch.stack(
        [saturated_fraction(outcome.rollouts["action"], task.actions) for outcome in outcomes]
    ).mean(0)
    return {
        "stop_reason": trainer.stop_reason,
        **({"unmet": unmet} if (unmet := trainer.ending.unmet(trainer.trials)) else {}),
        "experience_s": round(len(trainer.experience) * trainer.control_period, 6),
        "saved_trial": best.trial,
        "saved_success_rate": fmean(rates.values()),
        "promised_success_rate": trainer.promised_success_rate(),
        "saved_n_eval": sum(len(outcome.errors) for outcome in outcomes) if measured else 0,
        **({"saved_success_rate_by_target": rates} if len(outcomes) > 1 else {}),
        "units": {
            "objective": task.objective.unit,
            "demonstrations": dict(zip(match_space.names, match_space.units, strict=True)),
        },
        **_beside_demonstrations(task, outcomes),
        "saturated": _by_name(task.actions.names, saturated),
    }


def _beside_demonstrations(task: Task, outcomes: list[Outcome]) -> dict[str, object]:
    """How far rollouts, and demonstrations, are off the demonstrated mean, if there is one."""
    match_space, compared = task.space.match_space, [outcome.compared for outcome in outcomes]
    beside = [(each.demonstrations, each.executed) for each in compared]
    pairs = [(shown, match_space(executed)) for shown, executed in beside if shown is not None]
    if not pairs:
        return {}
    errors = torch.stack([rms_error(*pair) for pair in pairs])
    spread = torch.stack([demonstration_spread(shown) for shown, _ in pairs])
    return {
        "rms_error": _by_name(match_space.names, errors.square().mean(0).sqrt()),
        "demonstration_spread": _by_name(match_space.names, spread.square().mean(0).sqrt()),
    }


def _compared(trainer: PMILTrainer, task: Task, outcomes: list[Outcome]) -> dict[str, object]:
    """The results that compare what was predicted with what was executed and demonstrated."""
    compared = [outcome.compared for outcome in outcomes]
    covered = torch.stack(
        [two_sigma_coverage_by_entry(outcome.predicted, outcome.executed) for outcome in compared]
    ).mean(0)
    try:
        per_step = trainer.loss_module.per_step(task.initial).tolist()
    except (PredictionError, NotPositiveDefiniteError) as error:
        return {"prediction_error": str(error)}
    return {
        "two_sigma_coverage": fmean(
            two_sigma_coverage(outcome.predicted, outcome.executed) for outcome in compared
        ),
        "two_sigma_coverage_by_entry": _by_name(task.space.names, covered),
        "loss_per_step": per_step,
    }


def _diagnosis(
    trainer: PMILTrainer, task: Task, outcomes: list[Outcome], results: Mapping[str, Any]
) -> list[dict[str, object]]:
    """Likely reasons why the run did not learn; an empty list if it did."""
    if "prediction_error" in results:
        learned = results["saved_success_rate"] >= LEARNED
        reasons = [] if learned else [unpredictable(results["prediction_error"])]
    else:
        horizons = [trial.horizon for trial in trainer.trials]
        recorded = trainer.own_rollouts()
        reasons = likely_reasons(task, trainer.loss_module, outcomes, horizons, recorded)
    stopped = check_cut_short([trial.cut_short for trial in trainer.trials]) if reasons else None
    return [asdict(reason) for reason in (stopped, *reasons) if reason is not None]


def _by_name(names: tuple[str, ...], values: Tensor) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))


def _plain(trial: Trial) -> dict[str, object]:
    """A trial as JSON has it: a loss that is not finite is null."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in asdict(trial).items()
    }
