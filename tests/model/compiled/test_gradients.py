"""Gradients by the kernels are difference quotients of what the kernels predict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from tests.helpers.draws import Draws
from tests.helpers.two_ways import kernels_alone
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.rbf_policy import Controller
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.envs.history import History
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import Targets
from torch_pmil.model.rollout import predict_mean_trajectory, predict_trajectory

NAMES = ("a", "b", "c")
SPACE = StateSpace(NAMES, ("",) * 3, (1,), joint_match(NAMES, ("",) * 3))
R, F, M, N, STEPS = len(SPACE.feature_names), 2, 4, 2, 3
U_MAX, U_MIDDLE = torch.tensor([[1.5, 0.7], [0.4, -0.6]], dtype=torch.float64)

# positions follow from one velocity, and everything from two outputs and the actions
VELOCITY = KnownPart.of_velocities(NAMES, {"a": "c"}, F, 0.5)
MIXED = KnownPart(
    torch.linspace(-0.6, 0.7, 3 * (3 + F), dtype=torch.float64).reshape(3, -1),
    torch.tensor([[0.0, 1.0], [0.4, -0.3], [1.0, 0.0]], dtype=torch.float64),
    (2, 0),
)
# one entry is measured, the others are the last actions
PAST = History(("a",), ("u", "v"), 0.5, past_actions=1)
REMEMBERED = KnownPart.of_readings(PAST.shift, PAST.gain, PAST.measured)
kinds_of_targets = pytest.mark.parametrize(
    "targets",
    ["difference", "successor", VELOCITY, MIXED, REMEMBERED],
    ids=["d", "s", "velocity", "mixed", "history"],
)
# of one policy, of one for each belief, and with one that is exactly zero
weights = pytest.mark.parametrize("weights", [(F, M), (N, F, M)], ids=["one policy", "targets"])


@pytest.fixture(autouse=True)
def kernels() -> Iterator[None]:
    with kernels_alone():
        yield


@dataclass(frozen=True)
class Network:
    """A policy of given centres, weights and logarithms of widths."""

    parameters: tuple[Tensor, Tensor, Tensor]

    @property
    def controller(self) -> Controller:
        centres, weights, log_widths = self.parameters
        one = torch.ones(F, dtype=torch.float64)
        return Controller(KernelExpansion(centres, weights, log_widths.exp(), one), U_MAX, U_MIDDLE)


def make_dynamics(draws: Draws, targets: Targets) -> GPDynamics:
    E = targets.num_outputs if isinstance(targets, KnownPart) else 3
    dynamics = GPDynamics(R + F, E, targets)
    dynamics.set_data(draws.normal(10, R + F), 0.3 * draws.normal(10, E))
    dynamics.gp.covar_module.base_kernel.lengthscale = draws.uniform(0.7, 4.0, E, 1, R + F)
    dynamics.gp.covar_module.outputscale = draws.uniform(0.2, 0.6, E)
    dynamics.gp.likelihood.noise = torch.full((E, 1), 0.05, dtype=torch.float64)
    return dynamics


def parameters(draws: Draws, shape: tuple[int, ...]) -> list[Tensor]:
    found = draws.normal(M, R), draws.normal(*shape), draws.uniform(-0.3, 0.7, F, R)
    found[1][..., 0, 1] = 0.0
    return [values.requires_grad_() for values in found]


@kinds_of_targets
@weights
def test_gradients_of_a_trajectory(
    draws: Draws, targets: Targets, weights: tuple[int, ...]
) -> None:
    """In mean and covariance of the start, and all parameters of the policy."""
    dynamics = make_dynamics(draws, targets)

    def trajectory(mean: Tensor, root: Tensor, *policy: Tensor) -> tuple[Tensor, Tensor]:
        start = Gaussian(mean, root @ root.mT)
        predicted = predict_trajectory(start, Network(policy), dynamics, SPACE, STEPS)
        return predicted.mean, predicted.cov

    start = draws.normal(N, 3).requires_grad_(), (0.3 * draws.normal(N, 3, 2)).requires_grad_()
    assert gradcheck(trajectory, (*start, *parameters(draws, weights)))


@kinds_of_targets
@weights
def test_gradients_of_a_trajectory_of_the_mean(
    draws: Draws, targets: Targets, weights: tuple[int, ...]
) -> None:
    dynamics = make_dynamics(draws, targets)

    def trajectory(mean: Tensor, *policy: Tensor) -> Tensor:
        return predict_mean_trajectory(mean, Network(policy), dynamics, SPACE, STEPS)

    start = draws.normal(N, 3).requires_grad_()
    assert gradcheck(trajectory, (start, *parameters(draws, weights)))
