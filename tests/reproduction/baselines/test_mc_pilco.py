"""Particles on our model: their cost, its gradient, and the policy that is learned from them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from reproduction.baselines.mc_pilco import MCPilco, _bounded
from tests.helpers.draws import Draws
from tests.helpers.short_run import short_experiment
from tests.reproduction.baselines.test_bco import linear_system
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search.saturating_cost import expected_saturating_cost
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SEED, PERIOD = 100, 0.1


def unexplained(peer: MCPilco) -> None:
    """Let the model's data be so far away that all it says is its prior: draws of mean 0."""
    far = torch.full((2, peer.dynamics.num_inputs), 1e6, dtype=torch.float64)
    peer.dynamics.set_data(far, torch.zeros(2, peer.dynamics.num_outputs, dtype=torch.float64))


def test_mean_cost_of_linear_motion_is_that_of_its_moments() -> None:
    experiment = load_experiment("biorob")  # which is matched in its state
    peer = MCPilco(experiment, SEED, scale=1e5, particles=20_000, centres=1)
    peer.policy.weights.data.zero_()
    unexplained(peer)
    model, known = peer.dynamics.expansion, peer.dynamics.known_part(experiment.space)
    A, C = known.matrix[:, : experiment.space.dim], known.gain
    start, demonstrated = experiment.initial, experiment.demonstrated
    spread = torch.diag_embed(model.signal_variance + model.noise)
    mean, cov, expected = start.mean, start.cov, []
    steady = known.matrix[:, experiment.space.dim :] @ experiment.actions.middle
    for target, target_cov in zip(demonstrated.mean, demonstrated.cov, strict=True):
        mean, cov = A @ mean + steady, A @ cov @ A.mT + C @ spread @ C.mT
        white = torch.linalg.inv(torch.linalg.cholesky(1e5 * target_cov))
        residual = Gaussian(white @ (mean - target), white @ cov @ white.mT)
        expected.append(expected_saturating_cost(residual))
    total, steps = torch.stack(expected).sum(), experiment.horizon
    assert 0.05 * steps < total < 0.95 * steps  # or it would be saturated
    with torch.no_grad():
        offset = peer.simulate(0.0) - demonstrated.mean
        found = peer.cost(0.0)
    white = torch.linalg.solve_triangular(peer._factor, offset[..., None], upper=False)
    each = (1 - (-white.square().sum((-2, -1)) / 2).exp()).sum(-1)
    assert abs(found - total) < 4 * each.std() / len(each) ** 0.5


@pytest.mark.parametrize("most_slope", [None, 1e9])
def test_gradient_is_that_of_differences(most_slope: float | None, draws: Draws) -> None:
    """Also with a bound that no slope reaches."""
    peer = MCPilco(short_experiment(), SEED, most_slope=most_slope, particles=9, centres=4)
    states = peer.experiment.initial.mean + draws.normal(10, 4)
    inputs = torch.cat([peer.experiment.space.features(states), draws.normal(10, 2)], -1)
    peer.dynamics.set_data(inputs, draws.normal(10, peer.dynamics.num_outputs))

    def cost(shift: float) -> Tensor:
        peer.generator.manual_seed(0)
        with torch.no_grad():
            for parameter, step in zip(peer.policy.parameters(), direction, strict=True):
                parameter += shift * step
        return peer.cost(0.25)

    direction = [torch.zeros_like(p) for p in peer.policy.parameters()]
    slopes = torch.autograd.grad(cost(0.0), list(peer.policy.parameters()))
    direction = [slope / slope.norm() for slope in slopes]
    h = 1e-5
    with torch.no_grad():
        above, below = cost(h), cost(-2 * h)  # the second from where the first is
    expected = sum(slope.norm() for slope in slopes)
    torch.testing.assert_close((above - below) / (2 * h), expected, rtol=1e-5, atol=1e-8)


def test_bounded_slopes_keep_their_direction(draws: Draws) -> None:
    slopes = draws.normal(50, 4)
    slopes[0] = 0
    bounded, norms = _bounded(1.5)(slopes), slopes.norm(dim=-1)
    assert (norms < 1.5).any() and (norms > 1.5).any()
    torch.testing.assert_close(bounded.norm(dim=-1), norms.clamp(max=1.5))
    torch.testing.assert_close(bounded * norms[:, None], slopes * norms.clamp(max=1.5)[:, None])


def pushed() -> Task:
    """Four steps of two free bodies, whose demonstrations are those of a push of 1 N·m each."""
    experiment = short_experiment()
    velocities = torch.arange(5, dtype=torch.float64) / 2
    states = experiment.initial.mean.repeat(5, 1)
    states[:, 1::2] += velocities[:, None]
    states[:, 0::2] += PERIOD * velocities.cumsum(0)[:, None]
    shown = experiment.space.observe(states)
    noise = 0.01 * torch.randn(
        10, *shown.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    )
    demonstrations = replace(experiment.demonstrations, positions=shown + noise)
    return replace(experiment, demonstrations=demonstrations, demonstrated_states=states)


def test_policy_of_free_bodies_learns_to_push_as_demonstrated() -> None:
    peer = MCPilco(pushed(), SEED, scale=10.0, most_steps=150, particles=50, centres=20)
    transitions = linear_system(seed=1, steps=60)
    following = transitions["next", "observation"]
    following[:, 0::2] += PERIOD * following[:, 1::2]
    peer.add(transitions)
    peer.fit()
    first, last = (sum(costs) / 10 for costs in (peer.costs[:10], peer.costs[-10:]))
    assert first > 1 and last < 0.3 * first
    start = peer.experiment.initial.mean
    torch.testing.assert_close(peer.act(0, start), torch.ones(2).double(), rtol=0, atol=0.5)


def test_actions_are_within_their_limits_anywhere(draws: Draws) -> None:
    experiment = load_experiment("double_pendulum")
    peer = MCPilco(experiment, SEED, centres=30)
    peer.policy.weights.data.mul_(1e6)
    actions = peer.act(0, 10 * draws.normal(7, 100, 4))
    assert actions.shape == (7, 100, 2) and actions.dtype == torch.float64
    limits = experiment.actions
    assert (actions >= limits.low).all() and (actions <= limits.high).all()


def test_search_goes_on_from_the_last_policy() -> None:
    peer = MCPilco(short_experiment(), SEED, most_steps=1, particles=2, centres=3)
    peer.add(linear_system(seed=1, steps=30))
    before = peer.policy.weights.detach().clone()
    for fits in (1, 2):
        peer.fit()
        moved = (peer.policy.weights.detach() - before).abs().max()
        assert 0 < moved < 0.0101 * fits  # Adam's steps are its learning rate
