"""The figures, which are imported on their first use."""

from .calibration import plot_calibration as plot_calibration
from .gp_slices import plot_gp_slices as plot_gp_slices
from .heat_maps import plot_heat_map as plot_heat_map
from .kl_terms import plot_kl_per_step as plot_kl_per_step
from .pendulum import (
    pendulum_frames as pendulum_frames,
    plot_poses as plot_poses,
)
from .policy import Plane as Plane, plot_policy as plot_policy
from .recordings import (
    plot_before_after as plot_before_after,
    plot_recordings as plot_recordings,
)
from .strokes import plot_writing as plot_writing
from .style import (
    BLUE as BLUE,
    GREY as GREY,
    VERMILLION as VERMILLION,
    Figure as Figure,
    save_figure as save_figure,
    save_picture as save_picture,
)
from .success import (
    plot_learning_curve as plot_learning_curve,
    plot_success_of_methods as plot_success_of_methods,
    plot_success_over_experience as plot_success_over_experience,
)
from .trajectories import (
    plot_demonstrations as plot_demonstrations,
    plot_distributions as plot_distributions,
    plot_prediction as plot_prediction,
)
