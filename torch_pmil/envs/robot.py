"""The common base of simulated and physical robots."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from torch_pmil.checks import is_whole_number
from torch_pmil.envs.turning import Continued, Turning
from torch_pmil.seeds import LARGEST_SEED

Array = NDArray[np.floating]


class RobotEnv(EnvBase):
    """A robot in float64 with seeded starts, bounded actions and no reward.

    An episode ends only by ``guard``. It is called with the states (*batch, D) after each step, and
    returns why the motion must end, or "". ``cut_short`` holds that reason until the next reset.
    ``terminated`` says whether the environment behind the robot reported its end in the last step,
    and ``unread`` whether it gave no reading after it.
    ``physical`` is True for a real robot, which makes no unnecessary motion. A single robot with
    ``turns`` starts that many times, one after the other, and these rollouts make one batch.

    Args:
        batch_size: of the robots.
        control_period: seconds between two actions.
        from_pixels: whether there are pictures.
        seed: of the generator of starts and noise; None takes entropy from the system.

    Raises:
        ValueError: the seed is not a whole number from 0 on, or the period is not positive.
    """

    physical = terminated = unread = False
    turns: int | None = None

    def __init__(
        self,
        batch_size: tuple[int, ...],
        control_period: float,
        from_pixels: bool,
        seed: int | None,
    ) -> None:
        if not (math.isfinite(control_period) and control_period > 0):
            raise ValueError(
                f"control_period must be positive and finite, in seconds, got {control_period}"
            )
        super().__init__(device="cpu", batch_size=batch_size)
        self.control_period, self.from_pixels = control_period, from_pixels
        self.guard: Callable[[Tensor], str] | None = None
        self.cut_short = ""
        self.turning_entries: tuple[Turning, ...] = ()  # shown within a turn, and continued
        self._continued = Continued(())
        self._generator = torch.Generator()
        self._set_seed(seed)

    def rollout(self, max_steps: int, *args: Any, **given: Any) -> TensorDictBase:
        """TorchRL's rollouts (*batch, T); (turns, max_steps) of a robot that starts several times.

        Of these, a rollout that ends early stays at its last step. A single one ends with the last
        step that was read.
        """
        roll = super().rollout
        if self.turns is None:
            rollout = roll(max_steps, *args, **given)
            return rollout[..., :-1] if self.unread else rollout
        rolled = [roll(max_steps, *args, **given) for _ in range(self.turns)]
        steps = torch.arange(max_steps)
        return torch.stack([each[steps.clamp(max=len(each) - 1)] for each in rolled])

    def get_extra_state(self) -> Tensor:
        """State of the generator of starts and noise, part of ``state_dict``."""
        return self._generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Restore what ``get_extra_state`` returned."""
        self._generator.set_state(state)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the actions: of the motors in the robot's model, or else numbers."""
        return tuple(str(number) for number in range(self.action_spec.shape[-1]))

    @property
    def action_units(self) -> tuple[str, ...]:
        """Units of the actions, such as N·m for torques and rad for targets; "" if unknown."""
        return ("",) * self.action_spec.shape[-1]

    def needed_torques(self, states: Tensor) -> Tensor | None:
        """Torques (T, F) in each control period of a motion x_0..x_T, (T + 1, D).

        None if the model is unknown.
        """
        return None

    @property
    def torque_limits(self) -> Tensor | None:
        """Largest torques (F,) of the motors; None if unknown."""
        return None

    def beyond_range(self, states: Tensor) -> Tensor | None:
        """Distance (*batch, J) of the joints beyond their stops in states (*batch, D), 0 within.

        None if the stops are unknown.
        """
        return None

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            self._generator.seed()
        elif is_whole_number(seed) and 0 <= seed <= LARGEST_SEED:
            self._generator.manual_seed(int(seed))
        else:
            raise ValueError(
                f"seed must be None or a whole number from 0 to {LARGEST_SEED}, got {seed!r}"
            )

    def _set_specs(
        self, dim: int, low: Tensor, high: Tensor, more: Mapping[str, TensorSpec]
    ) -> None:
        """Set the specs of states (*batch, dim), actions from low to high (*batch, F), and more."""
        batch = self.batch_size
        self.observation_spec = Composite(
            {"observation": Unbounded((*batch, dim), dtype=torch.float64), **more}, shape=batch
        )
        self.action_spec = Bounded(low, high, low.shape, dtype=torch.float64)
        self.reward_spec = Unbounded((*batch, 1), dtype=torch.float64)

    def _without_reward(self, measured: TensorDictBase) -> TensorDictBase:
        """The result of a step: the measurement, no reward, and an end if the guard wants one."""
        if self.guard is not None:
            self.cut_short = self.guard(measured["observation"])
        measured["reward"] = torch.zeros(*self.batch_size, 1, dtype=torch.float64)
        measured["done"] = torch.full((*self.batch_size, 1), bool(self.cut_short))
        return measured


def check_num_envs(num_envs: int | None) -> None:
    """Raise ValueError unless ``num_envs`` is None, for one robot, or at least 1."""
    if num_envs is not None and not (is_whole_number(num_envs) and num_envs >= 1):
        raise ValueError(f"num_envs must be None or at least 1, got {num_envs}")
