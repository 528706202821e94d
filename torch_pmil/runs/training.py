"""One learning run: Algorithm 1 on an experiment, and what it leaves in its folder."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.checkpoint import CheckpointRotation
from torchrl.record.loggers import Logger

from torch_pmil.checks import check_whole
from torch_pmil.control.policy_file import save_policy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.demonstrations.distribution import demonstration_spread, rms_error
from torch_pmil.envs.operator import RolloutDiscarded
from torch_pmil.files import write_json
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.model.calibration import two_sigma_coverage, two_sigma_coverage_by_entry
from torch_pmil.model.compiled import available, kernels
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.experience import torchrl_warnings_alone
from torch_pmil.model.rollout import PredictionError
from torch_pmil.runs.diagnosis.after_a_run import likely_reasons
from torch_pmil.runs.diagnosis.causes import check_cut_short, unpredictable
from torch_pmil.runs.diagnosis.measures import LEARNED, saturated_fraction
from torch_pmil.runs.lock import alone_in
from torch_pmil.runs.run_folder import (
    MOST_TRIALS,
    SEEDS,
    check_logger,
    check_resume,
    clear_folder,
    open_logger,
    prepare_folder,
    provenance,
    remove_debris,
    rewind_logs,
    save_tensors,
    write_metrics,
    write_origin,
    write_settings,
)
from torch_pmil.tasks.task import Experiment, Outcome
from torch_pmil.trainer.checkpoints import (
    SavedRun,
    discard_newest,
    newest_undamaged,
    rotation_in,
)
from torch_pmil.trainer.trainer import PMILTrainer
from torch_pmil.trainer.trials import Candidate, Trial, success_rate

EVALUATION_STARTS = 20


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Args:
        summary: what ``summary.json`` holds.
        trials: all of them.
        outcomes: what the saved policy was predicted to do under the newest model, and did from
            fresh starts, or in its own rollout where there are none, task by task.
        policy: the saved policy.
        dynamics: the newest model.
    """

    summary: dict
    trials: list[Trial]
    outcomes: list[Outcome]
    policy: StatePolicy
    dynamics: GPDynamics


def train(
    experiment: Experiment,
    seed: int,
    trials: int,
    out: Path | str,
    command: str,
    progress_bar: bool = True,
    on_trial: Callable[[Trial], None] = lambda trial: None,
    resume: bool = False,
    logger: str | None = None,
    overwrite: bool = False,
    settings: Mapping[str, object] | None = None,
) -> RunResult:
    """Learn an experiment, and write policy, model and numbers into the folder of the run.

    These are ``policy.pt``, ``dynamics.pt``, ``summary.json``, and after every trial
    ``metrics.csv``.

    ``run.json`` says how the run was begun, ``settings.yaml`` with which settings. A checkpoint is
    written into ``checkpoints/`` after every rollout of the robot. A run that was killed goes on
    from there with ``resume`` and ends with the very same policy and model; one that has ended
    comes to the same end again, or goes on if ``trials`` was its limit and is larger now.

    Args:
        experiment: what to learn.
        seed: of the robot's starts, the random actions and the policy; same seed, same run.
        trials: largest number of trials.
        out: folder of the run.
        command: said in the summary, so that the run can be repeated.
        progress_bar: whether to show progress.
        on_trial: called with each finished trial.
        resume: whether to go on from the newest checkpoint in the folder; without one the run
            begins anew.
        logger: kind of TorchRL's logger, one of ``LOGGERS``, which writes into ``logs/``; None for
            none.
        overwrite: whether to replace a run that has ended; without it, and without ``resume``, such
            a run stays as it is.
        settings: of the command, by which ``settings.yaml`` names the task.

    Where the operator discards the robot's last rollout, the run goes on as one that never had it.

    Raises:
        RunStopped: the operator ended the run; it goes on with ``resume``.
        RobotError: the robot cannot be reached; the run goes on with ``resume``.
        RuntimeError: the robot hardly moved: every rollout was cut short at its start.
        OSError: the folder cannot be written to.
        TypeError: the experiment is none, as its name is.
        ValueError: a setting is out of range, or the checkpoint is of a run with other settings.
        RunGoingOnError: another run is going on in the folder.
        FinishedRunError: the folder holds a run that has ended, and neither ``overwrite`` nor
            ``resume`` is set.
        UnfinishedRunError: the folder holds a run that was stopped, and ``resume`` is not set.
        CheckpointError: all checkpoints are damaged.
        ImportError: the library of that logger is missing.
    """
    if not isinstance(experiment, Experiment):
        raise TypeError(
            f"experiment must be an Experiment, as load_experiment gives it, got {experiment!r:.80}"
        )
    out = Path(out)
    check_whole("seed", seed, *SEEDS)
    check_whole("trials", trials, 1, MOST_TRIALS)
    check_resume(resume, overwrite)
    check_logger(logger)
    rotation, identity = rotation_in(out / "checkpoints"), _identity(experiment, seed)

    def record(trial: Trial) -> None:
        write_metrics(out / "metrics.csv", Trial, trainer.trials)
        on_trial(trial)

    with alone_in(out), torchrl_warnings_alone():
        remove_debris(out)
        saved = _same_run(rotation, identity) if resume else None
        if not resume:
            clear_folder(out, overwrite)
        (out / "summary.json").unlink(missing_ok=True)  # from now on the run is unfinished
        prepare_folder(out)
        source = provenance(command)
        named = {"experiment": experiment.name, "seed": seed, "trials": trials, **(settings or {})}
        write_settings(out, named | experiment.adjustable)
        write_origin(out, source)
        opened = None if logger is None else open_logger(logger, out, experiment.name, seed)
        if available():
            kernels()  # compiled before the progress bar stands
        ended = False
        while not ended:
            trainer = make_trainer(experiment, seed, trials, progress_bar, record, opened, rotation)
            if saved is not None:
                trainer.resume(saved)
            rewind_logs(opened, trainer.collected_frames)
            write_metrics(out / "metrics.csv", Trial, trainer.trials)
            ended = _ended(trainer)
            if not ended:
                saved = discard_newest(rotation)
        return _finish(trainer, experiment, out, {"seed": seed, **source}, trials)


def _ended(trainer: PMILTrainer) -> bool:
    """Train, and say whether that came to its end: not if the last rollout was discarded."""
    try:
        trainer.train()
    except RolloutDiscarded:
        trainer.collector.shutdown(close_env=False)
        return False
    except BaseException:
        trainer.collector.shutdown()
        raise
    return True


def _finish(
    trainer: PMILTrainer,
    experiment: Experiment,
    out: Path,
    origin: dict[str, object],
    trials: int,
) -> RunResult:
    """Save the best policy and the model, measure the policy anew, and write ``summary.json``."""
    best = trainer.best_policy()
    policy, dynamics = _save_learned(trainer, experiment, out)
    predicted, failure = _predict(trainer, experiment)
    outcomes = experiment.outcomes(predicted, *_executed(trainer, best))
    results = {
        **_measured(trainer, best, experiment, outcomes),
        **(_unknown(failure) if failure else _compared(trainer, experiment, outcomes)),
    }
    summary = {
        "experiment": experiment.name,
        **origin,
        "settings": {"trials": trials, **experiment.settings},
        "wall_seconds": round(trainer.seconds, 2),
        **results,
        "diagnosis": _diagnosis(trainer, experiment, outcomes, results),
        "trials": [_plain(trial) for trial in trainer.trials],
    }
    write_json(out / "summary.json", summary)
    return RunResult(summary, trainer.trials, outcomes, policy, dynamics)


def _save_learned(
    trainer: PMILTrainer, experiment: Experiment, out: Path
) -> tuple[StatePolicy, GPDynamics]:
    """Write ``policy.pt`` and ``dynamics.pt``, and return what they hold."""
    network, dynamics = trainer.loss_module.actor_network, trainer.loss_module.dynamics
    space, period = experiment.space, trainer.control_period
    target_names = experiment.demonstrations.target_names
    actions = experiment.actions
    save_policy(out / "policy.pt", network, space, period, target_names, actions)
    save_tensors(out / "dynamics.pt", dynamics.state_dict())
    return StatePolicy(network, space, period, target_names, actions), dynamics


def _identity(experiment: Experiment, seed: int) -> dict[str, object]:
    """The settings that a resumed run must share with the stopped one, as JSON has them."""
    positions = experiment.demonstrations.positions.contiguous().numpy().tobytes()
    identity = {
        "experiment": experiment.name,
        "seed": seed,
        "demonstrations": hashlib.sha256(positions).hexdigest(),
    }
    return json.loads(json.dumps({**identity, **experiment.settings}))


def _same_run(rotation: CheckpointRotation, identity: dict[str, object]) -> SavedRun | None:
    """The checkpoint to go on from, if there is one, or ValueError if it is of another run."""
    saved = newest_undamaged(rotation)
    if saved is None:
        return None
    for name, value in identity.items():
        if saved.metadata.get(name) != value:
            found = " ".join(str(saved.metadata.get(name)).split())
            raise ValueError(
                f"the run in {rotation.directory} has {name} = {found[:200]}, got {value}: it "
                "cannot go on so"
            )
    return saved


def make_trainer(
    experiment: Experiment,
    seed: int,
    trials: int,
    progress_bar: bool,
    on_trial: Callable[[Trial], None],
    logger: Logger | None = None,
    rotation: CheckpointRotation | None = None,
) -> PMILTrainer:
    """The trainer of an experiment, with every source of randomness seeded."""
    generators = [torch.Generator().manual_seed(seed + offset) for offset in (0, 1_000_000)]
    policy = experiment.make_policy(generators[0])
    return PMILTrainer(
        env=experiment.robot(seed),
        evaluation_env=(
            experiment.robots(EVALUATION_STARTS, seed + 2_000_000) if experiment.evaluated else None
        ),
        loss_module=experiment.make_loss(policy, experiment.make_dynamics()),
        initial=experiment.initial,
        limits=experiment.limits,
        error=experiment.error,
        tolerance=experiment.tolerance,
        promise=experiment.promised,
        tracking=experiment.tracking,
        confirmations=experiment.confirmations,
        trials=trials,
        search=experiment.search,
        make_policy=experiment.make_policy,
        exploration=experiment.exploration,
        box=experiment.state_box,
        policy_generator=generators[0],
        generator=generators[1],
        on_trial=on_trial,
        progress_bar=progress_bar,
        logger=logger,
        checkpoint_rotation=rotation,
        checkpoint_metadata=_identity(experiment, seed),
    )


@torch.no_grad()
def _predict(
    trainer: PMILTrainer, experiment: Experiment
) -> tuple[Gaussian, PredictionError | None]:
    """The saved policy's predicted states; NaN, and why, if the newest model cannot predict it."""
    try:
        return trainer.loss_module.predict_states(experiment.initial), None
    except PredictionError as error:
        return Gaussian(*(moment * torch.nan for moment in _like(experiment))), error


def _like(experiment: Experiment) -> tuple[Tensor, Tensor]:
    """Moments of the shapes of predicted states, of all targets if there are several."""
    leading, D = experiment.demonstrated.mean.shape[:-1], experiment.space.dim
    return (
        torch.zeros(*leading, D, dtype=torch.float64),
        torch.zeros(*leading, D, D, dtype=torch.float64),
    )


@torch.no_grad()
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
    trainer: PMILTrainer, best: Candidate, experiment: Experiment, outcomes: list[Outcome]
) -> dict[str, object]:
    """The results of a run, with the saved policy measured anew from starts that no trial saw.

    Without such starts its own rollout tells. Of several targets it is the mean.
    """
    match_space, measured = experiment.space.match_space, trainer.evaluation_env is not None
    rates = {
        outcome.label: success_rate(outcome.errors, experiment.tolerance) for outcome in outcomes
    }
    compared = [outcome.compared for outcome in outcomes]
    spread = torch.stack([demonstration_spread(outcome.demonstrations) for outcome in compared])
    errors = torch.stack(
        [
            rms_error(outcome.demonstrations, experiment.space.observe(outcome.executed))
            for outcome in compared
        ]
    )
    saturated = torch.stack(
        [saturated_fraction(outcome.rollouts["action"], experiment.actions) for outcome in outcomes]
    ).mean(0)
    return {
        "stop_reason": trainer.stop_reason,
        "experience_s": round(len(trainer.experience) * trainer.control_period, 6),
        "saved_trial": best.trial,
        "saved_success_rate": fmean(rates.values()),
        "promised_success_rate": trainer.promised_success_rate(),
        "saved_n_eval": sum(len(outcome.errors) for outcome in outcomes) if measured else 0,
        **({"saved_success_rate_by_target": rates} if len(outcomes) > 1 else {}),
        "units": {
            "objective": experiment.objective.unit,
            "demonstrations": dict(zip(match_space.names, match_space.units, strict=True)),
        },
        "rms_error": _by_name(match_space.names, errors.square().mean(0).sqrt()),
        "demonstration_spread": _by_name(match_space.names, spread.square().mean(0).sqrt()),
        "saturated": _by_name(experiment.actions.names, saturated),
    }


def _compared(
    trainer: PMILTrainer, experiment: Experiment, outcomes: list[Outcome]
) -> dict[str, object]:
    """The results that compare what was predicted with what was executed and demonstrated."""
    compared = [outcome.compared for outcome in outcomes]
    covered = torch.stack(
        [two_sigma_coverage_by_entry(outcome.predicted, outcome.executed) for outcome in compared]
    ).mean(0)
    try:
        per_step = _per_step(trainer, experiment)
    except (PredictionError, NotPositiveDefiniteError) as error:
        return _unknown(error)
    return {
        "two_sigma_coverage": fmean(
            two_sigma_coverage(outcome.predicted, outcome.executed) for outcome in compared
        ),
        "two_sigma_coverage_by_entry": _by_name(experiment.space.names, covered),
        "loss_per_step": per_step,
    }


def _unknown(error: Exception) -> dict[str, object]:
    """The entry in place of those of :func:`_compared`, where the model cannot predict."""
    return {"prediction_error": str(error)}


def _diagnosis(
    trainer: PMILTrainer,
    experiment: Experiment,
    outcomes: list[Outcome],
    results: Mapping[str, Any],
) -> list[dict[str, object]]:
    """Likely reasons why the run did not learn; an empty list if it did."""
    if "prediction_error" in results:
        learned = results["saved_success_rate"] >= LEARNED
        reasons = [] if learned else [unpredictable(results["prediction_error"])]
    else:
        horizons = [trial.horizon for trial in trainer.trials]
        recorded = trainer.own_rollouts()
        reasons = likely_reasons(experiment, trainer.loss_module, outcomes, horizons, recorded)
    stopped = check_cut_short([trial.cut_short for trial in trainer.trials]) if reasons else None
    return [asdict(reason) for reason in (stopped, *reasons) if reason is not None]


@torch.no_grad()
def _per_step(trainer: PMILTrainer, experiment: Experiment) -> list[float]:
    """Summands of the saved policy's predicted loss under the newest model, (T,)."""
    return trainer.loss_module.per_step(experiment.initial).tolist()


def _by_name(names: tuple[str, ...], values: Tensor) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))


def _plain(trial: Trial) -> dict[str, object]:
    """A trial as JSON has it: a loss that is not finite is null."""
    values = asdict(trial)
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in values.items()
    }
