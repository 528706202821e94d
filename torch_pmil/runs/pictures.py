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
from torch_pmil.runs.figures import figures_of
from torch_pmil.runs.printing import Step, print_left, print_result, tell
from torch_pmil.runs.report import write_report
from torch_pmil.runs.training import RunResult
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.task import Task

FEWEST_FRAMES = 50  # in a second


def tell_all(label: str, task: Task, result: RunResult, out: Path) -> list[str]:
    """Report, print, draw and film a run that is saved; a line for each of these that failed.

    The report is there at once, and again with figures and video when they are drawn.
    """
    with suppress(Exception):  # the step that writes it again says what fails
        write_report(out, drawn=False)
    print_result(label, result.summary)
    failures = tell(steps_of(task, result, out))
    print_left(label, out)
    return failures


def steps_of(task: Task, result: RunResult, out: Path) -> Iterator[Step]:
    """Steps that draw figures and video (as a GIF too), and write the report with them.

    A robot that makes no motion but its own rollouts is not filmed.
    """
    yield "figures", partial(draw_figures, task, result, out / "figures")
    if task.draws and task.evaluated:
        yield "video", partial(film, task, result, out / "video.mp4")
    if (out / "video.mp4").exists():
        yield "GIF", partial(write_gif, out / "video.gif", out / "video.mp4")
    yield "report", partial(write_report, out)


def draw_figures(task: Task, result: RunResult, folder: Path) -> None:
    """Draw all figures of a run into a folder."""
    folder.mkdir(exist_ok=True)
    for name, figure in figures_of(task, result):
        plotting.save_figure(figure, folder / f"{name}.png")


def film(task: Task, result: RunResult, path: Path) -> None:
    """Film the saved policy. Raises RuntimeError where the robot gives no pictures."""
    env = task.first_robot(seed=0)
    if isinstance(env, MujocoRobotEnv):
        film_outcome(env, task, result.outcomes[0], path)
    else:
        film_as_shown(task, result, path)


def film_outcome(env: MujocoRobotEnv, task: Task, outcome: Outcome, path: Path) -> None:
    """Film the first executed rollout, as the simulator draws it.

    Without OpenGL it is drawn as lines. Raises RuntimeError if the robot has no sketch.
    """
    start, actions = outcome.executed[0, 0], outcome.rollouts["action"][0]
    frames = frames_per_step(env)
    fps = frames / env.control_period
    try:
        write_video(path, render_rollout(env, start, actions, frames), fps)
    except RuntimeError as error:
        if task.sketch is None:
            raise
        print(f"{path} is a sketch, because {error}")
        write_video(path, sketched(env, task, start, actions, frames), fps)


def frames_per_step(env: MujocoRobotEnv) -> int:
    """The fewest pictures in a control period that make 50 in a second, or as many as there are.

    Each is of a time step of the simulation.
    """
    wanted = FEWEST_FRAMES * env.control_period - 1e-9
    numbers = range(1, env.substeps + 1)
    return next(n for n in numbers if env.substeps % n == 0 and (n >= wanted or n == env.substeps))


def sketched(
    env: MujocoRobotEnv,
    task: Task,
    start: Tensor,
    actions: Tensor,
    frames: int = 5,
) -> Iterator[np.ndarray]:
    """Pictures of a rollout drawn as lines, without OpenGL.

    Args:
        env, start, actions: as for :func:`~torch_pmil.plotting.video.render_rollout`.
        task: one with a sketch.
        frames: in a control period.
    """
    assert task.sketch is not None
    joints = task.sketch(dense_states(env, start, actions, frames))
    return plotting.pendulum_frames(joints, env.control_period / frames)


@torch.no_grad()
def film_as_shown(task: Task, result: RunResult, path: Path) -> None:
    """Film the policy from a fresh start, as the environment shows itself, if it does."""
    env = task.make_env(from_pixels=True, seed=0)
    rollout = env.rollout(task.horizon, result.policy.as_tensordict_module())
    write_video(path, pictures_of(rollout), 1 / task.demonstrations.time_step)
