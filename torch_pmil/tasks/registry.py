"""The tasks that can be learned by name: those of the package, and those of a user's own module."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from inspect import signature
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from torch_pmil.demonstrations import Demonstrations, Recordings, load_demonstrations
from torch_pmil.files import short
from torch_pmil.tasks.strokes import lasa_strokes
from torch_pmil.tasks.task import Task


class Shipped(NamedTuple):
    """A task of the package: the module of torch_pmil.tasks whose function it is, and what it is.

    The sentence says what the robot learns.
    """

    module: str
    sentence: str


EXPERIMENTS = {
    name: Shipped(*about)
    for name, about in {
        "acrobot": ("one_motor", "Swing two links up with a motor in the elbow alone."),
        "biorob": ("biorob", "A compliant arm hits a ball, as it was guided by hand."),
        "biorob_targets": ("biorob_targets", "One policy of that arm hits balls in a plane."),
        "cart_pole": ("cart_pole", "Swing a pole up and balance it by pushing its cart."),
        "double_pendulum": ("double_pendulum", "Swing two links up by torques, and balance them."),
        "double_pendulum_pilco": ("pilco", "The same by PILCO's cost, without demonstrations."),
        "double_pendulum_servo": ("double_pendulum_servo", "The same by angles for two servos."),
        "double_pendulum_targets": (
            "double_pendulum_targets",
            "One policy moves the tip to places and holds it there.",
        ),
        "gym_pendulum": ("gym_pendulum", "Swing up Pendulum-v1, too weak to lift, and hold it."),
        "handwriting": ("handwriting", "The tip of a pendulum writes what a person wrote."),
        "handwriting_biorob": ("handwriting", "The racket of the compliant arm writes it."),
        "inverted_pendulum": ("inverted_pendulum", "Bring InvertedPendulum-v5 to rest."),
        "pendubot": ("one_motor", "Swing two links up with a motor in the shoulder alone."),
    }.items()
}
LASA = "lasa:"  # begins a source of demonstrations: a shape of the LASA handwriting set


def load_experiment(name: str, demonstrations: Demonstrations | Recordings | None = None) -> Task:
    """A task by name, with the settings by which it is learned.

    Args:
        name: one of the package; or ``mine.py:arm`` or ``package.module:arm`` for a function
            ``arm`` of your own, which returns a :class:`Task` and may take the demonstrations.
            Such a module is executed.
        demonstrations: your own; None for those that come with the task.

    Raises:
        TypeError: the demonstrations are of another kind.
        ValueError: there is no such task; the message lists those there are. Or the function takes
            or returns something else, or the demonstrations are not of that robot.
        OSError: the file cannot be read.
        ImportError: it needs another library.

    Example:
        >>> load_experiment("double_pendulum").horizon
        25
    """
    if not isinstance(demonstrations, Demonstrations | Recordings | None):
        raise TypeError(
            "demonstrations must be Demonstrations or Recordings, got "
            f"{type(demonstrations).__name__}"
        )
    make, given = _maker(name), () if demonstrations is None else (demonstrations,)
    taken = signature(make)
    try:
        taken.bind(*given)
    except TypeError as error:
        wanted = "take the demonstrations that are given" if given else "need no argument"
        raise ValueError(f"{name} must {wanted}, got a function of {taken}: {error}") from error
    task = make(*given)
    if not isinstance(task, Task):
        raise ValueError(f"{name} must return a Task, got {type(task).__name__}")
    return task


def is_own(name: str) -> bool:
    """Whether a name is that of a user's own task, whose module is executed."""
    return ":" in name


def demonstrations_from(source: str) -> Demonstrations | Recordings:
    """The demonstrations of a file or folder, or of ``lasa:SHAPE``.

    Raises:
        ValueError: there is no such shape, or the file is malformed.
        ImportError: the LASA set, or a library for the format, is missing.
        OSError: the file cannot be read.
    """
    if source.startswith(LASA):
        return lasa_strokes(source.removeprefix(LASA))
    return load_demonstrations(source)


def run_name(experiment: object, demonstrations: object) -> str:
    """Name of the folder of an experiment's runs, whatever the settings hold.

    Example:
        >>> run_name("handwriting", "lasa:Angle"), run_name("robots/mine.py:arm", None)
        ('handwriting_Angle', 'arm')
    """
    name = str(experiment).rpartition(":")[2]
    shape = str(demonstrations).partition(LASA)[2]
    return f"{name}_{shape}" if shape else name


def _maker(name: object) -> Callable[..., Any]:
    """The function that makes a task."""
    if isinstance(name, str) and name in EXPERIMENTS:
        return getattr(import_module(f"torch_pmil.tasks.{EXPERIMENTS[name].module}"), name)
    if not isinstance(name, str) or not is_own(name):
        raise ValueError(
            f"experiment must be one of {', '.join(EXPERIMENTS)}, or FILE.py:FUNCTION or "
            f"MODULE:FUNCTION of your own, got {short(name)}"
        )
    source, _, function = name.rpartition(":")
    make = getattr(module_of(source), function, None)
    if not callable(make):
        raise ValueError(f"{source} must have a function {function}, found none of that name")
    return make


def module_of(source: str) -> ModuleType:
    """The module of a file, or one of the working folder or of the installed packages.

    Others beside it can be imported by it.
    """
    if not source.endswith(".py"):
        with _importing_from(Path.cwd()):
            return import_module(source)
    path = Path(source)
    path.stat()  # raises if it is missing
    spec = spec_from_file_location(path.stem, path.absolute())
    assert spec is not None and spec.loader is not None  # true of any .py file
    module = module_from_spec(spec)
    with _importing_from(path.absolute().parent):
        spec.loader.exec_module(module)
    return module


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
