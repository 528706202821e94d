"""When a run ends: the robot's own rollouts succeeded, and the model keeps the promise."""

from __future__ import annotations

from collections.abc import Sequence

from torch_pmil.search.promise import Promise
from torch_pmil.trainer.trials import Trial

LIMIT = "limit of trials"
NUMERALS = {2: "two", 3: "three", 4: "four"}


def why_ended(
    trials: Sequence[Trial], confirmations: int, promise: Promise | None, most_trials: int
) -> str:
    """Why a run ends after these trials, "" if it goes on.

    Args:
        trials: all of them, one at least.
        confirmations: number of own successes in a row without which it does not end so.
        promise: what the model must predict after the last of them; None for nothing.
        most_trials: the limit of trials.
    """
    last = trials[-confirmations:]
    if len(last) == confirmations and all(trial.own_success for trial in last):
        done = _succeeded(confirmations)
        if promise is None:
            return done
        least = last[-1].promised_success_rate
        if least is not None and least >= promise.aim:
            return f"{done}, and the model predicts success from {least:.1%} of the starts at least"
    return LIMIT if len(trials) >= most_trials else ""


def _succeeded(count: int) -> str:
    if count == 1:
        return "the own rollout succeeded"
    return f"the own rollouts of {NUMERALS.get(count, count)} trials in a row succeeded"
