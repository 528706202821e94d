"""Section 5.2.4, Figures 8 and 10: the BioRob learns to hit a ball; ten seeds, four trials."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDictBase

from reproduction.learned import load_learned
from reproduction.plots.photos import plot_photo_series
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.teachers.kinesthetic_teaching import Strike, Variation, record_strike
from torch_pmil.envs.biorob import JOINTS, BioRobEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.plotting import Figure, plot_distributions, plot_success_over_experience
from torch_pmil.runs.summaries import read_summary, success_over_experience
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import MEASURED_STARTS, Task

SEEDS, TRIALS = range(10), 4
QUICK_SEEDS, QUICK_TRIALS = range(1), 2
SOLVED = 0.95  # hit rate of 20 fresh starts
START_SEED = 7_000_000  # no start that a run has seen
PHOTOGRAPHED = (0.0, 0.8, 1.1, 1.2, 1.25, 1.4)  # s; the ball is hit between 1.2 s and 1.3 s
ARM_AND_BALL = (0.2, 0.82)  # of a picture's width
IN_DEGREES = torch.eye(2 * len(JOINTS), dtype=torch.float64)[: len(JOINTS)].rad2deg()


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """The runs that ``pmil train experiment=biorob`` makes."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    return [learning_run(root, load_experiment("biorob"), seed, trials) for seed in seeds]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Seeds that solved it, distance from the demonstrations, and coverage; seed 0 is drawn."""
    experiment, runs = load_experiment("biorob"), [read_summary(folder) for folder in folders]
    learned = load_learned(folders[0], experiment)
    rollouts = learned.rollouts(experiment, MEASURED_STARTS, START_SEED)
    executed = states_of(rollouts) @ IN_DEGREES.mT
    predicted = learned.predicted(experiment).add_noise(experiment.noise_std**2)
    curve = success_over_experience(runs)
    figures = {
        "figure10": plot_distributions(
            [f"q {joint}" for joint in JOINTS],
            ["°"] * len(JOINTS),
            experiment.demonstrations.time_step,
            experiment.demonstrations.positions @ IN_DEGREES.mT,
            experiment.demonstrated.affine(IN_DEGREES),
            predicted.affine(IN_DEGREES),
            executed,
        ),
        "hits_over_experience": plot_success_over_experience(
            curve.experience_s, curve.rates, curve.lower, curve.upper
        ),
    }
    try:
        figures["figure8"] = photo_series(rollouts[0], experiment)
    except RuntimeError as error:
        warnings.warn(f"there is no figure 8: {error}", RuntimeWarning, stacklevel=1)
    return Results(headline_of(runs), figures, {"measured": [measured(run) for run in runs]})


def headline_of(runs: Sequence[dict]) -> dict[str, float | None]:
    """The main numbers of some runs' summaries."""
    coverages = {
        name: float(np.mean([run["two_sigma_coverage_by_entry"][name] for run in runs]))
        for name in runs[0]["rms_error"]
    }
    errors = [joint_degrees(run["rms_error"]) for run in runs]
    return {
        "seeds_solved_by_trial_4": sum(
            run["saved_success_rate"] >= SOLVED and len(run["trials"]) <= TRIALS for run in runs
        ),
        "seeds": len(runs),
        "hit_rate": float(np.mean([run["saved_success_rate"] for run in runs])),
        "max_experience_s": max(run["experience_s"] for run in runs),
        "joint_rms_error_deg": math.sqrt(np.mean(np.square(errors))),
        "median_joint_rms_error_deg": float(np.median(errors)),
        "worst_joint_rms_error_deg": max(errors),
        "demonstration_spread_deg": joint_degrees(runs[0]["demonstration_spread"]),
        "two_sigma_coverage": float(np.mean([run["two_sigma_coverage"] for run in runs])),
        **{f"two_sigma_coverage_{name}": value for name, value in coverages.items()},
        "median_wall_s": float(np.median([run["wall_seconds"] for run in runs])),
        "max_wall_s": max(run["wall_seconds"] for run in runs),
    }


def joint_degrees(by_entry: dict[str, float]) -> float:
    """Root mean square over the joints' positions, in degrees, of numbers in rad by entry.

    Example:
        >>> by_entry = {"q_yaw": 0.0, "q_shoulder": 0.03, "q_elbow": 0.0, "dq_yaw": 9.0}
        >>> round(joint_degrees(by_entry), 3)
        0.992
    """
    return math.degrees(math.sqrt(np.mean([by_entry[f"q_{joint}"] ** 2 for joint in JOINTS])))


def measured(run: dict) -> dict[str, object]:
    """The main numbers of a run, for the details."""
    keys = (
        "seed",
        "saved_success_rate",
        "saved_trial",
        "experience_s",
        "rms_error",
        "two_sigma_coverage_by_entry",
    )
    return {
        **{key: run[key] for key in keys},
        "joint_rms_error_deg": joint_degrees(run["rms_error"]),
        "hit_rates": [trial["success_rate"] for trial in run["trials"]],
    }


def photo_series(rollout: TensorDictBase, experiment: Task) -> Figure:
    """A demonstration above a rollout (T,) of the robot, in pictures of the simulation (Figure 8).

    It is the first demonstration that comes with the package, led by hand anew.

    Raises:
        RuntimeError: OpenGL is not available.
    """
    env: BioRobEnv = experiment.make_env(seed=0)
    strike = Variation().of(Strike(), env.model, np.random.default_rng(0))
    shown = record_strike(env.model, strike).physics
    done = env.replay(rollout["observation"][0], rollout["action"], env.substeps)
    frames = [round(time / env.model.opt.timestep) for time in PHOTOGRAPHED]
    photos = {"demonstrated": torch.from_numpy(shown[frames]), "learned": done[frames]}
    try:
        pictures = {
            name: [cropped(env.draw(one)) for one in states] for name, states in photos.items()
        }
    finally:
        env.close()
    figure = plot_photo_series(pictures, PHOTOGRAPHED)
    figure.supxlabel("pictures rendered from the simulation, not photographs", fontsize="medium")
    return figure


def cropped(picture: np.ndarray) -> np.ndarray:
    """The part of a picture (height, width, 3) with the arm and the ball."""
    first, last = (round(share * picture.shape[1]) for share in ARM_AND_BALL)
    return picture[:, first:last]


BIOROB = PaperExperiment(
    "biorob", "the BioRob hits a ball (Section 5.2.4, Figures 8 and 10)", needed_runs, results
)
