"""Section 5.2.5: one policy of the BioRob hits balls in a plane, learned from six strikes."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.envs.hitting_plane import TARGET_NAMES, ball_at
from torch_pmil.tasks.biorob import (
    INPUT_WIDTHS,
    NOISE_STD,
    SEARCH,
    biorob_space,
    distance_from_ball,
    holding_torques_at,
    movements_around,
)
from torch_pmil.tasks.fitting import simulated_parts
from torch_pmil.tasks.method import EndingSettings, Method, PolicySettings
from torch_pmil.tasks.targets import TargetTask

REACH = (24.0, 34.0, 39.0)  # degrees, as far as the demonstrations of one ball go
# factors of the widths for one ball: strikes at balls to the left and right differ in yaw
WIDENED = (2.0, 1.0, 1.0, 2.0, 1.0, 1.0)


def robots_before_balls(
    *,
    targets: Tensor,
    num_envs: int | None = None,
    from_pixels: bool = False,
    seed: int | None = None,
) -> BioRobEnv:
    """BioRobs that see where in the plane their balls hang, (num_envs, 2), or (2,) for one."""
    return BioRobEnv(
        ball_at(targets), targets=targets, num_envs=num_envs, from_pixels=from_pixels, seed=seed
    )


def biorob_targets(demonstrations: Demonstrations | None = None) -> TargetTask:
    """The experiment of Section 5.2.5: balls in a plane.

    It has 250 basis functions, 2774 policy parameters, and 1.8 s at 10 Hz with the shipped
    demonstrations.

    Exploration takes 6 s in all, 2 s of each of the three robots that learn. The covariance of two
    demonstrations of a target has rank one; elsewhere only the observation noise counts.

    Args:
        demonstrations: entries of :func:`biorob_space` at 10 Hz, with targets y and z; None for the
            package's own. Others raise :class:`DemonstrationError`.
    """
    env = BioRobEnv()
    space, targets = biorob_space(), TARGET_NAMES
    parts = simulated_parts("biorob_targets", env, space, demonstrations, target_names=targets)
    widths, widened = torch.tensor([INPUT_WIDTHS, WIDENED], dtype=torch.float64)
    reach = torch.tensor(REACH, dtype=torch.float64)
    movements = movements_around(env.initial_mean, reach, parts["actions"].half_range)
    return TargetTask(
        **parts,
        make_env=robots_before_balls,
        noise_std=torch.tensor(NOISE_STD, dtype=torch.float64),
        error=distance_from_ball,
        tolerance=0.0,
        holding_actions=holding_torques_at,
        method=Method(
            policy=PolicySettings(num_centres=250, input_widths=widths * widened),
            exploration=replace(movements, rollouts=1),
            search=replace(SEARCH, final_iterations=60),
            ending=EndingSettings(confirmations=4),
        ),
    )
