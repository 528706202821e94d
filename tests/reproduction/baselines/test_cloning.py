"""Recorded torques: cloned where they were recorded, and what other masses would need."""

from __future__ import annotations

import pytest
import torch

from reproduction.baselines import cloning
from reproduction.learned import measured_success
from reproduction.masses import with_second_link
from tests.helpers.draws import Draws
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, link_positions


def test_peak_at_the_demonstrated_mass_is_of_the_applied_torques_and_grows_with_mass(
    draws: Draws,
) -> None:
    env, torques = DoublePendulumEnv(num_envs=2, seed=0), draws.uniform(-3.0, 3.0, 2, 3, 2)
    states = [env.reset()["observation"]]
    for step in range(3):
        states.append(env.simulate(states[-1], torques[:, step]))
    peaks = cloning.peak_tracking_torques(torch.stack(states, 1), torques, (0.5, 1.0, 2.0))
    torch.testing.assert_close(peaks[:, 0], torques.abs().amax((1, 2)), rtol=0, atol=1e-9)
    assert (peaks[:, 2] > peaks[:, 1]).all()


@pytest.mark.slow
def test_seed_0_is_the_shipped_demonstrations_and_its_clone_swings_up_where_it_learned() -> None:
    states, torques = next(cloning.record_pairs([0]))
    shipped = shipped_demonstrations("double_pendulum").positions
    torch.testing.assert_close(link_positions(states), shipped, rtol=0, atol=1e-6)
    clone = cloning.clone_double_pendulum(states, torques)
    robots = with_second_link(0.5), with_second_link(1.0)
    rates = [measured_success(clone, robot, starts=20, seed=1) for robot in robots]
    assert rates == [pytest.approx(1.0, abs=0.1), 0.0]
