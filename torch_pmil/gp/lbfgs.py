"""Minimisation by an optimiser of PyTorch that survives points at which the objective fails."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from torch_pmil.files import bounded_line

MakeOptimizer = Callable[[list[Tensor]], torch.optim.Optimizer]  # such as a class of torch.optim

LARGEST_LOSS = 1e10  # beyond, an objective counts as failed


class NotFiniteError(ValueError):
    """An objective or its gradient is not finite."""


@dataclass(frozen=True)
class MinimiseResult:
    """Outcome of one run of an optimiser.

    ``stop_reason`` is "iteration limit", "gradient is small", "no further progress", or "numerical
    failure".
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
    optimizer: MakeOptimizer = torch.optim.LBFGS,
) -> MinimiseResult:
    """Minimise with ``torch.optim.LBFGS`` and a strong Wolfe line search, or another optimiser.

    The parameters end at the best point that was seen. The line search steps back where the
    objective raises one of the errors in ``survives``. It also steps back where the value is 1e10
    or more, or where value or gradient is not finite.

    Args:
        parameters: changed in place.
        objective: a scalar with a graph.
        max_iterations: largest number of iterations; one of L-BFGS takes one to a few evaluations.
        survives: errors by which the objective says that it has no value at a point.
        tolerance_grad: the search ends when no gradient entry is larger.
        tolerance_change: it ends when loss or all parameters change by less in an iteration.
        optimizer: a class of ``torch.optim``, or a function such as
            ``functools.partial(torch.optim.Adam, lr=0.02)``. Any but L-BFGS makes
            ``max_iterations`` steps and ignores the tolerances.

    Raises:
        NotFiniteError: the objective is not finite at the start; an error of ``survives`` there is
            raised as well.
        TypeError: the optimiser's step does not call its closure.

    Example:
        >>> x = nn.Parameter(torch.tensor([3.0, -1.0], dtype=torch.float64))
        >>> minimise([x], lambda: ((x - 1) ** 2).sum(), max_iterations=20).stop_reason
        'gradient is small'
        >>> [round(v, 6) for v in x.tolist()]
        [1.0, 1.0]
    """
    variables = list(parameters)
    best, result = minimise_function(
        in_one_vector(variables),
        differentiated(variables, objective),
        max_iterations,
        survives,
        tolerance_grad,
        tolerance_change,
        optimizer,
    )
    set_to(variables, best)
    return result


def differentiated(
    variables: Sequence[nn.Parameter], objective: Callable[[], Tensor]
) -> Callable[[Tensor], tuple[float, Tensor]]:
    """A scalar with a graph as a function of one vector (D,) that knows its gradient."""

    def function(point: Tensor) -> tuple[float, Tensor]:
        with torch.inference_mode(False):
            set_to(variables, point)
            loss = objective()
            gradients = torch.autograd.grad(
                loss, variables, allow_unused=True, materialize_grads=True
            )
            return loss.item(), in_one_vector(gradients)

    return function


def in_one_vector(variables: Sequence[Tensor]) -> Tensor:
    """The entries of tensors one after the other, (D,), without a graph."""
    return torch.cat([variable.detach().flatten() for variable in variables])


def set_to(variables: Sequence[nn.Parameter], point: Tensor) -> None:
    """Set parameters to the parts of one vector, and forget their gradients."""
    parts = point.split([variable.numel() for variable in variables])
    restore(variables, [part.view_as(v) for part, v in zip(parts, variables, strict=True)])


def minimise_function(
    start: Tensor,
    function: Callable[[Tensor], tuple[float, Tensor]],
    max_iterations: int,
    survives: tuple[type[Exception], ...] = (),
    tolerance_grad: float = 1e-5,
    tolerance_change: float = 1e-10,
    optimizer: MakeOptimizer = torch.optim.LBFGS,
) -> tuple[Tensor, MinimiseResult]:
    """:func:`minimise` for a function of one vector that knows its gradient.

    Args:
        start: (D,), left as it is.
        function: value and gradient (D,) at a point (D,), which changes afterwards. It is called
            in inference mode.

    Returns:
        The best point that was seen, (D,), and the outcome.
    """
    guard = _Guard(start, function, survives)
    with torch.inference_mode():  # its small calls take a sixth less time than without
        if optimizer is torch.optim.LBFGS:
            lbfgs = torch.optim.LBFGS(
                [guard.point],
                max_iter=max_iterations,
                max_eval=3 * max_iterations,
                history_size=50,
                tolerance_grad=tolerance_grad,
                tolerance_change=tolerance_change,
                line_search_fn="strong_wolfe",
            )
            lbfgs.step(guard)
            iterations = lbfgs.state[guard.point]["n_iter"]
        else:
            other = optimizer([guard.point])
            iterations = max_iterations
            for _ in range(iterations):
                other.step(guard)
            if iterations and not guard.evaluations:
                raise TypeError("step of the optimizer must call its closure, got no call")
    return guard.best.clone(), MinimiseResult(
        initial_loss=guard.initial_loss,
        loss=guard.best_loss,
        iterations=iterations,
        evaluations=guard.evaluations,
        failures=guard.failures,
        stop_reason=guard.stop_reason(iterations, max_iterations, tolerance_grad),
    )


def check_optimizer(optimizer: MakeOptimizer) -> None:
    """Raise TypeError unless an optimiser is made of one vector, and its step calls a closure.

    It minimises the sum of two squares by one iteration.

    Example:
        >>> check_optimizer(torch.optim.Adam)
    """
    start = torch.ones(2, dtype=torch.float64)
    try:
        minimise_function(start, lambda x: (x.square().sum().item(), 2 * x), 1, optimizer=optimizer)
    except Exception as error:  # each optimiser fails with errors of its own
        name = getattr(optimizer, "__name__", type(optimizer).__name__)
        raise TypeError(
            f"optimizer must be a torch.optim class whose step takes a closure, got {name}: "
            f"{bounded_line(error)}"
        ) from error


class _Guard:
    """An L-BFGS closure that survives failed evaluations and keeps the best point."""

    def __init__(
        self,
        start: Tensor,
        function: Callable[[Tensor], tuple[float, Tensor]],
        survives: tuple[type[Exception], ...],
    ) -> None:
        self.point, self.best, self.function = start.detach().clone(), start, function
        self.failed: tuple[type[Exception], ...] = (NotFiniteError, *survives)
        self.evaluations = self.failures = 0
        self.initial_loss = self.best_loss = self.best_gradient = float("inf")
        self.last_failed = False

    def __call__(self) -> float:
        self.evaluations += 1
        try:
            loss, self.point.grad = self._evaluate()
        except self.failed:
            if self.evaluations == 1:
                raise
            self.failures += 1
            self.last_failed = True
            # worse than the best, but near enough for a fair step back; inf would freeze the search
            loss = self.best_loss + 10 * (1 + abs(self.best_loss))
            self.point.grad = torch.zeros_like(self.point)
        return loss

    def _evaluate(self) -> tuple[float, Tensor]:
        loss, gradient = self.function(self.point)
        largest = gradient.abs().max().item()
        if not (abs(loss) < LARGEST_LOSS and largest < float("inf")):
            raise NotFiniteError(
                f"the objective must be below {LARGEST_LOSS:g}, with a finite gradient, got {loss} "
                f"and {largest}"
            )
        if self.evaluations == 1:
            self.initial_loss = loss
        if loss < self.best_loss:
            self.best_loss, self.best_gradient = loss, largest
            self.best = self.point.clone()
        self.last_failed = False
        return loss, gradient

    def stop_reason(self, iterations: int, max_iterations: int, tolerance_grad: float) -> str:
        if self.best_gradient <= tolerance_grad:
            return "gradient is small"
        if self.last_failed:
            return "numerical failure"
        return "iteration limit" if iterations >= max_iterations else "no further progress"


@torch.no_grad()
def restore(parameters: Sequence[nn.Parameter], values: Sequence[Tensor]) -> None:
    """Set parameters to given values, and forget their gradients."""
    for parameter, value in zip(parameters, values, strict=True):
        parameter.copy_(value)
        parameter.grad = None
