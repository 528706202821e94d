"""A forward model of one's own beside the GPs that it wraps, and what is refused."""

from __future__ import annotations

from threading import Lock
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.model.test_rollout import assert_moments_of
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.own_dynamics import OwnDynamics
from torch_pmil.model.rollout import PredictionError, predict_trajectory
from torch_pmil.model.sampled_rollouts import SampledPrediction, sample_consistent_rollouts

PLAIN = StateSpace(("a", "b"), ("", ""), (), joint_match(("a", "b"), ("", "")))
NOISE = 0.05


class OfGP:
    """A GP of a known noise."""

    def fit(self, inputs: Tensor, targets: Tensor) -> None:
        self.gp = GPDynamics(3, 2)
        self.gp.set_data(inputs, targets)
        self.gp.gp.likelihood.noise = torch.full((2, 1), NOISE, dtype=torch.float64)
        self.noise = self.gp.noise


class ByMoments(OfGP):
    """Mean and variance."""

    def moments(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        return self.gp.predict(inputs)


class BySamples(OfGP):
    """Functions that are drawn."""

    def sample(self, count: int, generator: torch.Generator) -> Any:
        return self.gp.functions(count, generator)


class Drawn:
    """A network whose fit draws from PyTorch's generator and goes on from its last weights."""

    def __init__(self) -> None:
        self.module = nn.Linear(3, 2)

    def fit(self, inputs: Tensor, targets: Tensor) -> None:
        assert torch.is_grad_enabled()  # wherever the first prediction asks for the fit
        with torch.no_grad():
            self.module.weight.add_(torch.randn(2, 3) + targets.mean())

    def moments(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        mean = self.module.double()(inputs)
        return mean, torch.ones_like(mean)


def data(draws: Draws) -> tuple[Tensor, Tensor]:
    inputs = draws.normal(25, 3)
    return inputs, torch.stack([inputs[:, 0].sin(), inputs[:, 1]], -1)


def policy() -> RBFPolicy:
    made = RBFPolicy(torch.zeros(1, 2), torch.ones(1), torch.ones(2))
    made.weights.data.fill_(0.5)
    return made


@torch.no_grad()
def test_one_step_by_moments_is_the_one_that_is_matched(draws: Draws) -> None:
    """Exact for one step, though each function keeps its distance from the mean."""
    own, gp, known = OwnDynamics(ByMoments(), 3, 2), ByMoments(), data(draws)
    own.fit(*known)
    gp.fit(*known)
    state = draws.belief(2)
    given = SampledPrediction(100_000).rollouts(state, policy(), own, PLAIN, 1)
    assert_moments_of(given[:, 1], predict_trajectory(state, policy(), gp.gp, PLAIN, 1)[0])


@torch.no_grad()
def test_functions_of_the_object_are_followed(draws: Draws) -> None:
    own, known = OwnDynamics(BySamples(), 3, 2), data(draws)
    own.fit(*known)
    start = draws.belief(2)
    states = []
    for dynamics in (own, own.own.gp):
        functions = dynamics.functions(50, torch.Generator().manual_seed(1))
        generator = torch.Generator().manual_seed(2)
        given = functions, 50, own, PLAIN, 6, generator
        states.append(sample_consistent_rollouts(start, policy(), *given))
    assert_close(*states, rtol=1e-9, atol=1e-9)


@torch.no_grad()
def test_particle_stays_as_far_from_the_mean_as_it_began(draws: Draws) -> None:
    own = OwnDynamics(ByMoments(), 3, 2)
    own.fit(*data(draws))
    functions = own.functions(4, torch.Generator().manual_seed(0))
    apart = []
    for _ in range(2):
        inputs = draws.normal(3).expand(4, 3)
        mean, variance = own.predict(inputs)
        apart.append((functions(inputs) - mean) / variance.sqrt())
    assert_close(*apart)


def test_every_fit_begins_anew_and_repeats_itself(draws: Draws) -> None:
    """So a run that was stopped predicts as one that was not."""
    model, known = Drawn(), data(draws)
    before, own = model.module.weight.clone(), OwnDynamics(model, 3, 2)
    state = torch.random.get_rng_state()
    own.fit(*known)
    first = own.predict(known[0])[0].detach()
    own.fit(*known)
    assert torch.equal(own.predict(known[0])[0], first)
    resumed = OwnDynamics(model, 3, 2)
    resumed.load_state_dict(own.state_dict())
    with torch.no_grad():
        assert resumed.own is not own.own
    assert torch.equal(resumed.predict(known[0])[0], first)
    assert torch.equal(model.module.weight, before)  # a user's object stays as it is
    assert torch.equal(torch.random.get_rng_state(), state)
    assert not list(own.parameters())


def test_mean_and_variance_of_an_object_without_moments_are_those_of_its_functions(
    draws: Draws,
) -> None:
    own, gp, known = OwnDynamics(BySamples(), 3, 2), ByMoments(), data(draws)
    own.fit(*known)
    gp.fit(*known)
    at = draws.normal(4, 3)
    with torch.no_grad():
        mean, variance = own.predict(at)
        exact, spread = gp.gp.predict(at)
    error = spread.sqrt() / 200**0.5
    assert ((mean - exact).abs() < 5 * error + 1e-6).all()
    assert_close(variance, spread, rtol=0.6, atol=1e-3)


class _Wrong(ByMoments):
    def __init__(self, found: Any) -> None:
        self.found = found

    def moments(self, inputs: Tensor) -> Any:
        return self.found


@pytest.mark.parametrize(
    ("found", "error", "message"),
    [
        (torch.zeros(2), TypeError, "must return mean and variance, got Tensor"),
        ((torch.zeros(5, 2), torch.zeros(5)), ValueError, r"must give a tensor \(5, 2\)"),
        ((torch.zeros(5, 2), -torch.ones(5, 2)), ValueError, "must give variances, got -1"),
        ((0.0, 1.0), ValueError, r"must give a tensor \(5, 2\) at inputs \(5, 3\), got float"),
    ],
)
def test_wrong_moments_are_refused(
    found: Any, error: type[Exception], message: str, draws: Draws
) -> None:
    own = OwnDynamics(_Wrong(found), 3, 2)
    own.fit(*data(draws))
    with pytest.raises(error, match=message):
        own.predict(torch.zeros(5, 3, dtype=torch.float64))


class _Locked(ByMoments):
    def __init__(self) -> None:
        self.lock = Lock()


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (nn.Linear(3, 2), r"fit.*got Linear with none of them"),
        (ByMoments, "must be an object, got the class ByMoments"),
        (_Locked(), "copy.deepcopy can copy, got cannot pickle"),
    ],
)
def test_what_is_no_model_is_refused(model: object, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        OwnDynamics(model, 3, 2)


class _NoSlope(ByMoments):
    def moments(self, inputs: Tensor) -> Any:
        mean, variance = super().moments(inputs)
        return mean.detach(), variance


class _NoSlopes(BySamples):
    def sample(self, count: int, generator: torch.Generator) -> Any:
        functions = super().sample(count, generator)
        return lambda inputs: functions(inputs.detach())


@pytest.mark.parametrize("model", [_NoSlope(), _NoSlopes()])
def test_model_without_a_slope_is_refused(model: object, draws: Draws) -> None:
    own = OwnDynamics(model, 3, 2)
    own.fit(*data(draws))
    inputs = torch.zeros(4, 1, 3, dtype=torch.float64)
    functions = own.functions(4, torch.Generator())
    assert functions(inputs).isfinite().all()  # without a search nothing is lacking
    with pytest.raises(ValueError, match="must be differentiable in the inputs"):
        functions(inputs.requires_grad_())


class _MeanNaN(ByMoments):
    def moments(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        mean, variance = super().moments(inputs)
        return torch.nan * mean, variance


class _VarianceNaN(ByMoments):
    def moments(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        mean, variance = super().moments(inputs)
        return mean, torch.nan * variance


class _SamplesNaN(BySamples):
    def sample(self, count: int, generator: torch.Generator) -> Any:
        functions = super().sample(count, generator)
        return lambda inputs: torch.nan * functions(inputs)


@pytest.mark.parametrize(
    ("model", "method"),
    [(_MeanNaN(), "moments"), (_VarianceNaN(), "moments"), (_SamplesNaN(), "sample")],
)
def test_model_that_returns_nan_is_named_with_its_method(
    model: object, method: str, draws: Draws
) -> None:
    own, start = OwnDynamics(model, 3, 2), draws.belief(2)
    own.fit(*data(draws))
    message = rf"^prediction of step 1 of 3 .*: {method}\(\) of the model returned nan$"
    with pytest.raises(PredictionError, match=message):
        SampledPrediction(10)(start, policy(), own, PLAIN, 3)


class _OfAllEntries(ByMoments):
    def fit(self, inputs: Tensor, targets: Tensor) -> None:
        super().fit(inputs, targets - torch.zeros(len(inputs), 4).double())


def test_model_that_learns_other_entries_sees_the_shapes(draws: Draws) -> None:
    model = OwnDynamics(_OfAllEntries(), 3, 2)
    said = r"must learn from inputs \(25, 3\) and targets \(25, 2\), got RuntimeError: The size of"
    with pytest.raises(ValueError, match=said):
        model.fit(*data(draws))


def test_model_without_data_says_so() -> None:
    with pytest.raises(RuntimeError, match="no data yet"):
        OwnDynamics(ByMoments(), 3, 2).functions(1, torch.Generator())


def test_prediction_by_moments_names_the_one_by_samples(draws: Draws) -> None:
    own = OwnDynamics(ByMoments(), 3, 2)
    own.fit(*data(draws))
    start = Gaussian(torch.zeros(2).double(), torch.eye(2).double())
    with pytest.raises(TypeError, match=r"got RBFPolicy and OwnDynamics: .* SampledPrediction"):
        predict_trajectory(start, policy(), own, PLAIN, 3)
