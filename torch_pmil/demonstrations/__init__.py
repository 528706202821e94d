"""Demonstrations: observed trajectories, without actions. Load them from what people and robots
recorded, check, save.
"""

from torch_pmil.demonstrations.dataset import Demonstrations
from torch_pmil.demonstrations.errors import DemonstrationError
from torch_pmil.demonstrations.loading import load_demonstrations, load_recordings
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.demonstrations.shipped import shipped_demonstrations

__all__ = [
    "DemonstrationError",
    "Demonstrations",
    "Recordings",
    "load_demonstrations",
    "load_recordings",
    "shipped_demonstrations",
]
