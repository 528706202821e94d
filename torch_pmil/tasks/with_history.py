"""A task whose state holds past readings and past actions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial, wraps
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import pad

from torch_pmil.checks import check_whole
from torch_pmil.control.exploration import PDMovements
from torch_pmil.control.recovered_states import rates_of
from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs.history import History, HistoryEnv
from torch_pmil.envs.rollouts import OfStates
from torch_pmil.files import short
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search.target_costs import FunctionCost
from torch_pmil.tasks.task import Task


def with_history(
    task: Task,
    *,
    past_entries: int = 0,
    past_actions: int = 0,
    positions_only: bool = False,
) -> Task:
    """The same task for a robot whose sensors do not show all that its motion depends on.

    The model learns the measured entries, from which the rest of the state follows. Policy and
    model see the whole state.

    Args:
        past_entries: number of past values of each entry; with ``positions_only``, of each but the
            positions from which a velocity is estimated. What is hidden, such as a spring, shows in
            them, and the noise of sensors averages out. Past angles are plain numbers, in which a
            full turn is a difference.
        past_actions: number of past actions: those that still act if there is a delay.
        positions_only: whether the sensors show no velocities. They are then estimated from the
            last two positions, which need ``past_actions=1`` to be as informative.

    Raises:
        TypeError: ``positions_only`` is not a bool.
        ValueError: the task has a history already or no demonstrations, a number is not a whole
            number from 0 to the horizon, or ``positions_only`` is set and no entry is the velocity
            of another.

    Example:
        >>> from torch_pmil import load_experiment
        >>> task = with_history(load_experiment("double_pendulum"), past_actions=1)
        >>> task.space.names
        ('q1', 'dq1', 'q2', 'dq2', 'tau1@1', 'tau2@1')
    """
    if task.history is not None:
        raise ValueError(f"{task.name} has a history already")
    if task.demonstrations is None:
        raise ValueError(f"{task.name} must have demonstrations to remember the past, got none")
    names, velocities = task.space.names, rates_of(task.space.names)
    most = task.horizon  # no motion has more
    past_entries = check_whole("past_entries", past_entries, 0, most)
    past_actions = check_whole("past_actions", past_actions, 0, most)
    if not isinstance(positions_only, bool):
        raise TypeError(f"positions_only must be True or False, got {short(positions_only)}")
    if positions_only and not velocities:
        raise ValueError(
            "positions_only needs entries of the state that are velocities of others, dNAME beside "
            f"NAME, of any value, got {', '.join(names)}"
        )
    measured = set(velocities.values()) if positions_only else set()
    history = History(
        names,
        task.actions.names,
        task.time_step,
        hidden=tuple(names[rate] for rate in velocities) if positions_only else (),
        past=tuple(name for entry, name in enumerate(names) if entry not in measured),
        past_entries=past_entries,
        past_actions=past_actions,
    )
    return _remembering(task, history, Resting(task))


@dataclass(frozen=True, eq=False)
class Resting:
    """Actions (*batch, F) that hold a robot in states (*batch, D_0), or the middle of the range."""

    task: Task

    def __call__(self, states: Tensor) -> Tensor:
        actions, held = self.task.actions, self.task.holding_actions
        if held is None:
            return actions.middle.expand(*states.shape[:-1], -1)
        holding = held(states.reshape(-1, states.shape[-1])).clamp(actions.low, actions.high)
        return holding.reshape(*states.shape[:-1], -1)


@dataclass(frozen=True, eq=False)
class OfShown:
    """A function of states (*batch, D_0), or of rollouts of such, at states with a history."""

    function: Callable[[Any], Tensor]
    dim: int

    def __call__(self, known: Tensor | TensorDictBase) -> Tensor:
        if isinstance(known, Tensor):
            return self.function(known[..., : self.dim])
        shown = known.copy()
        for key in ("observation", ("next", "observation")):
            shown[key] = known[key][..., : self.dim]
        return self.function(shown)


def _remembering(task: Task, history: History, resting: Resting) -> Task:
    shown, error, start = len(history.names), task.error, task.initial
    method, held = task.method, task.held_states
    of_reading, _ = history.resting

    def begin(states: Tensor) -> Tensor:
        return history.begin(states, resting(states))

    least = torch.tensor(task.settings["least_widths"], dtype=torch.float64)
    policy = replace(method.policy, least_widths=_with_past(least, task, history))
    if policy.input_widths is not None:
        policy = replace(policy, input_widths=_with_past(policy.input_widths, task, history))
    exploration = method.exploration
    if isinstance(exploration, PDMovements):
        exploration = _movements(exploration, history)
    changes: dict[str, Any] = {
        "history": history,
        "make_env": partial(HistoryEnv, task.make_env, history, resting),
        "space": _space(task, history),
        "initial": Gaussian(begin(start.mean), of_reading @ start.cov @ of_reading.mT),
        "demonstrated_states": _demonstrated(task, history, resting),
        "method": replace(method, policy=policy, exploration=exploration),
        "error": OfShown(error, shown),
    }
    if isinstance(error, OfStates):
        changes["error"] = OfStates(OfShown(error.of_states, shown))
    for name in ("predicted_error", "holding_actions", "sketch"):
        if (function := getattr(task, name)) is not None:
            changes[name] = OfShown(function, shown)
    if held is not None:
        changes["held_states"] = begin(held)
    if isinstance(cost := getattr(task, "cost", None), FunctionCost):
        changes["cost"] = _of_shown(cost, shown)
    return replace(task, **changes)


def _of_shown(cost: FunctionCost, shown: int) -> FunctionCost:
    """The cost of the first entries, which a user's function knows."""

    @wraps(cost.function)
    def function(states: Tensor, actions: Tensor) -> Tensor:
        return cost.function(states[..., :shown], actions)

    return FunctionCost(function)


def _space(task: Task, history: History) -> StateSpace:
    space, more = task.space, (0, history.dim - len(history.names))
    units = dict(zip(space.names, space.units, strict=True))
    units |= dict(zip(history.labels, task.actions.units, strict=True))
    match = space.match_space
    of_states, of_angles = match.weights.tensor_split([space.dim], -1)
    weights = torch.cat([pad(of_states, more), of_angles], -1)
    return StateSpace(
        history.state_names,
        tuple(units[name] for name in history.origins),
        space.angles,
        replace(match, angles=pad(match.angles, more), weights=weights),
    )


def _demonstrated(task: Task, history: History, resting: Resting) -> Tensor:
    """Demonstrated states with what came before them, by the actions that hold the robot there."""
    readings = task.demonstrated_states.unflatten(0, (len(task.demonstrations.positions), -1))
    actions = resting(readings)
    return history.along(readings, actions[:, :-1], actions[:, 0]).flatten(0, 1)


def _with_past(widths: Tensor, task: Task, history: History) -> Tensor:
    """Widths (D'_0,) of the features with those of the past.

    That of a past action is half its range, that of a past angle that of its sine.
    """
    space = task.space
    known = dict(zip(space.feature_names, widths.tolist(), strict=True))
    known |= {space.names[entry]: known[f"sin {space.names[entry]}"] for entry in space.angles}
    known |= dict(zip(history.labels, task.actions.half_range.tolist(), strict=True))
    past = [known[name] for name in history.origins[len(history.names) :]]
    now = len(space.plain)
    return torch.cat([widths[:now], widths.new_tensor(past), widths[now:]])


def _movements(movements: PDMovements, history: History) -> PDMovements:
    more = (0, history.dim - len(history.names))
    padded: dict[str, Any] = {
        name: pad(getattr(movements, name), more) for name in ("pose", "reach", "gain")
    }
    feedforward = OfShown(movements.feedforward, len(history.names))
    return replace(movements, **padded, feedforward=feedforward)
