"""Minimisation by ``torch.optim.LBFGS`` that survives points at which the objective fails."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

LARGEST_LOSS = 1e10  # beyond, an objective counts as failed


class NotFiniteError(ValueError):
    """An objective or its gradient is not finite."""


@dataclass(frozen=True)
class MinimiseResult:
    """Outcome of one run of L-BFGS.

    ``stop_reason`` is one of "iteration limit", "gradient is small", "no further progress",
    "numerical failure".
    """

    initial_loss: float
    loss: float
    iterations: int
    evaluations: int
    failures: int
    stop_reason: str


def minimise(
    parameters: Iterable[nn.Parameter],
    objective: Callable[[], Tensor],
    max_iterations: int,
    survives: tuple[type[Exception], ...] = (),
    tolerance_grad: float = 1e-5,
    tolerance_change: float = 1e-10,
) -> MinimiseResult:
    """Minimise with ``torch.optim.LBFGS`` and a strong Wolfe line search.

    The parameters end at the best point that was seen. A point where the objective raises one of
    the errors in ``survives``, or is not finite in value or gradient, counts as a large loss
    without gradient: the line search steps back from it.

    Args:
        parameters: changed in place.
        objective: a scalar with a graph.
        max_iterations: limit of L-BFGS; each iteration takes one to a few evaluations.
        survives: errors by which the objective says that it has no value at a point.
        tolerance_grad: the search ends when no gradient entry is larger than this.
        tolerance_change: the search ends when the loss, or every parameter, changes by less than
            this in an iteration.

    Raises:
        NotFiniteError: the objective is not finite at the starting point, where there is nothing
            to step back to. An error of ``survives`` at the starting point is raised as well.

    Example:
        >>> x = nn.Parameter(torch.tensor([3.0, -1.0], dtype=torch.float64))
        >>> minimise([x], lambda: ((x - 1) ** 2).sum(), max_iterations=20).stop_reason
        'gradient is small'
        >>> [round(v, 6) for v in x.tolist()]
        [1.0, 1.0]
    """
    guard = _Guard(list(parameters), objective, survives)
    optimizer = torch.optim.LBFGS(
        guard.parameters,
        max_iter=max_iterations,
        max_eval=3 * max_iterations,
        history_size=50,
        tolerance_grad=tolerance_grad,
        tolerance_change=tolerance_change,
        line_search_fn="strong_wolfe",
    )
    optimizer.step(guard)
    iterations = optimizer.state[guard.parameters[0]]["n_iter"]
    guard.restore_best()
    return MinimiseResult(
        initial_loss=guard.initial_loss,
        loss=guard.best_loss,
        iterations=iterations,
        evaluations=guard.evaluations,
        failures=guard.failures,
        stop_reason=guard.stop_reason(iterations, max_iterations, tolerance_grad),
    )


class _Guard:
    """An L-BFGS closure that survives failed evaluations and keeps the best point."""

    def __init__(
        self,
        parameters: list[nn.Parameter],
        objective: Callable[[], Tensor],
        survives: tuple[type[Exception], ...],
    ) -> None:
        self.parameters, self.objective = parameters, objective
        self.failed: tuple[type[Exception], ...] = (NotFiniteError, *survives)
        self.evaluations = self.failures = 0
        self.initial_loss = self.best_loss = float("inf")
        self.best_gradient = float("inf")
        self.best: list[Tensor] = []
        self.last_failed = False

    @torch.enable_grad()
    def __call__(self) -> Tensor:
        self.evaluations += 1
        try:
            loss, gradients = self._evaluate()
        except self.failed:
            if self.evaluations == 1:
                raise
            self.failures += 1
            self.last_failed = True
            loss = torch.tensor(self._rejected_loss())
            gradients = tuple(torch.zeros_like(p) for p in self.parameters)
        for parameter, gradient in zip(self.parameters, gradients, strict=True):
            parameter.grad = gradient.contiguous()
        return loss

    def _evaluate(self) -> tuple[Tensor, tuple[Tensor, ...]]:
        loss = self.objective()
        gradients = torch.autograd.grad(
            loss, self.parameters, allow_unused=True, materialize_grads=True
        )
        largest = max(g.abs().max().item() for g in gradients)
        value = loss.item()
        if not (abs(value) < LARGEST_LOSS and largest < float("inf")):
            raise NotFiniteError(
                f"the objective must be finite with a finite gradient, got {value} and {largest}"
            )
        if self.evaluations == 1:
            self.initial_loss = value
        if value < self.best_loss:
            self.best_loss, self.best_gradient = value, largest
            self.best = [p.detach().clone() for p in self.parameters]
        self.last_failed = False
        return loss.detach(), gradients

    def _rejected_loss(self) -> float:
        """A loss worse than the best by a margin, finite since inf would freeze the line search.

        It is near enough to the best loss for a fair step back.
        """
        return self.best_loss + 10 * (1 + abs(self.best_loss))

    def restore_best(self) -> None:
        restore(self.parameters, self.best)

    def stop_reason(self, iterations: int, max_iterations: int, tolerance_grad: float) -> str:
        if self.best_gradient <= tolerance_grad:
            return "gradient is small"
        if self.last_failed:
            return "numerical failure"
        return "iteration limit" if iterations >= max_iterations else "no further progress"


@torch.no_grad()
def restore(parameters: list[nn.Parameter], values: list[Tensor]) -> None:
    """Set parameters to given values, and forget their gradients."""
    for parameter, value in zip(parameters, values, strict=True):
        parameter.copy_(value)
        parameter.grad = None
