"""Cloning over the mass: success is measured on the named robots, peaks are those of exact tracking."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.draws import Draws
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, link_positions
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.paper import cloning
from torch_pmil.experiments.paper.cloning import (
    MASSES,
    clone_double_pendulum,
    needed_runs,
    peak_tracking_torques,
    record_pairs,
    report,
    success_over_mass,
)
from torch_pmil.policy import RBFPolicy
from torch_pmil.state_policy import StatePolicy


def motionless_policy() -> StatePolicy:
    experiment = load_experiment("double_pendulum")
    policy = RBFPolicy(torch.zeros(1, 6), experiment.u_max, torch.ones(6))
    return StatePolicy(policy, experiment.space, 0.1)


def test_a_policy_that_does_nothing_never_succeeds() -> None:
    assert success_over_mass(motionless_policy(), (0.3, 1.0), starts=2, seed=0) == [0.0, 0.0]


def test_success_is_measured_on_robots_of_those_masses_from_the_same_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    robots: list[DoublePendulumEnv] = []

    def make_env(*settings: object, **keywords: object) -> DoublePendulumEnv:
        robots.append(DoublePendulumEnv(*settings, **keywords))
        return robots[-1]

    monkeypatch.setattr(cloning, "DoublePendulumEnv", make_env)
    success_over_mass(motionless_policy(), (0.3, 1.0), starts=2, seed=7)
    assert [tuple(robot.model.body(link).mass.item() for link in ("link1", "link2")) for robot in robots] == [(0.5, 0.3), (0.5, 1.0)]
    assert {tuple(robot.batch_size) for robot in robots} == {(2,)}
    assert torch.equal(robots[0].reset()["observation"], robots[1].reset()["observation"])


def test_at_the_demonstrators_mass_the_peak_is_that_of_the_applied_torques_and_it_grows_with_the_mass(draws: Draws) -> None:
    env, torques = DoublePendulumEnv(num_envs=2, seed=0), draws.uniform(-3.0, 3.0, 2, 3, 2)
    states = [env.reset()["observation"]]
    for step in range(3):
        states.append(env.simulate(states[-1], torques[:, step]))
    peaks = peak_tracking_torques(torch.stack(states, 1), torques, (0.5, 1.0, 2.0))
    torch.testing.assert_close(peaks[:, 0], torques.abs().amax((1, 2)), rtol=0, atol=1e-9)
    assert (peaks[:, 2] > peaks[:, 1]).all()


def test_cloning_needs_no_runs() -> None:
    assert needed_runs(Path("runs"), False) == []


@pytest.mark.slow
def test_seed_0_is_the_shipped_demonstrations_and_its_clone_swings_up_where_it_learned() -> None:
    states, torques = next(record_pairs([0]))
    torch.testing.assert_close(link_positions(states), shipped_demonstrations("double_pendulum").positions, rtol=0, atol=1e-6)
    assert success_over_mass(clone_double_pendulum(states, torques), (0.5, 1.0), starts=20, seed=1) == [pytest.approx(1.0, abs=0.1), 0.0]


@pytest.mark.slow
def test_report_has_a_rate_and_a_peak_for_every_mass() -> None:
    made = report([], quick=True)
    assert {f"{name}_{mass:g}kg" for mass in MASSES for name in ("success_rate", "peak_torque")} < made.headline.keys()
    assert [len(rates) for rates in made.details["success_rates"]] == [len(MASSES)] * len(made.details["seeds"])
    assert list(made.figures) == ["cloning"]
