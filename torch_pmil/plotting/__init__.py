"""Figures of the results.

No other part of the package imports matplotlib. The functions here draw numbers and know no
experiment. Each name is imported when it is first used, so that matplotlib is loaded only then.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure

    from torch_pmil.plotting.calibration import plot_calibration as plot_calibration
    from torch_pmil.plotting.gaussian_process import (
        plot_gp as plot_gp,
        plot_gp_slices as plot_gp_slices,
        plot_moment_matching as plot_moment_matching,
    )
    from torch_pmil.plotting.heat_maps import plot_heat_map as plot_heat_map
    from torch_pmil.plotting.kl_terms import plot_kl_per_step as plot_kl_per_step
    from torch_pmil.plotting.pendulum import (
        pendulum_frames as pendulum_frames,
        plot_poses as plot_poses,
    )
    from torch_pmil.plotting.photos import plot_photo_series as plot_photo_series
    from torch_pmil.plotting.policy import Plane as Plane, plot_policy as plot_policy
    from torch_pmil.plotting.recordings import (
        plot_before_after as plot_before_after,
        plot_recordings as plot_recordings,
    )
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
    )
    from torch_pmil.plotting.trajectories import (
        plot_demonstrations as plot_demonstrations,
        plot_distributions as plot_distributions,
        plot_prediction as plot_prediction,
    )

NAMES = {  # of each module
    "calibration": ("plot_calibration",),
    "gaussian_process": ("plot_gp", "plot_gp_slices", "plot_moment_matching"),
    "heat_maps": ("plot_heat_map",),
    "kl_terms": ("plot_kl_per_step",),
    "pendulum": ("pendulum_frames", "plot_poses"),
    "photos": ("plot_photo_series",),
    "policy": ("Plane", "plot_policy"),
    "recordings": ("plot_before_after", "plot_recordings"),
    "strokes": ("plot_writing",),
    "style": ("BLUE", "GREY", "VERMILLION", "save_figure"),
    "success": ("plot_learning_curve", "plot_success_of_methods", "plot_success_over_experience"),
    "trajectories": ("plot_demonstrations", "plot_distributions", "plot_prediction"),
}
MODULES = {name: module for module, names in NAMES.items() for name in names}
__all__ = ["Figure", *MODULES]


def __getattr__(name: str) -> Any:
    """Import a name on its first use."""
    if name not in __all__:
        raise AttributeError(f"module 'torch_pmil.plotting' has no attribute {name!r}")
    module = "matplotlib.figure" if name == "Figure" else f"torch_pmil.plotting.{MODULES[name]}"
    value = globals()[name] = getattr(import_module(module), name)
    return value


def __dir__() -> list[str]:
    """Names of the room, with those that are not imported yet."""
    return sorted({*globals(), *__all__})
