"""The common base of environments that show or move another robot otherwise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from torch import Tensor
from torchrl.data import TensorSpec

from torch_pmil.envs.robot import RobotEnv


class WrappedRobotEnv(RobotEnv):
    """A robot that is seen or moved through another environment, with its names and limits.

    Args:
        make_env: makes the robot, called with ``settings``.
        periods: control periods of the robot in a step of this one.
        settings: such as ``num_envs``, ``from_pixels`` and ``seed``.
    """

    def __init__(
        self, make_env: Callable[..., RobotEnv], periods: int, settings: Mapping[str, Any]
    ) -> None:
        robot = make_env(**settings)
        period, seed = periods * robot.control_period, settings.get("seed")
        super().__init__(robot.batch_size, period, robot.from_pixels, seed)
        self.robot = robot
        self.physical, self.turns = robot.physical, robot.turns

    def _set_own_specs(self, dim: int | None, more: Mapping[str, TensorSpec]) -> None:
        """Set the robot's specs, with ``dim`` entries of the state (None: its own), and more."""
        limits, shown = self.robot.action_spec.space, self.robot.observation_spec.clone()
        dim = dim or shown["observation"].shape[-1]
        del shown["observation"]
        self._set_specs(dim, limits.low, limits.high, {**dict(shown.items()), **more})

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the robot."""
        return self.robot.action_names

    @property
    def action_units(self) -> tuple[str, ...]:
        """Units of the robot."""
        return self.robot.action_units

    @property
    def terminated(self) -> bool:  # type: ignore[override]
        """That of the robot."""
        return self.robot.terminated

    @property
    def unread(self) -> bool:  # type: ignore[override]
        """That of the robot."""
        return self.robot.unread

    @property
    def torque_limits(self) -> Tensor | None:
        """Limits of the robot."""
        return self.robot.torque_limits

    def beyond_range(self, states: Tensor) -> Tensor | None:
        """Distances of the robot's joints."""
        return self.robot.beyond_range(self._of_robot(states))

    def close(self, **kwargs: Any) -> None:
        """Close the robot."""
        self.robot.close(**kwargs)
        super().close(**kwargs)

    def _of_robot(self, states: Tensor) -> Tensor:
        """States of the robot itself."""
        return states
