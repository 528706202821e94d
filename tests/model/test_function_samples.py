"""Functions drawn from a posterior beside its moments, and the trajectories that follow them."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.losses import SPACE, make_parts
from tests.helpers.two_ways import formulas_alone, kernels_alone
from tests.model.test_rollout import assert_moments_of
from torch_pmil.control.rbf_policy import Controller, RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.function_samples import FunctionSamples
from torch_pmil.model.rollout import predict_mean_trajectory, predict_trajectory
from torch_pmil.model.sampled_rollouts import (
    follow_functions,
    noise_of_steps,
    sample_consistent_rollouts,
)

PLAIN = StateSpace(("a", "b"), ("", ""), (), joint_match(("a", "b"), ("", "")))
SETS, OF_A_SET = 400, 250  # sets of frequencies, and functions that share one
POINTS = torch.tensor([[0.0, 0.3], [0.9, -0.4], [2.5, 0.2]], dtype=torch.float64)  # the last is far


def smooth_model(draws: Draws, n: int = 20, most_exact: int = 1000) -> GPDynamics:
    """Two outputs of two inputs, with lengthscales and signals of their own."""
    dynamics = GPDynamics(2, 2, most_exact=most_exact, num_inducing=min(12, most_exact))
    inputs = draws.normal(n, 2)
    dynamics.set_data(inputs, torch.stack([inputs[:, 0].sin(), inputs[:, 1]], -1))
    kernel = dynamics.gp.covar_module
    kernel.base_kernel.lengthscale = torch.tensor([[[1.0, 1.5]], [[2.0, 0.8]]])
    kernel.outputscale = torch.tensor([0.5, 2.0])
    dynamics.gp.likelihood.noise = torch.tensor([[0.05], [0.02]])
    dynamics._expansion = None
    return dynamics


@torch.no_grad()
def posterior_at(dynamics: GPDynamics, points: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (E, P) and covariance (E, P, P) of each output at several points."""
    f = dynamics.expansion
    k = f.kernel(points).transpose(0, 1)  # (E, P, n)
    prior = (
        KernelExpansion(
            points, torch.ones(2, len(points)).double(), f.lengthscales, f.signal_variance
        )
        .kernel(points)
        .transpose(0, 1)
    )
    return f.mean(points).mT, prior - k @ f.gram_inverse @ k.mT


@pytest.mark.parametrize("most_exact", [1000, 15], ids=["exact", "sparse"])
def test_functions_have_the_posterior_mean_and_covariance_at_several_points(
    draws: Draws, most_exact: int
) -> None:
    """Of all pairs of points, so that each function is consistent; within 4.5 standard errors.

    Functions that share frequencies are no independent draws of a covariance, but their sets are.
    """
    dynamics = smooth_model(draws, most_exact=most_exact)
    assert dynamics.sparse == (most_exact == 15)
    mean, cov = posterior_at(dynamics, POINTS)
    means, covs = [], []
    for _ in range(SETS):
        functions = dynamics.functions(OF_A_SET, draws.generator)
        values = functions(POINTS.expand(OF_A_SET, -1, -1)) - mean.mT  # (N, P, E)
        means.append(values.mean(0).mT)
        covs.append(torch.einsum("npe,nqe->epq", values, values) / OF_A_SET)
    for sets, expected in ((means, torch.zeros_like(mean)), (covs, cov)):
        found = torch.stack(sets)
        error = (found.mean(0) - expected).abs() / (found.std(0) / math.sqrt(SETS))
        assert error.max() < 4.5


def test_functions_agree_where_there_are_data_and_differ_far_away(draws: Draws) -> None:
    """Near data their spread is at most that of the noise, far from them that of the prior."""
    dynamics = smooth_model(draws)
    functions, f = dynamics.functions(500, draws.generator), dynamics.expansion
    near = functions(f.inputs[:1].expand(500, -1))
    far = functions(torch.full((500, 2), 50.0, dtype=torch.float64))
    assert (near.std(0) < f.noise.sqrt()).all()
    assert_close(far.std(0), f.signal_variance.sqrt(), rtol=0.2, atol=0)


def test_functions_without_update_and_waves_give_the_mean_trajectory(draws: Draws) -> None:
    policy, dynamics = make_parts(draws)
    drawn = dynamics.functions(3, draws.generator)
    f = dynamics.expansion
    mean = FunctionSamples(f, drawn.frequencies, 0 * drawn.weights, f.weights.expand(3, -1, -1))
    start, noise = draws.normal(3, 2), torch.zeros(3, 5, 2, dtype=torch.float64)
    states = follow_functions(start, policy, mean, dynamics, SPACE, noise)
    assert_close(states, predict_mean_trajectory(start, policy, dynamics, SPACE, 5))


@torch.no_grad()
def test_one_step_has_the_moments_that_are_matched(draws: Draws) -> None:
    """Exact for one step, whatever function each particle follows."""
    policy, dynamics = RBFPolicy(torch.zeros(1, 2), torch.ones(1), torch.ones(2)), GPDynamics(3, 2)
    inputs = draws.normal(25, 3)
    dynamics.set_data(inputs, torch.stack([inputs[:, 0].sin(), inputs[:, 1]], -1))
    dynamics.gp.likelihood.noise = torch.full((2, 1), 0.05, dtype=torch.float64)
    state = draws.belief(2)
    samples = torch.cat(
        [
            sample_consistent_rollouts(
                state,
                policy,
                dynamics.functions(200, draws.generator),
                200,
                dynamics,
                PLAIN,
                1,
                draws.generator,
            )
            for _ in range(500)
        ]
    )
    assert_moments_of(samples[:, 1], predict_trajectory(state, policy, dynamics, PLAIN, 1)[0])


def moved_policy(draws: Draws) -> tuple[RBFPolicy, GPDynamics]:
    """A policy whose actions are not around zero, and its model."""
    policy, dynamics = make_parts(draws)
    policy.u_middle.fill_(0.7)
    policy.weights.data = draws.normal(*policy.weights.shape)
    return policy, dynamics


@pytest.mark.parametrize("units", [None, torch.tensor([0.5, 0.9]).double()], ids=["free", "bound"])
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_kernels_and_formulas_agree(
    draws: Draws, batch: tuple[int, ...], units: Tensor | None
) -> None:
    policy, dynamics = moved_policy(draws)
    functions = dynamics.functions(7, draws.generator)
    start, results = draws.normal(7, *batch, 2), []
    noise = noise_of_steps(dynamics, (7, *batch, 5), draws.generator)
    for alone in (formulas_alone, kernels_alone):
        variables = [start.clone().requires_grad_(), *policy.parameters()]
        with alone():
            states = follow_functions(
                variables[0], policy, functions, dynamics, SPACE, noise, units
            )
            gradients = torch.autograd.grad(states.square().sum(), variables)
        results.append([states.detach(), *gradients])
    for formula, kernel in zip(*results, strict=True):
        assert_close(kernel, formula, rtol=1e-10, atol=1e-12 * formula.abs().max().item())


def test_gradient_in_starts_and_policy(draws: Draws) -> None:
    policy, dynamics = moved_policy(draws)
    functions = dynamics.functions(3, draws.generator)
    noise = noise_of_steps(dynamics, (3, 4), draws.generator)

    def states(start: Tensor, centres: Tensor, weights: Tensor, log_widths: Tensor) -> Tensor:
        one = torch.ones(1, dtype=torch.float64)
        network = KernelExpansion(centres, weights, log_widths.exp(), one)
        controller = Controller(network, policy.u_max, policy.u_middle)
        actor = SimpleNamespace(controller=controller)
        return follow_functions(start, actor, functions, dynamics, SPACE, noise)

    variables = draws.normal(3, 2), draws.normal(4, 3), draws.normal(1, 4), draws.normal(1, 3) / 3
    with kernels_alone():
        assert gradcheck(states, tuple(variable.requires_grad_() for variable in variables))


def test_bound_shortens_the_cotangent_of_a_particle_that_tumbles_alone(draws: Draws) -> None:
    """To the norm one in these units; that of another particle stays as it is."""
    policy, dynamics = make_parts(draws)
    functions, start = dynamics.functions(2, draws.generator), draws.normal(2, 2)
    noise = torch.zeros(2, 1, 2, dtype=torch.float64)
    weight = torch.tensor([1e6, 1e-6], dtype=torch.float64)
    units = torch.tensor([0.5, 2.0], dtype=torch.float64)
    gradients = []
    for each in (None, units):
        x = start.clone().requires_grad_()
        states = follow_functions(x, policy, functions, dynamics, SPACE, noise, each)
        gradients.append(torch.autograd.grad((weight[:, None, None] * states).sum(), x)[0])
    norm = (1e6 * units).norm()
    assert_close(gradients[1][0], gradients[0][0] / norm)
    assert torch.equal(gradients[1][1], gradients[0][1])


def test_rollouts_repeat_themselves_and_begin_at_the_start(draws: Draws) -> None:
    policy, dynamics = make_parts(draws)
    certain = Gaussian(draws.normal(2), torch.zeros(2, 2, dtype=torch.float64))
    functions = dynamics.functions(5, draws.generator)
    one, again = (
        sample_consistent_rollouts(
            certain, policy, functions, 5, dynamics, SPACE, 4, torch.Generator().manual_seed(3)
        )
        for _ in range(2)
    )
    assert one.shape == (5, 5, 2) and torch.equal(one, again)
    assert_close(one[:, 0], certain.mean.expand(5, 2))
