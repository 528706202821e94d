"""The task of one's own robot, with defaults estimated from robot and recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Literal

import torch
from torch import Tensor

from torch_pmil.checks import check_noise
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.module_policy import MakePolicy
from torch_pmil.control.recovered_states import rates_of, recover_states
from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.demonstrations import DemonstrationError, Demonstrations, Recordings
from torch_pmil.demonstrations.distribution import expert_distribution
from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.envs.one_robot import OneRobot
from torch_pmil.envs.rollouts import of_states
from torch_pmil.gp.lbfgs import MakeOptimizer
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.sampled_cost import CostFunction
from torch_pmil.search.target_costs import Cost
from torch_pmil.tasks.declared_angles import on_one_turn, turning
from torch_pmil.tasks.deviation import Deviation
from torch_pmil.tasks.error_checks import check_error
from torch_pmil.tasks.fitting import fitting
from torch_pmil.tasks.improving_task import improving
from torch_pmil.tasks.method import Method, PolicySettings
from torch_pmil.tasks.own_observation import (
    chosen_actions,
    entries_of,
    observed_entries,
    robot_of,
    set_evaluated,
)
from torch_pmil.tasks.own_parts import with_own
from torch_pmil.tasks.own_recordings import Recorded, at_control_rate, noise, read, with_angles
from torch_pmil.tasks.own_robot_checks import check_said, seconds
from torch_pmil.tasks.own_samplings import samplings_of
from torch_pmil.tasks.own_starts import Robot, start_of, starts_of
from torch_pmil.tasks.resampled import resampled
from torch_pmil.tasks.sampling import Sampling
from torch_pmil.tasks.site_match import site_match
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.unit_checks import check_units

TOLERANCE = 2.0  # standard deviations of the demonstrations
CENTRES = 50
INPUT_SCALE = 3.0  # a few demonstrations show less of the state than fresh starts reach
# a robot that nobody here has seen may lead every search into the same poor optimum
SEARCH = SearchSettings(restarts=2)
TARGET_UNITS = ("rad", "m", "deg", "°")  # of an action, where the entry's unit is not known
PLACE = 3  # coordinates of a site
ESTIMATED = {"initial", "actions", "noise_std", "method"}  # fields for which None says nothing
CONFIRMATIONS = 3  # where the success of other starts cannot be predicted


def own_robot(
    env: Any,
    demonstrations: Recorded,
    control_period: float,
    *,
    state: Sequence[str] = (),
    units: Sequence[str] = (),
    angles: Sequence[str] = (),
    match: MatchSpace | str | None = None,
    past_entries: int = 0,
    past_actions: int = 0,
    positions_only: bool = False,
    step: float | Literal["auto"] = "auto",
    past: Literal["auto"] | None = "auto",
    steps_per_action: int | None = None,
    optimizer: MakeOptimizer | None = None,
    policy: MakePolicy | None = None,
    model: Any = None,
    cost: Cost | CostFunction | None = None,
    imitation_weight: float | None = None,
    **settings: Any,
) -> Task:
    """The task of one's own robot and recordings.

    Anything you leave out is estimated:

    - The start distribution comes from 20 resets, unless ``initial`` is given. For a robot that is
      not reset here (``evaluated`` is False, as it is for a physical robot), it comes from the
      demonstrations' starts, with a standard deviation of at least 5 % of the demonstrated values.
    - The range of the actions is that of the environment.
    - The observation noise is 5 % of each entry's demonstrated range; for an entry that hardly
      changes, 1 % of the largest range of the entries of its unit.
    - The demonstrated states come from
      :func:`~torch_pmil.control.recovered_states.recover_states`.
    - A success is a rollout within twice the standard deviation of the demonstrations (noise
      included) of their mean, in root mean square over all entries and times. A ``tolerance`` by
      name, as ``{"q2": 0.05}``, is instead the largest distance of each named entry from that mean,
      in its unit and in root mean square over time. An ``error`` of one's own needs a ``tolerance``
      in its unit.

    Actions that have the names of entries of the state, and not another unit, are targets of these
    entries, so the first policy holds the robot where it is.

    Args:
        env: an environment of TorchRL or gymnasium, or the name of one of gymnasium, or a
            :class:`~torch_pmil.envs.mujoco_robot.MujocoRobot`, which knows its state and its start.
        demonstrations: a file or folder of recordings, or what was read of one. Those of several
            lengths or at another rate are aligned and sampled at the control period.
        control_period: seconds between two actions.
        state: names of the entries of the observation; those of the demonstrations if empty. The
            entry ``dNAME`` is the velocity of the entry ``NAME``; the entries ``cos NAME`` and
            ``sin NAME`` become one entry of the state, the angle ``NAME``.
        units: of the entries of the state.
        angles: names of entries that are angles (rad) and turn round. What robot or recordings
            show within one turn is continued beyond it.
        match: what the demonstrations show of the state; by default its entries of their names. The
            name of a site of a MuJoCo robot stands for its place, and for its axes if these are
            demonstrated (:func:`~torch_pmil.tasks.site_match.site_match`).
        past_entries, past_actions, positions_only: what the state holds of the past, see
            :func:`~torch_pmil.tasks.with_history.with_history`.
        step: seconds for which the policy holds an action, a multiple of the control period. By
            default a run chooses it by the first motion
            (:func:`~torch_pmil.tasks.sampling_choice.choose`). With an ``error`` or an exploration
            of one's own it is the control period.
        past: whether a run chooses by the first motion what the state holds of the past. What is
            given above is not chosen.
        steps_per_action: steps of the environment for which an action is held, see
            :class:`~torch_pmil.envs.one_robot.OneRobot`.
        optimizer: of the policy search, a class of ``torch.optim`` or a function that makes one
            (:func:`~torch_pmil.gp.lbfgs.minimise`); ``torch.optim.LBFGS`` if None.
        policy: makes a policy of your own, a ``torch.nn.Module`` from features to actions, from
            their numbers, as ``torch.nn.Linear`` does
            (:class:`~torch_pmil.control.module_policy.ModulePolicy`); or
            :class:`~torch_pmil.control.linear_policy.LinearPolicy` itself; an RBF network if None.
        model: a forward model of your own, with ``fit`` and ``sample`` or ``moments``
            (:class:`~torch_pmil.model.own_dynamics.OwnDynamics`); GPs if None.
        cost: what is minimised beside the distance from the demonstrations, once the robot imitates
            them (:class:`~torch_pmil.tasks.improving_task.ImprovingTask`): a ``SaturatingCost`` or
            ``QuadraticCost`` whose target names entries of ``match``, or a function of states and
            actions. If None, the robot imitates alone.
        imitation_weight: of the KL to the demonstrations beside the cost; 1 if None.
        settings: fields of :class:`Task` and settings of its method
            (:class:`~torch_pmil.tasks.method.Method`), by name, in place of the defaults.

    Raises:
        DemonstrationError: the demonstrations cannot be read, or do not fit the match space.
        TypeError, ValueError: the environment or a setting is not as it must be.

    Example:
        >>> from torch_pmil import shipped_demonstrations
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> state = ("q1", "dq1", "q2", "dq2")
        >>> ends = MatchSpace.of_links(("q1", "q2"), (0.5, 0.5), state)
        >>> shown = shipped_demonstrations("double_pendulum")
        >>> robot = DoublePendulumEnv()
        >>> task = own_robot(robot, shown, 0.1, state=state, angles=("q1", "q2"), match=ends)
        >>> task.space.feature_names
        ('dq1', 'dq2', 'sin q1', 'sin q2', 'cos q1', 'cos q2')
    """
    said = {"state": state, "units": units, "angles": angles, "match": match}
    check_said(own_robot, Task, **said, **settings)
    settings = without_none(settings)
    if cost is None and imitation_weight is not None:
        raise ValueError("imitation_weight must come with a cost, got none")
    control_period = seconds(control_period)
    state, units, angles = entries_of(env, state, units, angles, settings)
    of_match = match.names if isinstance(match, MatchSpace) else () if match else state
    recorded = read(demonstrations, tuple(of_match), control_period)
    observed = tuple(state) or recorded.names
    if match is None:
        recorded = with_angles(recorded)
    if isinstance(match, str):
        match = site_match(env, match, orientation=len(recorded.names) > PLACE)
    space = _space(observed, units, angles, match, recorded.names)
    robot = robot_of(env, control_period, observed, steps_per_action, len(space.names))
    set_evaluated(robot, settings)
    starts = starts_of(robot, observed, space, settings)
    shown, states = _demonstrated(recorded, robot, observed, space, starts, settings)
    task = _task(robot, space, shown, states, starts, settings)
    task = with_own(task, optimizer, policy, model)
    if cost is not None:
        weight = {} if imitation_weight is None else {"imitation_weight": imitation_weight}
        task = improving(task, cost, **weight)
    check_error(task)
    given = Sampling(1, past_entries, past_actions, positions_only)
    samplings = samplings_of(task, given, step, past)
    if len(samplings) > 1:
        return replace(task, samplings=samplings)
    return resampled(task, samplings[0])


def _demonstrated(
    recorded: Demonstrations | Recordings,
    robot: Robot,
    observed: Sequence[str],
    space: StateSpace,
    starts: Tensor | None,
    settings: Mapping[str, Any],
) -> tuple[Demonstrations, Tensor]:
    """Demonstrations at the robot's rate and turn, and the states (N, T + 1, D) that show them."""
    units = dict(zip(space.names, space.units, strict=True))
    by_entry = {} if starts is None else dict(zip(space.names, starts.mT, strict=True))
    check_units(recorded, units, by_entry, dict(zip(observed, robot.bounds, strict=True)))
    near = settings["initial"].mean if "initial" in settings else None
    if starts is not None:
        near = starts.mean(0)
    recorded = on_one_turn(recorded, space, near)
    period, rates = robot.control_period, rates_of(space.names)
    velocities = {space.names[rate] for rate in rates}
    shown = fitting(at_control_rate(recorded, period, velocities), space, robot())
    begin = torch.zeros(space.dim, dtype=torch.float64) if near is None else near
    states = recover_states(space.match_space, shown.positions, period, begin, rates)
    if isinstance(robot, OneRobot):
        first = states[:, 0].mean(0) if starts is None else begin
        robot.turning_entries = turning(observed, space, first)
    return shown, states


def _task(
    robot: Robot,
    space: StateSpace,
    shown: Demonstrations,
    states: Tensor,
    starts: Tensor | None,
    settings: Mapping[str, Any],
) -> Task:
    """The task of these settings, by default those that robot and demonstrations suggest."""
    given, chosen = parted(settings, Task)
    if "noise_std" not in given:
        given["noise_std"] = noise(shown, space.match_space.units)
    given["noise_std"] = check_noise(given["noise_std"], space.match_space.names)
    if "initial" not in given:
        given["initial"] = start_of(starts, states, space.names)
    allowed = given.get("tolerance")
    if isinstance(allowed, Mapping):
        given["tolerance"] = 1.0  # of the largest share of what is allowed
    else:
        allowed = None
    marginals = expert_distribution(shown, given["noise_std"])
    actions = chosen_actions(given, robot())
    held = robot.held if isinstance(robot, MujocoRobot) else _held(actions, space)
    demonstrated = states.flatten(0, 1)
    defaults: dict[str, Any] = {
        "name": robot.name,
        "actions": actions,
        "holding_actions": held,
        "held_states": None if held is None else demonstrated,
        "demonstrated_states": demonstrated,
        "error": of_states(Deviation(marginals, space, allowed)),
        "tolerance": TOLERANCE,
        "method": Method(
            PolicySettings(num_centres=CENTRES, input_scale=INPUT_SCALE), search=SEARCH
        ),
        "draws": robot.draws,
    }
    fixed: dict[str, Any] = {"make_env": robot, "space": space, "demonstrations": shown}
    task = Task(**fixed, **(defaults | given))
    if task.promised is None:
        chosen = {"confirmations": CONFIRMATIONS, **chosen}
    return task.with_settings(**chosen)


def without_none(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings, without those that are None and are estimated if they are left out.

    Example:
        >>> without_none({"initial": None, "noise_std": 0.1, "units": None})
        {'noise_std': 0.1, 'units': None}
    """
    left_out = {name for name in ESTIMATED & settings.keys() if settings[name] is None}
    return {name: value for name, value in settings.items() if name not in left_out}


def parted(settings: Mapping[str, Any], kind: type[Task]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The fields of a kind of task among settings, and the settings of its method."""
    of_task = {entry.name for entry in fields(kind)}
    given = {name: value for name, value in settings.items() if name in of_task}
    return given, {name: value for name, value in settings.items() if name not in of_task}


def _space(
    observed: Sequence[str],
    units: Sequence[str],
    angles: Sequence[str],
    match: MatchSpace | None,
    shown: tuple[str, ...],
) -> StateSpace:
    """The state space of an observation, in which a pair of cosine and sine is an angle."""
    names, indices = observed_entries(observed, angles, units)
    known = tuple(units) or ("",) * len(names)
    if match is None:
        if unknown := [name for name in shown if name not in names]:
            raise DemonstrationError(
                f"demonstrations must be of entries of the state {', '.join(names)}, got "
                f"{', '.join(unknown)}: name the entries by state=, or say by match= what the "
                "demonstrations show of them, or choose columns by load_recordings(PATH, keys=...)"
            )
        match = MatchSpace.of_entries(shown, names, [known[names.index(name)] for name in shown])
    return StateSpace(names, known, indices, match)


def _held(actions: ActionSpace, state: StateSpace) -> Callable[[Tensor], Tensor] | None:
    """Actions that hold a robot whose servos take targets of entries of the state, in its units."""
    if not set(actions.names) <= set(state.names):
        return None
    entries = [state.names.index(name) for name in actions.names]
    for unit, entry in zip(actions.units, entries, strict=True):
        known = state.units[entry] or ("rad" if entry in state.angles else "")
        if unit and unit not in ((known,) if known else TARGET_UNITS):
            return None
    return lambda states: states[..., entries]
