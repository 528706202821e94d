"""What a run prints: warnings, a line for each trial, what it came to, and where there is more."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from tqdm import tqdm

from torch_pmil.demonstrations import DemonstrationError
from torch_pmil.runs.diagnosis.demonstration_checks import Finding
from torch_pmil.runs.summaries import judged_alone
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.trainer.trials import Trial

LEFT = ("report.html", "figures", "video.mp4", "summary.json")  # what a run may leave for the eye
MOST_WARNINGS = 10  # of one cause


def say(label: str, text: str) -> None:
    """Print lines above the progress bar, each with the label.

    The runs of a sweep print to one terminal.
    """
    tqdm.write("\n".join(label + line for line in text.splitlines()))
    sys.stdout.flush()


def warn_of(label: str, findings: list[Finding]) -> None:
    """Print what may go wrong with the demonstrations; raise DemonstrationError at what must.

    Of each cause the first ``MOST_WARNINGS`` are printed.
    """
    for finding in findings:
        if finding.fatal:
            raise DemonstrationError(finding.message)
    counts: Counter[str] = Counter()
    for finding in findings:
        counts[finding.cause] += 1
        if counts[finding.cause] <= MOST_WARNINGS:
            say(label, f"warning: {finding.message}")
    for cause, count in counts.items():
        if count > MOST_WARNINGS:
            say(label, f"warning: {count - MOST_WARNINGS} more of {cause}")


def print_trial(label: str, objective: type[TrajectoryLoss], trial: Trial) -> None:
    """Print one line for a trial."""
    predicted = f"{objective.label} {trial.loss:6.1f} {objective.unit}".rstrip()
    measured = ""
    if trial.success_rate is not None:
        measured = f"success rate {trial.success_rate:4.0%} of {trial.n_eval} starts, "
    say(
        label,
        f"trial {trial.trial:2d}: {trial.experience_s:5.1f} s of experience, {predicted}, own "
        f"rollout {own_end(trial)}, {measured}search {trial.search_seconds:.0f} s",
    )


def own_end(trial: Trial) -> str:
    """What became of a trial's own rollout."""
    if trial.cut_short:
        return f"was cut short after {trial.steps} steps ({trial.cut_short})"
    return "succeeded" if trial.own_success else "failed"


def by_entry(summary: dict) -> str:
    """The coverage of each entry of the state."""
    return ", ".join(
        f"{name} {coverage:.0%}"
        for name, coverage in summary["two_sigma_coverage_by_entry"].items()
    )


def of_predictions(summary: dict) -> str:
    """How far the executed states were predicted, or why they were not."""
    if "prediction_error" in summary:
        return f"the model cannot predict this policy: {summary['prediction_error']}"
    return (
        f"{summary['two_sigma_coverage']:.0%} of the executed states lie within two predicted "
        f"standard deviations: {by_entry(summary)}"
    )


def of_success(summary: dict) -> str:
    """How well the saved policy does, and what says so.

    Example:
        >>> of_success({"saved_success_rate": 1.0, "saved_n_eval": 0})
        "own rollout succeeded (judged by the robot's own rollouts alone)"
    """
    rate, count = summary["saved_success_rate"], summary["saved_n_eval"]
    if judged_alone(summary):
        ended = "succeeded" if rate else "failed"
        return f"own rollout {ended} (judged by the robot's own rollouts alone)"
    return f"success rate {rate:.0%} of {count} fresh starts"


def holds_something(path: Path) -> bool:
    """Whether there is a file, or a folder with one."""
    return any(path.glob("*")) if path.is_dir() else path.exists()


def print_result(label: str, summary: dict) -> None:
    """Print what the run came to."""
    reasons = [f"{reason['cause']}: {reason['message']}" for reason in summary["diagnosis"]]
    lines = [
        f"policy of trial {summary['saved_trial']}: {of_success(summary)} after "
        f"{summary['experience_s']:.1f} s of experience and {summary['wall_seconds']:.0f} s of "
        f"computing ({summary['stop_reason']})",
        of_predictions(summary),
        *(f"likely reason: {reason}" for reason in reasons),
    ]
    say(label, "\n".join(lines))


def print_left(label: str, out: Path) -> None:
    """Print where there is something to see."""
    left = [str(out / name) for name in LEFT if holds_something(out / name)]
    say(label, f"see {', '.join(left)}")
