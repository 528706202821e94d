r"""Recurrences :math:`x_{t+1} = F(x_t, \theta)` that are differentiated at all times at once.

The states are computed one after the other without a graph. Then, all of them being known, the
Jacobians of all steps are one batch; only the products of these small matrices go back step by
step, and the gradient in the parameters is one batch again. The work is that of backpropagation
through time, in a few large operations instead of many small ones. A predicted trajectory is such
a recurrence, and its gradient is Eq. 22.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


class Step(Protocol):
    """One step of a recurrence of states (*batch, S).

    The states at all times at once are (T, *batch, S).
    """

    def advance(self, state: Tensor) -> Tensor:
        """The next state, computed without a graph."""

    def jacobian(self, states: Tensor) -> Tensor:
        """Jacobians d x_{t+1} / d x_t, (T, *batch, S, S), at all the states that were advanced."""

    def parameter_gradients(
        self, states: Tensor, parameters: Sequence[Tensor], adjoints: Tensor
    ) -> Sequence[Tensor]:
        """Gradients in the parameters, from the adjoints (T, *batch, S) of all the next states."""


def unroll(step: Step, initial: Tensor, parameters: tuple[Tensor, ...], horizon: int) -> Tensor:
    """States at t = 1..horizon, (T, *batch, S), of a recurrence.

    They are differentiable (once) in the initial state (*batch, S) and the parameters.
    """
    return _Unrolled.apply(step, horizon, initial, *parameters)


class _Unrolled(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, step: Step, horizon: int, initial: Tensor, *parameters: Tensor) -> Tensor:
        states = [initial]
        for _ in range(horizon):
            states.append(step.advance(states[-1]))
        trajectory = torch.stack(states)
        ctx.step = step
        ctx.save_for_backward(trajectory[:-1], *parameters)
        return trajectory[1:].clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        states, *parameters = ctx.saved_tensors
        jacobian = ctx.step.jacobian(states)
        adjoints = [gradient[-1]]
        for earlier, J in zip(gradient[:-1].flip(0), jacobian[1:].flip(0), strict=True):
            adjoints.append(earlier + _row_times(adjoints[-1], J))
        d_initial = _row_times(adjoints[-1], jacobian[0]) if ctx.needs_input_grad[2] else None
        d_parameters: Sequence[Tensor | None] = [None] * len(parameters)
        if any(ctx.needs_input_grad[3:]):
            d_parameters = ctx.step.parameter_gradients(
                states, parameters, torch.stack(adjoints[::-1])
            )
        return None, None, d_initial, *d_parameters


def _row_times(row: Tensor, matrix: Tensor) -> Tensor:
    return (row[..., None, :] @ matrix).squeeze(-2)
