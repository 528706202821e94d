"""The tables of a run's page: its numbers with their units."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from torch_pmil.control.state_space import with_unit
from torch_pmil.runs.report.words import percent, say
from torch_pmil.runs.settings import SETTINGS
from torch_pmil.runs.summaries import judged_alone

ENDS = {  # of the optimiser's last run: reaching the limit of iterations is not a failure
    "iteration limit": "all iterations",
    "gradient is small": "an optimum",
    "no further progress": "no further progress",
    "numerical failure": "a numerical failure",
}
DERIVED = {  # units of what a summary's settings hold besides the settings of a run
    "horizon": "control steps",
    "held": "control periods",
    "exploration.random_action": SETTINGS["random_action"].unit,
    "exploration.around": "the units of the actions",
    "targets": "the unit of the entry",
    "centre_std": "the unit of the entry",
}


@dataclass(frozen=True)
class Table:
    """Cells of a table, as text, with the heads of its columns and a text below its title."""

    title: str
    heads: list[str]
    rows: list[list[str]]
    text: str = ""


def tables(summary: Mapping) -> Iterator[Table]:
    """The tables for which a summary has numbers."""
    yield _trials(summary)
    if "saved_success_rate_by_target" in summary:
        rows = _percents(summary["saved_success_rate_by_target"])
        yield Table("Targets", ["target", "success rate"], rows)
    if "rms_error" in summary and "demonstration_spread" in summary:
        spread = summary["demonstration_spread"]
        units = summary.get("units", {}).get("demonstrations", {})
        rows = [
            [with_unit(name, units.get(name)), say(error), say(spread[name])]
            for name, error in summary["rms_error"].items()
        ]
        text = (
            "Root mean square distance of the rollouts from the demonstrated mean, and the "
            "standard deviation of the demonstrations for comparison."
        )
        yield Table("Accuracy", ["entry", "rms error", "spread of the demonstrations"], rows, text)
    if "two_sigma_coverage_by_entry" in summary:
        rows = _percents(summary["two_sigma_coverage_by_entry"])
        text = (
            "Executed states within two predicted standard deviations of the trajectory; 95 % if "
            "the prediction were right and Gaussian."
        )
        yield Table("Coverage", ["entry of the state", "within"], rows, text)
    if "saturated" in summary:
        rows = _percents(summary["saturated"])
        yield Table("Motors", ["motor", "steps within 5 % of its limit"], rows)
    settings = _flat(summary.get("settings", {}))
    rows = [[name, value, unit_of(name, summary)] for name, value in settings]
    yield Table("Settings", ["setting", "value", "unit"], rows)
    origin = {name: summary[name] for name in ("command", "date", "commit") if name in summary}
    rows = list(_flat({**origin, **summary.get("versions", {})}))
    yield Table("Where it comes from", ["what", "value"], rows)


def unit_of(setting: str, summary: Mapping) -> str:
    """Unit of a setting of a run, "" if it has none or it is unknown.

    Example:
        >>> units = {"objective": "nats", "demonstrations": {"x": "m", "y": "m"}}
        >>> names = ("search.first_horizon", "search.trust_threshold", "noise_std")
        >>> [unit_of(name, {"units": units}) for name in names]
        ['whole horizons', 'nats a step and entry', 'm']
    """
    units = summary.get("units", {})
    if setting == "search.trust_threshold":
        search = summary.get("settings", {}).get("search", {})
        matched = units.get("objective") and not search.get("trust_what_is_sure")
        return f"{units['objective']} a step and entry" if matched else "variances of the data"
    if setting.startswith("cost.target."):
        return units.get("demonstrations", {}).get(setting.removeprefix("cost.target."), "")
    if setting == "noise_std":
        return ", ".join(dict.fromkeys(units.get("demonstrations", {}).values()))
    return SETTINGS[setting].unit if setting in SETTINGS else DERIVED.get(setting, "")


def _trials(summary: Mapping) -> Table:
    trials, columns = summary["trials"], _columns(summary)
    fields = [
        field for field in columns if any(trial.get(field) not in (None, "") for trial in trials)
    ]
    rows = [
        ["–" if trial.get(field) is None else columns[field][1](trial[field]) for field in fields]
        for trial in trials
    ]
    text = "The success rate is measured from fresh starts, from which nothing is learned."
    if judged_alone(summary):
        text = "Success is judged by the robot's own rollouts alone."
    if "predicted_success_rate" in fields:
        text += " The predicted rate is that of trajectories drawn from the trial's model."
    if "promised_success_rate" in fields:
        text += " The promised rate is its lower bound once the model knows the own rollout"
        rate = summary.get("settings", {}).get("promise")
        text += f"; promise={rate:g} asks {(1 + rate) / 2:.1%}." if rate else "."
    text += " A search usually uses all iterations; that is not a failure."
    return Table("Trials", [columns[field][0] for field in fields], rows, text)


def _columns(summary: Mapping) -> dict[str, tuple[str, Callable[[Any], str]]]:
    """Head of the column of each field, and how its values are written; metrics.csv has more."""
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
        "promised_success_rate": ("promised success", "{:.1%}".format),
        "success_rate": ("success rate", percent),
        "own_success": ("own rollout", lambda success: "succeeded" if success else "failed"),
        "own_error": own_error,
        "cut_short": ("cut short", str),
        "horizon": ("searched up to (step)", say),
        "gp_seconds": ("model (s)", "{:.1f}".format),
        "search_seconds": ("search (s)", "{:.1f}".format),
        "stop_reason": ("search ended with", lambda reason: ENDS.get(reason, reason)),
    }


def _percents(shares: Mapping[str, float]) -> list[list[str]]:
    return [[name, percent(share)] for name, share in shares.items()]


def _flat(settings: Mapping, prefix: str = "") -> Iterator[list[str]]:
    """Name and value of each setting; a nested one has both names."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield [f"{prefix}{name}", say(value)]
