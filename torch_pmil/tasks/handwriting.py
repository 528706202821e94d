"""Handwriting: a robot's tip writes what a person wrote, from a few strokes of the pen."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import DemonstrationError, Demonstrations, Recordings
from torch_pmil.envs.rollouts import of_states, states_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.tasks.fitting import actions_of, independent_start
from torch_pmil.tasks.method import Method, PolicySettings
from torch_pmil.tasks.strokes import (
    NAMES,
    TIME_STEP,
    distance_from_mean,
    distance_spread,
    preprocessed,
)
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.writers import Writer, biorob_writer, pendulum_writer, states_of_strokes

Pen = Demonstrations | Recordings

NOISE_SHARE = 1 / 30  # of the extent of what is written: the observation noise
NUM_CENTRES = 50
START_STD = 0.01, 0.02  # rad, rad/s: as a servo holds a joint
SUCCESS_RATIO = 1.25  # of the error to the writers' own spread
SPEED_WIDTH, ANGLE_WIDTH = 1.8, 0.42  # rad/s, rad: of a policy's basis functions, at least


class Writing(NamedTuple):
    """Strokes in the plane of writing, in m, x to the right and y up."""

    shown: Tensor  # by people, (N, T + 1, 2)
    predicted: Gaussian  # marginals of the tip at t = 1..T, mean (T, 2)
    written: Tensor  # by the robot, (B, T + 1, 2)


def writing_of(task: Task, predicted: Gaussian, rollouts: TensorDictBase) -> Writing:
    """Strokes of a writing task in its plane: shown, p(x_1..T), and of rollouts (B, T)."""
    assert task.plane is not None
    match_space, up = task.space.match_space, task.plane.mT
    shown, written = task.demonstrations.positions @ up, match_space(states_of(rollouts)) @ up
    return Writing(shown, match_space.moments(predicted).affine(task.plane), written)


def handwriting(demonstrations: Pen | None = None) -> Task:
    """Strokes of people, written by the double pendulum 0.3 m large in 3 s.

    A rollout's error is its root mean square distance from the mean stroke; it succeeds up to 1.25
    times the writers' own spread.

    Args:
        demonstrations: strokes, x and y of the pen in m at 10 Hz, as ``pmil draw`` records them; or
            recordings, which are aligned, such as :func:`~torch_pmil.tasks.strokes.lasa_strokes`.

    Raises:
        DemonstrationError: there are no strokes, or the robot cannot follow them.

    Example:
        >>> from torch_pmil.demonstrations import Demonstrations
        >>> line = torch.linspace(0, 1, 31)[:, None].expand(31, 2)
        >>> strokes = Demonstrations(torch.stack([line, 1.1 * line]), 0.1, ("x", "y"))
        >>> handwriting(strokes).horizon
        30
    """
    return _writes("handwriting", pendulum_writer(), demonstrations)


def handwriting_biorob(demonstrations: Pen | None = None) -> Task:
    """Strokes of people, written by the BioRob 0.5 m large in 2 s; see :func:`handwriting`."""
    return _writes("handwriting_biorob", biorob_writer(), demonstrations)


def _writes(name: str, writer: Writer, pen: Pen | None) -> Task:
    strokes = writer.on_board(_strokes(name, pen, writer))
    states = states_of_strokes(writer, strokes)
    start, start_std = _start(states, writer)
    make_env = partial(writer.make_env, initial_mean=start.tolist(), initial_std=start_std.tolist())
    actions, demonstrated = actions_of(make_env()), states.flatten(0, 1)
    return Task(
        name=name,
        make_env=make_env,
        space=writer.space,
        demonstrations=strokes,
        noise_std=NOISE_SHARE * writer.extent,
        initial=independent_start(start, start_std),
        actions=actions,
        demonstrated_states=demonstrated,
        error=of_states(partial(distance_of_tip, space=writer.space, strokes=strokes)),
        tolerance=SUCCESS_RATIO * distance_spread(strokes),
        holding_actions=writer.holding_torques,
        method=Method(
            policy=PolicySettings(
                num_centres=NUM_CENTRES, input_widths=input_widths(demonstrated, writer.space)
            ),
            model=writer.model,
            exploration=writer.movements(
                demonstrated, actions.half_range, strokes.positions.shape[1] - 1
            ),
            search=writer.search,
        ),
        plane=writer.plane,
    )


def distance_of_tip(states: Tensor, space: StateSpace, strokes: Demonstrations) -> Tensor:
    """:func:`distance_from_mean` of the tip in states x_0..x_T, (*batch, T + 1, D), (*batch)."""
    return distance_from_mean(space.observe(states), strokes)


def input_widths(demonstrated: Tensor, space: StateSpace) -> Tensor:
    """Widths (D',) of a new policy's basis functions: twice the features' standard deviation.

    They have a least value: a policy is zero beyond the narrow functions of small, slow strokes.
    """
    least = [SPEED_WIDTH if name.startswith("dq") else ANGLE_WIDTH for name in space.feature_names]
    spread = space.features(demonstrated).std(0)
    return torch.maximum(2 * spread, torch.tensor(least, dtype=torch.float64))


def _strokes(name: str, pen: Pen | None, writer: Writer) -> Demonstrations:
    if pen is None:
        raise DemonstrationError(
            f"{name} needs strokes (demonstrations=lasa:Angle, or a file of pmil draw), got none"
        )
    if isinstance(pen, Recordings):
        return preprocessed(pen, writer.duration)
    strokes = pen.in_order(NAMES)
    if abs(strokes.time_step / TIME_STEP - 1) > 1e-6:
        raise DemonstrationError(
            f"strokes must have a time step of {TIME_STEP} s, got {strokes.time_step} s"
        )
    return strokes


def _start(states: Tensor, writer: Writer) -> tuple[Tensor, Tensor]:
    """Mean and standard deviations (D,) of x_0: at rest, in the mean pose of the first samples."""
    begin = writer.positions(states[:, 0]).mean(0)
    position_std, velocity_std = (torch.full_like(begin, std) for std in START_STD)
    return writer.state(begin, torch.zeros_like(begin)), writer.state(position_std, velocity_std)
