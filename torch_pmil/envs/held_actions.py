"""A robot whose actions are held for several of its control periods."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary

from torch_pmil.checks import check_whole
from torch_pmil.envs.guards import set_guards
from torch_pmil.envs.robot import RobotEnv
from torch_pmil.envs.wrapped_robot import WrappedRobotEnv


class HeldActionsEnv(WrappedRobotEnv):
    """A robot that acts at a lower rate: each action is held for several control periods.

    A step of this robot shows the reading after the last of these periods. The guard sees every
    reading. If it ends the motion within a step, that step was not measured
    (:func:`~torch_pmil.envs.rollouts.as_executed` leaves it out).

    Args:
        make_env: makes the robot, called with ``settings``.
        periods: control periods of the robot for which an action is held.
        settings: such as ``num_envs``, ``from_pixels`` and ``seed``.

    Raises:
        ValueError: ``periods`` is not a whole number of at least 1.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> robot = HeldActionsEnv(DoublePendulumEnv, periods=2, num_envs=3)
        >>> robot.control_period, robot.rollout(5)["next", "observation"].shape
        (0.2, torch.Size([3, 5, 4]))
    """

    def __init__(self, make_env: Callable[..., RobotEnv], periods: int, **settings: Any) -> None:
        check_whole("periods", periods, 1)
        super().__init__(make_env, periods, settings)
        self.periods = periods
        whole = Binary(1, (*self.batch_size, 1), dtype=torch.bool)
        self._set_own_specs(None, {"measured": whole})

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        given = TensorDict({}, self.batch_size) if tensordict is None else tensordict.copy()
        set_guards(self.robot, self.guard)
        shown = self.robot.reset(given)
        self.cut_short = ""
        return self._shown(shown, measured=True)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        sent, measured = [], True
        for period in range(self.periods):
            action = TensorDict({"action": tensordict["action"]}, self.batch_size)
            shown = self.robot.step(action)["next"]
            sent.append(shown["sent"] if "sent" in shown else tensordict["action"])
            self.cut_short = self.robot.cut_short
            if self.cut_short:
                measured = period == self.periods - 1 and not self.robot.unread
                break
        result = self._shown(shown, measured)
        if "sent" in shown:
            result["sent"] = torch.stack(sent).mean(0)
        result["reward"], result["done"] = shown["reward"], shown["done"]
        return result

    def _shown(self, shown: TensorDictBase, measured: bool) -> TensorDict:
        """What the robot shows, and whether the step that led there is whole."""
        entries = {key: shown[key] for key in self.observation_spec if key in shown}
        whole = torch.full((*self.batch_size, 1), measured)
        whole &= entries.get("measured", torch.ones_like(whole))
        return TensorDict(entries | {"measured": whole}, self.batch_size)
