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

    Raises:
        ValueError: a number is not a whole number of at least 1.

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
            done = _succeeded(self.confirmations)
            if self.promise is None:
                return done
            least = last[-1].promised_success_rate
            if least is not None and least >= self.promise.aim:
                return (
                    f"{done}, and the model predicts success from {least:.1%} of the starts at "
                    "least"
                )
        return LIMIT if len(trials) >= self.trials else ""


def _succeeded(count: int) -> str:
    if count == 1:
        return "the own rollout succeeded"
    return f"the own rollouts of {NUMERALS.get(count, count)} trials in a row succeeded"
