"""The tables of a run's page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from torch_pmil.control.state_space import with_unit
from torch_pmil.runs.report.units import unit_of
from torch_pmil.runs.report.words import percent, say
from torch_pmil.runs.summaries import judged_alone

# why the last run of L-BFGS ended, in words that do not sound like a failure where there is none
ENDS = {
    "iteration limit": "all its iterations done",
    "gradient is small": "an optimum",
    "no further progress": "no further progress",
    "numerical failure": "a numerical failure",
}


@dataclass(frozen=True)
class Table:
    """Cells of a table, as text.

    Args:
        title: above it.
        heads: of the columns.
        rows: each with a cell for each column.
        text: below the title, "" for none.
    """

    title: str
    heads: list[str]
    rows: list[list[str]]
    text: str = ""


def tables(summary: Mapping) -> Iterator[Table]:
    """The tables for which a summary has numbers."""
    yield _trials(summary)
    if "saved_success_rate_by_target" in summary:
        rates = summary["saved_success_rate_by_target"].items()
        yield Table(
            "Targets", ["target", "success rate"], [[name, percent(rate)] for name, rate in rates]
        )
    if "rms_error" in summary and "demonstration_spread" in summary:
        spread = summary["demonstration_spread"]
        units = summary.get("units", {}).get("demonstrations", {})
        rows = [
            [with_unit(name, units.get(name)), say(error), say(spread[name])]
            for name, error in summary["rms_error"].items()
        ]
        text = (
            "Root mean square distance of the rollouts from the demonstrated mean, beside the "
            "demonstrations' own standard deviation."
        )
        yield Table("Accuracy", ["entry", "rms error", "spread of the demonstrations"], rows, text)
    if "two_sigma_coverage_by_entry" in summary:
        rows = [
            [name, percent(share)] for name, share in summary["two_sigma_coverage_by_entry"].items()
        ]
        text = (
            "Executed states within two predicted standard deviations of the trajectory; 95 % if "
            "the prediction were right and Gaussian."
        )
        yield Table("Coverage", ["entry of the state", "within"], rows, text)
    if "saturated" in summary:
        rows = [[name, percent(share)] for name, share in summary["saturated"].items()]
        yield Table("Motors", ["motor", "steps within 5 % of its limit"], rows)
    settings = [
        [name, value, unit_of(name, summary)] for name, value in _flat(summary.get("settings", {}))
    ]
    yield Table("Settings", ["setting", "value", "unit"], settings)
    origin = {name: summary[name] for name in ("command", "date", "commit") if name in summary}
    yield Table(
        "Where it comes from",
        ["what", "value"],
        list(_flat({**origin, **summary.get("versions", {})})),
    )


def _trials(summary: Mapping) -> Table:
    trials, columns = summary["trials"], _columns(summary)
    fields = [
        field for field in columns if any(trial.get(field) not in (None, "") for trial in trials)
    ]
    rows = [
        ["–" if trial.get(field) is None else columns[field][1](trial[field]) for field in fields]
        for trial in trials
    ]
    measured = "The success rate is from fresh starts, which are no experience."
    if judged_alone(summary):
        measured = "Success is judged by the robot's own rollouts alone."
    if "predicted_success_rate" in fields:
        measured += " The predicted one is of trajectories that are drawn from the trial's model."
    text = (
        f"{measured} A search has a number of iterations; that it does them all is usual, and no "
        "failure."
    )
    return Table("Trials", [columns[field][0] for field in fields], rows, text)


def _columns(summary: Mapping) -> dict[str, tuple[str, Callable[[Any], str]]]:
    """Columns that can be read at a glance (metrics.csv has all).

    Of each field what its column is called, and how its value is said.
    """
    tolerance = summary.get("settings", {}).get("tolerance")
    own_error: tuple[str, Callable[[Any], str]] = ("own error (unit of the task)", say)
    if tolerance:
        own_error = "own error, of the tolerance", lambda error: percent(error / tolerance)
    return {
        "trial": ("trial", say),
        "experience_s": ("experience (s)", "{:.1f}".format),
        "loss": (with_unit("objective", summary.get("units", {}).get("objective")), say),
        "tracking_error": ("tracking error (rad)", say),
        "predicted_success_rate": ("predicted success", percent),
        "success_rate": ("success rate", percent),
        "own_success": ("own rollout", lambda success: "succeeded" if success else "failed"),
        "own_error": own_error,
        "cut_short": ("cut short", str),
        "horizon": ("searched up to (step)", say),
        "gp_seconds": ("model (s)", "{:.1f}".format),
        "search_seconds": ("search (s)", "{:.1f}".format),
        "stop_reason": ("search ended with", lambda reason: ENDS.get(reason, reason)),
    }


def _flat(settings: Mapping, prefix: str = "") -> Iterator[list[str]]:
    """Name and value of each setting, one within another with both names."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield [f"{prefix}{name}", say(value)]
