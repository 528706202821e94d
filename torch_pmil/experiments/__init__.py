"""The experiments, by name."""

from __future__ import annotations

from torch_pmil.experiments.double_pendulum import double_pendulum
from torch_pmil.experiments.experiment import Experiment

EXPERIMENTS = {"double_pendulum": double_pendulum}


def load_experiment(name: str) -> Experiment:
    """The experiment of that name.

    Raises:
        ValueError: there is none; the message lists those there are.

    Example:
        >>> load_experiment("double_pendulum").horizon
        25
    """
    if name not in EXPERIMENTS:
        raise ValueError(f"experiment must be one of {', '.join(sorted(EXPERIMENTS))}, got {name!r}")
    return EXPERIMENTS[name]()
