"""What is counted of replayed runs: failures by cause, ends, and how right the predictions were."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from reproduction.delay_calibration import AHEAD
from reproduction.failure_causes import (
    CAUSES,
    ENDS,
    UNSURE,
    ReplayedTrial,
    cause_of,
    end_of,
    trials_not_needed,
)
from torch_pmil.runs.diagnosis.measures import COVERED
from torch_pmil.runs.summaries import wilson_interval

ALL = "all"
# success rates between which predictions are pooled
EDGES = (0.0, 0.05, 0.2, 0.4, 0.6, 0.75, 0.85, 0.9, 0.95, 1.0)


class Forecast(NamedTuple):
    """The success rate that was predicted for a policy, and the one that was measured.

    Args:
        predicted: fraction from 0 to 1.
        measured: from fresh starts.
    """

    predicted: float
    measured: float


@dataclass(frozen=True)
class ReplayedRun:
    """A run, as its replay left it.

    Args:
        task: what it learned.
        summary: of the run, with ``moved`` and ``predicted_saved`` of its replay.
        trials: of the replay.
    """

    task: str
    summary: Mapping[str, Any]
    trials: Sequence[ReplayedTrial]

    @classmethod
    def of(cls, task: str, summary: Mapping[str, Any]) -> ReplayedRun:
        """A run of whose summary the ``replayed`` trials are an entry."""
        return cls(task, summary, [ReplayedTrial(**trial) for trial in summary["replayed"]])

    @property
    def first_success(self) -> int:
        """Number of the first trial whose own rollout succeeded; beyond the last if none did."""
        return next((t.trial for t in self.trials if t.own_success), len(self.trials) + 1)

    @property
    def end(self) -> str:
        """How it ended, of ``ENDS``."""
        entries = ("saved_success_rate", "predicted_saved", "stop_reason")
        return end_of(*(self.summary[entry] for entry in entries))

    @property
    def wrong_one_step(self) -> int:
        """Trials whose model was unsure, and wrong about single steps already."""
        moved = self.summary["moved"]
        unsure = [t for t in self.trials if cause_of(t, moved) == UNSURE]
        return sum(t.covered < COVERED for t in unsure)

    def causes(self, after_success: bool = False) -> Counter[str]:
        """Failed trials by cause: all, or those after the first own success alone."""
        first = self.first_success if after_success else 0
        found = [cause_of(t, self.summary["moved"]) for t in self.trials if t.trial > first]
        return Counter(cause for cause in found if cause is not None)


def counts(runs: Sequence[ReplayedRun]) -> dict[str, Any]:
    """Trials by cause and runs by end.

    Returns:
        ``causes``, ``causes_after_success`` (after the first own success of a run) and ``ends``, by
        their names, and ``totals``.
    """
    causes, late = (
        sum((run.causes(after) for run in runs), Counter[str]()) for after in (False, True)
    )
    ends = Counter(run.end for run in runs)
    totals = {
        "runs": len(runs),
        "runs_not_learned": len(runs) - ends["learned"],
        "runs_ended_by_luck": sum(ends[end] for end in ENDS if "luck" in end),
        "runs_ended_by_luck_known": ends["ended by luck, and the model knew"],
        "trials": sum(len(run.trials) for run in runs),
        "trials_failed": causes.total(),
        "trials_wrong_one_step": sum(run.wrong_one_step for run in runs),
        "trials_not_needed": sum(trials_not_needed(run.trials) for run in runs),
    }
    return {
        "causes": {cause: causes[cause] for cause in CAUSES},
        "causes_after_success": {cause: late[cause] for cause in CAUSES},
        "ends": {end: ends[end] for end in ENDS},
        "totals": totals,
    }


def coverage_ahead(runs: Sequence[ReplayedRun]) -> dict[str, dict[str, float]]:
    """Two-sigma coverage by the number of steps ahead, up to the first own success and after.

    Means over trials, of models that had not learned from the rollouts in question.
    """
    trials = {
        "up_to_first_success": [t for r in runs for t in r.trials if t.trial <= r.first_success],
        "after": [t for r in runs for t in r.trials if t.trial > r.first_success],
    }
    found: dict[str, dict[str, float]] = {when: {} for when in trials}
    for when, held in trials.items():
        for steps in map(str, AHEAD):
            covered = [t.coverage_ahead[steps] for t in held if steps in t.coverage_ahead]
            if covered:
                found[when][steps] = fmean(covered)
    return found


def tables(runs: Sequence[ReplayedRun]) -> dict[str, dict[str, Any]]:
    """``counts`` and ``coverage_ahead`` of each task, in the order of the runs, and of ``ALL``."""
    groups: dict[str, list[ReplayedRun]] = {}
    for run in runs:
        groups.setdefault(run.task, []).append(run)
    groups[ALL] = list(runs)
    return {
        "counts": {task: counts(found) for task, found in groups.items()},
        "coverage_ahead": {task: coverage_ahead(found) for task, found in groups.items()},
    }


def reliability(forecasts: Sequence[Forecast]) -> list[dict[str, float]]:
    """Mean predicted and measured success rates of the forecasts in each bin of the prediction.

    Returns:
        Bins with a forecast, each with ``trials``, ``predicted``, ``measured``, and ``lower`` and
        ``upper``, the 95 % interval of Wilson of as many independent trials: the rollouts of one
        policy are not.

    Example:
        >>> (pooled,) = reliability([Forecast(0.96, 1.0), Forecast(1.0, 0.9)])
        >>> pooled["trials"], pooled["predicted"], pooled["measured"]
        (2, 0.98, 0.95)
    """
    bins = []
    for low, high in pairwise(EDGES):
        held = [f for f in forecasts if low <= f.predicted < high + (high == EDGES[-1])]
        if held:
            measured = fmean(f.measured for f in held)
            lower, upper = wilson_interval(np.array(measured), len(held))
            bins.append(
                {
                    "trials": len(held),
                    "predicted": fmean(f.predicted for f in held),
                    "measured": measured,
                    "lower": lower.item(),
                    "upper": upper.item(),
                }
            )
    return bins


def drawn(forecasts: Sequence[Forecast]) -> dict[str, Sequence[Sequence[float]]]:
    """What :func:`~reproduction.plots.calibration.plot_success_calibration` draws of forecasts."""
    shown = ("predicted", "measured", "lower", "upper")
    return {
        "trials": [(f.predicted, f.measured) for f in forecasts],
        "bins": [[pooled[name] for name in shown] for pooled in reliability(forecasts)],
    }
