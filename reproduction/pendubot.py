"""Pendubot and acrobot of the AI Olympics with RealAIGym, learned from positions of two links.

One motor moves two links: what a controller that tracks joint angles cannot do. A success has the
tip above the line at 0.45 m for the last 0.5 s of a trial of 3 s; the saved policies then act for
10 s, as long as there, from fresh starts, and the tip must stay above the line from 3 s on. The
robustness score of the AI Olympics is that of each saved policy, beside the published ones and
beside that of the teacher, which plans with the exact model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any

import torch
from joblib import Parallel, cpu_count, delayed
from torch import Tensor

from reproduction.figure7 import GOAL, OURS, size, success_curves, success_results
from reproduction.learned import load_learned, measured_anew
from reproduction.pendubot_robustness import CRITERIA, PUBLISHED, robustness
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.teachers import one_motor_teacher as teachers
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.envs.pendubot import AcrobotEnv, PendubotEnv, tip_height
from torch_pmil.envs.rollouts import states_of
from torch_pmil.tasks.one_motor import LINE
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

TRIALS = 9  # 30 s of experience in all, with the first motion
STARTS, START_SEED = 20, 11_000_000  # no start that a run has seen
LONG = 10.0  # s, of the AI Olympics
SCORE_SEED = 0  # of noise and pushes


@dataclass(frozen=True)
class Robot:
    """A robot with one motor.

    Args:
        name: of its experiment.
        make_env: makes it.
        joint: that its motor moves.
        motion: of its teacher.
    """

    name: str
    make_env: type[PendubotEnv]
    joint: int
    motion: teachers.SwingUp


ROBOTS = (
    Robot("pendubot", PendubotEnv, 0, teachers.PENDUBOT),
    Robot("acrobot", AcrobotEnv, 1, teachers.ACROBOT),
)


def needed_runs(robot: Robot, root: Path, quick: bool) -> list[Run]:
    """Our runs of a robot."""
    experiment, (seeds, trials) = load_experiment(robot.name), size(quick, TRIALS)
    return [learning_run(root, experiment, seed, trials) for seed in seeds]


@torch.no_grad()
def held_rate(policy: StatePolicy, experiment: Task, starts: int) -> float:
    """Fraction of fresh starts from which the tip is above the line from 3 s to 10 s."""
    robots = experiment.robots(starts, START_SEED)
    steps = round(LONG / robots.control_period)
    states = states_of(robots.rollout(steps, policy.as_tensordict_module()))
    return (tip_height(states[:, experiment.horizon :]) > LINE).all(-1).double().mean().item()


def teacher_robustness(robot: Robot) -> dict[str, float]:
    """The robustness of the teacher, that the demonstrations are of."""
    teacher = teachers.one_motor_teacher(robot.make_env(), robot.motion)

    def acts(step: int, states: Tensor) -> Tensor:
        return torch.from_numpy(teacher(step, states.numpy()))

    return robustness(acts, robot.joint, SCORE_SEED)


def measured(folder: Path, robot: Robot) -> dict[str, Any]:
    """The numbers of one run: of its experience and of its saved policy."""
    experiment = load_experiment(robot.name)
    learned = load_learned(folder, experiment)
    policy = learned.policy
    return measured_anew(learned, experiment, STARTS, START_SEED) | {
        "held_10s": held_rate(policy, experiment, STARTS),
        "robustness": robustness(lambda step, states: policy(states), robot.joint, SCORE_SEED),
    }


def headline_of(runs: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """The main numbers of a robot's runs."""
    rates = [run["success_rate"] for run in runs]
    numbers: dict[str, float | None] = {
        "seeds": len(runs),
        "seeds_at_95": sum(rate >= GOAL for rate in rates),
        "seeds_held_10s": sum(run["held_10s"] >= GOAL for run in runs),
        "max_experience_s": max(run["experience_s"] for run in runs),
        "mean_saved_success_rate": fmean(rates),
        "mean_held_10s": fmean(run["held_10s"] for run in runs),
    }
    for name in ("score", *CRITERIA):
        numbers[f"robustness_{name}"] = fmean(run["robustness"][name] for run in runs)
    return numbers


def results(robot: Robot, folders: Sequence[Path], quick: bool) -> Results:
    """Success over experience, over 10 s and over the cases of the robustness score."""
    curves = success_curves(folders, [OURS])
    runs = Parallel(n_jobs=cpu_count())(delayed(measured)(folder, robot) for folder in folders)
    headline = headline_of(runs) | {"experience_to_95": curves[OURS].experience_to(GOAL)}
    made = success_results(curves, headline, robot.name)
    published = {
        name: dict(zip(CRITERIA, values, strict=True)) | {"score": fmean(values) / 100}
        for name, values in PUBLISHED.items()
    }
    details = {
        "starts": STARTS,
        "published_robustness_percent": published,
        "teacher_robustness": teacher_robustness(robot),
        "measured": runs,
    }
    return replace(made, details={**made.details, **details})


PENDUBOT, ACROBOT = (
    PaperExperiment(
        robot.name,
        f"{robot.name} of the AI Olympics, one motor for two links",
        partial(needed_runs, robot),
        partial(results, robot),
    )
    for robot in ROBOTS
)
