"""Parts of a task that must fit each other."""

from __future__ import annotations

from torch import Tensor

from torch_pmil.checks import check_text
from torch_pmil.control.exploration import PDMovements
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.files import short
from torch_pmil.model.experience import FEWEST_TRANSITIONS


def check_movements(movements: PDMovements, dim: int) -> None:
    """Raise ValueError unless movements fit a state of that many entries and are long enough."""
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


def check_demonstrated_way(
    demonstrations: Demonstrations | None, holding_actions: object, demonstrated_states: Tensor
) -> None:
    """Raise ValueError unless it is known what holds the robot along the demonstrations."""
    if demonstrations is None:
        raise ValueError("explore_demonstrated needs demonstrations, got a cost in their place")
    count, samples = demonstrations.positions.shape[:2]
    if holding_actions is None:
        raise ValueError(
            "explore_demonstrated needs holding_actions, a function from states (S, D) to the "
            "actions (S, F) that hold the robot there, got none; if an action is the target of the "
            "first entry of the state: holding_actions=lambda states: states[:, :1]"
        )
    if (states := len(demonstrated_states)) != count * samples:
        raise ValueError(
            f"explore_demonstrated needs demonstrated_states of all {count} times {samples} "
            f"samples, got {states}"
        )


def check_folder_name(name: object) -> None:
    """Raise ValueError unless a name is that of a folder within another."""
    check_text("name", name)
    parts = str(name).split("/")
    if "\\" in str(name) or {"", ".", ".."} & set(parts):
        raise ValueError(f"name must be that of a folder within the runs, got {short(name)}")
