"""The robot whose torques take effect late, and the measures of calibration."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from reproduction.delay_calibration import Calibration, DelayedDoublePendulumEnv, with_delay
from tests.helpers.draws import Draws
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.gp.gaussian import Gaussian

STEPS = 8


@pytest.fixture
def torques(draws: Draws) -> Tensor:
    return draws.uniform(-3.5, 3.5, STEPS, 2)


def states(env: DoublePendulumEnv, torques: Tensor) -> Tensor:
    given = iter(torques)
    return states_of(env.rollout(len(torques), lambda observation: next(given)))


def test_robot_is_as_late_as_it_says(torques: Tensor) -> None:
    prompt, late = DelayedDoublePendulumEnv(0.0, seed=3), DelayedDoublePendulumEnv(0.1, seed=3)
    assert torch.equal(states(prompt, torques), states(DoublePendulumEnv(seed=3), torques))
    before = torch.cat([torch.zeros(1, 2, dtype=torch.float64), torques[:-1]])
    expected = states(DoublePendulumEnv(seed=3), before)
    torch.testing.assert_close(states(late, torques), expected)


def test_robot_that_is_half_a_period_late_is_one_of_twice_the_rate(torques: Tensor) -> None:
    """Each torque acts in the second half of its period and in the first half of the next."""
    halves = torch.cat(
        [torch.zeros(1, 2, dtype=torch.float64), torques.repeat_interleave(2, 0)[:-1]]
    )
    late = states(DelayedDoublePendulumEnv(0.05, seed=3), torques)
    fast = states(DoublePendulumEnv(control_period=0.05, seed=3), halves)
    torch.testing.assert_close(late, fast[::2])


def test_torques_of_a_rollout_do_not_act_on_in_the_next(torques: Tensor) -> None:
    env = DelayedDoublePendulumEnv(0.1, initial_std=[0.0] * 4, seed=0)
    first, second = states(env, torques), states(env, torques)
    assert torch.equal(first, second)


def test_names_tell_the_delay() -> None:
    assert with_delay(0.0).name == "double_pendulum"
    assert with_delay(0.02).name == "double_pendulum_late_20ms"
    assert with_delay(0.02).robot(seed=0).late_substeps == 10


def test_right_beliefs_are_calibrated(draws: Draws) -> None:
    """To five standard errors of 20,000 draws of 3 entries."""
    belief = Gaussian(draws.normal(20_000, 3), draws.cov(20_000, 3))
    found = Calibration.of(belief, belief.sample(1, draws.generator)[0])
    n = 3 * 20_000
    assert found.coverage == pytest.approx(0.9545, abs=5 * (0.9545 * 0.0455 * 3 / n) ** 0.5)
    assert found.standardised_error == pytest.approx(1, abs=5 * (3 / (2 * n)) ** 0.5)
    entropy = torch.distributions.MultivariateNormal(belief.mean, belief.cov).entropy().mean()
    assert found.nll == pytest.approx(entropy.item(), abs=5 * (1.5 / 20_000) ** 0.5)


def test_beliefs_that_are_too_sure_are_told_apart(draws: Draws) -> None:
    belief = Gaussian(torch.zeros(2000, 1).double(), torch.ones(2000, 1, 1).double())
    found = Calibration.of(belief, 3 * draws.normal(2000, 1))
    assert found.coverage < 0.6
    assert found.standardised_error == pytest.approx(3, rel=0.1)
    assert found.nll > Calibration.of(belief, draws.normal(2000, 1)).nll + 3
