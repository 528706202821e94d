"""When a run ends: the robot's own rollouts succeeded, and the model keeps the promise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch_pmil.checks import check_whole
from torch_pmil.search.promise import Promise
from torch_pmil.trainer.trials import Trial

LIMIT = "limit of trials"
NUMERALS = {2: "two", 3: "three", 4: "four"}


@dataclass(frozen=True, eq=False)
class Ending:
    """When a run ends.

    Args:
        trials: largest number of trials.
        confirmations: own successes in a row without which no run ends.
        promise: what the newest model must predict after the last of them; None if no success is
            predicted, so that the confirmations alone end the run.

    Example:
        >>> Ending(trials=0)
        Traceback (most recent call last):
        ValueError: trials must be a whole number of at least 1, got 0
    """

    trials: int = 12
    confirmations: int = 1
    promise: Promise | None = None

    def __post_init__(self) -> None:
        check_whole("trials", self.trials, 1)
        check_whole("confirmations", self.confirmations, 1)

    def reason(self, trials: Sequence[Trial]) -> str:
        """Why a run ends after these trials, one at least; "" if it continues."""
        last = trials[-self.confirmations :]
        if len(last) == self.confirmations and all(trial.own_success for trial in last):
            count = NUMERALS.get(self.confirmations, self.confirmations)
            done = f"the own rollouts of {count} trials in a row succeeded"
            if self.confirmations == 1:
                done = "the own rollout succeeded"
            if self.promise is None:
                return done
            rate = last[-1].promised_success_rate
            if rate is not None and rate >= self.promise.aim:
                return (
                    f"{done}, and the model predicts success from {rate:.1%} of the starts at least"
                )
        return LIMIT if len(trials) >= self.trials else ""
