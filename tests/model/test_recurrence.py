"""Recurrences differentiated at all times at once, against the plain loop."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from tests.helpers.draws import Draws
from torch_pmil.model.recurrence import unroll

SIZE, HORIZON = 3, 6
batches = pytest.mark.parametrize(
    "batch", [(), (4,), (2, 3)], ids=["one", "batch", "two batch dimensions"]
)


def follow(state: Tensor, matrix: Tensor, offset: Tensor) -> Tensor:
    """A small nonlinear map of states (*batch, S)."""
    return (state @ matrix.mT + offset).tanh() + 0.1 * state.square()


class Map:
    """:func:`follow` as a step, which counts what it is asked for."""

    def __init__(self, matrix: Tensor, offset: Tensor) -> None:
        self.parameters = matrix, offset
        self.steps = self.jacobians = self.gradients = 0

    def advance(self, state: Tensor) -> Tensor:
        assert not torch.is_grad_enabled()
        self.steps += 1
        return follow(state, *self.parameters)

    def jacobian(self, states: Tensor) -> Tensor:
        self.jacobians += 1
        flat = states.reshape(-1, SIZE)
        rows = [
            torch.autograd.functional.jacobian(lambda x: follow(x, *self.parameters), state)
            for state in flat
        ]
        return torch.stack(rows).detach().view(*states.shape, SIZE)

    def parameter_gradients(
        self, states: Tensor, parameters: Sequence[Tensor], adjoints: Tensor
    ) -> Sequence[Tensor]:
        self.gradients += 1
        leaves = [parameter.detach().requires_grad_() for parameter in parameters]
        with torch.enable_grad():
            following = follow(states, *leaves)
        return torch.autograd.grad(following, leaves, adjoints)


def plain_loop(initial: Tensor, matrix: Tensor, offset: Tensor, horizon: int = HORIZON) -> Tensor:
    states = [initial]
    for _ in range(horizon):
        states.append(follow(states[-1], matrix, offset))
    return torch.stack(states[1:])


def unrolled(initial: Tensor, matrix: Tensor, offset: Tensor, horizon: int = HORIZON) -> Tensor:
    return unroll(Map(matrix, offset), initial, (matrix, offset), horizon)


def variables(draws: Draws, batch: tuple[int, ...] = ()) -> list[Tensor]:
    """Initial state, matrix and offset."""
    return [
        t.requires_grad_()
        for t in (draws.normal(*batch, SIZE), 0.7 * draws.normal(SIZE, SIZE), draws.normal(SIZE))
    ]


@batches
@pytest.mark.parametrize("horizon", [1, 2, HORIZON])
def test_states_and_gradients_are_those_of_the_plain_loop(
    draws: Draws, batch: tuple[int, ...], horizon: int
) -> None:
    leaves, cotangent = variables(draws, batch), draws.normal(horizon, *batch, SIZE)
    ours, loop = (function(*leaves, horizon) for function in (unrolled, plain_loop))
    assert ours.shape == (horizon, *batch, SIZE)
    assert torch.equal(ours, loop)
    gradients = (torch.autograd.grad(states, leaves, cotangent) for states in (ours, loop))
    for gradient, expected in zip(*gradients, strict=True):
        torch.testing.assert_close(gradient, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("t", range(4))
def test_gradient_of_a_single_state_goes_through_all_the_earlier_ones(draws: Draws, t: int) -> None:
    leaves = variables(draws, (2,))
    gradients = (
        torch.autograd.grad(function(*leaves, 4)[t].sin().sum(), leaves)
        for function in (unrolled, plain_loop)
    )
    for gradient, expected in zip(*gradients, strict=True):
        torch.testing.assert_close(gradient, expected, rtol=1e-12, atol=1e-12)


def test_gradient(draws: Draws) -> None:
    assert gradcheck(unrolled, variables(draws, (2,)))


def test_gradient_flows_to_what_the_parameters_were_made_of(draws: Draws) -> None:
    initial, matrix, offset = variables(draws)

    def gradients(function) -> tuple[Tensor, ...]:
        return torch.autograd.grad(
            function(initial.sin(), matrix.exp(), offset * 2).square().sum(),
            (initial, matrix, offset),
        )

    for gradient, expected in zip(gradients(unrolled), gradients(plain_loop), strict=True):
        torch.testing.assert_close(gradient, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    "needed",
    [(0,), (1,), (2,), (0, 2), (1, 2)],
    ids=["initial", "matrix", "offset", "initial+offset", "parameters"],
)
@pytest.mark.parametrize("horizon", [1, HORIZON])
def test_gradient_in_some_of_the_variables(
    draws: Draws, needed: tuple[int, ...], horizon: int
) -> None:
    leaves, cotangent = [t.detach() for t in variables(draws, (2,))], draws.normal(horizon, 2, SIZE)
    wanted = [leaves[index].requires_grad_() for index in needed]
    gradients = (
        torch.autograd.grad(function(*leaves, horizon), wanted, cotangent)
        for function in (unrolled, plain_loop)
    )
    for gradient, expected in zip(*gradients, strict=True):
        torch.testing.assert_close(gradient, expected, rtol=1e-12, atol=1e-12)


def test_gradients_in_constant_parameters_are_not_asked_for(draws: Draws) -> None:
    initial, matrix, offset = (t.detach() for t in variables(draws))
    step = Map(matrix, offset)
    unroll(step, initial.requires_grad_(), (matrix, offset), HORIZON).sum().backward()
    assert (step.steps, step.jacobians, step.gradients) == (HORIZON, 1, 0)
    assert initial.grad is not None and matrix.grad is None


def test_derivatives_of_all_times_are_asked_for_once(draws: Draws) -> None:
    initial, matrix, offset = variables(draws, (2,))
    step = Map(matrix, offset)
    unroll(step, initial, (matrix, offset), HORIZON).sum().backward()
    assert (step.steps, step.jacobians, step.gradients) == (HORIZON, 1, 1)


def test_recurrence_without_parameters(draws: Draws) -> None:
    initial, matrix, offset = variables(draws)
    constant = matrix.detach(), offset.detach()
    (gradient,) = torch.autograd.grad(unroll(Map(*constant), initial, (), HORIZON).sum(), initial)
    torch.testing.assert_close(
        gradient,
        torch.autograd.grad(plain_loop(initial, *constant).sum(), initial)[0],
        rtol=1e-12,
        atol=1e-12,
    )


@pytest.mark.parametrize("recording", [True, False])
def test_nothing_is_differentiated_where_nothing_needs_it(draws: Draws, recording: bool) -> None:
    """Either no variable needs a gradient, or no graph is recorded."""
    leaves = [t.detach() if recording else t for t in variables(draws)]
    step = Map(*leaves[1:])
    with torch.set_grad_enabled(recording):
        states = unroll(step, leaves[0], tuple(leaves[1:]), HORIZON)
    assert not states.requires_grad
    assert torch.equal(states, plain_loop(*leaves))
    assert (step.steps, step.jacobians, step.gradients) == (HORIZON, 0, 0)


def test_states_may_be_changed_in_place(draws: Draws) -> None:
    leaves = variables(draws)
    changed = unrolled(*leaves).mul_(2).sum()
    for gradient, expected in zip(
        torch.autograd.grad(changed, leaves),
        torch.autograd.grad(2 * plain_loop(*leaves).sum(), leaves),
        strict=True,
    ):
        torch.testing.assert_close(gradient, expected, rtol=1e-12, atol=1e-12)


def test_states_may_be_differentiated_several_times(draws: Draws) -> None:
    leaves = variables(draws)
    loss = unrolled(*leaves).square().sum()
    once, again = (
        torch.autograd.grad(loss, leaves, retain_graph=retain) for retain in (True, False)
    )
    assert all(torch.equal(a, b) for a, b in zip(once, again, strict=True))


@pytest.mark.parametrize("variable", range(3), ids=["initial", "matrix", "offset"])
def test_second_derivatives_are_refused(draws: Draws, variable: int) -> None:
    leaves = variables(draws)
    (gradient,) = torch.autograd.grad(
        unrolled(*leaves).square().sum(), leaves[variable], create_graph=True
    )
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()
