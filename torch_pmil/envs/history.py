"""Past readings and past actions as entries of the state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.nn.functional import pad

from torch_pmil.checks import is_whole_number
from torch_pmil.envs.guards import set_guards
from torch_pmil.envs.robot import RobotEnv
from torch_pmil.envs.wrapped_robot import WrappedRobotEnv


@dataclass(frozen=True)
class History:
    r"""A state that holds some of the past besides the D_0 entries that a robot shows.

    Its D entries are those of the robot, then past entries and then past actions, the latest first.
    The next state is linear in the state, the action and the next reading y of the measured
    entries:

    .. math:: x_{t+1} = S\,[x_t, u_t] + C\,y_{t+1}

    A hidden velocity is estimated from the last two positions, :math:`\dot q_t =
    (q_t - q_{t-1}) / \Delta t`. Together with the action between them they carry as much
    information as position and velocity.

    Args:
        names: of the D_0 entries, hidden velocities included.
        action_names: of the F actions.
        control_period: s.
        hidden: velocities that the sensors do not show, dNAME beside NAME.
        past: entries whose past values are kept.
        past_entries: number of past values of each.
        past_actions: number of past actions that are kept. They let the model learn actions that
            take effect up to that many periods late.

    Raises:
        ValueError: a name is not an entry, or a number is not a whole number from 0 on.

    Example:
        >>> history = History(("q", "dq"), ("tau",), 0.1, hidden=("dq",), past_actions=1)
        >>> history.state_names
        ('q', 'dq', 'tau@1')
        >>> at_rest = history.begin(torch.tensor([1.0, 0.0]), torch.tensor([0.0]))
        >>> history.advanced(at_rest, torch.tensor([2.0]), torch.tensor([1.5, 0.0]))
        tensor([1.5000, 5.0000, 2.0000])
    """

    names: tuple[str, ...]
    action_names: tuple[str, ...]
    control_period: float
    hidden: tuple[str, ...] = ()
    past: tuple[str, ...] = ()
    past_entries: int = 0
    past_actions: int = 0

    def __post_init__(self) -> None:
        without = [name for name in self.hidden if name[1:] not in self.names]
        unknown = [name for name in (*self.hidden, *self.past) if name not in self.names]
        if unknown or without:
            raise ValueError(
                f"hidden and past must be entries of {', '.join(self.names)}, and hidden ones "
                f"velocities dNAME beside NAME, got {', '.join(unknown or without)}"
            )
        for name in ("past_entries", "past_actions"):
            if not is_whole_number(getattr(self, name)) or getattr(self, name) < 0:
                raise ValueError(
                    f"{name} must be a whole number from 0 on, got {getattr(self, name)!r}"
                )

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the D entries; NAME@2 is the value of NAME two periods before."""
        entries = [f"{name}@{k + 1}" for k in range(self.past_entries) for name in self.past]
        actions = [f"{name}@{k + 1}" for k in range(self.past_actions) for name in self.labels]
        return (*self.names, *entries, *actions)

    @property
    def origins(self) -> tuple[str, ...]:
        """For each of the D entries, the name in ``names`` or ``labels`` whose value it holds."""
        entries, actions = self.past_entries * self.past, self.past_actions * self.labels
        return (*self.names, *entries, *actions)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the F actions, made different from those of the entries.

        Example:
            >>> History(("q", "dq"), ("q",), 0.05).labels
            ('action q',)
        """
        return tuple(f"action {name}" if name in self.names else name for name in self.action_names)

    @property
    def dim(self) -> int:
        """Number of entries D."""
        return len(self.state_names)

    @property
    def measured(self) -> tuple[int, ...]:
        """Indices of the entries that the sensors show."""
        return tuple(i for i, name in enumerate(self.names) if name not in self.hidden)

    @cached_property
    def shift(self) -> Tensor:
        """S (D, D + F): part of the next state that is linear in state and action."""
        latest = {label: self.dim + action for action, label in enumerate(self.labels)}
        matrix = torch.zeros(self.dim, self.dim + len(latest), dtype=torch.float64)
        for row, name in enumerate(self.origins):
            if row >= len(self.names):
                matrix[row, latest[name]] = 1.0
            elif name in self.hidden:
                matrix[row, self.names.index(name[1:])] = -1 / self.control_period
            latest[name] = row
        return matrix

    @cached_property
    def gain(self) -> Tensor:
        """C (D, measured): part of the next state that is linear in the next reading."""
        gain = torch.zeros(self.dim, len(self.measured), dtype=torch.float64)
        for column, entry in enumerate(self.measured):
            gain[entry, column] = 1.0
            if (rate := f"d{self.names[entry]}") in self.hidden:
                gain[self.names.index(rate), column] = 1 / self.control_period
        return gain

    @cached_property
    def resting(self) -> tuple[Tensor, Tensor]:
        """Matrices (D, D_0) of the reading and (D, F) of the action for a robot at rest."""
        of_reading = torch.zeros(self.dim, len(self.names), dtype=torch.float64)
        of_action = torch.zeros(self.dim, len(self.action_names), dtype=torch.float64)
        for row, name in enumerate(self.origins):
            if name in self.labels:
                of_action[row, self.labels.index(name)] = 1.0
            elif name not in self.hidden:
                of_reading[row, self.names.index(name)] = 1.0
        return of_reading, of_action

    def along(self, readings: Tensor, actions: Tensor, resting: Tensor) -> Tensor:
        """States (*batch, T + 1, D) of a robot that began at rest.

        Readings are (*batch, T + 1, D_0), actions (*batch, T, F), and ``resting`` (*batch, F) is
        the action at rest.
        """
        first, *later = readings.unbind(-2)
        states = [self.begin(first, resting)]
        for action, reading in zip(actions.unbind(-2), later, strict=True):
            states.append(self.advanced(states[-1], action, reading))
        return torch.stack(states, -2)

    def begin(self, reading: Tensor, action: Tensor) -> Tensor:
        """State (*batch, D) of a robot at rest, from its reading (*batch, D_0) and its action."""
        of_reading, of_action = (matrix.to(reading) for matrix in self.resting)
        return reading @ of_reading.mT + action @ of_action.mT

    def advanced(self, state: Tensor, action: Tensor, reading: Tensor) -> Tensor:
        """The state after an action (*batch, F) and the next reading (*batch, D_0)."""
        before = torch.cat([state, action], -1) @ self.shift.to(state).mT
        return before + reading[..., list(self.measured)] @ self.gain.to(state).mT


class HistoryEnv(WrappedRobotEnv):
    """A robot whose observation holds some of the past, given by a :class:`History`.

    A reset assumes a robot at rest: hidden velocities are zero, past entries equal the present
    ones, and past actions are ``resting``. ``state_dict`` resumes at the start of an episode.

    Args:
        make_env: makes the robot, called with ``settings``.
        history: of its state.
        resting: past actions (*batch, F) of a robot at rest in states (*batch, D_0).
        settings: such as ``num_envs``, ``from_pixels`` and ``seed``.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> names, actions = ("q1", "dq1", "q2", "dq2"), ("tau1", "tau2")
        >>> history = History(names, actions, 0.1, hidden=("dq1", "dq2"), past_actions=1)
        >>> env = HistoryEnv(DoublePendulumEnv, history, lambda states: 0 * states[..., :2])
        >>> env.rollout(5)["next", "observation"].shape
        torch.Size([5, 6])
    """

    def __init__(
        self,
        make_env: Callable[..., RobotEnv],
        history: History,
        resting: Callable[[Tensor], Tensor],
        **settings: Any,
    ) -> None:
        super().__init__(make_env, 1, settings)
        self.history, self.resting = history, resting
        self._set_own_specs(history.dim, {})

    def needed_torques(self, states: Tensor) -> Tensor | None:
        """Torques of the robot."""
        return self.robot.needed_torques(self._of_robot(states))

    def _guard_reading(self, reading: Tensor) -> str:
        assert self.guard is not None
        return self.guard(pad(reading, (0, self.history.dim - reading.shape[-1])))

    def _of_robot(self, states: Tensor) -> Tensor:
        return states[..., : len(self.history.names)]

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        given = TensorDict({}, self.batch_size) if tensordict is None else tensordict.copy()
        start = given.get("observation", None)
        if start is not None:
            given["observation"] = self._of_robot(start)
        seen = self.guard is not None and not self.history.hidden
        set_guards(self.robot, self._guard_reading if seen else None)  # between held actions too
        shown = self.robot.reset(given)
        self.cut_short = ""
        reading = shown["observation"]
        self._state = self.history.begin(reading, self.resting(reading)) if start is None else start
        return self._with_history(shown)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"]
        shown = self.robot.step(TensorDict({"action": action}, self.batch_size))["next"]
        limits, reading = self.action_spec.space, shown["observation"]
        taken = shown["sent"] if "sent" in shown else action.clamp(limits.low, limits.high)
        self._state = self.history.advanced(self._state, taken, reading)
        self.cut_short = self.robot.cut_short
        result = self._with_history(shown)
        if self.cut_short or self.guard is None or not self.history.hidden:
            result["reward"], result["done"] = shown["reward"], shown["done"]
            return result
        return self._without_reward(result)

    def _with_history(self, shown: TensorDictBase) -> TensorDict:
        entries = {key: shown[key] for key in self.observation_spec}
        return TensorDict({**entries, "observation": self._state}, self.batch_size)
