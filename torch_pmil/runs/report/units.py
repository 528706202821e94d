"""Units of the numbers in a run's summary."""

from __future__ import annotations

from collections.abc import Mapping

from torch_pmil.runs.settings import SETTINGS

# of what a summary's settings hold besides
DERIVED = {
    "horizon": "control steps",
    "exploration.random_action": SETTINGS["random_action"].unit,
    "exploration.around": "the units of the actions",
    "targets": "the unit of the entry",
}


def unit_of(setting: str, summary: Mapping) -> str:
    """Unit of a setting, "" where it has none or it is not known.

    Args:
        setting: its name, as ``"search.first_horizon"``.
        summary: of the run; says the units of what was demonstrated.

    Example:
        >>> units = {"objective": "nats", "demonstrations": {"x": "m", "y": "m"}}
        >>> names = ("search.first_horizon", "search.trust_threshold", "noise_std")
        >>> [unit_of(name, {"units": units}) for name in names]
        ['control steps', 'nats a step', 'm']
    """
    units = summary.get("units", {})
    if setting == "search.trust_threshold":
        return f"{units.get('objective') or 'objective'} a step"
    if setting == "noise_std":
        return ", ".join(dict.fromkeys(units.get("demonstrations", {}).values()))
    return SETTINGS[setting].unit if setting in SETTINGS else DERIVED.get(setting, "")
