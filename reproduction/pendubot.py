"""The pendubot of the AI Olympics with RealAIGym, learned from positions of its two links.

One motor moves two links: what a controller that tracks joint angles cannot do. A success has the
tip above the line at 0.45 m for the last 0.5 s of a trial of 3 s; the saved policies then act for
10 s, as long as there, from fresh starts, and the tip must stay above the line from 3 s on. The
robustness score of the AI Olympics is that of each saved policy, beside the published ones and
beside that of the teacher, which is told the exact model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import torch
from torch import Tensor

from reproduction.figure7 import GOAL, size, success_curves, success_results
from reproduction.learned import load_learned, measured_anew
from reproduction.pendubot_robustness import CRITERIA, PUBLISHED, robustness
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.envs.pendubot import PendubotEnv, tip_height
from torch_pmil.envs.rollouts import states_of
from torch_pmil.envs.teachers.one_motor_teacher import PENDUBOT as MOTION, one_motor_teacher
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.tasks.experiment import Experiment
from torch_pmil.experiments.tasks.one_motor import LINE

LABEL = "imitation (ours)"
TRIALS = 9  # the last one with 30 s of experience
STARTS, START_SEED = 20, 11_000_000  # no start that a run has seen
LONG = 10.0  # s, of the AI Olympics
MOTOR = 0  # the joint that it moves
SCORE_SEED = 0  # of noise and pushes


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ten seeds of the pendubot."""
    seeds, trials = size(quick, TRIALS)
    return [learning_run(root, load_experiment("pendubot"), seed, trials) for seed in seeds]


@torch.no_grad()
def held_rate(policy: StatePolicy, experiment: Experiment, starts: int) -> float:
    """Fraction of fresh starts from which the tip is above the line from 3 s to 10 s."""
    robots = experiment.robots(starts, START_SEED)
    steps = round(LONG / robots.control_period)
    states = states_of(robots.rollout(steps, policy.as_tensordict_module()))
    return (tip_height(states[:, experiment.horizon :]) > LINE).all(-1).double().mean().item()


def teacher_robustness() -> dict[str, float]:
    """The robustness of the teacher, that the demonstrations are of."""
    teacher = one_motor_teacher(PendubotEnv(), MOTION)

    def acts(step: int, states: Tensor) -> Tensor:
        return torch.from_numpy(teacher(step, states.numpy()))

    return robustness(acts, MOTOR, SCORE_SEED)


def measured(folder: Path, experiment: Experiment) -> dict[str, Any]:
    """The numbers of one run: of its experience and of its saved policy."""
    learned = load_learned(folder, experiment)
    policy = learned.policy
    return measured_anew(learned, experiment, STARTS, START_SEED) | {
        "held_10s": held_rate(policy, experiment, STARTS),
        "robustness": robustness(lambda step, states: policy(states), MOTOR, SCORE_SEED),
    }


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success over experience, over 10 s and over the cases of the robustness score."""
    experiment, curves = load_experiment("pendubot"), success_curves(folders, [LABEL])
    runs = [measured(folder, experiment) for folder in folders]
    rates = [run["success_rate"] for run in runs]
    headline: dict[str, float | None] = {
        "seeds": len(runs),
        "seeds_at_95": sum(rate >= GOAL for rate in rates),
        "seeds_held_10s": sum(run["held_10s"] == 1 for run in runs),
        "max_experience_s": max(run["experience_s"] for run in runs),
        "mean_saved_success_rate": fmean(rates),
        "mean_held_10s": fmean(run["held_10s"] for run in runs),
        "experience_to_95": curves[LABEL].experience_to(GOAL),
    }
    for name in ("score", *CRITERIA):
        key = "robustness_score" if name == "score" else f"robustness_{name}"
        headline[key] = fmean(run["robustness"][name] for run in runs)
    made = success_results(curves, headline, "pendubot")
    published = {
        name: dict(zip(CRITERIA, values, strict=True)) | {"score": fmean(values) / 100}
        for name, values in PUBLISHED.items()
    }
    details = {
        "starts": STARTS,
        "published_robustness_percent": published,
        "teacher_robustness": teacher_robustness(),
        "measured": runs,
    }
    return replace(made, details={**made.details, **details})


PENDUBOT = PaperExperiment(
    "pendubot", "the pendubot of the AI Olympics, one motor for two links", needed_runs, results
)
