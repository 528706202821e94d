"""Recorded demonstrations of any length, sampled at any times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torch_pmil.demonstrations.clock import clock, holes, on_ticks
from torch_pmil.demonstrations.dataset import Demonstrations, real_numbers
from torch_pmil.demonstrations.errors import DemonstrationError, check_names

ALIGN = "pmil align"


@dataclass(frozen=True, eq=False)
class Recordings:
    """Recorded demonstrations of any length, sampled at any times.

    Attributes:
        labels: number or name of each of the N demonstrations.
        times: of the samples of each, increasing, in s, (T_n,), float64.
        values: observations of each, (T_n, M), float64.
        names: of the M observed entries.
        targets: target of each, (N, K), float64, or None.
        target_names: of the K entries of a target.
        units: of the M entries, if known.
        format: of the file.
        places: name of each sample in messages, such as "row 3"; by default its number.
        in_seconds: whether the unit of the times is certain. Otherwise times that are implausible
            for a robot's control period are refused.

    Raises:
        DemonstrationError: there is no demonstration or entry, a shape is wrong, a name occurs
            twice, a number is not finite, or a time does not increase.

    Example:
        >>> time = torch.arange(3, dtype=torch.float64)
        >>> values = (time[:, None], time[:, None])
        >>> Recordings(("1", "2"), (0.1 * time, 0.2 * time), values, ("x",)).durations
        [0.2, 0.4]
    """

    labels: tuple[str, ...]
    times: tuple[Tensor, ...]
    values: tuple[Tensor, ...]
    names: tuple[str, ...]
    targets: Tensor | None = None
    target_names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    format: str = ""
    places: tuple[tuple[str, ...], ...] = ()
    in_seconds: bool = False

    def __post_init__(self) -> None:
        for name in ("labels", "names", "target_names"):
            object.__setattr__(self, name, tuple(map(str, getattr(self, name))))
        for name in ("times", "values"):
            each = tuple(real_numbers(name, one) for one in getattr(self, name))
            object.__setattr__(self, name, each)
        if self.targets is not None:
            object.__setattr__(self, "targets", real_numbers("targets", self.targets))
        self._check_shapes()
        for demonstration, (times, values) in enumerate(zip(self.times, self.values, strict=True)):
            self._check_numbers(demonstration, times, values)

    def _check_shapes(self) -> None:
        entries = len(self.names)
        if not (self.labels and entries):
            raise DemonstrationError(
                f"a recording must hold demonstrations and entries, got {len(self.labels)} and "
                f"{entries}"
            )
        counts = len(self.labels), len(self.times), len(self.values)
        if len(set(counts)) > 1:
            raise DemonstrationError(
                "labels, times and values must be as many, one for each demonstration, got "
                f"{counts[0]}, {counts[1]} and {counts[2]}"
            )
        check_names(self.names, self.values[0].shape[1] if self.values[0].ndim == 2 else entries)
        for label, times, values in zip(self.labels, self.times, self.values, strict=True):
            if times.ndim != 1 or values.shape != (len(times), entries) or not len(times):
                raise DemonstrationError(
                    f"demonstration {label} must hold {entries} entries at each of at least one "
                    f"time, got {tuple(values.shape)} at {times.numel()} times"
                )

    def _check_numbers(self, demonstration: int, times: Tensor, values: Tensor) -> None:
        for sample in (~times.isfinite()).nonzero().flatten().tolist()[:1]:
            where, found = self.place(demonstration, sample), times[sample].item()
            raise DemonstrationError(f"{where}, time must be a finite number, got {found}")
        for sample, entry in (~values.isfinite()).nonzero()[:1].tolist():
            name, number = self.names[entry], values[sample, entry].item()
            raise DemonstrationError(
                f"{self.place(demonstration, sample)}, {name} must be a finite number, got {number}"
            )
        for sample in (~(times.diff() > 0)).nonzero().flatten().tolist()[:1]:
            before, after = times[sample : sample + 2].tolist()
            raise DemonstrationError(
                f"{self.place(demonstration, sample + 1)}, time must increase, got {after} s "
                f"after {before} s"
            )

    @property
    def durations(self) -> list[float]:
        """Duration of each demonstration from its first to its last sample, in s."""
        return [(times[-1] - times[0]).item() for times in self.times]

    def place(self, demonstration: int, sample: int) -> str:
        """Name of a sample in messages."""
        if self.places:
            return self.places[demonstration][sample]
        return f"demonstration {self.labels[demonstration]}, sample {sample}"

    def holes(self) -> list[str]:
        """Stretches without samples, a line each."""
        return [
            f"demonstration {label} has no samples from {begin - times[0]:.4g} to "
            f"{end - times[0]:.4g} s: this hole of {end - begin:.3g} s is filled by a guess; "
            "record it again, or leave it out"
            for label, times in zip(self.labels, self.times, strict=True)
            for begin, end in holes(times)
        ]

    def demonstrations(self) -> Demonstrations:
        """The recordings as demonstrations.

        Raises DemonstrationError unless they have one length and one time step, and there are two
        at least (of each target).
        """
        if len(self.labels) < 2:
            raise DemonstrationError(
                f"at least two demonstrations are needed, got {len(self.labels)}"
            )
        self._check_lengths()
        times = torch.stack(self.times)  # (N, T+1)
        self._check_steps(float(np.median([clock(one).step for one in times])))
        time_step = ((times[:, -1] - times[:, 0]).mean() / (times.shape[1] - 1)).item()
        return Demonstrations(
            torch.stack(self.values), time_step, self.names, self.targets, self.target_names
        )

    def _check_lengths(self) -> None:
        first = len(self.times[0])
        if first < 2:
            raise DemonstrationError(
                f"demonstration {self.labels[0]} must have at least two samples, got {first}"
            )
        for label, times in zip(self.labels, self.times, strict=True):
            if len(times) != first:
                raise DemonstrationError(
                    f"demonstration {label} must have {first} samples like demonstration "
                    f"{self.labels[0]}, got {len(times)}; {ALIGN} makes them one length"
                )

    def _check_steps(self, expected: float) -> None:
        for demonstration, times in enumerate(self.times):
            if on_ticks(times, expected):
                continue
            steps = times.diff()
            step = int((steps - expected).abs().argmax())
            raise DemonstrationError(
                f"{self.place(demonstration, step + 1)}, time must follow the sample before it by "
                f"{expected:.9g} s, got {steps[step].item():.9g} s; {ALIGN} makes steps one length"
            )
