"""Demonstrations of one length and one time step, for training."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np
import torch
from torch import Tensor

from torch_pmil.demonstrations.errors import DemonstrationError, check_names
from torch_pmil.files import replacing

TIME_STEP_TOLERANCE = 1e-3  # relative difference between two time steps that count as equal


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """N demonstrations of one task, sampled at the same times from 0 on.

    Attributes:
        positions: observations, (N, T+1, M), float64; for the double pendulum [x1, y1, x2, y2] in
            m.
        time_step: seconds between two samples.
        names: names of the M observed coordinates.
        targets: target of each demonstration, (N, K), float64, such as the place of the ball; None
            if they have no targets.
        target_names: names of the K entries of a target.

    Raises:
        DemonstrationError: a shape is wrong, there are fewer than two demonstrations (of each
            target) or samples, a number is not finite, or the time step is not positive.

    Example:
        >>> Demonstrations(torch.zeros(2, 26, 1), time_step=0.1, names=("x",)).duration
        2.5
    """

    positions: Tensor  # (N, T+1, M)
    time_step: float
    names: tuple[str, ...]
    targets: Tensor | None = None  # (N, K)
    target_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", real_numbers("positions", self.positions))
        for names in ("names", "target_names"):
            object.__setattr__(self, names, tuple(map(str, getattr(self, names))))
        self._check_shapes()
        if not (isinstance(self.time_step, SupportsFloat) and 0 < float(self.time_step) < math.inf):
            raise DemonstrationError(
                f"time_step must be positive and finite, in seconds, got {self.time_step!r}"
            )
        object.__setattr__(self, "time_step", float(self.time_step))
        for demonstration, step, column in (~self.positions.isfinite()).nonzero()[:1].tolist():
            number, name = self.positions[demonstration, step, column].item(), self.names[column]
            raise DemonstrationError(
                f"positions must be finite, got {number} in demonstration {demonstration}, step "
                f"{step}, column {name}"
            )
        if self.targets is not None:
            object.__setattr__(self, "targets", real_numbers("targets", self.targets))
            self._check_targets(self.targets)
        elif self.target_names:
            raise DemonstrationError(
                f"target_names must come with targets, got {self.target_names} alone"
            )

    def _check_targets(self, targets: Tensor) -> None:
        N, shape = len(self.positions), tuple(targets.shape)
        if len(shape) != 2 or shape[0] != N or shape[1] < 1:
            raise DemonstrationError(
                f"targets must have shape ({N}, entries), one for each demonstration, got {shape}"
            )
        check_names(self.target_names, shape[1], "target_names", "entry")
        for demonstration, entry in (~targets.isfinite()).nonzero()[:1].tolist():
            number = targets[demonstration, entry].item()
            raise DemonstrationError(
                f"targets must be finite, got {number} of demonstration {demonstration}"
            )
        for target, count in zip(*targets.unique(dim=0, return_counts=True), strict=True):
            if count < 2:
                raise DemonstrationError(
                    f"each target must have at least two demonstrations, got one of "
                    f"{target.tolist()}"
                )

    def by_target(self) -> tuple[Tensor, tuple[Demonstrations, ...]]:
        """The S different targets (S, K), in order of appearance, and the set of each.

        Raises DemonstrationError if there are no targets.

        Example:
            >>> two = torch.tensor([[0.0], [0.0], [1.0], [1.0]])
            >>> shown = Demonstrations(torch.zeros(4, 26, 1), 0.1, ("x",), two, ("place",))
            >>> targets, sets = shown.by_target()
            >>> targets.tolist(), sets[1].positions.shape
            ([[0.0], [1.0]], torch.Size([2, 26, 1]))
        """
        if self.targets is None:
            raise DemonstrationError("demonstrations must have targets, got none")
        in_order = list(dict.fromkeys(map(tuple, self.targets.tolist())))
        distinct = torch.tensor(in_order, dtype=torch.float64)
        of_target = [self.positions[(self.targets == target).all(-1)] for target in distinct]
        sets = tuple(Demonstrations(shown, self.time_step, self.names) for shown in of_target)
        return distinct, sets

    def in_order(self, names: tuple[str, ...]) -> Demonstrations:
        """The demonstrations with their columns in the order of these names.

        Raises DemonstrationError, with a command that helps, if the columns have other names.

        Example:
            >>> shown = Demonstrations(torch.tensor([[[1.0, 2.0]] * 2] * 2), 0.1, ("x", "y"))
            >>> shown.in_order(("y", "x")).positions[0, 0]
            tensor([2., 1.], dtype=torch.float64)
        """
        if set(self.names) != set(names):
            raise DemonstrationError(
                f"demonstrations must be of {', '.join(names)}, got {', '.join(self.names)}"
                f"{self._renaming(names)}"
            )
        columns = [self.names.index(name) for name in names]
        return replace(self, positions=self.positions[..., columns], names=names)

    def _renaming(self, names: tuple[str, ...]) -> str:
        """The command that gives the columns those names, if there are enough of them."""
        if set(self.names) > set(names):
            return f"; pmil align RECORDED OUT.npz --keys {' '.join(names)} leaves out the others"
        if len(self.names) == len(names):
            return f"; pmil align RECORDED OUT.npz --names {' '.join(names)} renames them"
        return ""

    def _check_shapes(self) -> None:
        shape = tuple(self.positions.shape)
        if len(shape) != 3:
            raise DemonstrationError(
                f"positions must have shape (demonstrations, steps, columns), got {shape}"
            )
        for things, count in zip(("demonstrations", "steps"), shape[:2], strict=True):
            if count < 2:
                raise DemonstrationError(f"positions must hold at least two {things}, got {count}")
        check_names(self.names, shape[2])

    @property
    def duration(self) -> float:
        """Time of the last sample in seconds; the first is at 0."""
        return self.time_step * (self.positions.shape[1] - 1)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an NPZ file, replacing an existing one, wholly or not at all.

        It holds positions, time_step, names, and targets and target_names if there are any. Raises
        OSError if the folder is missing or not writable.
        """
        arrays: dict[str, Any] = {
            "positions": self.positions.numpy(),
            "time_step": np.array(self.time_step),
            "names": np.array(self.names),
        }
        if self.targets is not None:
            arrays |= {"targets": self.targets.numpy(), "target_names": np.array(self.target_names)}
        with replacing(Path(path)) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)


def real_numbers(name: str, values: object) -> Tensor:
    """Values as a float64 tensor; raises DemonstrationError unless they are real numbers."""
    try:
        tensor = torch.as_tensor(values)
    except (TypeError, ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        raise DemonstrationError(f"{name} must be an array of numbers, got {reason}") from error
    if tensor.is_complex():
        raise DemonstrationError(f"{name} must hold real numbers, got {tensor.dtype}")
    return tensor.to(torch.float64)
