"""What a run prints: warnings, a line for each trial, the result, and what could not be made."""

from __future__ import annotations

import shlex
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tqdm import tqdm

from torch_pmil.demonstrations import DemonstrationError
from torch_pmil.files import bounded_line
from torch_pmil.runs.diagnosis.findings import Finding
from torch_pmil.runs.run_folder import read_command
from torch_pmil.runs.summaries import RunError, judged_alone
from torch_pmil.search.promise import Promise
from torch_pmil.tasks.registry import is_own
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.trials import Trial

LEFT = ("report.html", "figures", "video.mp4", "summary.json")  # what there may be to see of a run
MOST_WARNINGS = 10  # of one cause
Step = tuple[str, Callable[[], object]]  # what it makes, and how


def say(label: str, text: str) -> None:
    """Print lines above the progress bar, each with the label of its run."""
    tqdm.write("\n".join(label + line for line in text.splitlines()))
    sys.stdout.flush()


def warn_of(label: str, findings: list[Finding]) -> None:
    """Print the first ``MOST_WARNINGS`` findings of each cause, or raise the first fatal one.

    Raises:
        DemonstrationError: of a fatal finding.
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


@contextmanager
def warnings_in_one_line(label: str) -> Iterator[None]:
    """Print a warning that is raised within like a finding, without its line of source code."""
    with warnings.catch_warnings():
        show = warnings.showwarning

        def print_warning(
            message: Warning | str, category: type[Warning], *where: Any, **options: Any
        ) -> None:
            if category in (UserWarning, RuntimeWarning):
                say(label, f"warning: {bounded_line(message)}")
            else:
                show(message, category, *where, **options)

        warnings.showwarning = print_warning
        yield


def print_trial(label: str, task: Task, trial: Trial) -> None:
    """Print one line for a trial."""
    objective = task.objective
    loss = f"{objective.label} {trial.loss:6.1f} {objective.unit}".rstrip()
    known = ", ".join(success_rates(trial, task.promised))
    number = round(trial.experience_s / task.time_step)
    # a task that is still to be sampled does not know how long its steps will be
    transitions = "" if task.samplings else f" ({number} transitions)"
    say(
        label,
        f"trial {trial.trial:2d}: {trial.experience_s:5.1f} s of experience{transitions}, "
        f"{loss}, own rollout {own_end(trial)}{known and ', success '}{known}",
    )


def success_rates(trial: Trial, promise: Promise | None) -> Iterator[str]:
    """The success rates of a trial's policy that are known, and the one that the promise asks."""
    if trial.success_rate is not None:
        yield f"measured {trial.success_rate:.0%}"
    if trial.predicted_success_rate is not None:
        yield f"predicted {trial.predicted_success_rate:.0%}"
    if trial.promised_success_rate is not None:
        yield f"promised {trial.promised_success_rate:.1%}"
    if promise is not None:
        yield f"asked {promise.aim:.1%}"


def own_end(trial: Trial) -> str:
    """How a trial's own rollout ended."""
    if trial.cut_short:
        return f"was cut short after {trial.steps} steps ({trial.cut_short})"
    return "succeeded" if trial.own_success else "failed"


def of_predictions(summary: dict) -> str:
    """How many executed states were predicted, or why none was."""
    if "prediction_error" in summary:
        return f"the model cannot predict this policy: {summary['prediction_error']}"
    entries = summary["two_sigma_coverage_by_entry"].items()
    by_entry = ", ".join(f"{name} {coverage:.0%}" for name, coverage in entries)
    return (
        f"{summary['two_sigma_coverage']:.0%} of the executed states lie within two predicted "
        f"standard deviations: {by_entry}"
    )


def of_success(summary: dict) -> str:
    """How well the saved policy does, and how it was judged."""
    rate, count = summary["saved_success_rate"], summary["saved_n_eval"]
    if judged_alone(summary):
        ended = "succeeded" if rate else "failed"
        return f"own rollout {ended} (judged by the robot's own rollouts alone)"
    return f"success rate {rate:.0%} of {count} fresh starts"


def of_errors(summary: dict) -> str:
    """How far the rollouts of the saved policy are from the demonstrated mean in the worst entry.

    That is the one with the largest error relative to the demonstrations' spread.
    """
    errors, spread = summary["rms_error"], summary["demonstration_spread"]
    worst = max(errors, key=lambda name: errors[name] / (spread[name] or 1.0))
    unit = summary["units"]["demonstrations"][worst]
    numbers = (f"{number:.2g} {unit}".rstrip() for number in (errors[worst], spread[worst]))
    return "{} is {} off the demonstrated mean, where demonstrations are {} off it".format(
        worst, *numbers
    )


def print_result(label: str, summary: dict) -> None:
    """Print the result of a run."""
    reasons = [f"{reason['cause']}: {reason['message']}" for reason in summary["diagnosis"]]
    lines = [
        f"policy of trial {summary['saved_trial']}: {of_success(summary)} after "
        f"{summary['experience_s']:.1f} s of experience and {summary['wall_seconds']:.0f} s of "
        f"computing ({summary['stop_reason']})",
        *([summary["unmet"]] if "unmet" in summary else []),
        *([of_errors(summary)] if "rms_error" in summary else []),
        of_predictions(summary),
        *(f"likely reason: {reason}" for reason in reasons),
    ]
    say(label, "\n".join(lines))


def print_left(label: str, out: Path) -> None:
    """Print which files, and folders that are not empty, there are to see."""
    paths = [out / name for name in LEFT]
    left = [path for path in paths if (any(path.glob("*")) if path.is_dir() else path.exists())]
    say(label, f"see {', '.join(map(str, left))}")


def tell(steps: Iterable[Step]) -> list[str]:
    """Take each step after a run's end, even if those before it failed; a line for each failure.

    Ctrl-C stops a step and all those after it.
    """
    failures, stopped = [], False
    for name, step in steps:
        try:
            if not stopped:
                step()
        except KeyboardInterrupt:
            stopped = True
        except Exception as error:  # whatever it is: what was learned is saved
            failures.append(f"{name}: {bounded_line(error)}")
        if stopped:
            failures.append(f"{name}: stopped")
    return failures


def making_the_rest(out: Path) -> str:
    """The command that makes the missing files of a run.

    Example:
        >>> making_the_rest(Path("my runs/a"))
        "pmil resume 'my runs/a'"
    """
    folder, own = f"./{out}" if str(out).startswith("-") else str(out), list[str]()
    with suppress(RunError, OSError):  # pmil resume says what is wrong with it
        own = own_experiment(read_command(out))
    return shlex.join(["pmil", "resume", folder, *own])


def own_experiment(command: Sequence[str]) -> list[str]:
    """The word that names a task of one's own, if there is one: ``pmil resume`` asks for it.

    Example:
        >>> own_experiment(["pmil", "train", "experiment=own.py:make", "seed=1"])
        ['experiment=own.py:make']
    """
    return [word for word in command if word.startswith("experiment=") and is_own(word)][:1]


def warn_incomplete(label: str, failures: list[str], remedy: str) -> None:
    """Print on standard error, in one line, what is missing, if anything is, and the remedy."""
    if failures:
        print(
            f"{label}the report is incomplete: {'; '.join(failures)}; {remedy} makes the rest "
            "later, pmil report the page alone",
            file=sys.stderr,
            flush=True,
        )
