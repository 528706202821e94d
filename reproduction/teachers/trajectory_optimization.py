r"""Control-limited trajectory optimisation and tracking: the teacher that demonstrates a task.

Iterative LQR with the torque limits as a box at each step (Tassa, Mansard and Todorov, 2014), then
a time-varying LQR about the plan and an infinite-horizon LQR about its target. Knows no robot:
``dynamics`` maps states (N, D) and actions (N, F) to the states (N, D) one control period later.

=========  =========================================================================
symbol     here
=========  =========================================================================
A, B       derivatives of the next state by state and action, (T, D, D), (T, D, F)
V_x, V_xx  derivatives of the cost to go
Q_u, ...   derivatives of the cost to go before the step
closed     derivative of the next state under feedback, A + B K
k, K       change of the action and feedback gain, (T, F), (T, F, D)
mu         regularisation: weight of leaving the states of the last iteration
=========  =========================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are
from scipy.optimize import lsq_linear

Array = NDArray[np.floating]
Dynamics = Callable[[Array, Array], Array]

LINE_SEARCH = 0.5 ** np.arange(10.0)
DIFFERENCE_STEP = 1e-5
MAX_ITERATIONS = 200  # after which the best plan so far is returned
MU_MIN, MU_MAX, MU_FACTOR = 1e-8, 1e8, 4.0


@dataclass(frozen=True, eq=False)
class QuadraticCost:
    """Quadratic cost of a trajectory's distance from a target state and a holding action.

    Half the sum of state_weights (x - target)² and action_weights (u - hold_action)².

    Attributes:
        target: state to reach, (D,), or states at steps 0..T to follow, (T+1, D).
        state_weights: for the states at steps 0..T, (T+1, D).
        action_weights: (F,), positive.
        hold_action: that keeps the robot at the target, (F,) or (T, F); 0 where it rests there
            without any.
    """

    target: Array
    state_weights: Array  # (T+1, D)
    action_weights: Array  # (F,)
    hold_action: Array | float = 0.0

    def __call__(self, states: Array, actions: Array) -> Array:
        """Costs (*batch,) of states (*batch, T+1, D) and actions (*batch, T, F)."""
        state_cost = (self.state_weights * (states - self.target) ** 2).sum((-2, -1))
        action_cost = (self.action_weights * (actions - self.hold_action) ** 2).sum((-2, -1))
        return (state_cost + action_cost) / 2


@dataclass(frozen=True, eq=False)
class Plan:
    """An optimised trajectory.

    Attributes:
        states: (T+1, D).
        actions: (T, F), within the limits.
        cost: of the trajectory.
        converged: whether what was left to gain was less than the tolerance when the search ended.
    """

    states: Array  # (T+1, D)
    actions: Array  # (T, F)
    cost: float
    converged: bool


@dataclass(frozen=True, eq=False)
class TrackingController:
    """Follows a plan by linear feedback, then holds its target; the torques stay within the limits.

    Attributes:
        plan: the trajectory to follow.
        gains: time-varying feedback, (T, F, D).
        hold_gain: feedback about the target, (F, D), from ``hold_from`` on.
        hold_from: first step of holding.
        target: state to hold, (D,).
        action_limit: largest absolute action, (F,).
        hold_action: that keeps the robot at the target, (F,); 0 where it rests there without any.
    """

    plan: Plan
    gains: Array
    hold_gain: Array
    hold_from: int
    target: Array
    action_limit: Array
    hold_action: Array | float = 0.0

    def __call__(self, step: int, states: Array) -> Array:
        """Actions (N, F) at a step for states (N, D)."""
        if step < self.hold_from:
            feedback = (states - self.plan.states[step]) @ self.gains[step].T
            actions = self.plan.actions[step] - feedback
        else:
            actions = self.hold_action - (states - self.target) @ self.hold_gain.T
        return actions.clip(-self.action_limit, self.action_limit)


def plan_trajectory(
    dynamics: Dynamics,
    start: Array,
    cost: QuadraticCost,
    initial_actions: Array,
    action_limit: Array,
    tolerance: float = 1e-6,
) -> Plan:
    """Control-limited iterative LQR.

    The search ends where an iteration improves the cost by less than the tolerance, or where none
    does and the local model, which is not regularised, promises less. Rounding may swallow an
    improvement, the promise does not depend on it.

    Args:
        dynamics: states (N, D) and actions (N, F) to next states (N, D).
        start: (D,).
        cost: what to minimise, over T steps.
        initial_actions: first guess (T, F).
        action_limit: largest absolute action, (F,).
        tolerance: relative improvement of the cost that ends the search.

    Returns:
        The plan; its ``converged`` says whether the tolerance was met.
    """
    guess = initial_actions.clip(-action_limit, action_limit)
    rollouts = roll_out(dynamics, start[None], lambda t, _: guess[t, None], len(guess))
    states, actions = rollouts[0][0], rollouts[1][0]
    best, mu = float(cost(states, actions)), 1.0
    A, B = linearize(dynamics, states[:-1], actions)
    for _ in range(MAX_ITERATIONS):
        k, K, _ = _backward(A, B, states, actions, cost, action_limit, mu)
        found = _line_search(dynamics, states, actions, k, K, cost, action_limit)
        improvement = best - found[-1]
        if improvement > 0:
            states, actions, best = found
            mu = max(mu / MU_FACTOR, MU_MIN)
            A, B = linearize(dynamics, states[:-1], actions)
        else:
            improvement = _backward(A, B, states, actions, cost, action_limit, mu=0.0)[2]
            if mu >= MU_MAX and improvement >= tolerance * best:
                break
            mu *= MU_FACTOR
        if improvement < tolerance * best:
            return Plan(states, actions, best, converged=True)
    return Plan(states, actions, best, converged=False)


def tracking_controller(
    dynamics: Dynamics,
    plan: Plan,
    target: Array,
    hold_from: int,
    state_weights: Array,
    action_weights: Array,
    action_limit: Array,
    hold_action: Array | float = 0.0,
) -> TrackingController:
    """Time-varying LQR about a plan, then infinite-horizon LQR about the target.

    The target is an equilibrium under ``hold_action``.

    Args:
        dynamics: states (N, D) and actions (N, F) to next states (N, D).
        plan: the trajectory to follow.
        target: state to hold, (D,).
        hold_from: first step of holding.
        state_weights: of the deviation from the plan or the target, (D,).
        action_weights: of the deviation from the planned action, (F,).
        action_limit: largest absolute action, (F,).
        hold_action: that keeps the robot at the target, (F,); 0 where it rests there without any.

    Returns:
        The controller, a function of step and states.

    Raises:
        numpy.linalg.LinAlgError: the dynamics about the target cannot be stabilised.
    """
    hold_gain, P = linear_regulator(dynamics, target, state_weights, action_weights, hold_action)
    weights = np.broadcast_to(state_weights, (len(plan.actions), len(target)))
    gains = tracking_gains(dynamics, plan, weights, action_weights, P)
    return TrackingController(plan, gains, hold_gain, hold_from, target, action_limit, hold_action)


def tracking_gains(
    dynamics: Dynamics, plan: Plan, state_weights: Array, action_weights: Array, final: Array
) -> Array:
    """Gains (T, F, D) of a time-varying LQR about a plan.

    Args:
        dynamics: states (N, D) and actions (N, F) to next states (N, D).
        plan: the trajectory to follow.
        state_weights: of the deviation from the plan at steps 0..T-1, (T, D).
        action_weights: of the deviation from the planned action, (F,).
        final: of the deviation at step T, (D, D).
    """
    R, P, gains = np.diag(action_weights), final, []
    steps = zip(state_weights, *linearize(dynamics, plan.states[:-1], plan.actions), strict=True)
    for weights, A, B in reversed(list(steps)):
        gains.append(_lqr_gain(A, B, P, R))
        P = np.diag(weights) + A.T @ P @ (A - B @ gains[-1])
    return np.array(gains[::-1])


def linear_regulator(
    dynamics: Dynamics,
    target: Array,
    state_weights: Array,
    action_weights: Array,
    hold_action: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Infinite-horizon LQR about a target that is an equilibrium under an action.

    Returns the feedback gain (F, D) and the cost to go (D, D).

    Args:
        dynamics: states (N, D) and actions (N, F) to next states (N, D).
        target: (D,).
        state_weights, action_weights: of the deviation, (D,) and (F,).
        hold_action: that keeps the robot at the target, (F,); 0 where it rests there without any.

    Raises:
        numpy.linalg.LinAlgError: the dynamics about the target cannot be stabilised.
    """
    Q, R = np.diag(state_weights), np.diag(action_weights)
    action = np.full((1, len(action_weights)), hold_action)
    (A,), (B,) = linearize(dynamics, target[None], action)
    P = solve_discrete_are(A, B, Q, R)
    return _lqr_gain(A, B, P, R), P


def roll_out(
    dynamics: Dynamics, starts: Array, controller: Callable[[int, Array], Array], steps: int
) -> tuple[Array, Array]:
    """States (N, T+1, D) and actions (N, T, F) from the starts (N, D) under a controller.

    The controller takes step and states to actions (N, F).
    """
    states, actions = [starts], []
    for t in range(steps):
        actions.append(controller(t, states[-1]))
        states.append(dynamics(states[-1], actions[-1]))
    return np.stack(states, axis=1), np.stack(actions, axis=1)


def linearize(dynamics: Dynamics, states: Array, actions: Array) -> tuple[Array, Array]:
    """Derivatives of the next states, (T, D, D) by state and (T, D, F) by action.

    They are central differences.
    """
    dim = states.shape[1]
    points = np.concatenate([states, actions], axis=1)  # (T, D+F)
    offsets = DIFFERENCE_STEP * np.eye(points.shape[1])
    shifted = points[:, None] + np.concatenate([offsets, -offsets])  # (T, 2(D+F), D+F)
    following = dynamics(*np.split(shifted.reshape(-1, points.shape[1]), [dim], axis=1))
    plus, minus = np.split(following.reshape(*shifted.shape[:2], dim), 2, axis=1)
    jacobian = ((plus - minus) / (2 * DIFFERENCE_STEP)).transpose(0, 2, 1)
    return jacobian[:, :, :dim], jacobian[:, :, dim:]


def _backward(
    A: Array,
    B: Array,
    states: Array,
    actions: Array,
    cost: QuadraticCost,
    action_limit: Array,
    mu: float,
) -> tuple[Array, Array, float]:
    """Changes k (T, F) and gains K (T, F, D) that minimise the local model within the limits.

    Also returns what k gains there.
    """
    gradients, R = cost.state_weights * (states - cost.target), np.diag(cost.action_weights)
    excess = actions - cost.hold_action
    V_x, V_xx = gradients[-1], np.diag(cost.state_weights[-1])
    k, K, gained = np.zeros_like(actions), np.zeros((*actions.shape, states.shape[1])), 0.0
    for t in reversed(range(len(actions))):
        Q_u = R @ excess[t] + B[t].T @ V_x
        Q_uu = R + B[t].T @ V_xx @ B[t] + mu * B[t].T @ B[t]
        Q_ux = B[t].T @ V_xx @ A[t] + mu * B[t].T @ A[t]
        k[t], free = _box_minimum(Q_uu, Q_u, -action_limit - actions[t], action_limit - actions[t])
        K[t, free] = -np.linalg.solve(Q_uu[np.ix_(free, free)], Q_ux[free])
        gained -= float(k[t] @ (Q_u + Q_uu @ k[t] / 2))
        closed = A[t] + B[t] @ K[t]
        V_x = gradients[t] + K[t].T @ R @ (excess[t] + k[t]) + closed.T @ (V_x + V_xx @ B[t] @ k[t])
        V_xx = np.diag(cost.state_weights[t]) + K[t].T @ R @ K[t] + closed.T @ V_xx @ closed
    return k, K, gained


def _box_minimum(
    hessian: Array, gradient: Array, lower: Array, upper: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Minimum of x·gradient + x·hessian·x/2 in a box, (F,), and which entries are off its walls."""
    L = np.linalg.cholesky(hessian)
    # A torque may already be at its limit: the box needs an inside.
    result = lsq_linear(
        L.T, -np.linalg.solve(L, gradient), (lower - 1e-12, upper + 1e-12), method="bvls"
    )
    return result.x, result.active_mask == 0


def _line_search(
    dynamics: Dynamics,
    states: Array,
    actions: Array,
    k: Array,
    K: Array,
    cost: QuadraticCost,
    action_limit: Array,
) -> tuple[Array, Array, float]:
    """The cheapest of the trajectories that go a part LINE_SEARCH of the way.

    All are simulated at once.
    """

    def changed(t: int, new_states: Array) -> Array:
        change = LINE_SEARCH[:, None] * k[t] + (new_states - states[t]) @ K[t].T
        return (actions[t] + change).clip(-action_limit, action_limit)

    starts = np.tile(states[0], (len(LINE_SEARCH), 1))
    all_states, all_actions = roll_out(dynamics, starts, changed, len(actions))
    costs = cost(all_states, all_actions)
    best = costs.argmin()
    return all_states[best], all_actions[best], float(costs[best])


def _lqr_gain(A: Array, B: Array, P: Array, R: Array) -> Array:
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
