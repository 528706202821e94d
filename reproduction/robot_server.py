"""A robot in another process: learning in real time, its punctuality, and ``kill -9``."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor

from examples.robot_server.launch import ServerProcess
from reproduction.kills import killed
from reproduction.reproduction import PaperExperiment, Results, Run
from reproduction.served_robot import DISTURBANCE, connected, served_experiment
from torch_pmil.control.policy_file import load_policy
from torch_pmil.envs import DoublePendulumEnv, DoublePendulumServoEnv
from torch_pmil.envs.robot import RobotEnv
from torch_pmil.files import read_json, write_json
from torch_pmil.runs.run_folder import provenance
from torch_pmil.runs.summaries import is_finished, read_summary
from torch_pmil.runs.training import train

SEEDS = range(10)
TRIALS = 12
KILLS = 20
PRECISION = 0.002  # s
ROLLOUTS, SERVO_ROLLOUTS = 20, 4  # of which the punctuality is measured
HORIZON, SERVO_STEPS = 25, 500  # their steps
SERVO_PERIOD = 0.02  # s
Policy = Callable[[TensorDictBase], TensorDictBase]


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """All in one, as two at a time would take each other's time."""
    return [Run(root / "robot_server", partial(_measure, quick=quick))]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """How many seeds learned, how many kills were survived, how punctual the steps were."""
    summary = read_json(folders[0] / "summary.json")
    learned = [run["saved_success_rate"] == 1 for run in summary["learned"]]
    headline = {
        "seeds_learned": sum(learned),
        "seeds": len(learned),
        "kills_survived": sum(kill["survived"] for kill in summary["kills"]),
        "kills": len(summary["kills"]),
        "steps_within_2ms": summary["steps_10hz"]["within_2ms"],
        "late_steps_50hz": summary["steps_50hz"]["late"],
    }
    return Results(headline, {}, {key: summary[key] for key in MEASURED})


MEASURED = ("learned", "kills", "steps_10hz", "steps_50hz")


def _measure(out: Path, command: str, quick: bool) -> None:
    """Learn, take the time of steps, kill; then write ``summary.json``."""
    seeds, kills = (SEEDS[:1], 4) if quick else (SEEDS, KILLS)
    source, robot = provenance(command), DoublePendulumEnv()
    learned = [_learned(out / f"seed_{seed}", command, seed) for seed in seeds]
    policy = load_policy(out / f"seed_{seeds[0]}" / "policy.pt").as_tensordict_module()
    servo = DoublePendulumServoEnv(control_period=SERVO_PERIOD)
    holding = servo.holding_actions(servo.initial_mean[None])[0]
    measured = (
        learned,
        killed(out / "kills", kills),
        _punctuality(robot, policy, ROLLOUTS, HORIZON),
        _punctuality(servo, _constant(holding), SERVO_ROLLOUTS, SERVO_STEPS),
    )
    results = dict(zip(MEASURED, measured, strict=True))
    write_json(out / "summary.json", {"experiment": "robot_server", **source, **results})


def _learned(out: Path, command: str, seed: int) -> dict[str, object]:
    """A run of the double pendulum on the server, and its main numbers."""
    if not is_finished(out):
        with ServerProcess(*DISTURBANCE, "--seed", str(seed)) as server:
            experiment = served_experiment((server.states, server.commands))
            train(experiment, seed, TRIALS, out, command, progress_bar=False, resume=True)
    summary = read_summary(out)
    kept = ("seed", "experience_s", "saved_success_rate", "stop_reason", "wall_seconds")
    return {name: summary[name] for name in kept}


@torch.no_grad()
def _punctuality(like: RobotEnv, policy: Policy, rollouts: int, steps: int) -> dict[str, object]:
    """How the steps of rollouts through the server went in time, and how busy the machine was."""
    path = f"{type(like).__module__}.{type(like).__name__}"
    options = ("--robot", path, "--control-period", str(like.control_period), *DISTURBANCE)
    with ServerProcess(*options) as server:
        env = connected((server.states, server.commands), like)
        env.rollout(2, policy)  # the first step of all is slower
        made = [env.rollout(steps, policy) for _ in range(rollouts)]
        env.close()
    errors = torch.cat([step_time_errors(rollout) for rollout in made])
    late = torch.cat([rollout["next", "late"] for rollout in made])
    return {
        "steps": len(late),
        "rollouts_cut_short": sum(len(rollout) < steps for rollout in made),
        "within_2ms": (errors <= PRECISION).double().mean().item(),
        "largest_error_s": errors.max().item(),
        "late": late.double().mean().item(),
        "load_average": os.getloadavg()[0],
    }


def step_time_errors(rollout: TensorDictBase) -> Tensor:
    """Differences (T - 1,) in s of the times between actions from the period.

    An action is sent ``delay`` seconds after its reading, which came ``overrun`` seconds after the
    deadline. One so late that it moves the deadlines counts twice.

    Example:
        >>> from tensordict import TensorDict
        >>> times = {"delay": torch.tensor([[0.001], [0.004]]), "overrun": torch.zeros(2, 1)}
        >>> step_time_errors(TensorDict({"next": times}, 2))
        tensor([0.0030])
    """
    delay, overrun = rollout["next", "delay"].flatten(), rollout["next", "overrun"].flatten()
    before = torch.cat([torch.zeros(1), overrun[:-1]])
    return (before + delay).diff().abs()


def _constant(action: Tensor) -> Policy:
    return lambda tensordict: tensordict.set("action", action)


ROBOT_SERVER = PaperExperiment(
    "robot_server", "learning on a robot in another process, and kill -9", needed_runs, results
)
