"""Where one's own robot starts: its resets, and the distribution p(x_0) that they suggest."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torch_pmil.control.recovered_states import without_turns
from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.envs.one_robot import OneRobot
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.seeds import Stream
from torch_pmil.tasks.fitting import independent_start
from torch_pmil.tasks.task import check_initial

STARTS = 20  # resets by which p(x_0) is estimated
LEAST_START = 0.01  # standard deviation of a start, in the demonstrated range of its entry
LEAST_START_BY_HAND = 0.05  # the same of a robot that a person puts there, and that is not asked
UNMOVED = 1e-6  # standard deviation of the start of an entry that never varies

Robot = OneRobot | MujocoRobot


def starts_of(
    robot: Robot, observed: Sequence[str], space: StateSpace, settings: Mapping[str, Any]
) -> Tensor | None:
    """States of the robot after resets, (S, D), on one turn; its angles are near them from now on.

    None for a robot that is not reset here. One reset is enough if ``initial`` is given; ValueError
    if that is over another number of entries.
    """
    if "initial" in settings:
        check_initial(settings["initial"], len(space.names))
    if not settings["evaluated"]:
        return None

    def after_resets() -> Tensor:
        env = robot(seed=Stream.RESETS)
        resets = 1 if "initial" in settings else STARTS
        return torch.stack([env.reset()["observation"] for _ in range(resets)])

    states = after_resets()
    if robot.angles:
        turned = states[:, [space.names.index(observed[pair.cos][4:]) for pair in robot.angles]]
        near = torch.atan2(turned.sin().mean(0), turned.cos().mean(0)).tolist()
        robot.angles = tuple(
            replace(pair, near=q) for pair, q in zip(robot.angles, near, strict=True)
        )
        states = after_resets()
    beside = settings["initial"].mean if "initial" in settings else states[0]
    return without_turns(states[:, None], beside, space.angles)[:, 0]


def start_around(mean: Tensor, std: Tensor) -> Gaussian:
    """p(x_0) of independent entries, (D,) each; one that never varies gets a tiny deviation."""
    return independent_start(mean, torch.where(std > 0, std, UNMOVED))


def start_of(starts: Tensor | None, states: Tensor, names: Sequence[str]) -> Gaussian:
    """p(x_0) by resets (N, D), or, without resets, by the demonstrated states, (N, T + 1, D).

    No robot starts twice in the same state: each deviation is at least a share of the demonstrated
    range.
    """
    share = LEAST_START
    if starts is None:
        starts, share = states[:, 0], LEAST_START_BY_HAND
    shown = states.flatten(0, -2)
    std = starts.std(0).maximum(share * (shown.amax(0) - shown.amin(0)))
    for number in (std == 0).nonzero()[:, 0].tolist():
        warnings.warn(
            f"{names[number]} starts at {starts[0, number]:g} each time and is not demonstrated, "
            "so its size is unknown: give initial, with a standard deviation as large as it "
            "becomes, or policy and model may not see it",
            UserWarning,
            stacklevel=5,
        )
    return start_around(starts.mean(0), std)
