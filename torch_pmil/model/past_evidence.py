"""Whether the next state depends on the past: the evidence in recorded motions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_pmil.checks import check_tensor
from torch_pmil.control.state_space import StateSpace
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.experience import gp_data
from torch_pmil.model.forward_model import Targets

FARTHEST = 6  # periods
# nats that each further action or reading in the state must gain: odds of twenty to one
LIKELY = 3.0


@dataclass(frozen=True)
class PastEvidence:
    """Evidence, in nats, that the past explains a motion better than state and action alone.

    Args:
        of_actions: nats gained from a single past action, by its age in periods.
        of_state: nats gained from the change of the state over the last period.
        transitions: number of transitions behind the evidence.
        time_step: length of a period, s.
        remembered: number of past actions that the state already holds.
    """

    of_actions: Mapping[int, float]
    of_state: float
    transitions: int
    time_step: float
    remembered: int = 0

    @property
    def periods(self) -> int:
        """Age in periods of the past action that gains most, after the cost of holding it."""
        return max(self.of_actions, key=self._beyond_its_price)

    @property
    def of_action(self) -> float:
        """Nats by that action."""
        return self.of_actions[self.periods]

    @property
    def most(self) -> float:
        """Nats by what explains most."""
        return max(self.of_action, self.of_state)

    @property
    def is_likely(self) -> bool:
        """Whether a state that holds the past is worth its further entries."""
        return max(self._beyond_its_price(self.periods), self.of_state - LIKELY) > 0

    @property
    def by_name(self) -> dict[str, float]:
        """Nats gained from the best past action and from the last change, by a description."""
        late = f"the action {self.periods * self.time_step:g} s before"
        return {
            late: self.of_action,
            f"the change over the last {self.time_step:g} s": self.of_state,
        }

    @property
    def acts_late(self) -> bool:
        """Whether the evidence points to delayed actions rather than to an incomplete state.

        If a part of the state is hidden, the change of the state explains more than past actions.
        """
        return self._beyond_its_price(self.periods) >= self.of_state - LIKELY

    def _beyond_its_price(self, periods: int) -> float:
        return self.of_actions[periods] - LIKELY * (periods - self.remembered)


def evidence_of_the_past(
    states: Tensor,
    actions: Tensor,
    space: StateSpace,
    time_step: float,
    targets: Targets = "difference",
    remembered: int = 0,
) -> PastEvidence:
    """The evidence of rollouts, with arguments as for :func:`evidence_of_past_action`.

    If the space already holds the last ``remembered`` actions, only earlier ones are tried.
    """
    motion = states, actions, space
    farthest = min(remembered + FARTHEST, actions.shape[1] - 4)
    further = range(remembered + 1, farthest + 1)
    return PastEvidence(
        {
            periods: evidence_of_past_action(*motion, periods, targets).sum().item()
            for periods in further
        },
        evidence_of_past_state(*motion, targets).sum().item(),
        actions[..., 0].numel(),
        time_step,
        remembered,
    )


def evidence_of_past_action(
    states: Tensor,
    actions: Tensor,
    space: StateSpace,
    periods: int = 1,
    targets: Targets = "difference",
) -> Tensor:
    r"""Nats of evidence that a model gains by an action of the past as a further input.

    .. math:: \log p(x_{t+1} \mid x_t, u_t, u_{t-k}) - \log p(x_{t+1} \mid x_t, u_t)

    Both are marginal likelihoods at their maximum, of all transitions whose past action is known.
    A robot whose commands act at once gains nothing. One that acts late, or has a part that the
    state does not show, gains more with every recorded motion. Such a robot learns by a state that
    holds past actions (:func:`~torch_pmil.tasks.with_history.with_history`).

    Args:
        states: x_0..x_T of rollouts, (N, T + 1, D).
        actions: u_0..u_{T-1}, (N, T, F), not all alike.
        space: of the states.
        periods: k, how many control periods ago the action was, from 1 to T - 1.
        targets: what the model learns, as in :class:`GPDynamics`.

    Returns:
        Nats for each of the model's E outputs, (E,). Below zero, the further input explained
        nothing. An output that never changes gains nothing.

    Raises:
        ValueError: shapes do not fit, a number is not finite, or ``periods`` is out of range.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> u = torch.randn(1, 40, 1, generator=torch.Generator().manual_seed(0)).double()
        >>> late = torch.cat([torch.zeros(1, 2, 1), u[:, :-1].cumsum(1)], 1)
        >>> bool(evidence_of_past_action(late, u, space) > 10)
        True
    """
    _check(states, actions, periods)
    return _evidence(states, actions, actions[:, :-periods], space, periods, targets)


def evidence_of_past_state(
    states: Tensor,
    actions: Tensor,
    space: StateSpace,
    targets: Targets = "difference",
) -> Tensor:
    r"""Nats of evidence that a model gains by how the features changed over the last period.

    .. math:: \log p(x_{t+1} \mid x_t, u_t, x_t - x_{t-1}) - \log p(x_{t+1} \mid x_t, u_t)

    The past helps where velocities are missing, a part is hidden, or sensors are noisy. Arguments,
    result and errors are those of :func:`evidence_of_past_action`.
    """
    _check(states, actions, 1)
    change = space.features(states[:, :-1]).diff(dim=1)
    return _evidence(states, actions, change, space, 1, targets)


def _check(states: Tensor, actions: Tensor, periods: int) -> None:
    check_tensor("states", states, ("N", "T + 1", "D"))
    count, steps, _ = states.shape
    check_tensor("actions", actions, (count, steps - 1, "F"))
    if not 1 <= periods < steps - 1:
        raise ValueError(f"periods must be from 1 to {steps - 2}, got {periods}")


def _evidence(
    states: Tensor,
    actions: Tensor,
    further: Tensor,
    space: StateSpace,
    periods: int,
    targets: Targets,
) -> Tensor:
    """Nats (E,) by further inputs (N, T - periods, K) at u_t, from t = ``periods`` on."""
    before, after = states[:, periods:-1], states[:, periods + 1 :]
    inputs, learned = gp_data(before, actions[:, periods:], after, space, targets)
    learned = learned.flatten(0, 1)
    changes = (learned != learned[0]).any(0)
    nats = learned.new_zeros(2, learned.shape[1])
    for row, seen in zip(nats, (inputs, torch.cat([inputs, further], -1)), strict=True):
        if changes.any():
            model = GPDynamics(seen.shape[-1], int(changes.sum()))
            fit = model.fit(seen.flatten(0, 1), learned[:, changes])
            row[changes] = fit.negative_log_likelihood
    return nats[0] - nats[1]
