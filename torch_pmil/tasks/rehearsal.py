"""A simulated robot is tried before the first motion: does it repeat itself, and fit its names?"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

import torch
from torch import Tensor

from torch_pmil.control.recovered_states import rates_of
from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs.layers import counted, unrepeatable_layer, wrappers_of
from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.envs.one_robot import OneRobot, length_of_step
from torch_pmil.envs.turning import within_half_a_turn
from torch_pmil.seeds import Stream
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.unit_checks import check_motion

STEPS, WINDOW = 50, 5  # of a try, and over which changes are compared
REACH = 0.4  # of the actions, in halves of their range
ALIKE = 1e-6  # difference of two tries that are the same, in the largest value of an entry
TRIES, SHORT = 40, 10  # of a robot that does not repeat itself, and steps of each
DRIFTING = 0.35  # ratio of von Neumann; 1 on average for independent noise, with deviation 0.16
FITS = 0.5  # relative difference of a position's changes from its velocity's sums
EXPLAINS = 0.3  # the same if the velocity is scaled
CLEAR = 5.0  # change of a position in standard deviations of its noise


def rehearse(task: Task) -> None:
    """Try one's own simulated robot with slow actions, twice from one seed. This is no experience.

    Warns if the actions change nothing, or if the robot moves far less than the recordings show.

    The actions are at most as large as those of the first motion, and ``box`` ends the motion. A
    robot that is not measured from fresh starts, such as a physical one, is not moved.

    Raises:
        ValueError: the robot resets itself, changes from reset to reset, or holds each action for a
            time other than the control period; or an entry dNAME is not the velocity of NAME.
    """
    robot: Any = task.make_env
    while isinstance(robot, partial):  # of the environments that hold actions or the past
        robot = robot.args[0] if robot.args else None
    if not (task.evaluated and isinstance(robot, OneRobot | MujocoRobot)):
        return
    with torch.random.fork_rng(devices=[]):
        _rehearse(task, robot)


def _rehearse(task: Task, robot: OneRobot | MujocoRobot) -> None:
    actions = _slow_actions(task)
    if isinstance(robot, OneRobot):
        with counted(robot.env) as calls:
            states = _tried(task, actions, calls.clear)
        steps = calls["step"] / (task.held * (len(states) - 1))
        _check_steps(robot, steps, calls["reset"])
    else:
        states = _tried(task, actions)
    again = _tried(task, actions)
    if not _alike(states, again):
        _check_drift(task, robot, actions[:SHORT])
    elif _do_nothing(task, actions, states):
        warnings.warn(
            f"actions of {_reach(task):.0%} of their range do not change how the robot moves: see "
            "that its motors are on, and strong enough to overcome friction",
            RuntimeWarning,
            stacklevel=4,
        )
        return
    states = states[: len(again)]
    if len(states) <= WINDOW + 1:
        return
    if task.demonstrations is not None:
        for doubt in check_motion(*_ranges(task, states)):
            warnings.warn(doubt, RuntimeWarning, stacklevel=4)
    hidden = task.history.hidden if task.history else ()
    check_velocities(states, task.space, task.time_step, hidden)


def _do_nothing(task: Task, actions: Tensor, states: Tensor) -> bool:
    """Whether the robot moves along these states (T + 1, D) with idle actions as well."""
    idle, history = _tried(task, task.actions.middle.expand_as(actions)), task.history
    measured = task.space.dim if history is None else len(history.names)
    return _alike(states[:, :measured], idle[:, :measured])


def _alike(first: Tensor, second: Tensor) -> bool:
    """Whether two motions (T + 1, D) are the same as far as both go."""
    count = min(len(first), len(second))
    scale = first[:count].abs().amax(0)
    apart = (first[:count] - second[:count]).abs() / torch.where(scale > 0, scale, 1.0)
    return bool((apart <= ALIKE).all())


def check_velocities(
    states: Tensor, space: StateSpace, period: float, hidden: Collection[str] = ()
) -> None:
    """Compare velocities dNAME, unless they are hidden, with the changes of NAME along states.

    The states are (T + 1, D).

    Raises:
        ValueError: another reading of the names or of their units explains the changes.
    """
    names = space.names
    rates = {k: of for k, of in rates_of(names).items() if names[k] not in hidden}
    change = _changes(states, space, period, rates)
    noise = change.diff(dim=0).square().mean(0).sqrt() / math.sqrt(6)  # at most
    moved, summed = _windows(change), _windows(_sums(states, period))
    rms = moved.square().mean(0).sqrt()

    def differ(position: int, rate: int, factor: float | Tensor = 1.0) -> float:
        apart = moved[:, position] - factor * summed[:, rate]
        return float(apart.square().mean().sqrt() / rms[position])

    for rate, position in rates.items():
        own = differ(position, rate)
        if rms[position] <= CLEAR * noise[position] or own < FITS:
            continue
        expected = f"{names[rate]} must be the velocity of {names[position]}"
        better = min(FITS, own / 2)
        if rms[rate] > 0 and differ(rate, position) < better:
            raise ValueError(f"{expected}, got the reverse: swap the two names in state")
        others = [k for k in range(len(names)) if k not in (rate, position)]
        best = min(others, key=partial(differ, position), default=rate)
        if differ(position, best) < better:
            raise ValueError(
                f"{expected}, got another entry: {names[position]} moves at the rate of "
                f"{names[best]}; state must name the entries in the order of the observation"
            )
        factor = (moved[:, position] @ summed[:, rate]) / summed[:, rate].square().sum()
        if factor != 0 and differ(position, rate, factor) < EXPLAINS:
            raise ValueError(
                f"{expected}, got {1 / factor:.3g} times that: check the sign, the units and "
                f"control_period ({period:g} s)"
            )
        if (states[:, rate].diff().square().mean() > states[:, rate].square().mean()).item():
            continue  # too fast for the control period to judge
        warnings.warn(
            f"{expected}, got an entry that does not move it so: if it is another quantity, "
            "name it otherwise",
            RuntimeWarning,
            stacklevel=5,
        )


def _sums(states: Tensor, period: float) -> Tensor:
    """Entries of states (T + 1, D), taken as velocities and integrated over each step, (T, D)."""
    return period * (states[:-1] + states[1:]) / 2


def _changes(states: Tensor, space: StateSpace, period: float, rates: dict[int, int]) -> Tensor:
    """Changes (T, D) of states (T + 1, D) in each step."""
    change, sums = states.diff(dim=0), _sums(states, period)
    for rate, position in rates.items():
        if position in space.angles:  # which may have been continued by a wrong velocity
            apart = within_half_a_turn(change[:, position] - sums[:, rate])
            right = apart.square().mean() < 1
            turned = sums[:, rate] + apart if right else within_half_a_turn(change[:, position])
            change[:, position] = turned
    return change


def _ranges(task: Task, tried: Tensor) -> tuple[dict, dict, dict, float]:
    """Recorded ranges, motions of the try, and units; how much further the robot could move."""
    space, shown, recorded = task.space, tried.amax(0) - tried.amin(0), task.demonstrations
    low, high = recorded.positions.flatten(0, 1).aminmax(dim=0)
    both = {name: index for index, name in enumerate(recorded.names) if name in space.names}
    entries = {name: space.names.index(name) for name in both}
    return (
        {name: (low[index].item(), high[index].item()) for name, index in both.items()},
        {name: shown[entry].item() for name, entry in entries.items()},
        {name: space.units[entry] for name, entry in entries.items()},
        max(1.0, task.horizon / STEPS) * REACH / _reach(task),
    )


def _reach(task: Task) -> float:
    """Reach of the actions, in halves of their range, no larger than in the first motion."""
    return min(REACH, getattr(task.method.exploration, "random_action", REACH))


def _windows(steps: Tensor) -> Tensor:
    """Sums of consecutive steps."""
    return steps.unfold(0, WINDOW, 1).sum(-1)


def _slow_actions(task: Task) -> Tensor:
    """Actions (STEPS, F) of one or two slow waves, a different one for each action."""
    space, count = task.actions, len(task.actions.names)
    around = space.middle
    if task.holding_actions is not None:
        around = task.holding_actions(task.initial.mean[None])[0]
    cycles = 1 + torch.arange(count, dtype=torch.float64) / count
    phases = 2 * math.pi * cycles * torch.arange(1, STEPS + 1)[:, None] / STEPS
    return (around + _reach(task) * space.half_range * phases.sin()).clamp(space.low, space.high)


def _tried(task: Task, actions: Tensor, begun: Callable[[], None] = lambda: None) -> Tensor:
    """States (T + 1, D) from a reset by always the same seed, until they leave the box."""
    env = task.robot(Stream.REHEARSAL)
    step = env.reset()
    begun()
    states = [step["observation"]]
    for action in actions:
        step = env.step(step.set("action", action))["next"]
        states.append(step["observation"])
        if env.cut_short:
            break
    return torch.stack(states)


def _check_steps(robot: OneRobot, steps: float, resets: int) -> None:
    """Check how many steps of gymnasium's environment an action took."""
    if resets:
        raise ValueError(
            f"env must not reset itself within a motion, got {robot.name}, which was reset "
            f"{resets} times in {STEPS} actions: remove what resets it"
        )
    layers = wrappers_of(robot.env)
    length = length_of_step(layers[0]) if layers else None
    if length is not None and not math.isclose(steps * length, robot.control_period, rel_tol=1e-6):
        raise ValueError(
            f"each action must last control_period = {robot.control_period:g} s, got {steps:g} "
            f"steps of {length:g} s of {type(layers[0]).__name__}: give another control_period "
            "or steps_per_action"
        )


def _check_drift(task: Task, robot: object, actions: Tensor) -> None:
    """Raise if a robot changes from try to try, or warn if it is noisy without a seed."""
    layer = unrepeatable_layer(robot.env) if isinstance(robot, OneRobot) else task.name
    last = torch.stack([_tried(task, actions)[-1] for _ in range(TRIES)])
    changing = last.std(0) > ALIKE * last.abs().amax(0)
    steps = last.diff(dim=0).square().mean(0)[changing]
    ratios = steps / (2 * last.var(0)[changing])
    if (ratios < DRIFTING).any():
        entry = task.space.names[int(changing.nonzero()[ratios.argmin()])]
        shown = last[:, task.space.names.index(entry)]
        raise ValueError(
            f"env must do the same after each reset by one seed, got {entry} = {shown[0]:.3g}, and "
            f"{shown[-1]:.3g} after {TRIES} resets: {layer} remembers what was before; do without, "
            f"or leave {entry} out of the observation"
        )
    warnings.warn(
        f"{layer} draws random numbers that no seed determines: a run cannot be repeated. Draw "
        "them from the generator that reset(seed) seeds",
        RuntimeWarning,
        stacklevel=5,
    )
