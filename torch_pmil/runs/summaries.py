"""The folders of several runs of one experiment, and their mean success rate over experience."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from torch_pmil.files import LineError, in_words, read_json, read_text, short

CONFIDENCE = 0.95
ROUNDING = 1e-9  # of a mean of rates
LARGEST = 1e9  # of a number, as the seconds of a run
COMMAND = 16_384  # characters
NUMBERS = ("seed", "wall_seconds", "saved_trial")
COVERAGE = "two_sigma_coverage"  # of a method that predicts
TEXTS = ("experiment", "stop_reason")


class RunError(LineError):
    """A run's folder does not hold what a run leaves; the message names it."""


@dataclass(frozen=True, eq=False)
class SuccessCurve:
    """Success rate of each run, (runs, K), after seconds of experience, (K,).

    The mean over runs and the ends of its 95 % interval are (K,).
    """

    experience_s: np.ndarray
    rates: np.ndarray
    mean: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def at(self, experience_s: float) -> float:
        """Mean success rate after that much experience."""
        return self.mean[self.column(experience_s)].item()

    def column(self, experience_s: float) -> int:
        """Index of the last measurement up to that much experience, or of the first one."""
        measured = int(np.searchsorted(self.experience_s, experience_s, side="right"))
        return max(measured - 1, 0)

    def experience_to(self, rate: float) -> float | None:
        """Seconds of experience with which the mean first reached a rate; None if it never did."""
        reached = self.experience_s[self.mean >= rate - ROUNDING]
        return reached[0].item() if len(reached) else None


def judged_alone(summary: Mapping) -> bool:
    """Whether a run was judged by the robot's own rollouts alone, without fresh starts."""
    return not summary["saved_n_eval"]


def rate_of(trial: Mapping) -> float:
    """Success rate of a trial's policy from fresh starts, or of its own rollout without them."""
    rate, own = trial["success_rate"], trial.get("own_success")
    return float(own) if rate is None and own is not None else rate


def find_runs(folders: Sequence[Path]) -> list[Path]:
    """Folders of runs: those given, and the runs directly below those given, each once.

    A run has ``metrics.csv`` before its first trial. A link to a run is that run.

    Raises:
        RunError: a folder is missing, or is not a run and holds none.
    """
    found: dict[Path, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise RunError(f"{folder} is not a folder")
        candidates = (folder, *sorted(folder.iterdir()))
        runs = [path for path in candidates if (path / "metrics.csv").is_file()]
        if not runs:
            raise RunError(f"{folder} holds no run: neither metrics.csv nor folders with it")
        for path in runs:
            found.setdefault(path.resolve(), path)
    return list(found.values())


def words_of(command: object) -> list[str]:
    """The words of a command line of a run.

    Raises:
        ValueError: a shell would not take it, or it is too long: the time to split it grows with
            the square of its length.
    """
    if not isinstance(command, str) or len(command) > COMMAND:
        raise ValueError(f"command must be text of at most {COMMAND} characters")
    return shlex.split(command)


def is_finished(folder: Path) -> bool:
    """Whether the run ended, and so wrote its summary."""
    return (folder / "summary.json").is_file()


def read_summary(folder: Path) -> dict:
    """``summary.json`` of a finished run.

    Raises:
        RunError: it cannot be read, or an entry is missing or wrong.
    """
    try:
        summary = read_json(folder / "summary.json", finite=True)
        _check_summary(summary)
    except OSError as error:
        raise RunError(f"{folder} holds no finished run: {in_words(error)}") from error
    except KeyError as error:
        raise RunError(f"{folder}: summary.json has no {error.args[0]!r}") from error
    except (ValueError, TypeError, AttributeError) as error:
        raise RunError(f"{folder}: summary.json is damaged: {error}") from error
    return summary


def _check_summary(summary: dict) -> None:
    """Raise KeyError, ValueError or TypeError unless a summary has what tables and curves need."""
    if not summary["trials"]:
        raise ValueError("it has no trial")
    measured = [summary | {"success_rate": summary["saved_success_rate"]}, *summary["trials"]]
    _check_numbers("success_rate", [rate_of(measurement) for measurement in measured], largest=1)
    _check_numbers("experience_s", [measurement["experience_s"] for measurement in measured])
    for key in (*NUMBERS, *({COVERAGE} & summary.keys())):
        _check_numbers(key, [summary[key]])
    for key in TEXTS:
        if not isinstance(summary[key], str):
            raise ValueError(f"{key} must be text, got {short(summary[key])}")


def _check_numbers(name: str, values: list, largest: float = LARGEST) -> None:
    for value in values:
        if not (isinstance(value, int | float) and 0 <= value <= largest):
            raise ValueError(f"{name} must be a number from 0 to {largest:g}, got {short(value)}")


def count_trials(folder: Path) -> int:
    """Number of trials in ``metrics.csv``, of any run; raise RunError if that is damaged."""
    try:
        rows = csv.reader(io.StringIO(read_text(folder / "metrics.csv")))
        return max(0, sum(1 for row in rows if row) - 1)
    except (OSError, ValueError, csv.Error) as error:
        raise RunError(f"{folder}: metrics.csv is damaged: {error}") from error


def success_over_experience(runs: Sequence[dict]) -> SuccessCurve:
    """Mean success rate over seconds of experience, wherever one of the runs was measured.

    Between two measurements a run counts with its last one. From the end of its experience on, it
    counts with the rate of its saved policy, measured from new starts. Without fresh starts, the
    own rollouts count as 0 or 1. The runs are summaries, see :func:`read_summary`.
    """
    measured = [_measurements(run) for run in runs]
    first = max(times[0] for times, _ in measured)
    grid = np.unique(np.concatenate([times for times, _ in measured]))
    grid = grid[grid >= first]
    rates = np.stack(
        [values[np.searchsorted(times, grid, side="right") - 1] for times, values in measured]
    )
    mean = rates.mean(0)
    lower, upper = wilson_interval(mean, len(runs))
    return SuccessCurve(grid, rates, mean, lower, upper)


def _measurements(run: dict) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of experience at which a run was measured, and its success rates, the saved last."""
    measured = {round(trial["experience_s"], 6): rate_of(trial) for trial in run["trials"]}
    measured[round(run["experience_s"], 6)] = run["saved_success_rate"]
    times = sorted(measured)
    return np.array(times), np.array([measured[time] for time in times])


def wilson_interval(mean: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    r"""Wilson's 95 % score interval for the mean of ``count`` draws from [0, 1].

    .. math:: \frac{\hat p + z^2/2n}{1 + z^2/n} \pm \frac{z}{1 + z^2/n}
        \sqrt{\frac{\hat p (1 - \hat p)}{n} + \frac{z^2}{4 n^2}}

    The draws are the success rates of runs, as the rollouts of one run share its policy and are not
    independent. No draw from [0, 1] with mean p has a variance above p (1 - p), that of draws of 0
    and 1, for which the interval was made. Unlike a bootstrap over the runs, it does not shrink to
    nothing where all runs agree.

    The mean of the draws has any shape; ``count`` is n.

    Source: E. B. Wilson (1927), Probable inference, the law of succession, and statistical
    inference, JASA 22.

    Example:
        >>> lower, upper = wilson_interval(np.array(1.0), 10)
        >>> f"{lower:.3f} {upper:.3f}"
        '0.722 1.000'
    """
    z = scipy.special.ndtri((1 + CONFIDENCE) / 2)
    shrink = 1 + z**2 / count
    centre = (mean + z**2 / (2 * count)) / shrink
    half = z / shrink * np.sqrt(mean * (1 - mean) / count + z**2 / (4 * count**2))
    return np.clip(centre - half, 0, mean), np.clip(centre + half, mean, 1)
