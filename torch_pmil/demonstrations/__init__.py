"""Demonstrations: observed trajectories, without actions, loaded, checked and saved."""

from torch_pmil.demonstrations.dataset import Demonstrations
from torch_pmil.demonstrations.errors import DemonstrationError
from torch_pmil.demonstrations.loading import (
    load_demonstrations,
    load_recordings,
    shipped_demonstrations,
)
from torch_pmil.demonstrations.recordings import Recordings

__all__ = [
    "DemonstrationError",
    "Demonstrations",
    "Recordings",
    "load_demonstrations",
    "load_recordings",
    "shipped_demonstrations",
]
