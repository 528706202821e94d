"""One learning run: Algorithm 1 on a task, and what it leaves in its folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torchrl.record.loggers import Logger

from torch_pmil.checks import check_whole
from torch_pmil.control.policy_file import save_policy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.envs.operator import RolloutDiscarded
from torch_pmil.files import write_json
from torch_pmil.model.compiled import available, kernels
from torch_pmil.model.experience import torchrl_warnings_alone
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.runs.lock import alone_in
from torch_pmil.runs.own_files import check_free, own
from torch_pmil.runs.results import results_of
from torch_pmil.runs.run_folder import (
    MOST_TRIALS,
    check_logger,
    check_resume,
    clear_folder,
    open_logger,
    provenance,
    remove_debris,
    rewind_logs,
    save_tensors,
    write_metrics,
    write_origin,
    write_settings,
)
from torch_pmil.runs.same_robot import motion_of, moves_alike
from torch_pmil.runs.sampled import discard_motion, sampled
from torch_pmil.seeds import SEEDS
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.rehearsal import rehearse
from torch_pmil.tasks.resampled import resampled
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.checkpoints import (
    RunRotation,
    SavedRun,
    discard_newest,
    newest_undamaged,
    rotation_in,
)
from torch_pmil.trainer.ending import Ending
from torch_pmil.trainer.trainer import PMILTrainer
from torch_pmil.trainer.trials import Trial

ROBOT = "robot"  # entry of a checkpoint's metadata: how the robot moves


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Args:
        summary: what ``summary.json`` holds.
        trials: all of them.
        outcomes: what the saved policy was predicted to do by the newest model, and did from fresh
            starts or, without these, in its own rollout; one for each target.
        policy: the saved policy.
        dynamics: the newest model.
        task: what was learned, as the run sampled it.
    """

    summary: dict
    trials: list[Trial]
    outcomes: list[Outcome]
    policy: StatePolicy
    dynamics: ForwardModel
    task: Task


def train(
    task: Task,
    seed: int,
    trials: int,
    out: Path | str,
    command: str,
    progress_bar: bool = True,
    on_trial: Callable[[Trial], None] = lambda trial: None,
    resume: bool | Path | str = False,
    logger: str | None = None,
    overwrite: bool = False,
    settings: Mapping[str, object] | None = None,
    announce: Callable[[str], None] = lambda line: None,
) -> RunResult:
    """Learn a task, and write policy, model and numbers into the folder of the run.

    These are ``policy.pt``, ``dynamics.pt``, ``summary.json``, and after every trial
    ``metrics.csv``. ``run.json`` and ``settings.yaml`` say how the run was begun. A checkpoint is
    written into ``checkpoints/`` after every rollout of the robot. A run that was killed continues
    from there with ``resume`` and ends with the very same policy and model; one that has ended
    comes to the same end again, or continues if ``trials`` was its limit and is larger now. If the
    operator discards the robot's last rollout, the run continues as if it had never happened.

    Args:
        task: what to learn.
        seed: of the robot's starts, the random actions and the policy; same seed, same run.
        trials: largest number of trials.
        out: folder of the run.
        command: written into the summary, so that the run can be repeated.
        progress_bar: whether to show progress.
        on_trial: called with each finished trial.
        resume: whether to continue from the newest checkpoint in the folder, if there is one. The
            folder of another run with the same settings, of this or another robot, begins a new run
            in ``out`` with that run's experience and its newest policy.
        logger: kind of TorchRL's logger, one of ``LOGGERS``, which writes into ``logs/``, or None.
        overwrite: whether to replace a run that has ended.
        settings: of the command, by which ``settings.yaml`` names the task.
        announce: called with how the run samples the robot, if it chooses, and with one line where
            it begins to improve what it imitates.

    Raises:
        RunStopped, RobotError: the operator ended the run, or the robot cannot be reached; the run
            continues with ``resume``.
        RuntimeError: the exploration gave too few transitions, no policy was admitted to the robot,
            or every rollout was cut short at its start.
        OSError: the folder cannot be written to.
        TypeError: the task is of another kind, such as its name.
        ValueError: a setting is out of range, or the checkpoint is of a run with other settings.
        RunGoingOnError: another run is going on in the folder.
        FinishedRunError: the folder holds a run that has ended, and neither ``overwrite`` nor
            ``resume`` is set.
        UnfinishedRunError: the folder holds a run that was stopped, and ``resume`` is not set.
        CheckpointError: all checkpoints are damaged.
        ImportError: the library of that logger is missing.
    """
    if not isinstance(task, Task):
        raise TypeError(f"task must be a Task, as load_experiment gives it, got {task!r:.80}")
    out = Path(out)
    seed = check_whole("seed", seed, *SEEDS)
    trials = check_whole("trials", trials, 1, MOST_TRIALS)
    if not isinstance(resume, bool | str | Path):
        raise TypeError(f"resume must be a bool or the folder of a run, got {resume!r:.80}")
    check_resume(resume is True, overwrite)
    check_logger(logger)
    rehearse(resampled(task, task.samplings[0]) if task.samplings else task)
    another = None if isinstance(resume, bool) else Path(resume)
    if another is not None:
        _of_another(another, out, {})  # it is there, before the robot moves or a file is removed

    def record(trial: Trial) -> None:
        write_metrics(own(out, "metrics.csv"), Trial, trainer.trials)
        on_trial(trial)

    def begun(known: bool) -> _Beginning:
        beginning = _beginning(task, seed, out, known, another, announce)
        named = {"experiment": task.name, "seed": seed, "trials": trials, **(settings or {})}
        _write_origin(out, named | beginning.task.adjustable, source)
        return beginning

    source = provenance(command)
    with alone_in(out), torchrl_warnings_alone():
        _clear(out, resume, overwrite)
        run = begun(resume is True)
        saved = run.saved
        opened = None if logger is None else open_logger(logger, out, task.name, seed)
        if available():
            kernels()  # compiled before the progress bar stands
        while True:
            trainer = make_trainer(
                run.task, seed, trials, progress_bar, record, opened, run.rotation, announce
            )
            _begin(trainer, saved, run.before, run.first)
            rewind_logs(opened, trainer.collected_frames)
            write_metrics(own(out, "metrics.csv"), Trial, trainer.trials)
            if _ended(trainer):
                return _finish(trainer, run.task, out, {"seed": seed, **source}, trials)
            saved = discard_newest(run.rotation)
            if saved is None and run.first is not None:
                discard_motion(out)
                run = begun(False)


@dataclass(frozen=True, eq=False)
class _Beginning:
    """What a run begins with.

    Args:
        task: as the run samples it.
        first: the motion that decided how, if there was one.
        rotation: of the run's checkpoints.
        before: the run whose experience it begins with, if any.
        saved: the newest checkpoint of a run that continues.
    """

    task: Task
    first: TensorDictBase | None
    rotation: RunRotation
    before: SavedRun | None
    saved: SavedRun | None


def _beginning(
    task: Task,
    seed: int,
    out: Path,
    known: bool,
    another: Path | None,
    announce: Callable[[str], None],
) -> _Beginning:
    """Begin a run, or continue one that is ``known``; from now on it is unfinished."""
    task, first = sampled(task, seed, out, known, another, announce)
    identity = _identity(task, seed)
    rotation = _rotation(out, identity)
    before = None if another is None else _of_another(another, out, identity)
    saved = _same_run(rotation, identity) if known else None
    (out / "summary.json").unlink(missing_ok=True)
    return _Beginning(task, first, rotation, before, saved)


def _rotation(out: Path, identity: dict[str, object]) -> RunRotation:
    """The checkpoints of a run, each of which is listed before it is written."""
    rotation = rotation_in(out / "checkpoints", identity)
    rotation.announce = lambda name: own(out, f"checkpoints/{name}")
    return rotation


def _clear(out: Path, resume: bool | Path | str, overwrite: bool) -> None:
    """Clear the folder for a new run, or leave it to the one that continues there."""
    check_free(out)
    remove_debris(out)
    if resume is not True:
        clear_folder(out, overwrite, resume is not False)


def _begin(
    trainer: PMILTrainer,
    saved: SavedRun | None,
    before: SavedRun | None,
    first: TensorDictBase | None,
) -> None:
    """Continue a run, or begin one, perhaps with another run's experience and a motion made."""
    if saved is not None:
        trainer.resume(saved)
        return
    if before is not None:
        trainer.begin_with(before)
    if first is not None:
        trainer.collector.begin_with(first)


def _write_origin(out: Path, settings: Mapping[str, object], source: dict[str, object]) -> None:
    """Write how the run was begun, and make the folder of its figures."""
    write_settings(out, settings)
    write_origin(out, source)
    (out / "figures").mkdir(exist_ok=True)


def _ended(trainer: PMILTrainer) -> bool:
    """Train to the end; return False if the last rollout was discarded."""
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
    trainer: PMILTrainer, task: Task, out: Path, origin: dict[str, object], trials: int
) -> RunResult:
    """Save the best policy and the model, measure the policy anew, and write ``summary.json``."""
    best = trainer.best_policy()
    network, dynamics = trainer.loss_module.actor_network, trainer.loss_module.dynamics
    meaning = task.space, trainer.control_period, task.target_names, task.actions
    save_policy(own(out, "policy.pt"), network, *meaning)
    save_tensors(own(out, "dynamics.pt"), dynamics.state_dict())
    policy = StatePolicy(network, *meaning)
    results, outcomes = results_of(trainer, best, task)
    summary = {
        "experiment": task.name,
        **origin,
        "settings": {"trials": trials, **task.settings},
        "wall_seconds": round(trainer.seconds, 2),
        "cpu_seconds": round(trainer.cpu_seconds, 2),
        **results,
    }
    write_json(own(out, "summary.json"), summary)
    return RunResult(summary, trainer.trials, outcomes, policy, dynamics, task)


def _identity(task: Task, seed: int) -> dict[str, object]:
    """The settings that a resumed run must share with the stopped one, as JSON has them."""
    shown = torch.zeros(0) if task.demonstrations is None else task.demonstrations.positions
    content = shown.contiguous().numpy().tobytes()
    identity = {
        "experiment": task.name,
        "seed": seed,
        "demonstrations": hashlib.sha256(content).hexdigest(),
        "control_period": task.time_step,
        "state": list(task.space.names),
        "actions": [task.actions.low.tolist(), task.actions.high.tolist()],
    }
    return json.loads(json.dumps({**identity, **task.settings, ROBOT: motion_of(task)}))


def _same_run(rotation: RunRotation, identity: dict[str, object]) -> SavedRun | None:
    """The newest checkpoint, or None; raises ValueError if it is of another run or robot."""
    saved = newest_undamaged(rotation)
    if saved is None:
        return None
    _check_settings(saved, rotation.directory, identity)
    recorded = saved.metadata.get(ROBOT)
    if not moves_alike(identity[ROBOT], recorded):
        folder = rotation.directory.parent
        raise ValueError(
            f"the run in {folder} is of a robot that moves otherwise under the same actions: "
            f"another out starts a new run, and learn(out=..., resume={str(folder)!r}) one that "
            "begins with its experience"
        )
    rotation.metadata = identity | {ROBOT: recorded}
    return saved


def _of_another(folder: Path, out: Path, identity: Mapping[str, object]) -> SavedRun:
    """The newest checkpoint of a run that another one begins with."""
    saved = newest_undamaged(rotation_in(folder / "checkpoints"))
    if saved is None or folder.resolve() == out.resolve():
        raise ValueError(f"resume must be true or the folder of another run, got {folder}")
    alike = {key: value for key, value in identity.items() if key not in ("experiment", "seed")}
    _check_settings(saved, folder, alike)
    return saved


def _check_settings(saved: SavedRun, folder: Path, identity: Mapping[str, object]) -> None:
    """Raise ValueError if a checkpoint is of a run with other settings."""
    for name, value in identity.items():
        if name != ROBOT and saved.metadata.get(name) != value:
            found = " ".join(str(saved.metadata.get(name)).split())
            raise ValueError(
                f"the run in {folder} has {name} = {found[:200]}, got {value}: it cannot go on so"
            )


def make_trainer(
    task: Task,
    seed: int,
    trials: int,
    progress_bar: bool,
    on_trial: Callable[[Trial], None],
    logger: Logger | None = None,
    rotation: RunRotation | None = None,
    announce: Callable[[str], None] = lambda line: None,
) -> PMILTrainer:
    """The trainer of a task, with every source of randomness seeded."""
    method = task.method
    trainer = PMILTrainer(
        task.problem(seed),
        Ending(trials, method.ending.confirmations, task.promised),
        method.search,
        seed,
        optimizer=method.optimizer,
        on_trial=on_trial,
        progress_bar=progress_bar,
        logger=logger,
        checkpoint_rotation=rotation,
    )
    trainer.announce = announce
    return trainer
