"""Time of single steps, with pytest-benchmark: ``make benchmark-steps``.

``make test`` leaves them out.

Each is measured with its gradient. The least time is comparable even between loaded machines.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from benchmarks.workloads import Problem, make_problem
from torch_pmil import Gaussian, moment_match
from torch_pmil.gp.gaussian import joint
from torch_pmil.model.rollout import predict_step

pytest.importorskip("pytest_benchmark")
torch.set_num_threads(1)

each_size = pytest.mark.parametrize("n", [50, 100, 200, 400])


def with_gradient(problem: Problem, function: Callable[[], torch.Tensor]) -> Callable[[], None]:
    """A function that computes a number and its gradient by the policy's parameters."""
    parameters = list(problem.policy.parameters())
    return lambda: torch.autograd.grad(function(), parameters)


def gp_input(problem: Problem) -> Gaussian:
    """Belief over features and action at the start, without a graph."""
    space, policy = problem.experiment.space, problem.policy
    features, _ = space.feature_moments(problem.experiment.initial)
    action, slope = policy.controller.on_belief(features)
    return joint(features, action, features.cov @ slope).detach()


@each_size
def test_moments_of_the_gp(benchmark, n: int) -> None:
    """Moment matching of the model at an uncertain input, and its gradient by that."""
    problem = make_problem(n, horizon=1)
    belief = gp_input(problem)
    mean, cov = belief.mean.requires_grad_(), belief.cov.requires_grad_()

    def step() -> None:
        moments = moment_match(
            problem.dynamics.expansion, Gaussian(mean, cov), observation_noise=True
        )
        torch.autograd.grad(
            moments.mean.sum() + moments.cov.sum() + moments.inv_cov_cross_cov.sum(), [mean, cov]
        )

    benchmark(step)


def test_action_of_a_belief(benchmark) -> None:
    """Moments of the policy's action."""
    problem = make_problem(10, horizon=1)
    features, _ = problem.experiment.space.feature_moments(problem.experiment.initial)

    def action() -> torch.Tensor:
        belief, slope = problem.policy.controller.on_belief(features)
        return belief.mean.sum() + belief.cov.sum() + slope.sum()

    benchmark(with_gradient(problem, action))


@each_size
def test_step_of_a_prediction(benchmark, n: int) -> None:
    """One step of the prediction, from one belief to the next."""
    problem = make_problem(n, horizon=1)

    def step() -> torch.Tensor:
        state = predict_step(
            problem.experiment.initial,
            problem.policy.controller,
            problem.dynamics,
            problem.experiment.space,
        )
        return state.mean.sum() + state.cov.sum()

    benchmark(with_gradient(problem, step))


@each_size
def test_trajectory_kl(benchmark, n: int) -> None:
    """One evaluation of the objective, all 25 steps."""
    problem = make_problem(n, horizon=25)
    loss = problem.loss
    benchmark(with_gradient(problem, lambda: loss.per_step(problem.experiment.initial).sum()))
