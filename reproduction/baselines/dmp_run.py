"""A run of the baseline with movement primitives on the double pendulum, and its folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from torch import Tensor

from reproduction.baselines.dmp import DMP
from reproduction.baselines.dmp_learning import (
    InverseDynamicsLearner,
    Motion,
    dmp_reference,
    execute,
    random_torques,
)
from reproduction.baselines.learned_inverse_dynamics import POSITION_GAIN, VELOCITY_GAIN
from torch_pmil.checks import check_whole
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.envs.rollouts import rollout_of
from torch_pmil.files import write_json
from torch_pmil.runs.own_files import own
from torch_pmil.runs.run_folder import clear_folder, provenance, write_metrics
from torch_pmil.seeds import Stream, generator_of
from torch_pmil.tasks.method import RandomMotion
from torch_pmil.tasks.task import MEASURED_STARTS, Task
from torch_pmil.trainer.ending import LIMIT
from torch_pmil.trainer.trials import Measurement, success_rate

NUM_BASIS = 30  # of the primitive; with them it is within 1 mrad of the demonstrations' mean
# s; held for 0.1 s, the paper's gains are unstable on this robot
# (tests/reproduction/baselines/test_learned_inverse_dynamics.py)
FEEDBACK_PERIOD = 0.01


@dataclass(frozen=True)
class DMPTrial(Measurement):
    """One trial of the baseline.

    Args:
        tracking_error: root mean square error of the joint angles in the rollouts from fresh
            starts, rad.
        gp_seconds: wall time.
    """

    tracking_error: float
    gp_seconds: float


def joint_trajectories(experiment: Task) -> Tensor:
    """Joint angles (N, T + 1, J), rad, that the demonstrations show.

    Each has the turns that begin nearest to the robot's start.
    """
    count = len(experiment.demonstrations.positions)
    return experiment.demonstrated_states.unflatten(0, (count, -1))[..., 0::2]


def run_dmp(
    experiment: Task,
    seed: int,
    trials: int,
    out: Path,
    command: str,
    feedback_period: float = FEEDBACK_PERIOD,
    on_trial: Callable[[DMPTrial], None] = lambda trial: None,
) -> dict:
    """Learn the double pendulum with the baseline, and write numbers into the folder of the run.

    These are ``metrics.csv``, after every trial, and ``summary.json``.

    The first experience is the very random rollout that our learner gets with that seed, and all
    starts are the same too. Training does not end before the limit of trials. After the last one
    the model is learned from all experience and measured once more: the ``saved_success_rate``.

    Args:
        experiment: the double pendulum.
        seed: of the robot's starts and the random torques; same seed, same run up to rounding.
        trials: number of trials.
        out: folder of the run.
        command: said in the summary, so that the run can be repeated.
        feedback_period: of the PD controller, s; the learned torques are held for the experiment's
            control period, a multiple of it.
        on_trial: called with each finished trial.

    Returns:
        What ``summary.json`` holds.

    Raises:
        OSError: the folder cannot be written to.
        ValueError: a setting is out of range, or it is another experiment.
        UnfinishedRunError: the folder holds another, stopped run.
    """
    _check(experiment, seed, trials)
    begun, source = time.perf_counter(), provenance(command)
    hold = _hold(experiment.demonstrations.time_step, feedback_period)
    env = experiment.make_env(control_period=feedback_period, seed=seed)
    fresh = experiment.make_env(
        control_period=feedback_period, num_envs=MEASURED_STARTS, seed=seed + Stream.MEASURED_STARTS
    )
    out.mkdir(parents=True, exist_ok=True)
    clear_folder(out, overwrite=True)  # it takes less than a minute
    rows: list[DMPTrial] = []
    write_metrics(own(out, "metrics.csv"), DMPTrial, rows)
    learner = make_learner(experiment, hold)
    learner.add(random_rollout(experiment, env, hold, seed))
    for _ in range(trials):
        rows.append(run_trial(experiment, learner, env, fresh, len(rows) + 1))
        write_metrics(own(out, "metrics.csv"), DMPTrial, rows)
        on_trial(rows[-1])
    learner.fit()
    errors = experiment.error(rollout_of(learner.execute(fresh).states))
    summary = {
        "experiment": f"{experiment.name}_dmp",
        "seed": seed,
        **source,
        "settings": settings(experiment, trials, feedback_period),
        "wall_seconds": round(time.perf_counter() - begun, 2),
        "stop_reason": LIMIT,
        "experience_s": round(learner.experience_s, 6),
        "saved_trial": trials,
        "saved_success_rate": success_rate(errors, experiment.tolerance),
        "saved_n_eval": len(errors),
        "trials": [asdict(trial) for trial in rows],
    }
    write_json(own(out, "summary.json"), summary)
    return summary


def make_learner(experiment: Task, hold: int) -> InverseDynamicsLearner:
    """The learner of an experiment, with the primitive of its demonstrations as reference.

    A control step has ``hold`` steps of the feedback.
    """
    time_step = experiment.demonstrations.time_step
    dmp = DMP.from_demonstrations(joint_trajectories(experiment), time_step, NUM_BASIS)
    reference = dmp_reference(dmp, experiment.horizon, time_step, hold)
    return InverseDynamicsLearner(
        experiment.space, reference, experiment.actions.half_range, time_step
    )


def random_rollout(experiment: Task, env: MujocoRobotEnv, hold: int, seed: int) -> Motion:
    """The first experience: the random rollout that our learner gets with that seed."""
    generator = generator_of(Stream.MOTION, seed)
    torques = random_torques(
        experiment.actions.half_range, _random_action(experiment), hold, generator
    )
    # our learner's collector, too, tries out robot and torques when it is made
    torques(0, env.reset()["observation"])
    return execute(env, torques, experiment.horizon, hold)


def run_trial(
    experiment: Task,
    learner: InverseDynamicsLearner,
    env: MujocoRobotEnv,
    fresh: MujocoRobotEnv,
    number: int,
) -> DMPTrial:
    """Learn from all experience, measure from fresh starts, and gain experience on the robot."""
    experience_s, fit = learner.experience_s, learner.fit()
    measured, own = learner.execute(fresh), learner.execute(env)
    errors, own_error = (experiment.error(rollout_of(motion.states)) for motion in (measured, own))
    learner.add(own)
    return DMPTrial(
        trial=number,
        experience_s=experience_s,
        success_rate=success_rate(errors, experiment.tolerance),
        n_eval=len(errors),
        own_error=own_error.item(),
        own_success=own_error.item() <= experiment.tolerance,
        tracking_error=learner.tracking_error(measured),
        gp_seconds=fit.seconds,
    )


def settings(experiment: Task, trials: int, feedback_period: float) -> dict[str, object]:
    """The settings of the run, for its summary."""
    return {
        "trials": trials,
        "horizon": experiment.horizon,
        "num_basis": NUM_BASIS,
        "feedback_period": feedback_period,
        "position_gain": POSITION_GAIN,
        "velocity_gain": VELOCITY_GAIN,
        "random_action": _random_action(experiment),
        "tolerance": experiment.tolerance,
    }


def _check(experiment: Task, seed: int, trials: int) -> None:
    if experiment.name != "double_pendulum":
        raise ValueError(
            f"the baseline with movement primitives is for double_pendulum, got {experiment.name}"
        )
    check_whole("seed", seed, least=0)
    check_whole("trials", trials, least=1)


def _hold(control_period: float, feedback_period: float) -> int:
    """Number of steps of the feedback in a control step."""
    hold = round(control_period / feedback_period) if feedback_period > 0 else 0
    if hold < 1 or abs(hold * feedback_period - control_period) > 1e-9:
        raise ValueError(
            f"feedback_period must divide the control period of {control_period} s, got "
            f"{feedback_period} s"
        )
    return hold


def _random_action(experiment: Task) -> float:
    assert isinstance(experiment.method.exploration, RandomMotion)
    return experiment.method.exploration.random_action
