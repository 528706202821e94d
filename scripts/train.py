"""Learn an experiment from its demonstrations and show what was learned.

Example:
    python scripts/train.py experiment=double_pendulum seed=0 trials=12 out=runs/double_pendulum/seed_0
    python scripts/train.py -m "seed=range(10)"

A run that was stopped goes on with the same command and resume=true.
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

from torch_pmil.demonstration_checks import Finding
from torch_pmil.demonstrations import DemonstrationError, load_demonstrations
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.experiments import Experiment, load_experiment
from torch_pmil.experiments.checks import check
from torch_pmil.experiments.experiment import Outcome
from torch_pmil.experiments.figures import SKETCHES, figures_of
from torch_pmil.experiments.sweep import register_launchers
from torch_pmil.experiments.training import RunResult, train
from torch_pmil.plotting import save_figure
from torch_pmil.report import write_report
from torch_pmil.trajectory_loss import TrajectoryLoss
from torch_pmil.trials import Trial
from torch_pmil.video import dense_states, film_rollout, render_rollout, write_video

FRAMES_PER_SECOND = 50
LEFT = ("report.html", "figures", "video.mp4", "summary.json")  # what a run may leave for the eye


@hydra.main(version_base="1.3", config_path="config", config_name="train")
def main(config: DictConfig) -> None:
    """Learn, then draw."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    torch.set_num_threads(1)  # the matrices are small: more threads wait for each other
    out = Path(config.out)
    job = HydraConfig.get()
    alone = job.mode == RunMode.RUN
    label = "" if alone else f"{out}: "
    given = sys.argv[1:] if alone else [override.replace("\\", "") for override in job.overrides.task]  # Hydra escapes braces
    command = shlex.join(["python", "scripts/train.py", *(given or [f"experiment={config.experiment}"])])
    try:
        os.chdir(job.runtime.cwd)  # where the sweep was started: a cluster's worker may be elsewhere
        demonstrations = load_demonstrations(config.demonstrations) if config.demonstrations else None
        experiment = load_experiment(config.experiment, demonstrations, config.shape, config.robot)
        warn_of(label, check(experiment))
        told = partial(print_trial, label, experiment.objective)
        result = train(experiment, config.seed, config.trials, out, command, alone, told, config.resume, config.logger)
    except KeyboardInterrupt:
        print(f"\n{label}stopped; go on with: {command.removesuffix(' resume=true')} resume=true", file=sys.stderr)
        sys.exit(130)
    except (ImportError, ValueError, OSError, RuntimeError) as error:
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


def warn_of(label: str, findings: list[Finding]) -> None:
    """Print what may go wrong with the demonstrations, once. Raises DemonstrationError at what must."""
    for finding in findings:
        if finding.fatal:
            raise DemonstrationError(finding.message)
    for finding in findings:
        say(label, f"warning: {finding.message}")


def print_trial(label: str, objective: type[TrajectoryLoss], trial: Trial) -> None:
    """One line for each trial."""
    predicted = f"{objective.label} {trial.kl:6.1f} {objective.unit}".rstrip()
    say(
        label,
        f"trial {trial.trial:2d}: {trial.experience_s:5.1f} s of experience, {predicted}, "
        f"own rollout {'succeeded' if trial.own_success else 'failed'}, "
        f"success rate {trial.success_rate:4.0%} of {trial.n_eval} starts, search {trial.search_seconds:.0f} s",
    )


def draw(experiment: Experiment, result: RunResult, out: Path) -> None:
    """Figures, video and report of a run."""
    for name, figure in figures_of(experiment, result):
        save_figure(figure, out / "figures" / f"{name}.png")
    env = experiment.first_robot(seed=0)
    if isinstance(env, MujocoRobotEnv):
        film(env, experiment, result.outcomes[0], out / "video.mp4")
    else:
        film_as_shown(experiment, result, out / "video.mp4")
    write_report(out)


def film(env: MujocoRobotEnv, experiment: Experiment, outcome: Outcome, path: Path) -> None:
    """The first executed rollout, as the simulator draws it; without OpenGL, as lines, or not at all."""
    start, actions = outcome.executed[0, 0], outcome.rollouts["action"][0]
    try:
        write_video(path, render_rollout(env, start, actions), FRAMES_PER_SECOND)
    except RuntimeError as error:
        if experiment.name not in SKETCHES:
            print(f"there is no video, because {error}")
            return
        print(f"{path} is a sketch, because {error}")
        positions = experiment.space.match(dense_states(env, start, actions))
        write_video(path, SKETCHES[experiment.name](positions, 1 / FRAMES_PER_SECOND), FRAMES_PER_SECOND)


def film_as_shown(experiment: Experiment, result: RunResult, path: Path) -> None:
    """The policy from a fresh start, as the environment shows itself, if it does."""
    try:
        env = experiment.make_env(from_pixels=True, seed=0)
        pictures = film_rollout(env, result.policy.policy, experiment.space, experiment.horizon)
        write_video(path, pictures, 1 / experiment.demonstrations.time_step)
    except Exception as error:  # every renderer fails with a type of its own
        print(f"there is no video, because the environment gives no pictures: {str(error).partition(chr(10))[0]}")


def by_entry(summary: dict) -> str:
    """The coverage of each entry of the state."""
    return ", ".join(f"{name} {coverage:.0%}" for name, coverage in summary["two_sigma_coverage_by_entry"].items())


def print_summary(label: str, summary: dict, out: Path) -> None:
    """What the run came to, and where it is."""
    say(
        label,
        f"policy of trial {summary['saved_trial']}: success rate {summary['saved_success_rate']:.0%} of "
        f"{summary['saved_n_eval']} fresh starts after {summary['experience_s']:.1f} s of experience and "
        f"{summary['wall_seconds']:.0f} s of computing ({summary['stop_reason']})\n"
        f"{summary['two_sigma_coverage']:.0%} of the executed states lie within two predicted standard deviations: {by_entry(summary)}\n"
        + "".join(f"likely reason: {reason['cause']}: {reason['message']}\n" for reason in summary["diagnosis"])
        + f"see {', '.join(str(out / name) for name in LEFT if (out / name).exists())}",
    )


if __name__ == "__main__":
    register_launchers(Path(__file__).parent / "config" / "launcher")
    main()
