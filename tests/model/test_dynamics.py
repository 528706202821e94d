"""The learned forward model: fitting, saving, and the units of its hyper-parameters."""

from __future__ import annotations

from pathlib import Path

import gpytorch
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

import torch_pmil.model.dynamics
from tests.helpers.draws import Draws
from torch_pmil.control.known_part import KnownPart
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.hyperparameters import Optimum, find_hyperparameters
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.model.dynamics import GPDynamics


def true_function(x: Tensor) -> Tensor:
    return torch.stack([x[:, 0].sin() + 0.5 * x[:, 1], (x[:, 0] * x[:, 1]).cos()], -1)


@pytest.fixture
def data(draws: Draws) -> tuple[Tensor, Tensor]:
    """40 data with 2 inputs and 2 outputs, noise 0.05."""
    inputs = draws.uniform(-2, 2, 40, 2)
    return inputs, true_function(inputs) + 0.05 * draws.normal(40, 2)


@pytest.fixture
def fitted(data: tuple[Tensor, Tensor]) -> GPDynamics:
    dynamics = GPDynamics(2, 2)
    dynamics.fit(*data)
    return dynamics


def hyperparameters(dynamics: GPDynamics) -> tuple[Tensor, Tensor, Tensor]:
    """Lengthscales (E, D), signal variances (E,), noise variances (E,) of the GPyTorch model."""
    kernel = dynamics.gp.covar_module
    lengthscale, noise = kernel.base_kernel.lengthscale, dynamics.gp.likelihood.noise
    parameters = lengthscale[:, 0], kernel.outputscale, noise[:, 0]
    return tuple(parameter.detach() for parameter in parameters)


def test_fit_recovers_a_known_function_and_its_noise(fitted: GPDynamics, draws: Draws) -> None:
    x = draws.uniform(-1.5, 1.5, 200, 2)
    mean, variance = fitted.expansion.predict(x)
    error = mean - true_function(x)
    assert error.square().mean().sqrt() < 0.05
    assert ((error / variance.sqrt()).abs() < 5).all()
    expected = torch.full((2,), 0.05, dtype=torch.float64)
    noise = hyperparameters(fitted)[2].sqrt()
    assert_close(noise, expected, rtol=0.5, atol=0)


def test_fit_ends_where_the_likelihood_of_gpytorch_is_flat(fitted: GPDynamics) -> None:
    model = fitted.gp.train()
    objective = gpytorch.mlls.ExactMarginalLogLikelihood(model.likelihood, model)
    likelihood = objective(model(*model.train_inputs), model.train_targets)
    nats = -len(fitted.train_inputs) * likelihood.sum()
    for gradient in torch.autograd.grad(nats, tuple(model.parameters())):
        assert gradient.abs().max() < 0.1  # nats for a factor e


def test_tied_outputs_are_searched_together_and_differ_in_signal_and_noise_alone(
    data: tuple[Tensor, Tensor],
) -> None:
    inputs, targets = data
    tied, own = GPDynamics(2, 2, tied_lengthscales=True), GPDynamics(2, 2)
    result, best = tied.fit(inputs, targets), own.fit(inputs, targets)
    lengthscales, signal, noise = hyperparameters(tied)
    assert torch.equal(lengthscales[0], lengthscales[1])
    assert (signal[0] != signal[1]) and (noise[0] != noise[1])
    assert result.negative_log_likelihood.shape == (2,) and len(result.stop_reason) == 2
    assert result.negative_log_likelihood.sum() > best.negative_log_likelihood.sum()
    again = tied.fit(inputs, targets, max_iterations=1)
    assert again.negative_log_likelihood.sum() < result.negative_log_likelihood.sum() + 1e-6
    assert again.evaluations < result.evaluations / 3


def test_scaling_the_targets_scales_the_variances(data: tuple[Tensor, Tensor]) -> None:
    inputs, targets = data
    one, ten = GPDynamics(2, 2), GPDynamics(2, 2)
    one.fit(inputs, targets)
    ten.fit(inputs, 10 * targets)
    scaled = zip((1, 100, 100), hyperparameters(one), hyperparameters(ten), strict=True)
    for factor, values, of_ten in scaled:
        assert_close(of_ten, factor * values, rtol=0.02, atol=0)


def test_scaling_the_inputs_scales_the_lengthscales(data: tuple[Tensor, Tensor]) -> None:
    inputs, targets = data
    units = torch.tensor([10.0, 0.1], dtype=torch.float64)
    one, other = GPDynamics(2, 2), GPDynamics(2, 2)
    one.fit(inputs, targets)
    other.fit(inputs * units, targets)
    expected = hyperparameters(one)[0] * units
    assert_close(hyperparameters(other)[0], expected, rtol=0.02, atol=0)


def test_signal_to_noise_ratio_stays_bounded_without_noise(draws: Draws) -> None:
    inputs = draws.uniform(-2, 2, 30, 2)
    dynamics = GPDynamics(2, 2)
    dynamics.fit(inputs, true_function(inputs))
    _, signal, noise = hyperparameters(dynamics)
    assert ((signal / noise).sqrt() < 200).all()
    surer = GPDynamics(2, 2, most_signal_to_noise=500.0)
    surer.fit(inputs, true_function(inputs))
    _, signal, noise = hyperparameters(surer)
    assert ((signal / noise).sqrt() < 1000).all() and (signal / noise).sqrt().max() > 200


def test_constant_input_does_not_break_the_fit(draws: Draws) -> None:
    inputs = draws.uniform(-2, 2, 30, 1)
    inputs = torch.cat([inputs, torch.full_like(inputs, 1000.0)], -1)
    targets = inputs[:, :1].sin() + 0.05 * draws.normal(30, 1)
    with_constant, without = GPDynamics(2, 1), GPDynamics(1, 1)
    with_constant.fit(inputs, targets)
    without.fit(inputs[:, :1], targets)
    expected = without.expansion.mean(inputs[:, :1])
    assert_close(with_constant.expansion.mean(inputs), expected, rtol=0, atol=1e-2)


def test_fit_to_a_little_more_data_is_as_good_as_one_from_the_beginning(
    data: tuple[Tensor, Tensor],
) -> None:
    inputs, targets = data
    grown, fresh = GPDynamics(2, 2), GPDynamics(2, 2)
    grown.fit(inputs[:33], targets[:33])
    warm, cold = grown.fit(inputs, targets), fresh.fit(inputs, targets)
    assert (warm.negative_log_likelihood < cold.negative_log_likelihood + 1e-2).all()
    assert warm.evaluations < cold.evaluations / 2


@pytest.fixture
def starts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of starts of the searches that follow, one for each output."""
    numbers: list[int] = []

    def counting(inputs: Tensor, target: Tensor, starts: list[Tensor], *limits: float) -> Optimum:
        numbers.append(len(starts))
        return find_hyperparameters(inputs, target, starts, *limits)

    monkeypatch.setattr(torch_pmil.model.dynamics, "find_hyperparameters", counting)
    return numbers


def test_all_starts_are_searched_again_when_the_data_have_grown_by_a_quarter(
    data: tuple[Tensor, Tensor], starts: list[int]
) -> None:
    dynamics = GPDynamics(2, 2)
    for n, expected in ((20, 4), (22, 1), (24, 1), (25, 5), (31, 1), (32, 5), (39, 1)):
        starts.clear()
        dynamics.fit(data[0][:n], data[1][:n])
        assert starts == [expected, expected]


def test_all_starts_are_searched_for_other_data(
    data: tuple[Tensor, Tensor], fitted: GPDynamics, starts: list[int]
) -> None:
    inputs, targets = data
    fitted.fit(*data)
    assert starts == [1, 1]
    back = inputs.flip(0), targets.flip(0)
    for other in ((back[0], targets), back, (back[0][:30], back[1][:30]), data):
        starts.clear()
        fitted.fit(*other)
        assert starts == [5, 5]


def test_loaded_model_fits_on_as_the_saved_one_would(
    data: tuple[Tensor, Tensor], starts: list[int]
) -> None:
    saved, loaded = GPDynamics(2, 2), GPDynamics(2, 2)
    saved.fit(data[0][:20], data[1][:20])
    saved.fit(data[0][:22], data[1][:22])
    loaded.load_state_dict(saved.state_dict())
    for n, expected in ((24, 1), (25, 5)):
        starts.clear()
        for dynamics in (saved, loaded):
            dynamics.fit(data[0][:n], data[1][:n])
        assert starts == [expected] * 4
        assert torch.equal(saved.expansion.weights, loaded.expansion.weights)


def test_all_starts_are_searched_where_the_last_optimum_fails(
    data: tuple[Tensor, Tensor], fitted: GPDynamics, starts: list[int]
) -> None:
    """A new target is 10^7 times what the model knows of one output."""
    inputs, targets = data
    outlier = torch.tensor([[1e7, 0.0]], dtype=torch.float64)
    result = fitted.fit(torch.cat([inputs, inputs[:1] + 0.1]), torch.cat([targets, outlier]))
    assert starts == [1, 5, 1]
    assert result.negative_log_likelihood.isfinite().all()


def test_result_says_for_each_output_why_its_search_ended(data: tuple[Tensor, Tensor]) -> None:
    dynamics = GPDynamics(2, 2)
    assert dynamics.fit(*data, max_iterations=1).stop_reason == ("iteration limit",) * 2
    ended = {"gradient is small", "no further progress"}
    assert set(dynamics.fit(data[0][:30], data[1][:30]).stop_reason) <= ended


def test_targets_that_never_change_are_learned(data: tuple[Tensor, Tensor]) -> None:
    dynamics = GPDynamics(2, 1)
    dynamics.fit(data[0], torch.full((40, 1), 3.0))
    assert dynamics.expansion.mean(data[0][0]).item() == pytest.approx(3.0, rel=1e-2)


def test_new_data_keep_the_hyperparameters_and_change_the_posterior(
    fitted: GPDynamics, draws: Draws
) -> None:
    x, before = draws.normal(2), hyperparameters(fitted)
    old, _ = fitted.expansion.predict(x)
    inputs = draws.uniform(-2, 2, 10, 2)
    fitted.set_data(inputs, true_function(inputs) + 1)
    for kept, parameter in zip(before, hyperparameters(fitted), strict=True):
        assert torch.equal(kept, parameter)
    assert not torch.allclose(fitted.expansion.predict(x)[0], old)


def test_expansion_is_the_gpytorch_posterior(fitted: GPDynamics, draws: Draws) -> None:
    x = draws.normal(5, 2)
    fitted.gp.eval()
    posterior = fitted.gp(x.expand(2, 5, 2))
    mean, variance = fitted.expansion.predict(x)
    assert_close(mean, posterior.mean.mT.detach(), rtol=1e-6, atol=1e-8)
    assert_close(variance, posterior.variance.mT.detach(), rtol=1e-6, atol=1e-8)


def test_expansion_has_no_graph(fitted: GPDynamics, draws: Draws) -> None:
    assert not moment_match(fitted.expansion, draws.belief(2)).cov.requires_grad


def assert_same_predictions(one: GPDynamics, other: GPDynamics, belief: Gaussian) -> None:
    expected, result = moment_match(one.expansion, belief), moment_match(other.expansion, belief)
    assert torch.equal(result.mean, expected.mean)
    assert torch.equal(result.cov, expected.cov)
    assert torch.equal(result.inv_cov_cross_cov, expected.inv_cov_cross_cov)


def test_fresh_or_other_model_in_a_module_predicts_the_same_from_a_file(
    fitted: GPDynamics, draws: Draws, tmp_path: Path
) -> None:
    torch.save(torch.nn.ModuleList([fitted]).state_dict(), tmp_path / "dynamics.pt")
    fresh, other, inputs = GPDynamics(2, 2), GPDynamics(2, 2), draws.normal(7, 2)
    other.set_data(inputs, true_function(inputs))
    assert other.expansion.inputs.shape == (7, 2)
    for model in (fresh, other):
        saved = torch.load(tmp_path / "dynamics.pt", weights_only=True)
        torch.nn.ModuleList([model]).load_state_dict(saved)
        assert_same_predictions(fitted, model, draws.belief(2))


def test_state_without_data_loads_too() -> None:
    fresh = GPDynamics(2, 2)
    fresh.load_state_dict(GPDynamics(2, 2).state_dict())
    with pytest.raises(RuntimeError, match="no data yet"):
        _ = fresh.expansion


def test_data_are_copied(fitted: GPDynamics, data: tuple[Tensor, Tensor], draws: Draws) -> None:
    x, before = draws.normal(2), fitted.state_dict()["train_inputs"].clone()
    expected, _ = fitted.expansion.predict(x)
    data[0].zero_()
    fitted.set_data(fitted.train_inputs, fitted.train_targets)
    assert torch.equal(fitted.state_dict()["train_inputs"], before)
    assert torch.equal(fitted.expansion.predict(x)[0], expected)


def test_refused_data_leave_the_model_as_it_was(fitted: GPDynamics, draws: Draws) -> None:
    x = draws.normal(2)
    before, _ = fitted.expansion.predict(x)
    with pytest.raises(ValueError, match="expected inputs"):
        fitted.fit(torch.zeros(5, 3), torch.zeros(5, 2))
    assert torch.equal(fitted.expansion.predict(x)[0], before)


def test_fit_without_iterations_is_an_error() -> None:
    with pytest.raises(ValueError, match="max_iterations must be a whole number of at least 1"):
        GPDynamics(1, 1).fit(torch.zeros(3, 1), torch.zeros(3, 1), max_iterations=0)


def test_more_data_than_an_exact_posterior_has_make_a_sparse_one(draws: Draws) -> None:
    inputs, other = draws.uniform(-2, 2, 120, 2), draws.uniform(-2, 2, 300, 2)
    targets = true_function(inputs) + 0.05 * draws.normal(120, 2)
    sparse, exact = GPDynamics(2, 2, most_exact=60, num_inducing=40), GPDynamics(2, 2)
    for dynamics in (sparse, exact):
        dynamics.fit(inputs, targets)
    assert sparse.sparse and not exact.sparse
    assert sparse.expansion.inputs.shape == (40, 2)
    assert all((row == inputs).all(-1).any() for row in sparse.expansion.inputs)
    predicted = [dynamics.expansion.mean(other) for dynamics in (sparse, exact)]
    errors = [(mean - true_function(other)).square().mean().sqrt() for mean in predicted]
    assert errors[0] < 1.5 * errors[1]


def test_as_many_data_as_an_exact_posterior_has_change_nothing(
    data: tuple[Tensor, Tensor], fitted: GPDynamics
) -> None:
    limited = GPDynamics(2, 2, most_exact=len(data[0]), num_inducing=5)
    limited.fit(*data)
    assert torch.equal(limited.expansion.weights, fitted.expansion.weights)


def test_sparse_model_predicts_the_same_from_a_file(
    data: tuple[Tensor, Tensor], draws: Draws
) -> None:
    saved, loaded = (GPDynamics(2, 2, most_exact=20, num_inducing=10) for _ in range(2))
    saved.fit(*data)
    loaded.load_state_dict(saved.state_dict())
    assert_same_predictions(saved, loaded, draws.belief(2))


def test_more_inducing_inputs_than_exact_data_are_an_error() -> None:
    with pytest.raises(ValueError, match="most_exact must be a whole number of at least 200"):
        GPDynamics(2, 2, most_exact=100)


def test_rule_of_the_positions_is_learned_and_comes_back_from_a_file(draws: Draws) -> None:
    known = KnownPart.of_velocities(("q", "dq"), {"q": "dq"}, num_actions=1, time_step=0.1)
    x, dq = draws.normal(20, 2), draws.normal(20)
    after = torch.stack([x[:, 0] + 0.02 * x[:, 1] + 0.07 * dq, dq], -1)
    dynamics, loaded = GPDynamics(3, 1, known), GPDynamics(3, 1, known)
    dynamics.fit_known_part(x, after)
    loaded.load_state_dict(dynamics.state_dict())
    expected = torch.tensor([[0.02, 0.07]]).double()
    for model in (dynamics, loaded):
        assert_close(model.targets.rule, expected, rtol=1e-4, atol=0)
    assert_close(known.rule, torch.full((1, 2), 0.05).double())


def test_rule_of_the_positions_does_not_depend_on_those_before_it(draws: Draws) -> None:
    """A third of the joints turned back; by the first rule, all the others are far off."""
    known = KnownPart.of_velocities(("q", "dq"), {"q": "dq"}, num_actions=1, time_step=0.1)
    x, dq, dynamics = draws.normal(30, 2), draws.normal(30), GPDynamics(3, 1, known)
    way, half = x[:, 1] + dq, torch.full((1, 2), 0.05).double()
    dynamics.fit_known_part(x, torch.stack([x[:, 0] + 0.03 * way, dq], -1))
    assert_close(dynamics.targets.rule, 0.6 * half, rtol=1e-4, atol=0)
    way[20:] = 0.0
    dynamics.fit_known_part(x, torch.stack([x[:, 0] + 0.05 * way, dq], -1))
    assert_close(dynamics.targets.rule, half, rtol=1e-4, atol=0)


def test_model_of_all_entries_has_no_rule(fitted: GPDynamics) -> None:
    fitted.fit_known_part(torch.zeros(3, 2), torch.zeros(3, 2))
    assert "position_rule" not in fitted.state_dict()
    assert fitted.targets.learned == (0, 1)
