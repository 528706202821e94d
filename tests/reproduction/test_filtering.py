"""The extended Kalman filter: exact where the robot is linear, with the right slopes elsewhere."""

from __future__ import annotations

import torch
from torch import Tensor

from reproduction.filtering import FilteredPolicy, KalmanFilter, of_robot, slopes
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.tasks.registry import load_experiment

STEPS = 4
A = torch.tensor([[1.0, 0.1], [-0.3, 0.9]], dtype=torch.float64)
B = torch.tensor([[0.0], [0.5]], dtype=torch.float64)
PROCESS = torch.tensor([[0.02, 0.01], [0.01, 0.05]], dtype=torch.float64)
READINGS = torch.tensor([0.3, 0.7], dtype=torch.float64)


def test_belief_in_a_linear_robot_is_its_state_given_all_readings() -> None:
    generator = torch.Generator().manual_seed(0)
    readings = torch.randn(STEPS + 1, 3, 2, dtype=torch.float64, generator=generator)
    actions = torch.randn(STEPS, 3, 1, dtype=torch.float64, generator=generator)
    kalman = KalmanFilter(lambda x, u: x @ A.T + u @ B.T, lambda x, u: PROCESS, READINGS)
    start = Gaussian(torch.ones(3, 2).double(), torch.eye(2).double().expand(3, 2, 2))
    belief = kalman.updated(start, readings[0])
    for action, reading in zip(actions, readings[1:], strict=True):
        belief = kalman.updated(kalman.predicted(belief, action), reading)

    # the states x_0..x_T are one Gaussian, conditioned on all readings at once
    means, cov = [start.mean], torch.zeros(2 * (STEPS + 1), 2 * (STEPS + 1)).double()
    cov[:2, :2] = torch.eye(2)
    for t, action in enumerate(actions):
        now, then = slice(2 * t, 2 * t + 2), slice(2 * t + 2, 2 * t + 4)
        means.append(means[-1] @ A.T + action @ B.T)
        cov[then, : 2 * t + 2] = A @ cov[now, : 2 * t + 2]
        cov[: 2 * t + 2, then] = cov[then, : 2 * t + 2].T
        cov[then, then] = A @ cov[now, now] @ A.T + PROCESS
    noise = torch.diag(READINGS.repeat(STEPS + 1) ** 2)
    gain = torch.linalg.solve(cov + noise, cov).T[-2:]
    mean = torch.cat(means, -1)
    innovation = readings.transpose(0, 1).flatten(1) - mean
    torch.testing.assert_close(belief.mean, means[-1] + innovation @ gain.T, rtol=0, atol=1e-8)
    expected = (cov[-2:] - gain @ cov)[:, -2:].expand(3, 2, 2)
    torch.testing.assert_close(belief.cov, expected, rtol=0, atol=1e-8)


def test_slopes_are_those_of_the_function() -> None:
    def turned(states: Tensor, actions: Tensor) -> Tensor:
        return torch.stack([states.prod(-1).sin(), states[:, 1] ** 3 + actions[:, 0]], -1)

    states = torch.tensor([[0.5, -1.0], [2.0, 0.3]], dtype=torch.float64)
    actions = torch.ones(2, 1, dtype=torch.float64)
    exact = [
        torch.autograd.functional.jacobian(lambda x, u=u: turned(x[None], u[None])[0], state)
        for state, u in zip(states, actions, strict=True)
    ]
    found = slopes(turned, states, actions, 1e-5 * READINGS)
    # the error of central differences is of second order, and rounding adds 1e-16 / 1e-5
    torch.testing.assert_close(found, torch.stack(exact), rtol=0, atol=1e-9)


def test_a_policy_behind_sensors_without_noise_acts_as_it_does_alone() -> None:
    task = load_experiment("double_pendulum")
    network = task.make_policy(torch.Generator().manual_seed(0))
    policy = StatePolicy(network, task.space, task.time_step, actions=task.actions)
    exact = of_robot(task.robot(0), torch.full((4,), 1e-9, dtype=torch.float64))
    filtered = FilteredPolicy(policy, exact, task.initial)
    with torch.no_grad():
        ways = [
            task.robots(2, 1).rollout(3, each.as_tensordict_module())["action"]
            for each in (filtered, policy)
        ]
    # what a reading says beside what was predicted counts by 1 - 1e-18 / 1e-4
    torch.testing.assert_close(*ways, rtol=0, atol=1e-8)
