"""The two tasks of gymnasium start and move as they say; teachers do what they demonstrate."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import torch

from reproduction.teachers.gym_teachers import (
    CART_STEPS,
    HOLD_FROM,
    PENDULUM_STEPS,
    TORQUE_LIMIT,
    balancing_teacher,
    pendulum_teacher,
)
from reproduction.teachers.trajectory_optimization import (
    Array,
    Dynamics as ArrayDynamics,
    roll_out,
)
from torch_pmil.envs import gym_tasks
from torch_pmil.envs.gym_tasks import (
    cart_dynamics,
    gym_pendulum_env,
    inverted_pendulum_env,
    pendulum_dynamics,
)
from torch_pmil.envs.rollouts import rollout_of, states_of
from torch_pmil.tasks.registry import load_experiment

STARTS = 500
each_task = pytest.mark.parametrize("name", ["inverted_pendulum", "gym_pendulum"])


@pytest.mark.parametrize(
    ("name", "make_env", "kurtosis"),
    [("inverted_pendulum", inverted_pendulum_env, 1.8), ("gym_pendulum", gym_pendulum_env, 3.0)],
)
def test_starts_have_the_moments_of_the_task(name: str, make_env: object, kurtosis: float) -> None:
    """Uniform ones of the cart, normal ones of the pendulum."""
    env, initial = make_env(seed=0), load_experiment(name).initial
    starts = torch.stack([env.reset()["observation"] for _ in range(STARTS)])
    assert name == "gym_pendulum" or starts.abs().max() <= 0.1
    assert ((starts.mean(0) - initial.mean).abs() <= 4 * initial.std / STARTS**0.5).all()
    tolerance = 4 * ((kurtosis - 1) / 4 / STARTS) ** 0.5
    assert ((starts.std(0) / initial.std - 1).abs() <= tolerance).all()


def test_pendulum_moves_by_its_equation_with_the_torque_held_for_both_steps() -> None:
    """g = 10 m/s², m = 1 kg, l = 1 m, Euler steps of 0.05 s, as gymnasium documents them."""
    env = gym_pendulum_env(seed=1)
    rollout = env.rollout(40)
    for step in rollout:
        (q, dq), torque = step["observation"].tolist(), step["action"].item()
        for _ in range(2):
            dq = min(max(dq + (15 * math.sin(q) + 3 * torque) * 0.05, -8), 8)
            q += dq * 0.05
        after = step["next", "observation"].tolist()
        assert after == pytest.approx([q, dq], abs=1e-5), "gymnasium shows float32"


@pytest.mark.parametrize(
    ("make_env", "dynamics", "tolerance"),
    [(inverted_pendulum_env, cart_dynamics, 1e-6), (gym_pendulum_env, pendulum_dynamics, 1e-5)],
)
def test_what_the_teacher_plans_with_is_the_environment(
    make_env: object, dynamics: object, tolerance: float
) -> None:
    rollout = make_env(seed=2).rollout(20)
    predicted = dynamics()(rollout["observation"].numpy(), rollout["action"].numpy())
    np.testing.assert_allclose(predicted, rollout["next", "observation"], rtol=0, atol=tolerance)


def test_match_space_of_the_cart_is_where_mujoco_has_cart_and_tip() -> None:
    """Up to the pole's lean of 1 mm over its 0.6 m."""
    space = load_experiment("inverted_pendulum").space
    model = gym_tasks.gymnasium.make("InvertedPendulum-v5").unwrapped.model
    data, state = mujoco.MjData(model), torch.tensor([0.3, -0.4, 0.0, 0.0], dtype=torch.float64)
    data.qpos[:] = state[:2]
    mujoco.mj_forward(model, data)
    pole = data.body("pole")
    tip = pole.xpos + pole.xmat.reshape(3, 3) @ [0.0, 0.0, 0.6]
    expected = [data.body("cart").xpos[0], tip[0], tip[2]]
    np.testing.assert_allclose(space.observe(state), expected, rtol=0, atol=1e-12)


def teacher_error(
    name: str, dynamics: ArrayDynamics, starts: Array, teacher: object, steps: int
) -> torch.Tensor:
    states, _ = roll_out(dynamics, starts, teacher, steps)
    return load_experiment(name).error(rollout_of(torch.from_numpy(states)))


def test_cart_teacher_meets_the_criterion_from_every_corner_of_the_starts() -> None:
    corners = 0.1 * np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1).T
    teacher, task = balancing_teacher(), "inverted_pendulum"
    error = teacher_error(task, cart_dynamics(), corners, teacher, CART_STEPS)
    assert error.max() < load_experiment(task).tolerance


def test_pendulum_teacher_meets_the_criterion_three_standard_deviations_off() -> None:
    teacher, signs = pendulum_teacher(), np.array(np.meshgrid([-1, 1], [-1, 1])).reshape(2, -1).T
    corners = np.array([math.pi, 0.0]) + 3 * np.array([0.05, 0.1]) * signs
    error = teacher_error("gym_pendulum", pendulum_dynamics(), corners, teacher, PENDULUM_STEPS)
    assert error.max() < 0.25
    assert np.abs(teacher.plan.states[HOLD_FROM]).max() < 0.1
    assert np.abs(teacher(0, 10 * corners)).max() == TORQUE_LIMIT


@each_task
def test_shipped_demonstrations_are_successes_and_show_no_more_than_positions(name: str) -> None:
    task = load_experiment(name)
    shown = task.demonstrations
    states = task.demonstrated_states.reshape(len(shown.positions), -1, task.space.dim)
    assert (task.error(rollout_of(states)) <= task.tolerance).all()
    torch.testing.assert_close(task.space.observe(states), shown.positions, rtol=0, atol=2e-3)
    assert shown.names == task.space.match_space.names


def test_basis_functions_begin_as_wide_as_said() -> None:
    experiment = load_experiment("inverted_pendulum")
    std = experiment.demonstrated_states.std(0)  # the state is its own features
    policy = experiment.make_policy(torch.Generator().manual_seed(0))
    torch.testing.assert_close(policy.scale, 3 * std)
    distances = (policy.centres * policy.scale)[:, None] - experiment.demonstrated_states
    # centres lie near demonstrated states whatever the width
    assert (distances / std).norm(dim=-1).amin(1).max() < 1


@each_task
def test_velocities_recovered_from_demonstrations_are_those_of_the_motion(name: str) -> None:
    experiment = load_experiment(name)
    env, dim = experiment.make_env(seed=0), experiment.space.dim
    still = torch.zeros(1, dtype=torch.float64)
    states = states_of(env.rollout(8, lambda tensordict: tensordict.set("action", still)))
    positions, velocities = states[:, : dim // 2], states[:, dim // 2 :]
    recovered = torch.gradient(positions, spacing=env.control_period, dim=0)[0]
    error = (recovered - velocities)[1:-1].abs().max()
    assert error < 0.25 * velocities.abs().max() + 0.02


@each_task
def test_missing_gymnasium_is_one_clear_line(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setattr(gym_tasks, "gymnasium", None)
    with pytest.raises(ModuleNotFoundError) as error:
        load_experiment(name)
    line = "this task needs gymnasium, which is not installed: pip install 'torch_pmil[gym]'"
    assert str(error.value) == line
