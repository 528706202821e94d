"""One double-pendulum policy moves the tip to places and holds it there, learned from three."""

from __future__ import annotations

from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.tasks.double_pendulum import (
    NOISE_STD,
    REACH_DISTANCE,
    distance_from_target,
    double_pendulum_space,
    joints_at,
)
from torch_pmil.tasks.fitting import simulated_parts
from torch_pmil.tasks.method import EndingSettings, Method
from torch_pmil.tasks.targets import TargetTask


def distance_of_tip(rollout: TensorDictBase) -> Tensor:
    """Largest distance (m) of the tip from the target in the last 0.5 s of rollouts (*batch, T)."""
    return distance_from_target(states_of(rollout), rollout["target"][..., 0, :])


def double_pendulum_targets(demonstrations: Demonstrations | None = None) -> TargetTask:
    """The double pendulum of Section 5.1 with several targets, by the method of Section 5.2.5.

    It has 100 basis functions, 1016 policy parameters, and 2.5 s at 10 Hz.

    Args:
        demonstrations: link positions x1, y1, x2, y2 at 10 Hz, with targets x and y of the tip;
            None for the package's own. Others raise :class:`DemonstrationError`.
    """
    env, space = DoublePendulumEnv(), double_pendulum_space()
    parts = simulated_parts("double_pendulum_targets", env, space, demonstrations, ("x", "y"))
    return TargetTask(
        **parts,
        make_env=DoublePendulumEnv,
        noise_std=NOISE_STD,
        error=distance_of_tip,
        tolerance=REACH_DISTANCE,
        method=Method(ending=EndingSettings(confirmations=2)),
        sketch=joints_at,
    )
