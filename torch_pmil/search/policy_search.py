"""Search for the policy of least predicted loss (Eqs. 1 and 22) over a growing horizon."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.gp.lbfgs import (
    MakeOptimizer,
    MinimiseResult,
    NotFiniteError,
    in_one_vector,
    minimise_function,
    restore,
    set_to,
)
from torch_pmil.model.rollout import PredictionError
from torch_pmil.search.reparameterisation import reparameterised
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.settings import Settings, setting

Report = Callable[[str, float], None]  # takes the name and the loss of each run of the optimiser

REFIT_SAMPLES = 20  # states a time step
WORTHWHILE = 0.9  # another run follows one that brought the loss below this fraction of its start


@dataclass(frozen=True)
class SearchSettings(Settings):
    """Budget and horizon of a policy search; an iteration is one of the optimiser.

    The iterations at one horizon are repeated while the last steps are not trusted and each run
    lowers the loss by a tenth. The KL is trusted by its nats for each observed entry, so that one
    entry means the same as four; or, with ``trust_what_is_sure``, by :meth:`TrajectoryLoss.spread`.
    A match that is followed step by step leads further on some robots, a sure prediction is
    followed sooner on others. ``skip_matched_steps`` suits the KL, which is small wherever the
    prediction matches. Under another loss a motion may be predicted well and still be wrong: then
    the horizon grows by ``horizon_step`` alone, from ``first_horizon`` on for a random policy.
    """

    prefix: ClassVar[str] = "search."

    mean_iterations: int = setting(
        60, "iterations on the mean alone, at each horizon", least=0, unit="iterations"
    )
    stage_iterations: int = setting(
        30, "iterations on the loss, at each horizon", least=0, unit="iterations"
    )
    final_iterations: int = setting(
        40, "iterations on the loss at the last horizon", least=0, unit="iterations"
    )
    first_horizon: float = setting(
        0.2, "smallest length of the first horizon", above=0, most=1, unit="whole horizons"
    )
    horizon_step: float = setting(
        0.12, "by how much the horizon grows", above=0, most=1, unit="whole horizons"
    )
    trust_threshold: float = setting(
        0.75,
        "largest doubt of the last steps at which the horizon still grows",
        least=0,
        unit="nats of a step and observed entry; of what is sure: variances of the model's data",
    )
    trust_what_is_sure: bool = setting(
        False,
        "whether a step is trusted where its prediction is sure, instead of where it matches",
    )
    skip_matched_steps: bool = setting(
        True, "whether the horizon jumps to the first step above the threshold"
    )
    sample_steps: int = setting(
        0,
        "steps on sampled trajectories of the whole horizon, before the search of the loss",
        least=0,
        unit="steps of Adam",
    )
    restarts: int = setting(
        0, "largest number of searches from random policies", least=0, unit="searches"
    )

    def first_steps(self, horizon: int) -> int:
        """Smallest length of the first of the horizons up to this one, in steps."""
        return max(1, round(self.first_horizon * horizon))

    def more_steps(self, horizon: int) -> int:
        """Steps by which the horizon grows up to this one.

        Example:
            >>> SearchSettings().first_steps(25), SearchSettings().more_steps(25)
            (5, 3)
        """
        return max(1, round(self.horizon_step * horizon))


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Outcome of a policy search."""

    loss: float  # of the whole horizon T
    per_step: Tensor  # its summands, (T,)
    horizon: int  # the last one that was searched
    converged: bool  # whether its last steps are trusted
    evaluations: int
    failures: int
    seconds: float
    stop_reason: str  # of the last run of the optimiser

    @property
    def complete(self) -> bool:
        """Whether the search converged at the whole horizon T."""
        return self.converged and self.horizon == len(self.per_step)

    def with_work_of(self, other: SearchResult) -> SearchResult:
        """This outcome, with the time and the evaluations of both searches."""
        return replace(
            self,
            evaluations=self.evaluations + other.evaluations,
            failures=self.failures + other.failures,
            seconds=self.seconds + other.seconds,
        )


def search_policy(
    loss: TrajectoryLoss,
    initial: Gaussian,
    settings: SearchSettings = SearchSettings(),
    report: Report = lambda stage, loss: None,
    random: bool = False,
    optimizer: MakeOptimizer = torch.optim.LBFGS,
) -> SearchResult:
    """Minimise a loss over its policy, at horizons up to which the prediction can be trusted.

    The far, unpredictable part of a trajectory would pull the policy away from the near part that
    is right already. So the horizon starts where the present policy stops matching, and grows. At
    each horizon the mean alone is searched first, where a policy that only widens the prediction is
    no optimum, then the loss. The horizon stops growing when the loss falls no more and the mean
    loss of its last steps still exceeds ``settings.trust_threshold``. If every step is trusted
    already, the loss of the whole horizon alone is searched.

    Args:
        loss: objective with the policy (changed in place) and the model.
        initial: p(x_0).
        settings: budget and horizon.
        report: called after each run of the optimiser with its name and its loss.
        random: whether the policy is a random one, which no search has seen.
        optimizer: see :func:`~torch_pmil.gp.lbfgs.minimise`.

    Raises:
        TypeError: the settings are of another kind, or the policy has no moments in closed form.
        ValueError: there are several start beliefs.
        PredictionError: the first step cannot be predicted under the given policy.
        NotFiniteError: the loss is not finite at the policy from which the last run begins.
    """
    if not isinstance(settings, SearchSettings):
        raise TypeError(f"settings must be SearchSettings, got {type(settings).__name__}")
    if initial.batch_shape:
        raise ValueError(f"initial must be one belief, mean (D,), got {tuple(initial.mean.shape)}")
    search = SearchRuns(loss, initial, settings, report, optimizer)
    step_loss, more = step_loss_of(loss, initial, settings), settings.more_steps(loss.horizon)
    horizon = _first_untrusted(step_loss, settings)
    growing = bool((step_loss > settings.trust_threshold).any())
    if random and not settings.skip_matched_steps:
        horizon, growing = settings.first_steps(loss.horizon), True
    while growing:
        begun = search.stage(horizon)
        step_loss = step_loss_of(loss, initial, settings)
        growing = begun and horizon < loss.horizon and _trusted(step_loss[:horizon], settings, more)
        if growing:
            horizon = min(horizon + more, loss.horizon)
            if settings.skip_matched_steps:
                horizon = max(horizon, _first_untrusted(step_loss, settings))
    horizon = max(1, min(horizon, int(step_loss.isfinite().sum())))
    search.run(loss.label, loss.per_step, horizon, settings.final_iterations)
    return search.result(horizon)


class SearchRuns:
    """The runs of the optimiser in one policy search, by arguments of :func:`search_policy`."""

    def __init__(
        self,
        loss: TrajectoryLoss,
        initial: Gaussian,
        settings: SearchSettings,
        report: Report,
        optimizer: MakeOptimizer,
    ) -> None:
        self.loss, self.initial, self.settings = loss, initial, settings
        self.report, self.optimizer = report, optimizer
        self.runs: list[MinimiseResult] = []
        self.start = time.perf_counter()

    def run(
        self, name: str, per_step: Callable[[Gaussian, int], Tensor], horizon: int, iterations: int
    ) -> None:
        """Minimise the sum of the steps up to a horizon by one run of the optimiser."""
        searched = reparameterised(self.loss)
        variables = searched.variables
        best, result = minimise_function(
            in_one_vector(variables),
            searched.as_function(per_step, self.initial, horizon),
            iterations,
            survives=(PredictionError, NotPositiveDefiniteError),
            optimizer=self.optimizer,
        )
        set_to(variables, best)
        self.runs.append(result)
        searched.write()
        self.report(f"{name} {horizon}/{self.loss.horizon}", result.loss)

    def stage(self, horizon: int) -> bool:
        """Search the mean, then the loss; if one could not begin, restore the policy and say so."""
        loss, settings = self.loss, self.settings
        parameters = list(loss.actor_network.parameters())
        before = [parameter.detach().clone() for parameter in parameters]
        try:
            if settings.mean_iterations:
                self.run("mean", loss.mean_per_step, horizon, settings.mean_iterations)
            self.run(loss.label, loss.per_step, horizon, settings.stage_iterations)
            while self._worth_more(horizon):
                self.run(loss.label, loss.per_step, horizon, settings.stage_iterations)
        except (PredictionError, NotFiniteError):
            restore(parameters, before)
            return False
        return True

    def _worth_more(self, horizon: int) -> bool:
        """Whether the last steps are not trusted yet and more iterations may lower the loss."""
        last = self.runs[-1]
        if last.stop_reason != "iteration limit" or last.loss >= WORTHWHILE * last.initial_loss:
            return False
        step_loss = step_loss_of(self.loss, self.initial, self.settings, horizon)
        return not self._trusted(step_loss)

    def _trusted(self, step_loss: Tensor) -> bool:
        return _trusted(step_loss, self.settings, self.settings.more_steps(self.loss.horizon))

    def result(self, horizon: int) -> SearchResult:
        """Outcome of the search with the policy as it is now, after a last run at ``horizon``."""
        per_step = evaluate_steps(self.loss.per_step, self.initial, self.loss.horizon)
        step_loss = step_loss_of(self.loss, self.initial, self.settings)
        return SearchResult(
            loss=per_step.sum().item(),
            per_step=per_step,
            horizon=horizon,
            converged=self._trusted(step_loss[:horizon]),
            evaluations=sum(run.evaluations for run in self.runs),
            failures=sum(run.failures for run in self.runs),
            seconds=time.perf_counter() - self.start,
            stop_reason=self.runs[-1].stop_reason,
        )


@torch.no_grad()
def refit_policy(
    loss: TrajectoryLoss,
    initial: Gaussian,
    new: AnyPolicy,
    settings: SearchSettings,
    generator: torch.Generator,
) -> AnyPolicy:
    """Refit the weights of a new policy to the actions of the old one, and return the new one.

    The actions are compared as far as the prediction is trusted. Searches on early, poor models may
    drive widths and centres to extremes from which no later search returns. A new network keeps
    what was learned, and can be searched well.

    Args:
        loss: objective with the old policy and the newest model.
        initial, settings: as for :func:`search_policy`.
        new: a random policy of the same shape; changed in place.
        generator: source of the states, drawn from the prediction.
    """
    step_loss = step_loss_of(loss, initial, settings)
    trusted = min(_first_untrusted(step_loss, settings) - 1, int(step_loss.isfinite().sum()))
    states = loss.begin(initial)[0].sample(REFIT_SAMPLES, generator)[..., None, :]
    if trusted > 0:
        predicted = loss.predict_states(initial, trusted)
        states = torch.cat([states, predicted.sample(REFIT_SAMPLES, generator)], -2)
    inputs = loss.policy_inputs(states).flatten(0, -2)
    new.fit_weights(inputs, loss.actor_network(inputs))
    return new


@torch.no_grad()
def evaluate_steps(
    of_steps: Callable[[Gaussian, int], Tensor], initial: Gaussian, horizon: int
) -> Tensor:
    """Loss of each step, (horizon,), infinite from the first step whose prediction fails."""
    try:
        return of_steps(initial, horizon)
    except PredictionError as error:
        if error.step == 1:
            raise
        known = of_steps(initial, error.step - 1)
        return torch.cat([known, known.new_full((horizon - len(known),), math.inf)])


def step_loss_of(
    loss: TrajectoryLoss, initial: Gaussian, settings: SearchSettings, horizon: int | None = None
) -> Tensor:
    """Doubt about each step, (horizon,), which a search compares with its trust threshold.

    It is evaluated as in :func:`evaluate_steps`; a horizon of None stands for all steps.
    """
    doubt = loss.spread if settings.trust_what_is_sure else loss.step_loss_for_trust
    return evaluate_steps(doubt, initial, horizon or loss.horizon)


def _first_untrusted(step_loss: Tensor, settings: SearchSettings) -> int:
    untrusted = (step_loss > settings.trust_threshold).nonzero()[:, 0]
    first = int(untrusted[0]) + 1 if len(untrusted) else len(step_loss)
    return max(first, settings.first_steps(len(step_loss)))


def _trusted(step_loss: Tensor, settings: SearchSettings, last: int) -> bool:
    """Whether the last of these steps are trusted."""
    return step_loss[-last:].mean().item() <= settings.trust_threshold
