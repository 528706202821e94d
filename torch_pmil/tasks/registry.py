"""The experiments, by name."""

from __future__ import annotations

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.tasks.biorob import biorob
from torch_pmil.tasks.biorob_targets import biorob_targets
from torch_pmil.tasks.cart_pole import cart_pole
from torch_pmil.tasks.double_pendulum import double_pendulum
from torch_pmil.tasks.double_pendulum_servo import double_pendulum_servo
from torch_pmil.tasks.double_pendulum_targets import double_pendulum_targets
from torch_pmil.tasks.gym_pendulum import gym_pendulum
from torch_pmil.tasks.handwriting import handwriting, handwriting_name
from torch_pmil.tasks.inverted_pendulum import inverted_pendulum
from torch_pmil.tasks.one_motor import acrobot, pendubot
from torch_pmil.tasks.pilco import double_pendulum_pilco
from torch_pmil.tasks.task import Experiment

EXPERIMENTS = {
    "acrobot": acrobot,
    "biorob": biorob,
    "biorob_targets": biorob_targets,
    "cart_pole": cart_pole,
    "double_pendulum": double_pendulum,
    "double_pendulum_pilco": double_pendulum_pilco,
    "double_pendulum_servo": double_pendulum_servo,
    "double_pendulum_targets": double_pendulum_targets,
    "gym_pendulum": gym_pendulum,
    "handwriting": handwriting,
    "inverted_pendulum": inverted_pendulum,
    "pendubot": pendubot,
}


def load_experiment(
    name: str,
    demonstrations: Demonstrations | None = None,
    shape: str | None = None,
    robot: str | None = None,
) -> Experiment:
    """The experiment of that name.

    Args:
        name: as on the command line.
        demonstrations: one's own; those that come with the package if None.
        shape, robot: of handwriting, see :func:`handwriting`; None in all others.

    Raises:
        TypeError: the demonstrations are of another kind.
        ValueError: there is none; the message lists those there are. Or the demonstrations are not
            of that robot.
        ImportError: it needs another library.

    Example:
        >>> load_experiment("double_pendulum").horizon
        25
    """
    if demonstrations is not None and not isinstance(demonstrations, Demonstrations):
        raise TypeError(
            f"demonstrations must be Demonstrations, got {type(demonstrations).__name__}"
        )
    if not isinstance(name, str) or name not in EXPERIMENTS:
        raise ValueError(
            f"experiment must be one of {', '.join(sorted(EXPERIMENTS))}, got {name!r}"
        )
    if name == "handwriting":
        return handwriting(demonstrations, shape, robot)
    if shape is not None or robot is not None:
        raise ValueError(
            f"shape and robot are settings of experiment=handwriting, got shape={shape} and "
            f"robot={robot} for {name}"
        )
    return EXPERIMENTS[name](demonstrations)


def run_name(experiment: str, shape: str | None, robot: str | None) -> str:
    """Name of the folder of an experiment's runs.

    Example:
        >>> run_name("handwriting", "Angle", None), run_name("biorob", None, None)
        ('handwriting_Angle_double_pendulum', 'biorob')
    """
    return handwriting_name(shape, robot) if experiment == "handwriting" else experiment
