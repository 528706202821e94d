"""Numbers of a soak: how many runs ended and learned, and whether they keep what they promise."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from statistics import median
from typing import Any

import numpy as np
from scipy.stats import binomtest

from reproduction.biorob import joint_degrees
from reproduction.handwriting import ratio
from reproduction.learned import load_learned, measured_success
from reproduction.replay import replayed
from reproduction.replayed_runs import Forecast, ReplayedRun, reliability, tables
from reproduction.soak.processes import Attempt, End, attempts_in, has_ended, size_of
from reproduction.soak.tasks import SoakRun
from torch_pmil.files import read_json, write_json
from torch_pmil.runs.diagnosis.measures import LEARNED
from torch_pmil.runs.summaries import CONFIDENCE, read_summary
from torch_pmil.trainer.ending import LIMIT

LISTED = ("forecasts", "replayed", "diagnosis")  # not in the list of runs: elsewhere
STARTS, START_SEED = 100, 7_000_000  # no start that a run has seen
MEASURED, REPLAYED = "measured.json", "replayed.json"
SAMPLES = 100  # imagined rollouts of each prediction of a replay

Row = dict[str, Any]


def measure(run: SoakRun) -> float:
    """Success rate of a run's saved policy from 100 fresh starts, kept in ``measured.json``.

    Raises:
        RunError, PolicyFileError, OSError: as :func:`~reproduction.learned.load_learned`.
    """
    path = run.folder / MEASURED
    if not path.is_file():
        experiment = run.load()
        policy = load_learned(run.folder, experiment).policy
        rate = measured_success(policy, experiment, STARTS, START_SEED + run.seed)
        write_json(path, {"success_rate": rate, "starts": STARTS})
    return read_json(path)["success_rate"]


def replay(run: SoakRun) -> dict[str, Any]:
    """What a run's model expected at each trial, kept in ``replayed.json``.

    Returns:
        Entries of :func:`~reproduction.replay.replayed`.

    Raises:
        RunError: the run left no checkpoint.
        OSError: the file cannot be read or written.
    """
    path = run.folder / REPLAYED
    if not path.is_file():
        write_json(path, replayed(run.folder, run.load(), SAMPLES))
    return read_json(path)


def row_of(run: SoakRun) -> Row:
    """What the results say of a run; without the entries of its summary if it has not ended.

    Raises:
        RunError, PolicyFileError, OSError: its files are damaged.
    """
    attempts, ended = attempts_in(run.folder), has_ended(run.folder)
    row: Row = {
        "task": run.task.name,
        "seed": run.seed,
        "folder": str(run.folder),
        "ended": ended,
        "attempts": [str(attempt.end) for attempt in attempts],
        "cpu_seconds": cpu_seconds_of(attempts),
        "bytes": size_of(run.folder),
    }
    if not ended:
        return {**row, "said": attempts[-1].said if attempts else "not begun"}
    summary = read_summary(run.folder)
    return {
        **row,
        **outcome_of(summary),
        "measured_success_rate": measure(run),
        "replayed": ReplayedRun.of(run.task.title, {**summary, **replay(run)}),
    }


def cpu_seconds_of(attempts: Sequence[Attempt]) -> float | None:
    """What all attempts at a run computed, figures and video included; None where there is none."""
    return sum(attempt.cpu_seconds for attempt in attempts) if attempts else None


def outcome_of(summary: dict) -> Row:
    """Main numbers of a run's summary; None for what its version does not have."""
    saved = summary["trials"][summary["saved_trial"] - 1]
    outcome = {
        "commit": summary.get("commit"),
        "stop_reason": summary["stop_reason"],
        "claimed": summary["stop_reason"] != LIMIT,
        "trials": len(summary["trials"]),
        "experience_s": summary["experience_s"],
        "wall_seconds": summary["wall_seconds"],
        "saved_success_rate": summary["saved_success_rate"],
        "first_at_95": first_at_goal(summary["trials"]),
        "promise": summary["settings"].get("promise"),
        "promised_success_rate": summary.get("promised_success_rate"),
        "predicted_success_rate": saved.get("predicted_success_rate"),
        "forecasts": forecasts_of(summary["trials"]),
        "diagnosis": summary["diagnosis"],
    }
    if summary["experiment"].startswith("handwriting"):
        outcome["ratio"] = ratio(summary)
    if summary["experiment"] == "biorob":
        outcome["joint_rms_deg"] = joint_degrees(summary["rms_error"])
    return outcome


def first_at_goal(trials: Sequence[dict]) -> int | None:
    """Number of the first trial whose policy succeeds from 95 % of 20 fresh starts, if any does.

    Example:
        >>> first_at_goal([{"success_rate": 0.2}, {"success_rate": 0.95}, {"success_rate": 1.0}])
        2
    """
    reached = (number for number, trial in enumerate(trials, 1) if trial["success_rate"] >= LEARNED)
    return next(reached, None)


def forecasts_of(trials: Sequence[dict]) -> list[Forecast]:
    """Predicted and measured success rate of each trial that has both."""
    return [
        Forecast(trial["predicted_success_rate"], trial["success_rate"])
        for trial in trials
        if trial.get("predicted_success_rate") is not None
    ]


def headline_of(rows: Sequence[Row]) -> dict[str, float | None]:
    """The main numbers of all runs.

    A run *claimed* success if it ended because it had learned. It keeps its promise if it succeeds
    from at least the promised fraction of 100 fresh starts.

    Args:
        rows: of all runs, see :func:`row_of`.
    """
    ended = [row for row in rows if row["ended"]]
    claimed = [row for row in ended if row["claimed"]]
    kept = [keeps(row) for row in claimed if row["promise"] is not None]
    errors = [row["joint_rms_deg"] for row in ended if "joint_rms_deg" in row]
    return {
        "runs": len(rows),
        "ended": len(ended),
        "saved_at_95": at_goal(ended),
        "worst_claimed": min((row["saved_success_rate"] for row in claimed), default=None),
        "double_pendulum_at_95": at_goal(of_task(ended, "double_pendulum")),
        "biorob_at_95": at_goal(of_task(ended, "biorob")),
        "biorob_joint_rms_deg": math.sqrt(np.mean(np.square(errors))) if errors else None,
        "promise_kept": sum(kept) / len(kept) if kept else None,
    }


def keeps(row: Row) -> bool:
    """Whether a run succeeds at least as often as it was asked to promise, or promises nothing."""
    return row["promise"] is None or row["measured_success_rate"] >= row["promise"]


def of_task(rows: Sequence[Row], name: str) -> list[Row]:
    """The rows of a task."""
    return [row for row in rows if row["task"] == name]


def at_goal(rows: Sequence[Row]) -> int:
    """Number of runs whose saved policy succeeds from at least 95 % of 20 fresh starts."""
    return sum(row["saved_success_rate"] >= LEARNED for row in rows)


def details_of(rows: Sequence[Row]) -> dict[str, object]:
    """What the summary says besides the headline."""
    names = dict.fromkeys(row["task"] for row in rows)
    ended = [row for row in rows if row["ended"]]
    return {
        "attempts": Counter(end for row in rows for end in row["attempts"]),
        "failed": [_failed(row) for row in rows if set(row["attempts"]) != {str(End.ENDED)}],
        "disk_bytes": sum(row["bytes"] for row in rows),
        "largest_run_bytes": max((row["bytes"] for row in rows), default=0),
        "starts": STARTS,
        "tasks": {name: task_numbers(of_task(rows, name)) for name in names},
        "broken_promises": [_broken(row) for row in ended if row["claimed"] and not keeps(row)],
        "not_learned": [_not_learned(row) for row in ended if not _learned(row)],
        "reliability": reliability([f for row in ended for f in row["forecasts"]]),
        **tables([row["replayed"] for row in ended]),
        "runs": [{key: row[key] for key in row if key not in LISTED} for row in rows],
    }


def task_numbers(rows: Sequence[Row]) -> dict[str, float | None]:
    """Numbers of the runs of one task; medians and the like are of those that ended."""
    ended = [row for row in rows if row["ended"]]
    numbers: dict[str, float | None] = {
        "runs": len(rows),
        "ended": len(ended),
        "at_95": at_goal(ended),
        "claimed": sum(row["claimed"] for row in ended),
    }
    if not ended:
        return numbers
    for key, name in (("experience_s", "experience_s"), ("trials", "trials")):
        numbers |= {f"median_{name}": _median(ended, key), f"longest_{name}": _most(ended, key)}
    numbers |= {f"median_{key}": _median(ended, key) for key in ("wall_seconds", "cpu_seconds")}
    firsts = [row["first_at_95"] for row in ended]
    numbers["latest_first_at_95"] = None if None in firsts else max(firsts)
    if "ratio" in ended[0]:
        numbers |= {"median_ratio": _median(ended, "ratio"), "worst_ratio": _most(ended, "ratio")}
    return numbers


def _learned(row: Row) -> bool:
    return row["claimed"] and row["saved_success_rate"] >= LEARNED


def _not_learned(row: Row) -> Row:
    keys = ("folder", "stop_reason", "saved_success_rate", "measured_success_rate", "diagnosis")
    return {key: row[key] for key in keys}


def _broken(row: Row) -> Row:
    """What a run promised, and the upper end of the 95 % interval of what was measured."""
    keys = ("folder", "promise", "promised_success_rate", "measured_success_rate")
    succeeded = round(STARTS * row["measured_success_rate"])
    upper = binomtest(succeeded, STARTS).proportion_ci(CONFIDENCE).high
    return {**{key: row[key] for key in keys}, "upper": float(upper)}


def _failed(row: Row) -> Row:
    keys = ("folder", "ended", "attempts", "said")
    return {key: row[key] for key in keys if key in row}


def _median(rows: Sequence[Row], key: str) -> float:
    return median(row[key] for row in rows)


def _most(rows: Sequence[Row], key: str) -> float:
    return max(row[key] for row in rows)
