"""When a run ends: the robot's own rollouts succeeded, and the model keeps the promise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean

from torch_pmil.checks import check_whole
from torch_pmil.search.promise import Promise
from torch_pmil.trainer.trials import Trial

LIMIT = "limit of trials"
AGAIN = 3  # own successes in a row that end a run, whatever the model promises
NUMERALS = {2: "two", 3: "three", 4: "four"}


@dataclass(frozen=True, eq=False)
class Ending:
    """When a run ends.

    Args:
        trials: largest number of trials.
        confirmations: own successes in a row without which no run ends.
        promise: what the newest model must predict after the last confirmation. Two exceptions end
            a run sooner: two successes whose models both predict the promised rate itself, and
            ``AGAIN`` successes in a row, unless the rates measured from fresh starts contradict the
            promise. None if no success is predicted; the confirmations alone then end the run.

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
        if kept := self._kept(trials):
            return kept
        again = max(AGAIN, self.confirmations)
        if _succeeded(trials, again) and self._measured(trials[-again:]):
            return _done(again)
        return LIMIT if len(trials) >= self.trials else ""

    def _kept(self, trials: Sequence[Trial]) -> str:
        """How the last of these trials are confirmed and keep the promise; "" if they do not."""
        if _succeeded(trials, self.confirmations):
            done = _done(self.confirmations)
            if self.promise is None:
                return done
            rate = trials[-1].promised_success_rate
            if rate is not None and rate >= self.promise.aim:
                return (
                    f"{done}, and the model predicts success from {rate:.1%} of the starts at least"
                )
            if self._twice(trials):
                least = f"{self.promise.rate:.1%} of the starts"
                return f"{_done(2)}, and both models predict success from {least}"
        return ""

    def imitated(self, trials: Sequence[Trial]) -> int:
        """Number of the first trial after which a run ends before its limit, or 0.

        It is that of the last trial of imitation, in a run that then improves.
        """
        counts = range(1, len(trials) + 1)
        return next((n for n in counts if self.reason(trials[:n]) not in ("", LIMIT)), 0)

    def improved(self, trials: Sequence[Trial]) -> str:
        """Why a run that improves its imitation ends, given the trials since then; else "".

        Three successes in a row do not end it, since the imitation succeeded already. The promise,
        if there is one, must be kept.
        """
        own = trials[self.imitated(trials) :]
        return self._kept(own) or (LIMIT if len(trials) >= self.trials else "")

    def _twice(self, trials: Sequence[Trial]) -> bool:
        """Whether two trials in a row succeeded whose models predict the promised rate itself.

        Half of the permitted failures are reserved for what the model does not know. The second
        success shows that this is little.
        """
        assert self.promise is not None
        rates = [trial.promised_success_rate or 0.0 for trial in trials[-2:]]
        return _succeeded(trials, 2) and min(rates) >= self.promise.rate

    def _measured(self, trials: Sequence[Trial]) -> bool:
        """Whether the measurements from fresh starts, if there are any, confirm the promise.

        A rate measured from 20 starts is often higher than the true rate of its policy, and each
        trial gives another chance of that.
        """
        assert self.promise is not None
        rates = [trial.success_rate for trial in trials if trial.success_rate is not None]
        return not rates or fmean(rates) > self.promise.rate - 1e-9  # a mean is rounded

    def unmet(self, trials: Sequence[Trial]) -> str:
        """What kept a run from ending before its limit although own rollouts succeeded; else "".

        It names a lower promise that would have ended the run sooner, if there is one.
        """
        succeeded = sum(trial.own_success for trial in trials)
        if not succeeded or self.reason(trials) != LIMIT or self.imitated(trials):
            return ""
        done = f"the own rollout succeeded in {succeeded} of {len(trials)} trials, but"
        counts = range(1, len(trials) + 1)
        confirmed = [n for n in counts if _succeeded(trials[:n], self.confirmations)]
        if self.promise is None or not confirmed:
            return f"{done} confirmations={self.confirmations} asks for that many in a row"
        best = max(trials[n - 1].promised_success_rate or 0.0 for n in confirmed)
        lacking = (
            f"{done} the model promises success from {best:.1%} of the starts at most, where "
            f"promise={self.promise.rate:g} asks {self.promise.aim:.1%}; more trials may reach that"
        )
        rate = math.floor(100 * (2 * best - 1) - 1e-9) / 100  # rounded down
        if rate <= 0:
            return lacking
        sooner = replace(self, trials=len(trials) + 1, promise=replace(self.promise, rate=rate))
        ended = next(n for n in confirmed if sooner.reason(trials[:n]))
        return f"{lacking}, and promise={rate:g} would have ended the run at trial {ended}"


def _succeeded(trials: Sequence[Trial], count: int) -> bool:
    """Whether the last ``count`` own rollouts all succeeded."""
    last = trials[-count:]
    return len(last) == count and all(trial.own_success for trial in last)


def _done(count: int) -> str:
    if count == 1:
        return "the own rollout succeeded"
    return f"the own rollouts of {NUMERALS.get(count, count)} trials in a row succeeded"
