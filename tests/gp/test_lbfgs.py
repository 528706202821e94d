"""The guarded L-BFGS on plain functions."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor, nn
from torch.testing import assert_close

from torch_pmil.gp.lbfgs import NotFiniteError, check_optimizer, minimise, minimise_function


class NoValueError(ValueError):
    """An objective has no value at this point."""


def parameter(*values: float) -> nn.Parameter:
    return nn.Parameter(torch.tensor(values, dtype=torch.float64))


def rosenbrock(x: Tensor) -> Tensor:
    return (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2


def test_rosenbrock_is_minimised() -> None:
    x = parameter(-1.2, 1.0)
    result = minimise([x], lambda: rosenbrock(x), max_iterations=200)
    assert_close(x.detach(), torch.ones(2, dtype=torch.float64), rtol=0, atol=1e-4)
    assert result.initial_loss == pytest.approx(24.2)
    assert result.loss == rosenbrock(x).item() < 1e-8
    assert result.failures == 0
    assert x.grad is None


def test_parameters_of_several_shapes_are_searched_together_without_contiguous_gradients() -> None:
    matrix, scalar = nn.Parameter(torch.zeros(2, 3, dtype=torch.float64)), parameter(5.0)
    target = torch.arange(6.0, dtype=torch.float64).reshape(3, 2)

    def objective() -> Tensor:
        return (matrix.mT.contiguous() - target).square().sum() + (scalar - 1).square().sum()

    assert not torch.autograd.grad(objective(), matrix)[0].is_contiguous()
    minimise([matrix, scalar], objective, max_iterations=50)
    assert_close(matrix.mT.detach(), target, rtol=0, atol=1e-4)
    assert scalar.item() == pytest.approx(1, abs=1e-4)


def test_search_works_where_gradients_are_switched_off() -> None:
    x = parameter(3.0)
    with torch.no_grad():
        assert minimise([x], lambda: (x**2).sum(), max_iterations=10).loss < 1e-8


def test_function_that_knows_its_gradient_is_searched_like_one_that_does_not() -> None:
    x, start, visited = parameter(-1.2, 1.0), parameter(-1.2, 1.0), []

    def function(point: Tensor) -> tuple[float, Tensor]:
        visited.append(point.clone())
        with torch.inference_mode(False):
            variable = point.clone().requires_grad_()
            value = rosenbrock(variable)
            (gradient,) = torch.autograd.grad(value, variable)
        return value.item(), gradient

    best, result = minimise_function(start, function, max_iterations=200)
    assert result == minimise([x], lambda: rosenbrock(x), max_iterations=200)
    assert torch.equal(best, x) and len(visited) == result.evaluations
    assert start.tolist() == [-1.2, 1.0] and not (best.requires_grad or best.is_inference())


def test_parameters_end_at_the_best_point_that_was_seen() -> None:
    """The objective worsens with each evaluation, so that L-BFGS itself ends at a later, worse
    point.
    """
    x, seen = parameter(-1.2, 1.0), []

    def objective() -> Tensor:
        loss = rosenbrock(x) + 10 * len(seen)
        seen.append((loss.item(), x.detach().clone()))
        return loss

    result = minimise([x], objective, max_iterations=5)
    loss, best = min(seen, key=lambda pair: pair[0])
    assert seen[-1][0] > loss
    assert result.loss == loss
    assert torch.equal(x.detach(), best)


def raising(error: Exception) -> float:
    raise error


FAILURES = {
    "error": lambda: raising(NoValueError()),
    "another error": lambda: raising(ZeroDivisionError()),
    "nan": lambda: math.nan,
    "inf": lambda: math.inf,
    "minus inf": lambda: -math.inf,
    "beyond the rejected": lambda: 1e11,
}


def walled(x: Tensor, wall: float, failure: str) -> Tensor:
    """x - log x, minimal at 1; it fails below the wall."""
    broken = FAILURES[failure]() if x.item() <= wall else 0.0
    return (x - x.log()).sum() if broken == 0 else x.sum() * 0 + broken


@pytest.mark.parametrize("failure", FAILURES)
def test_failures_in_a_part_of_the_space_are_survived_and_counted(failure: str) -> None:
    """The second step of L-BFGS leads to -1.7, beyond the wall."""
    x, fails = parameter(3.0), []

    def objective() -> Tensor:
        fails.append(x.item() <= 0)
        return walled(x, 0.0, failure)

    result = minimise([x], objective, max_iterations=50, survives=(NoValueError, ZeroDivisionError))
    assert x.item() == pytest.approx(1, abs=1e-4)
    assert result.failures == sum(fails) > 0
    assert result.evaluations == len(fails)
    assert result.stop_reason == "gradient is small"


def test_gradient_that_is_not_finite_is_a_failure() -> None:
    """sqrt has no slope at zero."""
    x, message = parameter(0.0), r"must be below 1e\+10, with a finite gradient, got 0\.0 and inf"
    with pytest.raises(NotFiniteError, match=message):
        minimise([x], lambda: x.sqrt().sum(), max_iterations=5)


@pytest.mark.parametrize(
    ("failure", "error"),
    [("error", NoValueError), ("nan", NotFiniteError), ("inf", NotFiniteError)],
)
def test_failure_at_the_start_is_an_error(failure: str, error: type[Exception]) -> None:
    x = parameter(0.5)
    with pytest.raises(error):
        minimise([x], lambda: walled(x, 0.6, failure), max_iterations=5, survives=(NoValueError,))
    assert x.item() == 0.5


def test_other_errors_of_the_objective_are_not_swallowed() -> None:
    x, survived = parameter(3.0), (ZeroDivisionError,)
    with pytest.raises(NoValueError):
        minimise([x], lambda: walled(x, 0.0, "error"), max_iterations=50, survives=survived)


@pytest.mark.parametrize(
    ("start", "wall", "iterations", "reason"),
    [
        (3.0, 0.0, 50, "gradient is small"),
        (3.0, 0.0, 1, "iteration limit"),
        (3.0, 2.999999999999, 50, "numerical failure"),
    ],
)
def test_result_says_why_the_search_ended(
    start: float, wall: float, iterations: int, reason: str
) -> None:
    x = parameter(start)
    result = minimise([x], lambda: walled(x, wall, "nan"), max_iterations=iterations)
    assert result.stop_reason == reason


def test_tolerance_is_that_of_the_largest_gradient_entry() -> None:
    x = parameter(3.0, 1.0)
    result = minimise([x], lambda: (x**2).sum(), max_iterations=10, tolerance_grad=6.5)
    assert (result.evaluations, result.stop_reason) == (1, "gradient is small")


def test_tolerance_of_change_is_that_of_the_loss_in_one_iteration() -> None:
    """x^4, on which L-BFGS never comes to an end by itself."""
    x = parameter(2.5)
    coarse, fine = (
        minimise([x], lambda: (x**4).sum(), 100, tolerance_grad=0, tolerance_change=change)
        for change in (1e-6, 1e-12)
    )
    assert coarse.stop_reason == fine.stop_reason == "no further progress"
    assert 1e-10 < coarse.loss < 1e-5
    assert fine.loss < 1e-10


class Deaf(torch.optim.SGD):
    """Does not call its closure."""

    def step(self, closure: object = None) -> None:
        super().step()


class Alone(torch.optim.SGD):
    """Takes no closure."""

    def step(self) -> None:
        super().step()


@pytest.mark.parametrize(
    ("optimizer", "said"),
    [
        (Deaf, "got Deaf: step of the optimizer must call its closure, got no call"),
        (Alone, "got Alone: Alone.step() takes 1 positional argument but 2 were given"),
        (lambda parameters: None, "got <lambda>: 'NoneType' object has no attribute 'step'"),
        (torch.optim.SparseAdam, "got SparseAdam: SparseAdam does not support dense gradients"),
        (torch.optim.Adam([torch.zeros(1)]), "got Adam: 'Adam' object is not callable"),
    ],
)
def test_optimiser_that_cannot_search_is_refused_in_one_line(optimizer: object, said: str) -> None:
    with pytest.raises(TypeError) as error:
        check_optimizer(optimizer)
    line = f"optimizer must be a torch.optim class whose step takes a closure, {said}"
    assert str(error.value).startswith(line) and "\n" not in str(error.value)


def test_search_by_an_optimiser_that_evaluates_nothing_is_an_error() -> None:
    x = parameter(3.0)
    with pytest.raises(TypeError, match="must call its closure, got no call"):
        minimise([x], lambda: (x**2).sum(), 5, optimizer=Deaf)
