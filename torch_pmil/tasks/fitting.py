"""Parts of a task: its start, its actions, and demonstrations that fit its robot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.recovered_states import rates_of, recover_states
from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import DemonstrationError, Demonstrations, shipped_demonstrations
from torch_pmil.demonstrations.dataset import TIME_STEP_TOLERANCE
from torch_pmil.demonstrations.time_unit import check_times
from torch_pmil.envs import AdaptedEnv, MujocoRobotEnv
from torch_pmil.gp.gaussian import Gaussian


def independent_start(mean: Tensor, std: Tensor) -> Gaussian:
    """p(x_0) of independent entries with these means and standard deviations, (D,) each."""
    return Gaussian(mean, torch.diag(std**2))


def actions_of(env: MujocoRobotEnv | AdaptedEnv) -> ActionSpace:
    """Names, units and range of the actions of one robot.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> print(actions_of(DoublePendulumEnv()))
        tau1 (N·m) from -3.5 to 3.5, tau2 (N·m) from -3.5 to 3.5
    """
    bounds = env.action_spec.space
    return ActionSpace(env.action_names, env.action_units, bounds.low, bounds.high)


def fitting(
    demonstrations: Demonstrations,
    space: StateSpace,
    env: MujocoRobotEnv | AdaptedEnv,
    target_names: tuple[str, ...] = (),
) -> Demonstrations:
    """Demonstrations with their columns in the order of the match space.

    Raises:
        DemonstrationError: their names, targets or time step are not those of the task.
    """
    if not isinstance(demonstrations, Demonstrations):
        raise DemonstrationError(
            "demonstrations must have one length and one time step, got "
            f"{type(demonstrations).__name__}; pmil align aligns recordings"
        )
    if demonstrations.target_names != target_names:
        wanted = ", ".join(target_names) or "none"
        found = ", ".join(demonstrations.target_names) or "none"
        raise DemonstrationError(f"targets of the demonstrations must be {wanted}, got {found}")
    demonstrations = demonstrations.in_order(space.match_space.names)
    if abs(demonstrations.time_step / env.control_period - 1) > TIME_STEP_TOLERANCE:
        samples = torch.arange(demonstrations.positions.shape[1], dtype=torch.float64)
        check_times([demonstrations.time_step * samples], env.control_period)
        raise DemonstrationError(
            f"demonstrations must have a time step of {env.control_period} s, the robot's control "
            f"period, got {demonstrations.time_step} s; pmil align --time-step "
            f"{env.control_period} resamples a recording"
        )
    return replace(demonstrations, time_step=env.control_period)  # without the stamps' rounding


def simulated_parts(
    name: str,
    env: MujocoRobotEnv | AdaptedEnv,
    space: StateSpace,
    demonstrations: Demonstrations | None,
    target_names: tuple[str, ...] = (),
    initial: Gaussian | None = None,
) -> dict[str, Any]:
    """Fields of the task of a simulated robot that follow from the robot and the demonstrations.

    Args:
        name: of the task, and of the demonstrations that come with the package.
        env, space: the robot and its state space.
        demonstrations: None for the package's own.
        target_names: of the demonstrations' targets.
        initial: p(x_0); None for that of the robot, if it is MuJoCo's.

    Raises:
        DemonstrationError: as in :func:`fitting`.
    """
    shown = fitting(demonstrations or shipped_demonstrations(name), space, env, target_names)
    if initial is None:
        initial = independent_start(env.initial_mean, env.initial_std)
    of_space = space.match_space, shown.positions, shown.time_step, initial.mean
    states = recover_states(*of_space, rates_of(space.names))
    return {
        "name": name,
        "space": space,
        "demonstrations": shown,
        "demonstrated_states": states.flatten(0, 1),
        "actions": actions_of(env),
        "initial": initial,
    }
