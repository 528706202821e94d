r"""Recurrences :math:`x_{t+1} = F(x_t, \theta)` that are differentiated at all times at once.

The states are computed one after the other without a graph. Then, all of them being known, the Jacobians of all steps are one batch; only
the products of these small matrices go back step by step, and the gradient in the parameters is one batch again. The work is that of
backpropagation through time, in a few large operations instead of many small ones.
"""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


class Step(Protocol):
    """One step of a recurrence, for states (*batch, S); at all times at once they are (T, *batch, S)."""

    def advance(self, state: Tensor) -> Tensor:
        """The next state; no graph is recorded."""

    def by_state(self, states: Tensor) -> Tensor:
        """The next states of several copies (T, *batch, C, S) of those that ``advance`` was given, differentiable in the states."""

    def by_parameters(self, states: Tensor, parameters: tuple[Tensor, ...]) -> Tensor:
        """The next states, differentiable in the parameters."""


def unroll(step: Step, initial: Tensor, parameters: tuple[Tensor, ...], horizon: int) -> Tensor:
    """States at t = 1..horizon, (T, *batch, S), differentiable (once) in the initial state (*batch, S) and the parameters."""
    return _Unrolled.apply(step, horizon, initial, *parameters)


class _Unrolled(torch.autograd.Function):
    @staticmethod
    def forward(ctx, step, horizon, initial, *parameters):
        states = [initial]
        for _ in range(horizon):
            states.append(step.advance(states[-1]))
        trajectory = torch.stack(states)
        ctx.step = step
        ctx.save_for_backward(trajectory[:-1], *parameters)
        return trajectory[1:].clone()

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        states, *parameters = ctx.saved_tensors
        jacobian = _jacobian(ctx.step, states)
        adjoints = [gradient[-1]]
        for earlier, J in zip(gradient[:-1].flip(0), jacobian[1:].flip(0), strict=True):
            adjoints.append(earlier + _row_times(adjoints[-1], J))
        d_initial = _row_times(adjoints[-1], jacobian[0]) if ctx.needs_input_grad[2] else None
        d_parameters = _parameter_gradients(ctx.step, states, parameters, ctx.needs_input_grad[3:], torch.stack(adjoints[::-1]))
        return None, None, d_initial, *d_parameters


def _row_times(row: Tensor, matrix: Tensor) -> Tensor:
    return (row[..., None, :] @ matrix).squeeze(-2)


def _jacobian(step: Step, states: Tensor) -> Tensor:
    """d x_{t+1} / d x_t at all times, (T, *batch, S, S): one copy of each state for every entry of the next."""
    size = states.shape[-1]
    copies = states[..., None, :].repeat(*[1] * (states.ndim - 1), size, 1).requires_grad_()
    with torch.enable_grad():
        following = step.by_state(copies)
    identity = torch.eye(size, dtype=states.dtype, device=states.device)
    return torch.autograd.grad(following, copies, identity.expand(following.shape))[0]


def _parameter_gradients(step: Step, states: Tensor, parameters: list[Tensor], needed: tuple[bool, ...], adjoints: Tensor) -> list:
    """For each parameter its gradient, or None where none is needed."""
    leaves = [parameter.detach().requires_grad_(needs) for parameter, needs in zip(parameters, needed, strict=True)]
    wanted = [leaf for leaf in leaves if leaf.requires_grad]
    if not wanted:
        return [None] * len(leaves)
    with torch.enable_grad():
        following = step.by_parameters(states, tuple(leaves))
    found = iter(torch.autograd.grad(following, wanted, adjoints))
    return [next(found) if leaf.requires_grad else None for leaf in leaves]
