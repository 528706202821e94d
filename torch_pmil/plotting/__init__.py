"""Figures of the results.

This is the only part of the package that imports matplotlib; it draws numbers and knows no
experiment.
"""

from matplotlib.figure import Figure

from torch_pmil.plotting.before_after import plot_before_after
from torch_pmil.plotting.calibration import plot_calibration
from torch_pmil.plotting.errors import plot_errors_over_data
from torch_pmil.plotting.frequencies import plot_frequencies
from torch_pmil.plotting.gaussian_process import plot_gp, plot_moment_matching
from torch_pmil.plotting.gp_slices import plot_gp_slices
from torch_pmil.plotting.heat_maps import plot_heat_map
from torch_pmil.plotting.kl_terms import plot_kl_per_step
from torch_pmil.plotting.pendulum import pendulum_frames, plot_poses
from torch_pmil.plotting.photos import plot_photo_series
from torch_pmil.plotting.policy import Plane, plot_policy
from torch_pmil.plotting.recordings import plot_recordings
from torch_pmil.plotting.strokes import plot_writing
from torch_pmil.plotting.style import BLUE, GREY, VERMILLION, save_figure, style
from torch_pmil.plotting.success import (
    plot_learning_curve,
    plot_success_of_methods,
    plot_success_over_experience,
    plot_success_over_mass,
    plot_success_over_settings,
)
from torch_pmil.plotting.trajectories import (
    plot_demonstrations,
    plot_distributions,
    plot_prediction,
)
from torch_pmil.plotting.variants import plot_variants

__all__ = [
    "BLUE",
    "GREY",
    "VERMILLION",
    "Figure",
    "Plane",
    "pendulum_frames",
    "plot_before_after",
    "plot_calibration",
    "plot_demonstrations",
    "plot_distributions",
    "plot_errors_over_data",
    "plot_frequencies",
    "plot_gp",
    "plot_gp_slices",
    "plot_heat_map",
    "plot_kl_per_step",
    "plot_learning_curve",
    "plot_moment_matching",
    "plot_photo_series",
    "plot_policy",
    "plot_poses",
    "plot_prediction",
    "plot_recordings",
    "plot_success_of_methods",
    "plot_success_over_experience",
    "plot_success_over_mass",
    "plot_success_over_settings",
    "plot_variants",
    "plot_writing",
    "save_figure",
    "style",
]
