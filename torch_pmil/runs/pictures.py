"""The figures, the video and the report of a finished run."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torch_pmil import plotting
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.envs.rollouts import pictures_of
from torch_pmil.plotting.video import dense_states, render_rollout, write_gif, write_video
from torch_pmil.runs.figures import figures_of
from torch_pmil.runs.own_files import own
from torch_pmil.runs.printing import Step, print_left, print_result, tell
from torch_pmil.runs.report import write_report
from torch_pmil.runs.training import RunResult
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.task import Task

FEWEST_FRAMES = 20  # in a second
FILM_SECONDS = 10.0  # of computing, after which one picture takes the place of the film
Draw = Callable[[Tensor, Tensor, int], Iterator[np.ndarray]]  # start, actions, frames in a period


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
    """Steps that draw figures, film a robot that is measured from fresh starts, and report."""
    yield "figures", partial(draw_figures, task, result, out)
    if task.draws and task.evaluated:
        yield "video", partial(film_or_picture, task, result, out)
    if (out / "video.mp4").exists():
        yield "GIF", lambda: write_gif(own(out, "video.gif"), out / "video.mp4")
    yield "report", partial(write_report, out)


def draw_figures(task: Task, result: RunResult, out: Path) -> None:
    """Draw all figures of a run into its folder."""
    (out / "figures").mkdir(exist_ok=True)
    for name, figure in figures_of(task, result):
        plotting.save_figure(figure, own(out, f"figures/{name}.png"))


class TooSlowError(RuntimeError):
    """Pictures of a robot take too long for a film."""


def film_or_picture(task: Task, result: RunResult, out: Path) -> None:
    """Film the saved policy; if that takes too long, draw the robot at its start alone."""
    try:
        film(task, result, own(out, "video.mp4"))
    except TooSlowError as error:
        print(f"{error}: figures/robot.png is one of them")
        robot = task.first_robot(seed=0)
        plotting.save_picture(robot.render(robot.initial_mean), own(out, "figures/robot.png"))


def timely(pictures: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield the pictures, and raise TooSlowError once they take more than ``FILM_SECONDS``."""
    spent = 0.0
    for number in itertools.count(1):
        begun = time.process_time()
        picture = next(pictures, None)
        spent += time.process_time() - begun
        if picture is None:
            return
        if spent > FILM_SECONDS:
            raise TooSlowError(
                f"no video: {number} pictures took {spent:.0f} s of computing, which a GPU or a "
                "robot without fine meshes would save"
            )
        yield picture


@torch.no_grad()
def film(task: Task, result: RunResult, path: Path) -> None:
    """Film the saved policy: an executed rollout, or a fresh one of a robot that shows itself.

    Raises RuntimeError where the robot gives no pictures.
    """
    robot = task.first_robot(seed=0)
    if isinstance(robot, MujocoRobotEnv):
        film_outcome(robot, task, result.outcomes[0], path)
        return
    env = task.make_env(from_pixels=True, seed=0)
    rollout = env.rollout(task.horizon, result.policy.as_tensordict_module())
    write_video(path, pictures_of(rollout), 1 / task.time_step)


def film_outcome(env: MujocoRobotEnv, task: Task, outcome: Outcome, path: Path) -> None:
    """Film the first executed rollout; see :func:`drawing_of`."""
    start, actions, frames = outcome.executed[0, 0], outcome.rollouts["action"][0], _frames(env)
    draw_quickly(env)
    pictures = drawing_of(env, task, path)(start, actions, frames)
    write_video(path, timely(pictures), frames / env.control_period)


def draw_quickly(env: MujocoRobotEnv) -> None:
    """Draw without shadows and smoothed edges: without a GPU they take most of the time."""
    quality = env.model.vis.quality
    quality.shadowsize = quality.offsamples = 0


def drawing_of(env: MujocoRobotEnv, task: Task, path: Path) -> Draw:
    """How the rollouts of a film are drawn: by the simulator, or as lines without OpenGL.

    Raises RuntimeError if there is neither OpenGL nor a sketch of the robot.
    """
    try:
        env.render(env.initial_mean)
    except RuntimeError as error:
        if task.sketch is None:
            raise
        print(f"{path} is a sketch, because {error}")
        return partial(_sketched, env, task.sketch)
    return partial(render_rollout, env)


def _frames(env: MujocoRobotEnv) -> int:
    """The fewest pictures in a control period, one each few substeps, that make 20 in a second."""
    wanted = FEWEST_FRAMES * env.control_period - 1e-9
    numbers = range(1, env.substeps + 1)
    return next(n for n in numbers if env.substeps % n == 0 and (n >= wanted or n == env.substeps))


def _sketched(
    env: MujocoRobotEnv,
    sketch: Callable[[Tensor], Tensor],
    start: Tensor,
    actions: Tensor,
    frames: int,
) -> Iterator[np.ndarray]:
    joints = sketch(dense_states(env, start, actions, frames))
    return plotting.pendulum_frames(joints, env.control_period / frames)
