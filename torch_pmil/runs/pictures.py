"""The figures, the video and the report of a finished run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torch_pmil import plotting
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.envs.rollouts import pictures_of
from torch_pmil.plotting.video import (
    dense_states,
    render_rollout,
    write_gif,
    write_video,
)
from torch_pmil.runs.figures import SKETCHED, figures_of
from torch_pmil.runs.printing import Step, print_left, print_result, tell
from torch_pmil.runs.report import write_report
from torch_pmil.runs.training import RunResult
from torch_pmil.tasks.task import Experiment, Outcome

FEWEST_FRAMES = 50  # in a second


def tell_all(label: str, experiment: Experiment, result: RunResult, out: Path) -> list[str]:
    """Report, print, draw and film a run that is saved; a line for each of these that failed.

    The report is there at once, and again with figures and video when they are drawn.
    """
    with suppress(Exception):  # the step that writes it again says what fails
        write_report(out, drawn=False)
    print_result(label, result.summary)
    failures = tell(steps_of(experiment, result, out))
    print_left(label, out)
    return failures


def steps_of(experiment: Experiment, result: RunResult, out: Path) -> Iterator[Step]:
    """Steps that draw figures and video (as a GIF too), and write the report with them.

    A robot that makes no motion but its own rollouts is not filmed.
    """
    yield "figures", partial(draw_figures, experiment, result, out / "figures")
    if experiment.draws and experiment.evaluated:
        yield "video", partial(film, experiment, result, out / "video.mp4")
    if (out / "video.mp4").exists():
        yield "GIF", partial(write_gif, out / "video.gif", out / "video.mp4")
    yield "report", partial(write_report, out)


def draw_figures(experiment: Experiment, result: RunResult, folder: Path) -> None:
    """Draw all figures of a run into a folder."""
    folder.mkdir(exist_ok=True)
    for name, figure in figures_of(experiment, result):
        plotting.save_figure(figure, folder / f"{name}.png")


def film(experiment: Experiment, result: RunResult, path: Path) -> None:
    """Film the saved policy. Raises RuntimeError where the robot gives no pictures."""
    env = experiment.first_robot(seed=0)
    if isinstance(env, MujocoRobotEnv):
        film_outcome(env, experiment, result.outcomes[0], path)
    else:
        film_as_shown(experiment, result, path)


def film_outcome(env: MujocoRobotEnv, experiment: Experiment, outcome: Outcome, path: Path) -> None:
    """Film the first executed rollout, as the simulator draws it.

    Without OpenGL it is drawn as lines. Raises RuntimeError where there are none for this robot.
    """
    start, actions = outcome.executed[0, 0], outcome.rollouts["action"][0]
    frames = frames_per_step(env)
    fps = frames / env.control_period
    try:
        write_video(path, render_rollout(env, start, actions, frames), fps)
    except RuntimeError as error:
        if experiment.name not in SKETCHED:
            raise
        print(f"{path} is a sketch, because {error}")
        write_video(path, sketched(env, experiment, start, actions, frames), fps)


def frames_per_step(env: MujocoRobotEnv) -> int:
    """The fewest pictures in a control period that make 50 in a second, or as many as there are.

    Each is of a time step of the simulation.
    """
    wanted = FEWEST_FRAMES * env.control_period - 1e-9
    numbers = range(1, env.substeps + 1)
    return next(n for n in numbers if env.substeps % n == 0 and (n >= wanted or n == env.substeps))


def sketched(
    env: MujocoRobotEnv,
    experiment: Experiment,
    start: Tensor,
    actions: Tensor,
    frames: int = 5,
) -> Iterator[np.ndarray]:
    """Pictures of a rollout drawn as lines, without OpenGL.

    Args:
        env, start, actions: as for :func:`~torch_pmil.plotting.video.render_rollout`.
        experiment: one of ``SKETCHED``.
        frames: in a control period.
    """
    states = dense_states(env, start, actions, frames)
    positions = experiment.space.observe(states)
    return plotting.pendulum_frames(positions, env.control_period / frames)


@torch.no_grad()
def film_as_shown(experiment: Experiment, result: RunResult, path: Path) -> None:
    """Film the policy from a fresh start, as the environment shows itself, if it does."""
    env = experiment.make_env(from_pixels=True, seed=0)
    rollout = env.rollout(experiment.horizon, result.policy.as_tensordict_module())
    write_video(path, pictures_of(rollout), 1 / experiment.demonstrations.time_step)
