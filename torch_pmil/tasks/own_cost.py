"""The task of one's own robot and a cost, with defaults estimated from the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_pmil.checks import check_whole
from torch_pmil.control.module_policy import MakePolicy
from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.envs.one_robot import OneRobot
from torch_pmil.envs.rollouts import check_results, of_states
from torch_pmil.gp.lbfgs import MakeOptimizer
from torch_pmil.search.sampled_cost import CostFunction
from torch_pmil.search.target_costs import Cost, FunctionCost, TargetCost
from torch_pmil.tasks.cost_task import CostTask
from torch_pmil.tasks.declared_angles import turning
from torch_pmil.tasks.error_checks import check_error
from torch_pmil.tasks.own_observation import (
    chosen_actions,
    entries_of,
    observed_entries,
    robot_of,
    set_evaluated,
)
from torch_pmil.tasks.own_parts import with_own
from torch_pmil.tasks.own_robot import parted, without_none
from torch_pmil.tasks.own_robot_checks import check_said, seconds
from torch_pmil.tasks.own_starts import start_around, starts_of
from torch_pmil.tasks.site_match import site_match

WITHIN = 1.0  # widths, of the distance from the target that is a success
HALF = 0.5  # of an error that is 0 or 1
OF_SUCCESS = {"error", "tolerance", "predicted_error"}  # fields that say what a success is


def own_cost(
    env: Any,
    cost: Cost | CostFunction,
    horizon: int,
    control_period: float,
    *,
    state: Sequence[str] = (),
    units: Sequence[str] = (),
    angles: Sequence[str] = (),
    match: MatchSpace | str | None = None,
    success: Callable[[Tensor], Tensor] | None = None,
    steps_per_action: int | None = None,
    optimizer: MakeOptimizer | None = None,
    policy: MakePolicy | None = None,
    model: Any = None,
    **settings: Any,
) -> CostTask:
    r"""The task of one's own robot and a cost.

    Anything you leave out is estimated as by :func:`~torch_pmil.tasks.own_robot.own_robot`. The
    range of the policy's centres comes from the first motion. A success is a rollout whose last
    fifth is within one width of the target.

    Args:
        env, control_period, units, angles, steps_per_action, optimizer, policy, model: as there.
        cost: what is minimised. Its target names entries of the state, or ``sin NAME`` and
            ``cos NAME`` of its angles, or entries of ``match``. A function of states x_1..x_T,
            (\*batch, T, D), and of the actions that led to them, (\*batch, T, F), returns costs
            (\*batch, T); its expectation is that of samples.
        horizon: number of actions of a motion.
        state: names of the entries of the observation; those of a MujocoRobot are known.
        match: the match space whose entries the target names. The name of a site of a MuJoCo
            robot stands for its place x, y, z. None if the target names entries of the state.
        success: function from states x_0..x_T, (N, T + 1, D), to whether each motion is a success,
            bool, (N,). By default the target decides; a cost that is a function needs this one.
        settings: fields of :class:`CostTask` and settings of its method.

    Raises:
        TypeError, ValueError: the environment, the cost or a setting is not as it must be.

    Example:
        >>> from torch_pmil.envs import CartPoleEnv
        >>> from torch_pmil.search.target_costs import SaturatingCost
        >>> cost = SaturatingCost(target={"x": 0.0, "cos q": 1.0}, width=0.5)
        >>> state = ("x", "dx", "q", "dq")
        >>> task = own_cost(CartPoleEnv(), cost, 40, 0.1, state=state, angles=("q",))
        >>> task.space.match_space.names, task.horizon
        (('x', 'cos q'), 40)
    """
    if not isinstance(cost, Cost):
        cost = FunctionCost(cost)
    if isinstance(cost, FunctionCost) and success is None:
        raise TypeError(
            "success must say which motions are successes, since a function is the cost"
        )
    if success is not None and (besides := sorted(OF_SUCCESS & settings.keys())):
        raise ValueError(
            f"{' and '.join(besides)} must be left out beside success, which alone says what a "
            "success is"
        )
    check_whole("horizon", horizon, 1)
    said = {"state": state, "units": units, "angles": angles, "match": match}
    check_said(own_cost, CostTask, **said, **settings)
    settings = without_none(settings)
    control_period = seconds(control_period)
    state, units, angles = entries_of(env, state, units, angles, settings)
    if not state:
        raise ValueError("state must name the entries of the observation, got none")
    names, indices = observed_entries(state, angles, units)
    if isinstance(match, str):
        match = site_match(env, match)
    known = tuple(units) or ("",) * len(names)
    if match is None:
        target = tuple(cost.target) if isinstance(cost, TargetCost) else names
        match = of_target(target, names, known, indices)
    space = StateSpace(names, known, indices, match)
    robot = robot_of(env, control_period, state, steps_per_action, len(names))
    set_evaluated(robot, settings)
    starts = starts_of(robot, state, space, settings)
    if "initial" not in settings:
        if starts is None:
            raise ValueError("initial must be given for a robot that is not reset here, got none")
        settings["initial"] = start_around(starts.mean(0), starts.std(0))
    if isinstance(robot, OneRobot):
        robot.turning_entries = turning(state, space, settings["initial"].mean)
    task = _task(robot, space, cost, horizon, control_period, success, settings)
    check_error(task)
    return with_own(task, optimizer, policy, model)


def _task(
    robot: Any,
    space: StateSpace,
    cost: Cost,
    horizon: int,
    control_period: float,
    success: Callable[[Tensor], Tensor] | None,
    settings: Mapping[str, Any],
) -> CostTask:
    """The task of these settings, by default those that robot and cost suggest."""
    given, chosen = parted(settings, CostTask)
    if success is not None:
        error = _failed(success)
    else:
        assert isinstance(cost, TargetCost)
        error = cost.at_end(space)
    defaults: dict[str, Any] = {
        "name": robot.name,
        "actions": chosen_actions(given, robot()),
        "error": of_states(error),
        "tolerance": WITHIN if success is None else HALF,
        "draws": robot.draws,
    }
    fixed = {"make_env": robot, "space": space, "cost": cost, "steps": horizon}
    task = CostTask(**fixed, control_period=control_period, **(defaults | given))
    return task.with_settings(**chosen)


def _failed(success: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """An error (*batch) of states (*batch, T + 1, D) that is 1 where a motion is no success."""
    if not callable(success):
        raise TypeError(f"success must be a function of states, got {type(success).__name__}")

    def failed(states: Tensor) -> Tensor:
        motions = states.reshape(-1, *states.shape[-2:])
        succeeded = success(motions)
        check_results("success", succeeded, motions.shape[:1], truth=True)
        return 1 - succeeded.double().reshape(states.shape[:-2])

    return failed


def of_target(
    target: Sequence[str], names: Sequence[str], units: Sequence[str], angles: Sequence[int]
) -> MatchSpace:
    """The match space of entries of the state, and of sines and cosines of its angles, by name.

    Raises ValueError if there is no such entry.

    Example:
        >>> space = of_target(("cos q", "x"), ("x", "q"), ("m", "rad"), angles=(1,))
        >>> space(torch.tensor([2.0, 0.0], dtype=torch.float64))
        tensor([1., 2.], dtype=torch.float64)
    """
    D, K = len(names), len(angles)
    turned = torch.eye(D, dtype=torch.float64)[list(angles)]
    columns = [
        *names,
        *(f"sin {names[entry]}" for entry in angles),
        *(f"cos {names[entry]}" for entry in angles),
    ]
    if unknown := [name for name in target if name not in columns]:
        raise ValueError(
            f"target must name some of {', '.join(columns)}, or entries of match, got "
            f"{', '.join(unknown)}"
        )
    chosen = torch.eye(D + 2 * K, dtype=torch.float64)[[columns.index(name) for name in target]]
    labels = dict(zip(names, units, strict=True))
    return MatchSpace(tuple(target), tuple(labels.get(name, "") for name in target), turned, chosen)
