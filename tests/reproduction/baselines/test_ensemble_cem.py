"""The ensemble of networks, and the planner that tracks the demonstrations with it."""

from __future__ import annotations

import torch

from reproduction.baselines.cross_entropy_method import minimise_by_cem
from reproduction.baselines.ensemble_cem import EnsembleCEM
from reproduction.baselines.network_ensemble import MEMBERS
from tests.reproduction.baselines.test_bco import linear_system
from torch_pmil.tasks.registry import load_experiment

SEED = 100


def test_planner_finds_the_minimum_of_a_quadratic_for_each_robot() -> None:
    generator = torch.Generator().manual_seed(0)
    best = 0.8 * (2 * torch.rand(3, 4, 2, generator=generator) - 1)

    def cost(plans: torch.Tensor) -> torch.Tensor:
        return (plans - best.unsqueeze(1)).square().sum((-2, -1))

    plan = minimise_by_cem(cost, torch.zeros(3, 4, 2), 0.5, 400, 40, 12, generator)
    torch.testing.assert_close(plan, best, atol=0.02, rtol=0)


def test_model_recovers_a_linear_system() -> None:
    peer = EnsembleCEM(load_experiment("double_pendulum"), SEED, steps=500, learning_rate=3e-3)
    peer.add(linear_system(seed=1))
    peer.fit()
    other = linear_system(seed=2)
    states, fractions = other["observation"].float(), other["action"].float() / 3.5
    predicted = peer.model.sample(states.expand(MEMBERS, -1, -1), fractions.expand(MEMBERS, -1, -1))
    differences = (other["next", "observation"] - other["observation"]).float()
    error = predicted.mean(0) - states - differences
    assert error.square().mean() < 0.02 * differences.square().mean()


def test_cost_of_the_demonstrated_states_is_small_and_that_of_others_saturates() -> None:
    peer = EnsembleCEM(load_experiment("double_pendulum"), SEED, most_cost=10.0)
    shown, later = peer.demonstrated_transitions
    steps = peer.experiment.horizon
    costs = [peer.step_cost(4, states.float()) for states in (later[4::steps], shown[::steps])]
    assert costs[0].max() < 2 and costs[1].min() > 5 and costs[1].max() <= 10


def test_actions_are_within_the_limits_up_to_the_last_step() -> None:
    experiment = load_experiment("double_pendulum")
    peer = EnsembleCEM(experiment, SEED, candidates=8, elites=2, iterations=1, plan_seconds=0.3)
    starts = experiment.initial.mean.expand(5, -1)
    for step in range(experiment.horizon):
        actions = peer.act(step, starts)
        assert actions.shape == (5, 2) and actions.abs().max() <= 3.5
    assert peer.act(0, starts[0]).shape == (2,)
