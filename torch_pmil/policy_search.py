"""Search for the policy of least predicted KL (Eq. 22): guarded L-BFGS, a horizon that grows as far as it can be trusted."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from torch_pmil.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.objective import TrajectoryKLLoss
from torch_pmil.policy import RBFPolicy
from torch_pmil.rollout import PredictionError, predict_trajectory

LARGEST_LOSS = 1e10  # beyond, an objective counts as failed
RENEWAL_SAMPLES = 20  # states a time step


class NotFiniteError(ValueError):
    """An objective or its gradient is not finite."""


@dataclass(frozen=True)
class MinimiseResult:
    """What one run of L-BFGS did.

    ``stop_reason`` is one of "iteration limit", "gradient is small", "no further progress", "numerical failure".
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
    tolerance_grad: float = 1e-5,
) -> MinimiseResult:
    """Minimise with ``torch.optim.LBFGS`` and strong Wolfe; the parameters end at the best point that was seen.

    A point where the objective raises one of the errors below, or is not finite in value or gradient, counts as a large
    loss without gradient: the line search steps back from it.

    Args:
        parameters: changed in place.
        objective: a scalar with a graph.
        max_iterations: of L-BFGS; each takes one to a few evaluations.
        tolerance_grad: largest gradient entry at which the search ends.

    Raises:
        PredictionError, NotPositiveDefiniteError, NotFiniteError: at the starting point, where there is nothing to step back to.

    Example:
        >>> x = nn.Parameter(torch.tensor([3.0, -1.0], dtype=torch.float64))
        >>> minimise([x], lambda: ((x - 1) ** 2).sum(), max_iterations=20).stop_reason
        'gradient is small'
        >>> [round(v, 6) for v in x.tolist()]
        [1.0, 1.0]
    """
    guard = _Guard(list(parameters), objective)
    optimizer = torch.optim.LBFGS(
        guard.parameters,
        max_iter=max_iterations,
        max_eval=3 * max_iterations,
        history_size=50,
        tolerance_grad=tolerance_grad,
        tolerance_change=1e-10,
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

    def __init__(self, parameters: list[nn.Parameter], objective: Callable[[], Tensor]) -> None:
        self.parameters, self.objective = parameters, objective
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
        except (PredictionError, NotPositiveDefiniteError, NotFiniteError):
            if self.evaluations == 1:
                raise
            self.failures += 1
            self.last_failed = True
            loss, gradients = torch.tensor(self._rejected_loss()), [torch.zeros_like(p) for p in self.parameters]
        for parameter, gradient in zip(self.parameters, gradients, strict=True):
            parameter.grad = gradient.contiguous()
        return loss

    def _evaluate(self) -> tuple[Tensor, tuple[Tensor, ...]]:
        loss = self.objective()
        gradients = torch.autograd.grad(loss, self.parameters)
        largest = max(g.abs().max().item() for g in gradients)
        value = loss.item()
        if not (abs(value) < LARGEST_LOSS and largest < float("inf")):
            raise NotFiniteError(f"the objective must be finite with a finite gradient, got {value} and {largest}")
        if self.evaluations == 1:
            self.initial_loss = value
        if value < self.best_loss:
            self.best_loss, self.best_gradient = value, largest
            self.best = [p.detach().clone() for p in self.parameters]
        self.last_failed = False
        return loss.detach(), gradients

    def _rejected_loss(self) -> float:
        """Worse than all that counts, yet finite (inf would freeze the line search) and near enough for a fair step back."""
        return self.best_loss + 10 * (1 + abs(self.best_loss))

    def restore_best(self) -> None:
        _restore(self.parameters, self.best)

    def stop_reason(self, iterations: int, max_iterations: int, tolerance_grad: float) -> str:
        if self.best_gradient <= tolerance_grad:
            return "gradient is small"
        if self.last_failed:
            return "numerical failure"
        return "iteration limit" if iterations >= max_iterations else "no further progress"


@dataclass(frozen=True)
class SearchSettings:
    """Budget and horizon of a search.

    Args:
        mean_iterations: of L-BFGS on the mean alone, for each horizon.
        stage_iterations: on the KL, for each horizon that is extended further.
        final_iterations: on the KL, at the last horizon.
        first_horizon: least number of steps of the first horizon.
        horizon_step: steps by which the horizon grows.
        trusted_kl: mean KL of the last steps (nats a step) above which the prediction is not followed further; about 3 in four dimensions.
    """

    mean_iterations: int = 60
    stage_iterations: int = 30
    final_iterations: int = 40
    first_horizon: int = 5
    horizon_step: int = 3
    trusted_kl: float = 3.0


@dataclass(frozen=True)
class SearchResult:
    """What a policy search did.

    ``kl`` is the sum over the whole horizon T, ``per_step`` its summands; ``horizon`` is the last one that was searched,
    ``matched`` whether all its steps are trusted; ``stop_reason`` says why the last run of L-BFGS ended.
    """

    kl: float
    per_step: Tensor  # (T,)
    horizon: int
    matched: bool
    evaluations: int
    failures: int
    seconds: float
    stop_reason: str

    @property
    def complete(self) -> bool:
        """Whether the whole horizon T is matched."""
        return self.matched and self.horizon == len(self.per_step)


def search_policy(
    loss: TrajectoryKLLoss,
    initial: Gaussian,
    settings: SearchSettings = SearchSettings(),
    report: Callable[[str, float], None] = lambda stage, kl: None,
) -> SearchResult:
    """Minimise Eq. 20 over the policy of ``loss``, following the prediction only as far as it can be trusted.

    The far, unpredictable part of a trajectory would pull the policy away from the near part that is right already.
    So the horizon starts where the present policy stops matching, and grows; at each horizon the mean alone is
    searched first (a policy that only widens the prediction is no optimum there), then the KL. It stops growing
    where the last steps cost more than ``settings.trusted_kl`` each.

    Args:
        loss: objective with the policy (changed in place) and the model.
        initial: p(x_0).
        settings: budget and horizon.
        report: called after each run of L-BFGS with its name and its loss.

    Raises:
        PredictionError: the prediction fails at the policy that was given.
    """
    search = _Search(loss, initial, settings, report)
    per_step = _evaluate(loss, initial)
    horizon = _first_unmatched(per_step, settings)
    while True:
        begun = search.stage(horizon)
        per_step = _evaluate(loss, initial)
        if not begun or horizon == loss.horizon or not _trusted(per_step, horizon, settings):
            break
        horizon = min(max(horizon + settings.horizon_step, _first_unmatched(per_step, settings)), loss.horizon)
    horizon = min(horizon, int(per_step.isfinite().sum()))
    search.run("KL", loss.per_step, horizon, settings.final_iterations)
    return search.result(horizon)


class _Search:
    """The runs of L-BFGS of one policy search."""

    def __init__(self, loss: TrajectoryKLLoss, initial: Gaussian, settings: SearchSettings, report: Callable[[str, float], None]) -> None:
        self.loss, self.initial, self.settings, self.report = loss, initial, settings, report
        self.parameters = list(loss.actor_network.parameters())
        self.runs: list[MinimiseResult] = []
        self.start = time.perf_counter()

    def run(self, name: str, per_step: Callable[[Gaussian, int], Tensor], horizon: int, iterations: int) -> None:
        """Minimise the sum of the steps up to a horizon."""
        self.runs.append(minimise(self.parameters, lambda: per_step(self.initial, horizon).sum(), iterations))
        self.report(f"{name} {horizon}/{self.loss.horizon}", self.runs[-1].loss)

    def stage(self, horizon: int) -> bool:
        """Search the mean, then the KL. Where one cannot begin, the policy is what it was before, and the answer False."""
        before = [parameter.detach().clone() for parameter in self.parameters]
        try:
            self.run("mean", self.loss.mean_per_step, horizon, self.settings.mean_iterations)
            self.run("KL", self.loss.per_step, horizon, self.settings.stage_iterations)
        except (PredictionError, NotFiniteError):
            _restore(self.parameters, before)
            return False
        return True

    def result(self, horizon: int) -> SearchResult:
        """What the policy has come to."""
        per_step = _evaluate(self.loss, self.initial)
        return SearchResult(
            kl=per_step.sum().item(),
            per_step=per_step,
            horizon=horizon,
            matched=_trusted(per_step, horizon, self.settings),
            evaluations=sum(run.evaluations for run in self.runs),
            failures=sum(run.failures for run in self.runs),
            seconds=time.perf_counter() - self.start,
            stop_reason=self.runs[-1].stop_reason,
        )


@torch.no_grad()
def _restore(parameters: list[nn.Parameter], values: list[Tensor]) -> None:
    for parameter, value in zip(parameters, values, strict=True):
        parameter.copy_(value)
        parameter.grad = None


@torch.no_grad()
def renew_policy(loss: TrajectoryKLLoss, initial: Gaussian, new: RBFPolicy, settings: SearchSettings, generator: torch.Generator) -> None:
    """Give the policy of ``loss`` the new policy's centres and widths, and weights that act as it did where it is trusted.

    Searches on early, poor models drive widths and centres to extremes from which no later search returns. A new network
    that was fitted to the old one's actions keeps what was learned, and can be searched well.

    Args:
        loss: objective with the policy (changed in place) and the newest model.
        initial: p(x_0).
        new: a random policy of the same shape; changed in place.
        settings: says up to which step the prediction is trusted.
        generator: of the states, drawn from the prediction, at which the actions are compared.
    """
    trusted = _first_unmatched(_evaluate(loss, initial), settings) - 1
    states = initial.sample(RENEWAL_SAMPLES, generator)[:, None]
    if trusted > 0:
        predicted = predict_trajectory(initial, loss.actor_network, loss.dynamics, loss.space, trusted)
        states = torch.cat([states, predicted.sample(RENEWAL_SAMPLES, generator)], 1)
    features = loss.space.features(states.flatten(0, 1))
    new.fit_weights(features, loss.actor_network(features))
    loss.actor_network.load_state_dict(new.state_dict())


@torch.no_grad()
def _evaluate(loss: TrajectoryKLLoss, initial: Gaussian) -> Tensor:
    """KL of each step, (T,); infinite from the step on at which the prediction fails."""
    try:
        return loss.per_step(initial)
    except PredictionError as error:
        if error.step == 1:
            raise
        known = loss.per_step(initial, error.step - 1)
        return torch.cat([known, known.new_full((loss.horizon - len(known),), math.inf)])


def _first_unmatched(per_step: Tensor, settings: SearchSettings) -> int:
    unmatched = (per_step > settings.trusted_kl).nonzero()[:, 0]
    first = unmatched[0].item() + 1 if len(unmatched) else len(per_step)
    return min(max(first, settings.first_horizon), len(per_step))


def _trusted(per_step: Tensor, horizon: int, settings: SearchSettings) -> bool:
    return per_step[max(horizon - settings.horizon_step, 0) : horizon].mean().item() <= settings.trusted_kl
