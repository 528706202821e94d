"""How much the past tells of a recorded motion beyond what state and action do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase

from torch_pmil.envs.rollouts import states_of
from torch_pmil.model.dynamics import Targets
from torch_pmil.runs.diagnosis.past_evidence import evidence_of_past_action, evidence_of_past_state
from torch_pmil.tasks.task import Task

RECORDED = 200  # transitions by which it is told, the latest; one rollout at least
FEWEST_STEPS = 5  # of a rollout, beyond those that the state remembers
FARTHEST = 2  # control periods


@dataclass(frozen=True)
class PastEvidence:
    """Nats by which the past explains a motion better than state and action alone.

    Args:
        of_actions: those of the action so many control periods before.
        of_state: those of how the state changed over the last period.
        transitions: of which they are the evidence.
        time_step: s.
    """

    of_actions: Mapping[int, float]
    of_state: float
    transitions: int
    time_step: float

    @property
    def periods(self) -> int:
        """How many periods before the action was that tells most."""
        return max(self.of_actions, key=lambda number: self.of_actions[number])


def evidence_of_the_past(
    experiment: Task, targets: Targets, recorded: Sequence[TensorDictBase]
) -> PastEvidence | None:
    """The evidence of the latest rollouts; None where there is too little to tell.

    Args:
        experiment: of the robot. Actions that its state holds already are left out.
        targets: what its model learns.
        recorded: whole rollouts, (robots, T) each, in their order.
    """
    remembered = 0 if experiment.history is None else experiment.history.past_actions
    steps = min(experiment.horizon, RECORDED)
    if not recorded or steps < remembered + FEWEST_STEPS:
        return None
    latest = recorded[-max(1, RECORDED // (steps * len(recorded[-1]))) :]
    states = torch.cat([states_of(each)[:, : steps + 1] for each in latest])
    actions = torch.cat([each["action"][:, :steps] for each in latest])
    motion = states, actions, experiment.space
    return PastEvidence(
        {
            periods: evidence_of_past_action(*motion, periods, targets).sum().item()
            for periods in range(remembered + 1, remembered + FARTHEST + 1)
        },
        evidence_of_past_state(*motion, targets=targets).sum().item(),
        actions[..., 0].numel(),
        experiment.demonstrations.time_step,
    )
