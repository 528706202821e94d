"""Units of the numbers in a run's summary."""

from __future__ import annotations

from collections.abc import Mapping

OF_EACH_FEATURE, OF_EACH_ENTRY = "that of each feature", "that of each entry of the state"
# of each setting by its name, those within another setting too; what is yes or no has none
SETTINGS = {
    "trials": "trials",
    "horizon": "steps",
    "num_centres": "basis functions",
    "random_torque": "of the torque limit",
    "rollouts": "rollouts",
    "steps": "steps",
    "hold": "steps",
    "pose": OF_EACH_ENTRY,
    "reach": OF_EACH_ENTRY,
    "gain": "N·m/rad, N·m·s/rad",
    "initial_weight_std": "rad",
    "input_scale": "standard deviations",
    "input_widths": OF_EACH_FEATURE,
    "least_widths": OF_EACH_FEATURE,
    "tolerance": "that of the own error",
    "confirmations": "own rollouts",
    "mean_iterations": "iterations",
    "stage_iterations": "iterations",
    "final_iterations": "iterations",
    "first_horizon": "steps",
    "horizon_step": "steps",
    "restarts": "searches",
    "target": "that of each demonstrated entry",
    "targets": "that of the demonstrations",
    "target_scale": "largest distances of targets",
    "cost_width": "that of the target",
    "velocity_std": "rad/s",
    "velocity_limit": "rad/s",
}


def with_unit(name: str, unit: str | None) -> str:
    """A name with its unit, if that is known and not 1.

    Example:
        >>> with_unit("x", "m"), with_unit("cost", ""), with_unit("x", None)
        ('x (m)', 'cost', 'x')
    """
    return f"{name} ({unit})" if unit else name


def unit_of(setting: str, summary: Mapping) -> str:
    """Unit of a setting, "" where it has none or it is not known.

    Args:
        setting: its name, as ``"search.first_horizon"``.
        summary: of the run; says the units of what was demonstrated.

    Example:
        >>> units = {"objective": "nats", "demonstrations": {"x": "m", "y": "m"}}
        >>> names = ("search.first_horizon", "search.trust_threshold", "noise_std")
        >>> [unit_of(name, {"units": units}) for name in names]
        ['steps', 'nats a step', 'm']
    """
    units, name = summary.get("units", {}), setting.rpartition(".")[-1]
    if name == "trust_threshold":
        return f"{units.get('objective') or 'objective'} a step"
    if name == "noise_std":
        return ", ".join(dict.fromkeys(units.get("demonstrations", {}).values()))
    return SETTINGS.get(name, "")
