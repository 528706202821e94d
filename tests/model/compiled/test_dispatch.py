"""Which predictions the kernels compute, and which the formulas in PyTorch."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.losses import SPACE, make_cost, make_kl, make_parts
from tests.helpers.run_script import ROOT
from tests.helpers.two_ways import formulas_alone
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.model.compiled import SLOWER, kernels
from torch_pmil.model.function_samples import FunctionSamples
from torch_pmil.model.rollout import predict_mean_trajectory, predict_trajectory

STEPS = 3
ANSWERS = (
    *("predict_beliefs", "predict_states", "costs_of_beliefs", "costs_of_states"),
    "outputs_of",
)


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the kernels were asked for."""
    asked: list[str] = []
    module = kernels()
    for name in ANSWERS:
        monkeypatch.setattr(module, name, listening(module, name, asked))
    return asked


def listening(module: ModuleType, name: str, asked: list[str]) -> Callable[..., Any]:
    function = getattr(module, name)

    def listen(*arguments: Any) -> Any:
        asked.append(name)
        return function(*arguments)

    return listen


@pytest.fixture
def start(draws: Draws) -> Gaussian:
    return draws.belief(2, scale=0.05)


def test_kernels_compute_what_is_ordinary(answers: list[str], start: Gaussian) -> None:
    for loss in (make_kl(seed=1), make_cost(seed=1)):
        loss.per_step(start).sum().backward()
        loss.mean_per_step(start).sum().backward()
    assert answers == [ANSWERS[0], ANSWERS[2], ANSWERS[1], ANSWERS[3]] * 2


def test_formulas_compute_in_single_precision(answers: list[str], start: Gaussian) -> None:
    policy, dynamics = (part.float() for part in make_parts(Draws(0)))
    single = Gaussian(start.mean.float(), start.cov.float())
    trajectory = predict_trajectory(single, policy, dynamics, SPACE, STEPS)
    states = predict_mean_trajectory(single.mean, policy, dynamics, SPACE, STEPS)
    assert trajectory.mean.dtype == trajectory.cov.dtype == states.dtype == torch.float32
    assert not answers


def test_formulas_compute_gradients_in_hyperparameters(answers: list[str], start: Gaussian) -> None:
    policy, dynamics = make_parts(Draws(0))
    dynamics._expansion = KernelExpansion.from_exact_gp(dynamics.gp)
    trajectory = predict_trajectory(start, policy, dynamics, SPACE, STEPS)
    parameters = list(dynamics.gp.parameters())
    gradients = torch.autograd.grad(trajectory.cov.sum(), parameters)
    assert all((gradient != 0).any() for gradient in gradients) and not answers


@pytest.mark.parametrize(
    "name",
    [
        *("inputs", "weights", "lengthscales", "signal_variance"),
        *("gram_inverse", "noise_variance", "offset"),
    ],
)
def test_formulas_compute_gradients_in_the_posterior(
    answers: list[str], start: Gaussian, name: str
) -> None:
    policy, dynamics = make_parts(Draws(0))
    leaf = getattr(dynamics.expansion, name).clone().requires_grad_()
    dynamics._expansion = replace(dynamics.expansion, **{name: leaf})
    trajectory = predict_trajectory(start, policy, dynamics, SPACE, STEPS)
    states = predict_mean_trajectory(start.mean, policy, dynamics, SPACE, STEPS)
    total = trajectory.cov.sum() + states.sum()
    (gradient,) = torch.autograd.grad(total, leaf)
    assert (gradient != 0).any() and not answers
    with torch.no_grad():
        predict_trajectory(start, policy, dynamics, SPACE, STEPS)
    assert answers == ["predict_beliefs"]


@pytest.mark.parametrize(
    ("make", "name"),
    [
        *((make_kl, name) for name in ("demonstrated_mean", "demonstrated_cov", "noise_std")),
        *((make_cost, name) for name in ("target", "to_widths")),
    ],
)
def test_formulas_compute_gradients_in_demonstrations_and_targets(
    answers: list[str], start: Gaussian, make: Callable[..., Any], name: str
) -> None:
    loss = make(seed=1)
    if make is make_kl:
        loss.noise_std = torch.full((2,), 0.1, dtype=torch.float64)
    leaf = getattr(loss, name).requires_grad_()
    gradient = torch.autograd.grad(loss.per_step(start).sum(), leaf)[0]
    assert (gradient != 0).any() and answers == ["predict_beliefs"]


def test_formulas_compute_where_marginals_are_for_other_batches(
    answers: list[str], start: Gaussian
) -> None:
    """Each demonstrated batch is compared with the one prediction."""
    loss = make_kl(seed=1)
    for name in ("demonstrated_mean", "demonstrated_cov"):
        setattr(loss, name, getattr(loss, name).expand(3, *getattr(loss, name).shape).clone())
    assert loss.per_step(start).shape == (3, loss.horizon)
    assert answers == ["predict_beliefs"]


# --- drawn functions ---


def drawn_functions(draws: Draws) -> FunctionSamples:
    return make_parts(draws)[1].functions(4, draws.generator)


@pytest.mark.parametrize("differentiable", [False, True])
def test_kernels_compute_drawn_functions(
    answers: list[str], draws: Draws, differentiable: bool
) -> None:
    functions = drawn_functions(draws)
    inputs = draws.normal(4, functions.expansion.num_inputs).requires_grad_(differentiable)
    assert functions(inputs).requires_grad == differentiable
    assert answers == ["outputs_of"]


def test_formulas_compute_drawn_functions_in_single_precision(
    answers: list[str], draws: Draws
) -> None:
    _, dynamics = (part.float() for part in make_parts(draws))
    functions = dynamics.functions(4, draws.generator)
    inputs = draws.normal(4, functions.expansion.num_inputs)
    assert functions(inputs.float()).dtype == torch.float32 and not answers


@pytest.mark.parametrize("name", ["frequencies", "weights", "updates"])
def test_formulas_compute_gradients_in_drawn_functions(
    answers: list[str], draws: Draws, name: str
) -> None:
    functions = drawn_functions(draws)
    leaf = getattr(functions, name).clone().requires_grad_()
    check_gradient_in(leaf, replace(functions, **{name: leaf}), draws, answers)


@pytest.mark.parametrize("name", ["inputs", "lengthscales", "signal_variance", "offset"])
def test_formulas_compute_gradients_in_the_posterior_of_drawn_functions(
    answers: list[str], draws: Draws, name: str
) -> None:
    functions = drawn_functions(draws)
    leaf = getattr(functions.expansion, name).clone().requires_grad_()
    posterior = replace(functions.expansion, **{name: leaf})
    check_gradient_in(leaf, replace(functions, expansion=posterior), draws, answers)


def check_gradient_in(
    leaf: Tensor, functions: FunctionSamples, draws: Draws, answers: list[str]
) -> None:
    """There is one by the formulas, and without a graph the kernels compute."""
    inputs = draws.normal(4, functions.expansion.num_inputs)
    (gradient,) = torch.autograd.grad(functions(inputs).sum(), leaf)
    assert (gradient != 0).any() and not answers
    with torch.no_grad():
        functions(inputs)
    assert answers == ["outputs_of"]


# --- without kernels ---

PREDICTIONS = """
import json, os, sys, warnings
sys.modules["numba"] = None
import torch
from tests.helpers.draws import Draws
from tests.helpers.losses import SPACE, make_kl, make_parts
from torch_pmil.model.compiled import available
from torch_pmil.model.rollout import predict_trajectory

def predict():
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        start = Draws(0).belief(2, scale=0.05)
        for _ in range(2):
            mean = predict_trajectory(start, *make_parts(Draws(0)), SPACE, 3).mean
            make_kl(seed=1).per_step(start)
    available.cache_clear()
    return [str(warning.message) for warning in said], mean.tolist()

results = [predict()]
del sys.modules["numba"]
for variable, value in (("TORCH_PMIL_COMPILED", "0"), ("NUMBA_DISABLE_JIT", "1")):
    os.environ[variable] = value
    results.append(predict())
    del os.environ[variable]
assert "llvmlite" not in sys.modules
print(json.dumps(results))
"""
REASONS = (
    "Numba is not installed (pip install numba)",
    "TORCH_PMIL_COMPILED is 0",
    "NUMBA_DISABLE_JIT is set",
)


def test_formulas_compute_where_there_are_no_kernels_and_say_so_once(start: Gaussian) -> None:
    printed = subprocess.run(
        [sys.executable, "-c", PREDICTIONS],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    with formulas_alone():
        reference = predict_trajectory(start, *make_parts(Draws(0)), SPACE, STEPS).mean
    for reason, (said, values) in zip(REASONS, json.loads(printed.stdout), strict=True):
        assert said == [SLOWER + reason]
        torch.testing.assert_close(torch.tensor(values, dtype=torch.float64), reference)
