"""The adjoint of a step of the prediction, against the graph of the step."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import Controller
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian, joint, symmetric
from torch_pmil.gp.moment_derivatives import RecordedMoments
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.gp.moments import Moments
from torch_pmil.model.dynamics import GPDynamics, Targets
from torch_pmil.model.rollout import predict_step
from torch_pmil.model.step_derivatives import StepDerivatives

NAMES, UNITS = ("a", "b", "c"), ("",) * 3

both_targets = pytest.mark.parametrize("targets", ["difference", "successor"])
spaces = pytest.mark.parametrize(
    "angles", [(), (1,), (0, 2)], ids=["no angle", "one angle", "two angles"]
)


@dataclass(frozen=True)
class Robot:
    """A random policy and a random model of the same robot."""

    space: StateSpace
    controller: Controller
    dynamics: GPDynamics

    @classmethod
    def draw(cls, draws: Draws, angles: tuple[int, ...], targets: Targets, actions: int) -> Robot:
        space = StateSpace(NAMES, UNITS, angles, joint_match(NAMES, UNITS))
        features = len(space.feature_names)
        dynamics = GPDynamics(features + actions, space.dim, targets)
        dynamics.set_data(draws.normal(12, features + actions), draws.normal(12, space.dim))
        dynamics.gp.covar_module.base_kernel.lengthscale = draws.uniform(
            0.8, 2.0, space.dim, 1, features + actions
        )
        dynamics.gp.covar_module.outputscale = draws.uniform(0.5, 2.0, space.dim)
        dynamics.gp.likelihood.noise = draws.uniform(0.01, 0.1, space.dim, 1)
        return cls(
            space,
            Controller(draws.network(6, features, actions), draws.uniform(0.5, 2.0, actions)),
            dynamics,
        )

    def linearise(self, state: Gaussian, noise: bool) -> StepDerivatives:
        network, model = (
            RecordedMoments(self.controller.network),
            RecordedMoments(self.dynamics.expansion, noise),
        )
        features, _ = self.space.feature_moments(state)
        action, slope = self.controller.squashed(network(features))
        model(joint(features, action, features.cov @ slope))
        differences = self.dynamics.targets == "difference"
        return StepDerivatives(
            state,
            network.derivatives,
            self.controller.u_max,
            model.derivatives,
            differences,
            self.space,
        )


@dataclass(frozen=True)
class GivenMoments(Controller):
    """A policy whose network has these moments, wherever it is asked."""

    raw: Moments

    def on_belief(self, features: Gaussian) -> tuple[Gaussian, Tensor]:
        return self.squashed(self.raw)


def cotangents(draws: Draws, N: int, C: int) -> tuple[Tensor, Tensor]:
    """C cotangents of each of N states, that of the covariance symmetric."""
    return draws.normal(N, C, 3), symmetric(draws.normal(N, C, 3, 3))


def adjoint_by_graph(
    following: Gaussian, leaves: list[Tensor], d_mean: Tensor, d_cov: Tensor
) -> list[Tensor]:
    """Cotangents of the leaves, one copy after the other."""
    outputs = following.mean, following.cov
    copies = [
        torch.autograd.grad(outputs, leaves, (d_mean[:, c], d_cov[:, c]), retain_graph=True)
        for c in range(d_mean.shape[1])
    ]
    return [torch.stack(copy, 1) for copy in zip(*copies, strict=True)]


def assert_all_close(ours: Tensor, graph: Tensor) -> None:
    torch.testing.assert_close(ours, graph, rtol=1e-9, atol=1e-9 * graph.abs().max().item())


@both_targets
@spaces
@pytest.mark.parametrize("actions", [1, 2])
@pytest.mark.parametrize(
    ("N", "C", "scale"), [(1, 1, 0.3), (3, 4, 0.3), (2, 3, 0.0)], ids=["one", "several", "certain"]
)
def test_adjoint_of_the_state_is_that_of_the_graph(
    draws: Draws,
    angles: tuple[int, ...],
    targets: Targets,
    actions: int,
    N: int,
    C: int,
    scale: float,
) -> None:
    robot, state, noise = (
        Robot.draw(draws, angles, targets, actions),
        draws.belief(N, 3, scale=scale),
        C == 4,
    )
    d_mean, d_cov = cotangents(draws, N, C)
    leaves = [t.clone().requires_grad_() for t in (state.mean, state.cov)]
    following = predict_step(
        Gaussian(*leaves), robot.controller, robot.dynamics, robot.space, noise
    )
    graph_mean, graph_cov = adjoint_by_graph(following, leaves, d_mean, d_cov)

    d_state_mean, d_state_cov = robot.linearise(state, noise).state_adjoint(d_mean, d_cov)
    assert_all_close(d_state_mean, graph_mean)
    assert_all_close(d_state_cov, symmetric(graph_cov))
    torch.testing.assert_close(d_state_cov, d_state_cov.mT, rtol=1e-13, atol=1e-13)


@both_targets
@spaces
@pytest.mark.parametrize("actions", [1, 2])
@pytest.mark.parametrize(("N", "C"), [(1, 1), (3, 4)])
def test_adjoint_of_the_network_is_that_of_the_graph(
    draws: Draws, angles: tuple[int, ...], targets: Targets, actions: int, N: int, C: int
) -> None:
    robot, state = Robot.draw(draws, angles, targets, actions), draws.belief(N, 3)
    d_mean, d_cov = cotangents(draws, N, C)
    raw = moment_match(robot.controller.network, robot.space.feature_moments(state)[0])
    leaves = [t.requires_grad_() for t in (raw.mean, raw.cov, raw.inv_cov_cross_cov)]
    controller = GivenMoments(robot.controller.network, robot.controller.u_max, Moments(*leaves))
    following = predict_step(state, controller, robot.dynamics, robot.space)
    graph_mean, graph_cov, graph_slope = adjoint_by_graph(following, leaves, d_mean, d_cov)

    d_raw_mean, d_raw_cov, d_raw_slope = robot.linearise(state, noise=True).network_adjoint(
        d_mean, d_cov
    )
    assert_all_close(d_raw_mean, graph_mean)
    assert_all_close(symmetric(d_raw_cov), symmetric(graph_cov))
    assert_all_close(d_raw_slope, graph_slope)


@both_targets
def test_adjoint_is_linear_in_the_cotangents(draws: Draws, targets: Targets) -> None:
    robot, state = Robot.draw(draws, (1,), targets, 1), draws.belief(2, 3)
    step, one, other = (
        robot.linearise(state, True),
        cotangents(draws, 2, 3),
        cotangents(draws, 2, 3),
    )
    together = step.state_adjoint(*(2 * a + b for a, b in zip(one, other, strict=True)))
    for whole, a, b in zip(
        together, step.state_adjoint(*one), step.state_adjoint(*other), strict=True
    ):
        torch.testing.assert_close(whole, 2 * a + b, rtol=1e-11, atol=1e-11)


@both_targets
def test_steps_from_several_beliefs_are_those_from_each(draws: Draws, targets: Targets) -> None:
    robot, states = Robot.draw(draws, (0, 2), targets, 2), draws.belief(3, 3)
    d_mean, d_cov = cotangents(draws, 3, 2)
    together = robot.linearise(states, True).state_adjoint(d_mean, d_cov)
    for index in range(3):
        one = slice(index, index + 1)
        alone = robot.linearise(states[one], True).state_adjoint(d_mean[one], d_cov[one])
        for whole, part in zip(together, alone, strict=True):
            torch.testing.assert_close(whole[one], part, rtol=1e-11, atol=1e-11)
