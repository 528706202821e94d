"""Long-term prediction, against its sampled twin, its mean, and its parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.autograd.graph import saved_tensors_hooks
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.memory import LargestResult
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.rbf_policy import Controller, RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.envs.history import History
from torch_pmil.gp import exponential_sums
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError, symmetric
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.model import rollout
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import Targets, known_part
from torch_pmil.model.particles import sample_trajectories
from torch_pmil.model.rollout import (
    PredictionError,
    predict_mean_trajectory,
    predict_step,
    predict_trajectory,
)

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))
U_MAX, U_MIDDLE = torch.tensor([[2.0], [0.5]], dtype=torch.float64)


def pendulum(inputs: Tensor) -> Tensor:
    """Change of [q, dq] in 0.1 s at inputs [dq, sin q, cos q, u]."""
    return 0.1 * torch.stack([inputs[:, 0], inputs[:, 3] - 2 * inputs[:, 1]], -1)


def make_dynamics(
    draws: Draws, n: int = 30, noise: float = 0.01, targets: Targets = "difference"
) -> GPDynamics:
    """A GP of a pendulum, with hyper-parameters by hand."""
    states, actions = draws.uniform(-1.5, 1.5, n, 2), draws.uniform(-2, 2, n, 1)
    inputs = torch.cat([SPACE.features(states), actions], -1)
    change = pendulum(inputs) + noise * draws.normal(n, 2)
    dynamics = GPDynamics(4, 2, targets)
    dynamics.set_data(inputs, change if targets == "difference" else states + change)
    kernel = dynamics.gp.covar_module
    kernel.base_kernel.lengthscale = torch.tensor([[3.0, 1.5, 1.5, 4.0]], dtype=torch.float64)
    kernel.outputscale = torch.tensor([0.5, 0.8], dtype=torch.float64)
    dynamics.gp.likelihood.noise = torch.full((2, 1), noise**2, dtype=torch.float64)
    return dynamics


STEPS_ALONE = pytest.mark.parametrize("way", ["formulas"], indirect=True)  # no kernel serves those


@pytest.fixture(autouse=True, params=["kernels", "formulas"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Both ways in which a trajectory is predicted."""
    if request.param == "formulas":
        monkeypatch.setattr(rollout, "serves", lambda *_: False)
    return request.param


@pytest.fixture
def dynamics(draws: Draws) -> GPDynamics:
    return make_dynamics(draws)


@pytest.fixture
def policy(draws: Draws) -> RBFPolicy:
    policy = RBFPolicy(draws.normal(6, 3), U_MAX, torch.ones(3), U_MIDDLE)
    policy.weights.data.copy_(0.5 * draws.normal(6, 1))
    return policy


@pytest.fixture
def initial(draws: Draws) -> Gaussian:
    return Gaussian(0.5 * draws.normal(2), draws.cov(2, scale=0.02))


def assert_moments_of(samples: Tensor, belief: Gaussian, bias: float = 0.0) -> None:
    """Samples (N, D) have these moments up to four standard errors and ``bias`` times the std."""
    deviation = samples - belief.mean
    products = deviation[:, :, None] * deviation[:, None, :]
    root_n = len(samples) ** 0.5
    scale = belief.std[:, None] * belief.std
    error = (products.mean(0) - belief.cov).abs()
    assert (deviation.mean(0).abs() <= 4 * deviation.std(0) / root_n + bias * belief.std).all()
    assert (error <= 4 * products.std(0) / root_n + bias * scale).all()


class LinearController(Controller):
    """Acts linearly on the features, so that one step's moments are exact."""

    gain = torch.tensor([[-0.4, 0.7, 0.3]], dtype=torch.float64)

    def __init__(self) -> None:
        """Has no network."""

    def __call__(self, features: Tensor) -> Tensor:
        return features @ self.gain.mT

    def on_belief(self, features: Gaussian) -> tuple[Gaussian, Tensor]:
        return features.affine(self.gain), self.gain.mT.expand(*features.batch_shape, -1, -1)


MIXED = KnownPart(
    torch.tensor([[0.9, 0.2, 0.0, 0.5], [0.1, 0.0, -0.7, 0.3], [0.0, 0.4, 0.8, -0.6]]).double(),
    torch.tensor([[0.6, -0.4], [1.0, 0.0], [0.0, 1.0]]).double(),
    (1, 2),
)


# of a position whose velocity is hidden, and the last action
PAST = History(("q", "dq"), ("u",), 0.5, ("dq",), past_actions=1)
REMEMBERED = KnownPart.of_readings(PAST.shift, PAST.gain, PAST.measured)


@STEPS_ALONE
@pytest.mark.parametrize("noise", [False, True], ids=["latent", "noisy"])
@pytest.mark.parametrize(
    "targets", ["difference", "successor", MIXED, REMEMBERED], ids=["d", "s", "mixed", "history"]
)
def test_step_without_angles_has_the_moments_of_samples(
    draws: Draws, targets: Targets, noise: bool
) -> None:
    """Exact here, where features and action are jointly Gaussian."""
    space = StateSpace(("a", "b", "c"), ("",) * 3, (), joint_match(("a", "b", "c"), ("",) * 3))
    known = known_part(targets, 3)
    inputs, E = draws.normal(25, 4), known.num_outputs
    dynamics, controller, state = GPDynamics(4, E, targets), LinearController(), draws.belief(3)
    dynamics.set_data(inputs, inputs[:, :E].sin() + inputs[:, 3:])
    dynamics.gp.likelihood.noise = torch.full((E, 1), 0.05, dtype=torch.float64)

    successors = []
    for x in state.sample(1_000_000, draws.generator).split(4096):  # in a processor's cache
        u = controller(x)
        mean, variance = dynamics.expansion.predict(torch.cat([x, u], -1))
        variance = variance + dynamics.expansion.noise_variance if noise else variance
        output = mean + variance.sqrt() * draws.normal(*mean.shape)
        successors.append(known.successors(x, u, output))
    predicted = predict_step(state, controller, dynamics, space, observation_noise=noise)
    assert_moments_of(torch.cat(successors), predicted)


@pytest.mark.slow
@torch.no_grad()
def test_trajectory_has_nearly_the_moments_of_its_sampled_twin(
    draws: Draws, dynamics: GPDynamics, policy: RBFPolicy, initial: Gaussian
) -> None:
    narrow = Gaussian(initial.mean, initial.cov / 10)
    samples = sample_trajectories(narrow, policy, dynamics, SPACE, 8, 50_000, draws.generator)
    predicted = predict_trajectory(narrow, policy, dynamics, SPACE, 8).detach()
    for t in range(8):
        assert_moments_of(samples[:, t], predicted[t], bias=0.05)


def test_prediction_without_uncertainty_is_the_mean_trajectory(
    draws: Draws, policy: RBFPolicy
) -> None:
    """Dense data without noise leave next to no variance, up to what the prediction itself adds."""
    dynamics = make_dynamics(draws, n=150, noise=1e-4)
    x = torch.tensor([0.3, -0.2], dtype=torch.float64)
    certain = Gaussian(x, torch.zeros(2, 2, dtype=torch.float64))
    predicted = predict_trajectory(certain, policy, dynamics, SPACE, 5, observation_noise=False)
    mean = predict_mean_trajectory(x, policy, dynamics, SPACE, 5)
    assert_close(predicted.mean, mean, rtol=0, atol=1e-5)
    assert predicted.std.max() < 1e-2


def test_first_step_from_a_certain_state_is_the_posterior(
    policy: RBFPolicy, dynamics: GPDynamics, draws: Draws
) -> None:
    x = draws.normal(2)
    features = SPACE.features(x)
    mean, variance = dynamics.expansion.predict(torch.cat([features, policy(features)]))
    certain = Gaussian(x, torch.zeros(2, 2, dtype=torch.float64))
    predicted = predict_trajectory(certain, policy, dynamics, SPACE, 1)[0]
    assert_close(predicted.mean, x + mean)
    noisy = variance + dynamics.expansion.noise_variance
    assert_close(predicted.cov, torch.diag(noisy))


def test_covariances_are_symmetric_and_positive_definite(
    policy: RBFPolicy, dynamics: GPDynamics, initial: Gaussian
) -> None:
    cov = predict_trajectory(initial, policy, dynamics, SPACE, 15).cov.detach()
    assert torch.equal(cov, cov.mT)
    assert torch.linalg.eigvalsh(cov).min() > 0


def test_batch_of_starts_is_a_loop(policy: RBFPolicy, dynamics: GPDynamics, draws: Draws) -> None:
    initial = draws.belief(2, 3, 2, scale=0.02)
    together = predict_trajectory(initial, policy, dynamics, SPACE, 4)
    means = predict_mean_trajectory(initial.mean, policy, dynamics, SPACE, 4)
    assert together.mean.shape == means.shape == (2, 3, 4, 2)
    for index in np.ndindex(2, 3):
        alone = predict_trajectory(initial[index], policy, dynamics, SPACE, 4)
        assert_close(together[index].mean, alone.mean)
        assert_close(together[index].cov, alone.cov)
        mean = predict_mean_trajectory(initial.mean[index], policy, dynamics, SPACE, 4)
        assert_close(means[index], mean)


def test_longer_horizon_begins_with_the_shorter_one(
    policy: RBFPolicy, dynamics: GPDynamics, initial: Gaussian
) -> None:
    short, long = (
        predict_trajectory(initial, policy, dynamics, SPACE, horizon) for horizon in (3, 6)
    )
    assert torch.equal(short.mean, long.mean[:3])
    assert torch.equal(short.cov, long.cov[:3])


@STEPS_ALONE
@pytest.mark.parametrize("targets", ["difference", "successor"])
def test_gradient_in_the_policy(draws: Draws, initial: Gaussian, targets: Targets) -> None:
    dynamics = make_dynamics(draws, n=8, targets=targets)

    def last_state(centres: Tensor, weights: Tensor, log_widths: Tensor) -> tuple[Tensor, Tensor]:
        one = torch.ones(1, dtype=torch.float64)
        network, state = KernelExpansion(centres, weights, log_widths.exp(), one), initial
        for _ in range(3):
            state = predict_step(state, Controller(network, U_MAX, U_MIDDLE), dynamics, SPACE)
        return state.mean, state.cov

    variables = draws.normal(4, 3), draws.normal(1, 4), 0.3 * draws.normal(1, 3)
    assert gradcheck(last_state, tuple(variable.requires_grad_() for variable in variables))


@STEPS_ALONE
def test_failed_step_is_named(
    policy: RBFPolicy, dynamics: GPDynamics, initial: Gaussian, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The matrix of the second step has no Cholesky factor."""
    steps = iter([initial.flattened])

    def failing_step(*_: object) -> Gaussian:
        for state in steps:
            return state
        raise NotPositiveDefiniteError("I + Sigma P must be positive definite")

    monkeypatch.setattr(rollout, "_propagate", failing_step)
    message = r"prediction of step 2 of 4 failed: I \+ Sigma P must be positive definite"
    with pytest.raises(PredictionError, match=message) as error:
        predict_trajectory(initial, policy, dynamics, SPACE, 4)
    assert error.value.step == 2


@STEPS_ALONE
def test_state_that_is_not_finite_is_named(
    policy: RBFPolicy, dynamics: GPDynamics, initial: Gaussian, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = Gaussian(initial.mean, initial.cov.clone())
    broken.cov[1, 1] = float("inf")
    states = iter(state.flattened for state in (initial, initial, broken, broken))
    monkeypatch.setattr(rollout, "_propagate", lambda *_: next(states))
    message = "prediction of step 3 of 4 failed: dq is not finite"
    with pytest.raises(PredictionError, match=message) as error:
        predict_trajectory(initial, policy, dynamics, SPACE, 4)
    assert error.value.step == 3


# --- the trajectory against its steps ---

kinds_of_targets = pytest.mark.parametrize("targets", ["difference", "successor"])
batches = pytest.mark.parametrize(
    "batch", [(), (3,), (2, 3)], ids=["one start", "batch", "two batch dimensions"]
)


def loop_of_steps(
    initial: Gaussian,
    policy: RBFPolicy,
    dynamics: GPDynamics,
    space: StateSpace,
    horizon: int,
    noise: bool,
) -> Gaussian:
    states = [initial]
    for _ in range(horizon):
        states.append(predict_step(states[-1], policy.controller, dynamics, space, noise))
    means, covs = [state.mean for state in states[1:]], [state.cov for state in states[1:]]
    return Gaussian(torch.stack(means, -2), torch.stack(covs, -3))


def loop_of_means(
    initial: Tensor, policy: RBFPolicy, dynamics: GPDynamics, space: StateSpace, horizon: int
) -> Tensor:
    states = [initial]
    for _ in range(horizon):
        features = space.features(states[-1])
        mean = dynamics.expansion.mean(torch.cat([features, policy(features)], -1))
        states.append(states[-1] + mean if dynamics.targets.matrix.any() else mean)
    return torch.stack(states[1:], -2)


def assert_all_close(ours: Sequence[Tensor], expected: Sequence[Tensor]) -> None:
    for one, other in zip(ours, expected, strict=True):
        assert_close(one, other, rtol=1e-10, atol=1e-10 * other.abs().max().item())


@kinds_of_targets
@batches
@pytest.mark.parametrize(("horizon", "noise"), [(1, True), (6, True), (6, False)])
def test_trajectory_and_gradient_are_those_of_a_loop_of_steps(
    draws: Draws,
    policy: RBFPolicy,
    targets: Targets,
    batch: tuple[int, ...],
    horizon: int,
    noise: bool,
) -> None:
    dynamics = make_dynamics(draws, n=15, targets=targets)
    start = draws.belief(*batch, 2, scale=0.05)
    mean, cov = (t.requires_grad_() for t in (start.mean, start.cov))
    loop = loop_of_steps(Gaussian(mean, cov), policy, dynamics, SPACE, horizon, noise)
    predicted = predict_trajectory(Gaussian(mean, cov), policy, dynamics, SPACE, horizon, noise)
    assert predicted.mean.shape == (*batch, horizon, 2)
    assert_all_close((predicted.mean, predicted.cov), (loop.mean, loop.cov))

    leaves = [mean, cov, *policy.parameters()]
    cotangent = draws.normal(*loop.mean.shape), draws.normal(*loop.cov.shape)
    gradients = [
        list(torch.autograd.grad((states.mean, states.cov), leaves, cotangent))
        for states in (predicted, loop)
    ]
    assert_close(gradients[0][1], gradients[0][1].mT)
    gradients[1][1] = symmetric(gradients[1][1])
    assert_all_close(*gradients)


@kinds_of_targets
@batches
@pytest.mark.parametrize("horizon", [1, 6])
def test_mean_trajectory_and_gradient_are_those_of_a_loop(
    draws: Draws, policy: RBFPolicy, targets: Targets, batch: tuple[int, ...], horizon: int
) -> None:
    dynamics = make_dynamics(draws, n=15, targets=targets)
    start = draws.normal(*batch, 2).requires_grad_()
    loop, predicted = (
        function(start, policy, dynamics, SPACE, horizon)
        for function in (loop_of_means, predict_mean_trajectory)
    )
    assert predicted.shape == (*batch, horizon, 2)
    assert_all_close([predicted], [loop])
    leaves, cotangent = [start, *policy.parameters()], draws.normal(*loop.shape)
    gradients = [torch.autograd.grad(states, leaves, cotangent) for states in (predicted, loop)]
    assert_all_close(*gradients)


def test_gradient_in_part_of_the_policy(
    policy: RBFPolicy, dynamics: GPDynamics, initial: Gaussian
) -> None:
    """The gradient in the weights is the same where centres and widths are constant."""

    def by_weights() -> Sequence[Tensor]:
        predicted = predict_trajectory(initial, policy, dynamics, SPACE, 4)
        return torch.autograd.grad(predicted.cov.sum(), [policy.weights])

    whole = by_weights()
    for parameter in (policy.centres, policy.log_widths):
        parameter.requires_grad_(False)
    assert_all_close(by_weights(), whole)


@kinds_of_targets
def test_no_array_of_pairs_of_data_is_saved_for_the_gradient(
    draws: Draws, initial: Gaussian, monkeypatch: pytest.MonkeyPatch, targets: Targets
) -> None:
    """Nor is one made, but by pieces as small as the cache, of data or of as many centres."""
    n, horizon, saved = 200, 3, []
    dynamics = make_dynamics(draws, n=n, noise=0.1, targets=targets)
    policy = RBFPolicy(draws.normal(n, 3), U_MAX, torch.ones(3), U_MIDDLE)
    predict_trajectory(initial, policy, dynamics, SPACE, 1)  # fills what the expansion keeps
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)
    monkeypatch.setattr(exponential_sums, "CACHED_NUMBERS", 8 * n)
    with (
        LargestResult() as largest,
        saved_tensors_hooks(
            lambda tensor: (saved.append(tensor.numel()), tensor)[1], lambda tensor: tensor
        ),
    ):
        predicted = predict_trajectory(initial, policy, dynamics, SPACE, horizon)
        predicted.cov.sum().backward()
    assert 0 < max(saved) < n * n / 4
    assert 0 < largest.numbers < n * n / 2
