"""Why a run did not learn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.envs.rollouts import states_of
from torch_pmil.model.calibration import standardised_residuals
from torch_pmil.model.forward_model import ForwardModel, Targets
from torch_pmil.model.past_evidence import PastEvidence, evidence_of_the_past
from torch_pmil.runs.diagnosis.before_a_run import check, needed_torques
from torch_pmil.runs.diagnosis.causes import (
    Reason,
    check_chance,
    check_experience,
    check_model,
    check_motion,
    check_past,
    check_readings,
    check_saturation,
    check_search,
    group,
    unexplained,
)
from torch_pmil.runs.diagnosis.findings import FEW, Finding
from torch_pmil.runs.diagnosis.measures import LEARNED, LITTLE, MATCHED, first_mismatch
from torch_pmil.search.improving_loss import ImprovingKLLoss
from torch_pmil.search.kl import gaussian_kl, gaussian_kl_terms
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.task import Task

RECORDED = 200  # latest transitions that are evidence of the past; one rollout at least
SHORTEST = 6  # steps of a rollout, beyond those that the state remembers


@torch.no_grad()
def likely_reasons(
    task: Task,
    loss: TrajectoryLoss,
    outcomes: Sequence[Outcome],
    horizons: Sequence[int],
    recorded: Sequence[TensorDictBase],
) -> list[Reason]:
    """Likely reasons why a run did not learn, the most likely first: causes before consequences.

    A sensor that wraps an angle makes model and match wrong from there on. Wrong demonstrations
    mislead everything that follows. A robot that is too weak or does not move gives the model
    nothing to learn. If the past explains the motion better than the present, no model of the
    present is right. A model that is wrong up to the step at which the search is stuck misleads the
    search. If it is wrong only beyond that step, that is because the policy goes where nothing
    leads it. Few demonstrations alone seldom keep a robot from learning. Of several targets, the
    worst one is examined.

    Args:
        task: what was to be learned.
        loss: with the saved policy and the newest model.
        outcomes: what that policy was predicted to do, and did.
        horizons: steps up to which the search of each trial went.
        recorded: whole rollouts that are experience, (N, T) each, in their order.

    Returns:
        An empty list for a run that learned, at least one reason for any other.
    """
    failures = [~(outcome.errors <= task.tolerance) for outcome in outcomes]
    failed = torch.cat(failures)
    if (~failed).double().mean() >= LEARNED:
        return []
    outcome = outcomes[max(range(len(outcomes)), key=lambda number: failures[number].sum())]
    found = group([*_of_the_sensors(task, outcomes, recorded), *check(task)])
    evidence = evidence_in(task, loss.dynamics.targets, recorded)
    past = check_past(evidence) if evidence else None
    search = _Search(task, loss, outcomes)
    step = first_mismatch(search.step_loss, search.most)
    led = _of_the_model(task, loss.dynamics, outcome, step or task.horizon)
    beyond = [] if led else _of_the_model(task, loss.dynamics, outcome, task.horizon)
    reasons = [
        *(reason for reason in found if reason.cause != FEW),
        *_of_the_robot(task, outcome),
        *([past] if past else []),
        *led,
        *([search.stuck(step, horizons)] if step else []),
        *beyond,
        *(reason for reason in found if reason.cause == FEW),
    ]
    if reasons:
        return reasons
    promise, counted = task.promised, (int(failed.sum()), len(failed))
    promised = promise.predicted(loss, task.initial).least if promise else None
    if chance := check_chance(*counted, promised):
        return [chance]
    return [unexplained(*counted, task.tolerance, search.largest(), task.adjustable)]


def evidence_in(
    task: Task, targets: Targets, recorded: Sequence[TensorDictBase]
) -> PastEvidence | None:
    """Evidence of the past in the latest rollouts, or None if they are too few or too short.

    Args:
        task: of the robot. Actions that its state holds already are left out.
        targets: what its model learns.
        recorded: whole rollouts, (robots, T) each, in their order.
    """
    remembered = 0 if task.history is None else task.history.past_actions
    steps = min(task.horizon, RECORDED)
    if not recorded or steps < remembered + SHORTEST:
        return None
    latest = recorded[-max(1, RECORDED // (steps * len(recorded[-1]))) :]
    states = torch.cat([states_of(each)[:, : steps + 1] for each in latest])
    actions = torch.cat([each["action"][:, :steps] for each in latest])
    period = task.time_step
    return evidence_of_the_past(states, actions, task.space, period, targets, remembered)


def known_steps(task: Task, dynamics: ForwardModel, outcome: Outcome) -> Tensor:
    """The steps t = 0..T-1 of executed rollouts at which the model knows something, bool, (N, T).

    There the state is within the largest values of the model's data, and no predicted standard
    deviation is above half of that without data.
    """
    before = outcome.executed[:, :-1]
    inputs = torch.cat([task.space.features(before), outcome.rollouts["action"]], -1)
    _, variance = dynamics.predict(inputs)
    prior = dynamics.prior_variance
    sure = ((variance <= LITTLE**2 * prior) | (prior == 0)).all(-1)
    plain = list(task.space.plain)  # the first features
    reached = dynamics.train_inputs[:, : len(plain)].abs().amax(0)
    return sure & (before[..., plain].abs() <= reached).all(-1)


def _of_the_sensors(
    task: Task, outcomes: Sequence[Outcome], recorded: Sequence[TensorDictBase]
) -> list[Finding]:
    """Findings on angles that the robot's sensors wrap, in all that it did."""
    rollouts = [*recorded, *(outcome.rollouts for outcome in outcomes)]
    motions = [motion for each in rollouts for motion in states_of(each)]
    names = task.space.names if task.history is None else task.history.names
    return check_readings(motions, names, task.space.angles, task.time_step)


def _of_the_robot(task: Task, outcome: Outcome) -> list[Reason]:
    """Reasons that lie in the robot's motors."""
    outcome, torques = outcome.compared, needed_torques(task)
    needed = None if torques is None else torques.abs().amax((0, 1))
    saturated = check_saturation(outcome.rollouts["action"], task.actions, needed)
    if outcome.demonstrations is None:
        return _found(outcome, saturated)
    moved, shown = task.space.observe(outcome.executed), outcome.demonstrations.positions
    noise_std = torch.as_tensor(task.noise_std, dtype=torch.float64)
    return _found(outcome, saturated, check_motion(moved, shown, noise_std, task.adjustable))


def _of_the_model(task: Task, dynamics: ForwardModel, outcome: Outcome, steps: int) -> list[Reason]:
    """Reasons that lie in the model, by the first steps of rollouts that it was not fitted to."""
    outcome = outcome.compared
    actions, time_step = outcome.rollouts["action"], task.time_step
    residuals = standardised_residuals(dynamics, task.space, outcome.executed, actions)
    residuals, known = residuals[:, :steps], known_steps(task, dynamics, outcome)[:, :steps]
    predicted, executed = outcome.predicted[:steps], outcome.executed[:, : steps + 1]
    names, settings = task.space.names, task.adjustable
    return _found(
        outcome,
        check_model(residuals[known], predicted, executed, names, time_step, settings),
        check_experience(~known, len(dynamics.train_inputs), time_step, settings),
    )


def _found(outcome: Outcome, *reasons: Reason | None) -> list[Reason]:
    """The reasons that are not None, each with the name of the target if there are several."""
    where = f"at {outcome.label}, " if outcome.label else ""
    found = [reason for reason in reasons if reason is not None]
    return [replace(reason, message=where + reason.message) for reason in found]


@dataclass(frozen=True, eq=False)
class _Search:
    """How far the prediction of the newest model is from what a search should reach."""

    task: Task
    loss: TrajectoryLoss
    outcomes: Sequence[Outcome]

    @cached_property
    def step_loss(self) -> Tensor:
        """For each step, (T,): the KL per observed entry, or the predicted spread under a cost."""
        return self.loss.step_loss_for_trust(self.task.initial)

    @property
    def most(self) -> float:
        """Largest ``step_loss`` of a step that counts as right."""
        search = self.task.method.search
        by_match = self.named[0] == TrajectoryKLLoss.label
        return MATCHED if by_match and search.trust_what_is_sure else search.trust_threshold

    @property
    def named(self) -> tuple[str, str]:
        """Name and unit of ``step_loss``."""
        improving = isinstance(self.loss, ImprovingKLLoss) and self.loss.improving
        if isinstance(self.loss, TrajectoryKLLoss) and not improving:
            return TrajectoryKLLoss.label, TrajectoryKLLoss.unit
        return "predicted variance", "of that of the data"

    def stuck(self, step: int, horizons: Sequence[int]) -> Reason:
        """Why the search is stuck at a step."""
        of_task = self.task.time_step, self.task.adjustable
        mismatch = self.mismatch(step)
        return check_search(self.step_loss, step, *self.named, mismatch, horizons, *of_task)

    def largest(self) -> str:
        """The largest loss of a step, in words."""
        step, (name, unit) = int(self.step_loss.argmax()) + 1, self.named
        time = step * self.task.time_step
        return (
            f"the {name} of a step is at most {self.step_loss[step - 1]:.3g} {unit}, at "
            f"{time:.2f} s, {self.mismatch(step)}"
        )

    def mismatch(self, step: int) -> str:
        """The entry in which prediction and demonstrations of the worst target differ most."""
        if not isinstance(self.loss, TrajectoryKLLoss):
            return "where the prediction is too wide to be followed"
        match_space, noise = self.task.space.match_space, self.task.noise_std**2
        pairs = [
            (
                outcome.demonstrated[step - 1],
                match_space.moments(outcome.predicted[step - 1]).add_noise(noise),
            )
            for outcome in self.outcomes
            if outcome.demonstrated is not None
        ]
        losses = [gaussian_kl(*pair).item() for pair in pairs]
        worst = losses.index(max(losses))
        terms, label = gaussian_kl_terms(*pairs[worst]), self.outcomes[worst].label
        entry = int((terms.mean + terms.spread).argmax())
        name, unit = match_space.names[entry], match_space.units[entry]
        demonstrated, predicted = (
            f"{belief.mean[entry]:.2f} ± {belief.std[entry]:.2f} {unit}".rstrip()
            for belief in pairs[worst]
        )
        where = f"most in {name} (predicted {predicted}, demonstrated {demonstrated})"
        return f"{where} at {label}" if label else where
