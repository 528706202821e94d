"""Learn an experiment from its demonstrations and show what was learned.

Example:
    python scripts/train.py experiment=double_pendulum seed=0 trials=12 out=runs/double_pendulum/seed_0
    python scripts/train.py -m "seed=range(10)"
"""

from __future__ import annotations

import logging
import os
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import NoReturn

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from tqdm import tqdm

from torch_pmil.demonstrations import load_demonstrations
from torch_pmil.envs.mujoco import MujocoRobotEnv
from torch_pmil.experiments import Experiment, load_experiment
from torch_pmil.experiments.sweep import register_launchers
from torch_pmil.experiments.training import RunResult, train
from torch_pmil.plotting import pendulum_frames, plot_distributions, plot_learning_curve, plot_poses, save_figure
from torch_pmil.trainer import Trial
from torch_pmil.video import dense_states, render_rollout, write_video

FRAMES_PER_SECOND = 50
SKETCHES = {"double_pendulum": pendulum_frames}  # pictures without OpenGL, from positions in the match space


@hydra.main(version_base="1.3", config_path="config", config_name="train")
def main(config: DictConfig) -> None:
    """Learn, then draw."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    torch.set_num_threads(1)  # the matrices are small: more threads wait for each other
    out = Path(config.out)
    job = HydraConfig.get()
    alone = job.mode == RunMode.RUN
    label = "" if alone else f"{out}: "
    try:
        os.chdir(job.runtime.cwd)  # where the sweep was started: a cluster's worker may be elsewhere
        demonstrations = load_demonstrations(config.demonstrations) if config.demonstrations else None
        experiment = load_experiment(config.experiment, demonstrations)
        given = sys.argv[1:] if alone else [override.replace("\\", "") for override in job.overrides.task]  # Hydra escapes braces
        command = ["python", "scripts/train.py", *(given or [f"experiment={experiment.name}"])]
        result = train(experiment, config.seed, config.trials, out, shlex.join(command), alone, partial(print_trial, label))
    except (ValueError, OSError, RuntimeError) as error:
        fail(f"{label}error: {error}", alone)
    draw(experiment, result, out)
    print_summary(label, result.summary, out)


def fail(message: str, alone: bool) -> NoReturn:
    """End the run; the other runs of a sweep go on, and Hydra ends it with an error when all are done."""
    if alone:
        sys.exit(message)
    print(message, file=sys.stderr, flush=True)
    raise CompactHydraException(message)


def say(label: str, text: str) -> None:
    """Print lines above the progress bar, each with the label: the runs of a sweep print to one terminal."""
    tqdm.write("\n".join(label + line for line in text.splitlines()))
    sys.stdout.flush()


def print_trial(label: str, trial: Trial) -> None:
    """One line for each trial."""
    say(
        label,
        f"trial {trial.trial:2d}: {trial.experience_s:5.1f} s of experience, KL {trial.kl:6.1f} nats, "
        f"own rollout {'succeeded' if trial.own_success else 'failed'}, "
        f"success rate {trial.success_rate:4.0%} of {trial.n_eval} starts, search {trial.search_seconds:.0f} s",
    )


def draw(experiment: Experiment, result: RunResult, out: Path) -> None:
    """Figures and video of a run."""
    match = experiment.space.match
    predicted = match.belief(result.predicted).add_noise(experiment.noise_std**2)
    executed = match(result.executed)
    figures = {
        "trajectories": plot_distributions(
            match.names, match.units, experiment.demonstrations.time_step, experiment.expert, predicted, executed[:, 1:]
        ),
        "learning_curve": plot_learning_curve(
            [t.experience_s for t in result.trials],
            [t.success_rate for t in result.trials],
            [t.kl for t in result.trials],
        ),
        "poses": plot_poses(executed[0], experiment.demonstrations.time_step),
    }
    for name, figure in figures.items():
        save_figure(figure, out / "figures" / f"{name}.png")
    film(experiment, result, out / "video.mp4")


def film(experiment: Experiment, result: RunResult, path: Path) -> None:
    """The first executed rollout, as the simulator draws it; without OpenGL, as lines."""
    states = result.executed[0]
    with torch.no_grad():
        actions = result.policy(experiment.space.features(states[:-1]))
    env: MujocoRobotEnv = experiment.make_env(seed=0)
    try:
        write_video(path, render_rollout(env, states[0], actions), FRAMES_PER_SECOND)
    except RuntimeError as error:
        print(f"{path} is a sketch, because {error}")
        positions = experiment.space.match(dense_states(env, states[0], actions))
        write_video(path, SKETCHES[experiment.name](positions, 1 / FRAMES_PER_SECOND), FRAMES_PER_SECOND)


def print_summary(label: str, summary: dict, out: Path) -> None:
    """What the run came to, and where it is."""
    say(
        label,
        f"policy of trial {summary['saved_trial']}: success rate {summary['saved_success_rate']:.0%} of "
        f"{summary['saved_n_eval']} fresh starts after {summary['experience_s']:.1f} s of experience and "
        f"{summary['wall_seconds']:.0f} s of computing ({summary['stop_reason']})\n"
        f"{summary['two_sigma_coverage']:.0%} of the executed states lie within two predicted standard deviations\n"
        f"see {out}/figures, {out}/video.mp4, {out}/summary.json",
    )


if __name__ == "__main__":
    register_launchers(Path(__file__).parent / "config" / "launcher")
    main()
