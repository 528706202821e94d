"""Figures of the results.

This is the only part of the package that imports matplotlib; it draws numbers and knows no
experiment. Every name is imported when it is first asked for: who draws only at the end waits for
matplotlib only then.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure

    from torch_pmil.plotting.before_after import plot_before_after as plot_before_after
    from torch_pmil.plotting.calibration import plot_calibration as plot_calibration
    from torch_pmil.plotting.gaussian_process import (
        plot_gp as plot_gp,
        plot_moment_matching as plot_moment_matching,
    )
    from torch_pmil.plotting.gp_slices import plot_gp_slices as plot_gp_slices
    from torch_pmil.plotting.heat_maps import plot_heat_map as plot_heat_map
    from torch_pmil.plotting.kl_terms import plot_kl_per_step as plot_kl_per_step
    from torch_pmil.plotting.pendulum import (
        pendulum_frames as pendulum_frames,
        plot_poses as plot_poses,
    )
    from torch_pmil.plotting.photos import plot_photo_series as plot_photo_series
    from torch_pmil.plotting.policy import Plane as Plane, plot_policy as plot_policy
    from torch_pmil.plotting.recordings import plot_recordings as plot_recordings
    from torch_pmil.plotting.strokes import plot_writing as plot_writing
    from torch_pmil.plotting.style import (
        BLUE as BLUE,
        GREY as GREY,
        VERMILLION as VERMILLION,
        save_figure as save_figure,
    )
    from torch_pmil.plotting.success import (
        plot_learning_curve as plot_learning_curve,
        plot_success_of_methods as plot_success_of_methods,
        plot_success_over_experience as plot_success_over_experience,
        plot_success_over_mass as plot_success_over_mass,
        plot_success_over_settings as plot_success_over_settings,
    )
    from torch_pmil.plotting.trajectories import (
        plot_demonstrations as plot_demonstrations,
        plot_distributions as plot_distributions,
        plot_prediction as plot_prediction,
    )

MODULES = {
    "BLUE": "style",
    "GREY": "style",
    "Plane": "policy",
    "VERMILLION": "style",
    "pendulum_frames": "pendulum",
    "plot_before_after": "before_after",
    "plot_calibration": "calibration",
    "plot_demonstrations": "trajectories",
    "plot_distributions": "trajectories",
    "plot_gp": "gaussian_process",
    "plot_gp_slices": "gp_slices",
    "plot_heat_map": "heat_maps",
    "plot_kl_per_step": "kl_terms",
    "plot_learning_curve": "success",
    "plot_moment_matching": "gaussian_process",
    "plot_photo_series": "photos",
    "plot_policy": "policy",
    "plot_poses": "pendulum",
    "plot_prediction": "trajectories",
    "plot_recordings": "recordings",
    "plot_success_of_methods": "success",
    "plot_success_over_experience": "success",
    "plot_success_over_mass": "success",
    "plot_success_over_settings": "success",
    "plot_writing": "strokes",
    "save_figure": "style",
}
__all__ = ["Figure", *MODULES]


def __getattr__(name: str) -> Any:
    """Import a name on its first use."""
    if name not in __all__:
        raise AttributeError(f"module 'torch_pmil.plotting' has no attribute {name!r}")
    module = "matplotlib.figure" if name == "Figure" else f"torch_pmil.plotting.{MODULES[name]}"
    value = globals()[name] = getattr(import_module(module), name)
    return value


def __dir__() -> list[str]:
    """Names of the room, with those that were not asked for yet."""
    return sorted({*globals(), *__all__})
