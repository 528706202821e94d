"""The tables of a run's page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from torch_pmil.experiments.runs.report.words import percent, say

# columns that can be read at a glance (metrics.csv has all): a field, what its column is called,
# and how its value is said
TRIAL: dict[str, tuple[str, Callable[[Any], str]]] = {
    "trial": ("trial", say),
    "experience_s": ("experience (s)", "{:.1f}".format),
    "loss": ("objective", say),
    "tracking_error": ("tracking error (rad)", say),
    "success_rate": ("success rate", percent),
    "own_success": ("own rollout", lambda success: "succeeded" if success else "failed"),
    "own_error": ("own error", say),
    "horizon": ("steps searched", say),
    "gp_seconds": ("model (s)", "{:.1f}".format),
    "search_seconds": ("search (s)", "{:.1f}".format),
    "stop_reason": ("search ended by", say),
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
    yield _trials(summary["trials"])
    if "saved_success_rate_by_target" in summary:
        rates = summary["saved_success_rate_by_target"].items()
        yield Table(
            "Targets", ["target", "success rate"], [[name, percent(rate)] for name, rate in rates]
        )
    if "rms_error" in summary and "demonstration_spread" in summary:
        spread = summary["demonstration_spread"]
        rows = [
            [name, say(error), say(spread[name])] for name, error in summary["rms_error"].items()
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
    yield Table("Settings", ["setting", "value"], list(_flat(summary.get("settings", {}))))
    origin = {name: summary[name] for name in ("command", "date", "commit") if name in summary}
    yield Table(
        "Where it comes from",
        ["what", "value"],
        list(_flat({**origin, **summary.get("versions", {})})),
    )


def _trials(trials: list[Mapping]) -> Table:
    fields = [field for field in TRIAL if field in trials[0]]
    rows = [
        ["–" if trial.get(field) is None else TRIAL[field][1](trial[field]) for field in fields]
        for trial in trials
    ]
    return Table("Trials", [TRIAL[field][0] for field in fields], rows)


def _flat(settings: Mapping, prefix: str = "") -> Iterator[list[str]]:
    """Name and value of each setting, one within another with both names."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield [f"{prefix}{name}", say(value)]
