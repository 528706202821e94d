"""Parts of a task: its start, its actions, and demonstrations that fit its robot."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import DemonstrationError, Demonstrations
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
    if demonstrations.target_names != target_names:
        wanted = ", ".join(target_names) or "none"
        found = ", ".join(demonstrations.target_names) or "none"
        raise DemonstrationError(f"targets of the demonstrations must be {wanted}, got {found}")
    demonstrations = demonstrations.in_order(space.match_space.names)
    if abs(demonstrations.time_step / env.control_period - 1) > 1e-6:
        raise DemonstrationError(
            f"demonstrations must have a time step of {env.control_period} s, the robot's control "
            f"period, got {demonstrations.time_step} s; pmil align --time-step "
            f"{env.control_period} resamples a recording"
        )
    return demonstrations
