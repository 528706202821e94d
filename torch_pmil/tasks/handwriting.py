"""Handwriting: a robot's tip writes what a person wrote, from a few strokes of the pen."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import DemonstrationError, Demonstrations
from torch_pmil.envs.rollouts import of_states, states_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.tasks.strokes import (
    NAMES,
    TIME_STEP,
    distance_from_mean,
    distance_spread,
    lasa_strokes,
    preprocessed,
)
from torch_pmil.tasks.task import Experiment, actions_of, independent_start
from torch_pmil.tasks.writers import WRITERS, Writer, states_of_strokes

ROBOT = "double_pendulum"
NOISE_SHARE = 1 / 30  # of the extent of what is written: the observation noise
NUM_CENTRES = 50
START_STD = 0.01, 0.02  # rad, rad/s: as a servo holds a joint
SUCCESS_RATIO = 1.25  # of the error to the writers' own spread
SPEED_WIDTH, ANGLE_WIDTH = 1.8, 0.42  # rad/s, rad: of a policy's basis functions, at least


class Writing(NamedTuple):
    """Strokes in the plane of writing, in m, x to the right and y up.

    Args:
        shown: strokes of people, (N, T + 1, 2).
        predicted: marginals of the tip at t = 1..T, mean (T, 2).
        written: strokes of the robot, (B, T + 1, 2).
    """

    shown: Tensor
    predicted: Gaussian
    written: Tensor


@dataclass(frozen=True, eq=False)
class Handwriting(Experiment):
    """An imitation task in a plane: an :class:`Experiment` whose match space holds the tip's place.

    As :class:`Experiment`; its match space holds the tip's place.

    Args:
        plane: in which it writes (2, M): to the right, and up.
    """

    plane: Tensor = field(default_factory=lambda: torch.eye(2, dtype=torch.float64))

    def writing(self, predicted: Gaussian, rollouts: TensorDictBase) -> Writing:
        """Strokes of the demonstrations, of p(x_1..T) and of rollouts (B, T), in the plane."""
        match_space, up = self.space.match_space, self.plane.mT
        shown, written = self.demonstrations.positions @ up, match_space(states_of(rollouts)) @ up
        return Writing(shown, match_space.moments(predicted).affine(self.plane), written)


def handwriting(
    demonstrations: Demonstrations | None = None, shape: str | None = None, robot: str | None = None
) -> Handwriting:
    """A shape of the LASA handwriting set, or one's own strokes, written by a robot.

    The double pendulum writes 0.3 m large in 3 s, the BioRob 0.5 m large in 2 s.

    A rollout's error is its root mean square distance from the mean stroke; it succeeds up to 1.25
    times the writers' own spread.

    Args:
        demonstrations: one's own strokes, x and y of the pen in m at 10 Hz; None for a shape.
        shape: name of a shape of the set; None for one's own strokes.
        robot: double_pendulum (if None) or biorob.

    Raises:
        ValueError: there is no such robot or shape, or not exactly one of shape and demonstrations
            is given.
        DemonstrationError: the strokes hold something else, or the robot cannot follow them.
        ImportError: the set is not installed.

    Example:
        >>> from torch_pmil.demonstrations import Demonstrations
        >>> line = torch.linspace(0, 1, 31)[:, None].expand(31, 2)
        >>> strokes = Demonstrations(torch.stack([line, 1.1 * line]), 0.1, ("x", "y"))
        >>> handwriting(strokes).horizon
        30
    """
    writer = _writer(robot or ROBOT)
    strokes = writer.on_board(_strokes(demonstrations, shape, writer))
    states = states_of_strokes(writer, strokes)
    start, start_std = _start(states, writer)
    make_env = partial(writer.make_env, initial_mean=start.tolist(), initial_std=start_std.tolist())
    actions, demonstrated = actions_of(make_env()), states.flatten(0, 1)
    return Handwriting(
        name=handwriting_name(shape, robot),
        make_env=make_env,
        space=writer.space,
        demonstrations=strokes,
        noise_std=NOISE_SHARE * writer.extent,
        initial=independent_start(start, start_std),
        actions=actions,
        demonstrated_states=demonstrated,
        num_centres=NUM_CENTRES,
        error=of_states(partial(distance_of_tip, space=writer.space, strokes=strokes)),
        tolerance=SUCCESS_RATIO * distance_spread(strokes),
        pd_movements=writer.movements(
            demonstrated, actions.half_range, strokes.positions.shape[1] - 1
        ),
        input_widths=input_widths(demonstrated, writer.space),
        holding_actions=writer.holding_torques,
        search=writer.search,
        plane=writer.plane,
    )


def handwriting_name(shape: str | None, robot: str | None) -> str:
    """The name of the experiment: its shape, or own, and its robot."""
    return f"handwriting_{shape or 'own'}_{robot or ROBOT}"


def distance_of_tip(states: Tensor, space: StateSpace, strokes: Demonstrations) -> Tensor:
    """Root mean square distance (m) of the tip from the mean stroke.

    States x_0..x_T are (*batch, T + 1, D), distances (*batch).
    """
    return distance_from_mean(space.observe(states), strokes)


def input_widths(demonstrated: Tensor, space: StateSpace) -> Tensor:
    """Widths (D',) of a new policy's basis functions: twice the features' spread, or more.

    The spread is the standard deviation of the demonstrated features.

    Slow strokes in a small place would make narrow functions, beyond whose reach a policy is
    nothing.
    """
    least = [SPEED_WIDTH if name.startswith("dq") else ANGLE_WIDTH for name in space.feature_names]
    spread = space.features(demonstrated).std(0)
    return torch.maximum(2 * spread, torch.tensor(least, dtype=torch.float64))


def _writer(robot: str) -> Writer:
    if robot not in WRITERS:
        raise ValueError(f"robot must be one of {', '.join(sorted(WRITERS))}, got {robot!r}")
    return WRITERS[robot]()


def _strokes(
    demonstrations: Demonstrations | None, shape: str | None, writer: Writer
) -> Demonstrations:
    if demonstrations is None and shape is not None:
        return preprocessed(lasa_strokes(shape), writer.duration)
    if demonstrations is None or shape is not None:
        raise ValueError(
            "handwriting needs a shape or demonstrations, got "
            f"{'neither' if shape is None else 'both'}"
        )
    demonstrations = demonstrations.in_order(NAMES)
    if abs(demonstrations.time_step / TIME_STEP - 1) > 1e-6:
        raise DemonstrationError(
            f"strokes must have a time step of {TIME_STEP} s, got {demonstrations.time_step} s"
        )
    return demonstrations


def _start(states: Tensor, writer: Writer) -> tuple[Tensor, Tensor]:
    """Mean and standard deviations (D,) of x_0: at rest, in the mean pose of the first samples."""
    begin = writer.positions(states[:, 0]).mean(0)
    position_std, velocity_std = (torch.full_like(begin, std) for std in START_STD)
    return writer.state(begin, torch.zeros_like(begin)), writer.state(position_std, velocity_std)
