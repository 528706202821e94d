"""Whether the parts of a task fit each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch_pmil.checks import check_noise, check_tensor, check_text
from torch_pmil.control.exploration import PDMovements
from torch_pmil.control.recovered_states import rates_of
from torch_pmil.demonstrations import DemonstrationError
from torch_pmil.files import short
from torch_pmil.model.experience import FEWEST_TRANSITIONS

if TYPE_CHECKING:
    from torch_pmil.tasks.task import Task


def check_task(task: Task) -> None:
    """Raise TypeError or ValueError unless the parts of a task fit each other."""
    D, method, settings = task.space.dim, task.method, task.method.policy
    _check_folder_name(task.name)
    for name in ("error", "predicted_error", "holding_actions", "sketch"):
        function = getattr(task, name)
        if not callable(function) and (function is not None or name == "error"):
            raise TypeError(f"{name} must be a function, got {type(function).__name__}")
    if outside := task.state_box and task.state_box.guard(task.initial.mean):
        raise ValueError(f"box must hold the mean of initial, but {outside}")
    check_noise(task.noise_std, task.space.match_space.names)
    check_tensor("demonstrated_states", task.demonstrated_states, ("S", D))
    if task.held_states is not None:
        check_tensor("held_states", task.held_states, ("S", D))
    if task.initial.dim != D:
        raise ValueError(
            f"initial must be over the {D} entries of the state, got {task.initial.dim}"
        )
    for name in ("input_widths", "least_widths"):
        if (widths := getattr(settings, name)) is not None:
            check_tensor(name, widths, (len(task.space.feature_names),))
    if method.model.velocities_alone and not rates_of(task.space.names):
        raise ValueError(
            "velocities_alone needs entries of the state that are velocities of others, dNAME "
            f"beside NAME, got {', '.join(task.space.names)}"
        )
    if isinstance(method.exploration, PDMovements):
        _check_movements(method.exploration, D)
        return
    if method.exploration.explore_demonstrated:
        _check_demonstrated_way(task)
    if task.horizon < FEWEST_TRANSITIONS:
        raise DemonstrationError(
            f"demonstrations must have {FEWEST_TRANSITIONS + 1} samples at least, since the robot "
            f"explores for as long and its model needs {FEWEST_TRANSITIONS} transitions, got "
            f"{task.horizon + 1}"
        )


def _check_movements(movements: PDMovements, dim: int) -> None:
    if movements.pose.shape != (dim,):
        raise ValueError(
            f"exploration.pose must be a state of {dim} entries, got {len(movements.pose)}"
        )
    transitions = movements.rollouts * movements.steps
    if transitions < FEWEST_TRANSITIONS:
        raise ValueError(
            "exploration.rollouts times exploration.steps must be at least "
            f"{FEWEST_TRANSITIONS}, got {transitions}"
        )


def _check_demonstrated_way(task: Task) -> None:
    """Raise ValueError unless it is known what holds the robot along the demonstrations."""
    count, samples = task.demonstrations.positions.shape[:2]
    if task.holding_actions is None:
        raise ValueError(
            "explore_demonstrated needs holding_actions, a function from states (S, D) to the "
            "actions (S, F) that hold the robot there, got none; if an action is the target of the "
            "first entry of the state: holding_actions=lambda states: states[:, :1]"
        )
    if (states := len(task.demonstrated_states)) != count * samples:
        raise ValueError(
            f"explore_demonstrated needs demonstrated_states of all {count} times {samples} "
            f"samples, got {states}"
        )


def _check_folder_name(name: object) -> None:
    """Raise ValueError unless a name is that of a folder within another."""
    check_text("name", name)
    parts = str(name).split("/")
    if "\\" in str(name) or {"", ".", ".."} & set(parts):
        raise ValueError(f"name must be that of a folder within the runs, got {short(name)}")
