"""States of a robot that show what was observed of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from torch_pmil.control.state_space import MatchSpace

STAYING = 3e-4  # weight of an entry's change between samples, beside what the change shows


def rates_of(names: tuple[str, ...]) -> dict[int, int]:
    """Indices of velocities, named dNAME, with the indices of their positions NAME."""
    return {
        entry: names.index(name[1:])
        for entry, name in enumerate(names)
        if name[:1] == "d" and name[1:] in names
    }


def recover_states(
    match_space: MatchSpace,
    observed: Tensor,
    time_step: float,
    start: Tensor,
    rates: Mapping[int, int],
) -> Tensor:
    """States that show trajectories of the match space.

    Least squares solve for each sample from the one before, so that angles continue beyond a whole
    turn. An entry that is not shown is, if ``rates`` has it, the derivative of its position by
    central differences; otherwise it stays as it starts.

    Args:
        match_space: what is shown of a state.
        observed: trajectories (N, T + 1, M).
        time_step: between samples, s.
        start: near which the first states are sought, (D,).
        rates: indices of velocities, with the indices of their positions.

    Returns:
        (N, T + 1, D), float64.

    Example:
        >>> space = MatchSpace.of_links(("q",), (1.0,), state=("q", "dq"))
        >>> q = torch.linspace(0, 4, 41, dtype=torch.float64)
        >>> shown = torch.stack([q.sin(), q.cos()], -1)[None]
        >>> found = recover_states(space, shown, 0.1, torch.zeros(2), rates_of(("q", "dq")))
        >>> bool((found - torch.stack([q, torch.ones(41)], -1)).abs().max() < 1e-4)
        True
    """
    sizes = _sizes(match_space, observed)
    states = torch.stack([_solved(match_space, each, start.double(), *sizes) for each in observed])
    shown = _shown_entries(match_space)
    for rate, position in rates.items():
        if rate not in shown:
            states[..., rate] = torch.gradient(states[..., position], spacing=time_step, dim=-1)[0]
    return states


def without_turns(states: Tensor, start: Tensor, angles: Sequence[int]) -> Tensor:
    """Trajectories (N, T, D), moved by whole turns so that they begin near a start (D,).

    Otherwise trajectories a turn apart would have no mean, nor a servo the right target.

    Args:
        angles: indices of the entries that are angles, rad.

    Example:
        >>> turned = torch.tensor([[[-3.0, 0.0, 6.28, 0.0], [-2.5, 0.0, 7.28, 0.0]]])
        >>> start = torch.tensor([3.14, 0.0, 0.0, 0.0])
        >>> without_turns(turned, start, (0, 2)).round(decimals=2) + 0.0
        tensor([[[3.2800, 0.0000, 0.0000, 0.0000],
                 [3.7800, 0.0000, 1.0000, 0.0000]]])
    """
    turns = torch.zeros_like(states[:, :1])
    chosen = list(angles)
    turns[..., chosen] = ((states[:, :1] - start)[..., chosen] / (2 * math.pi)).round()
    return states - 2 * math.pi * turns


def _solved(
    match_space: MatchSpace, observed: Tensor, start: Tensor, shown: Tensor, changes: Tensor
) -> Tensor:
    """States (T + 1, D) that show one trajectory (T + 1, M); the last two are :func:`_sizes`."""
    states = []
    before = start
    for sample in observed:
        # the unknown is the change, which begins at zero: steps of the search are relative
        seen = partial(_residual, match_space, sample, before, shown, changes)
        slopes = partial(_slopes, match_space, before, shown, changes)
        found = least_squares(seen, np.zeros(len(start)), slopes, method="lm").x
        before = before + changes * torch.from_numpy(found)
        states.append(before)
    return torch.stack(states)


def _residual(
    match_space: MatchSpace,
    sample: Tensor,
    before: Tensor,
    shown: Tensor,
    changes: Tensor,
    change: np.ndarray,
) -> np.ndarray:
    """How far a changed state is from what was observed (M,), and how much it changed (D,)."""
    apart = match_space(before + changes * torch.from_numpy(change)) - sample
    return np.concatenate([(apart / shown).numpy(), STAYING * change])


def _slopes(
    match_space: MatchSpace, before: Tensor, shown: Tensor, changes: Tensor, change: np.ndarray
) -> np.ndarray:
    """Derivatives (M + D, D) of :func:`_residual` by the change."""
    of_angles, D = match_space.angles.double(), len(change)
    plain, sines, cosines = match_space.weights.double().tensor_split([D, D + len(of_angles)], -1)
    turned = of_angles @ (before + changes * torch.from_numpy(change))
    slopes = plain + (sines * turned.cos() - cosines * turned.sin()) @ of_angles
    return np.concatenate([(slopes * changes / shown[:, None]).numpy(), STAYING * np.eye(D)])


def _sizes(match_space: MatchSpace, observed: Tensor) -> tuple[Tensor, Tensor]:
    """Sizes of observed entries (M,) and of changes of the state (D,), whatever their units.

    An entry that shows angles is compared with its largest lever, another with its spread. A state
    changes by a radian, or by what changes an observed entry by its size.
    """
    D = match_space.angles.shape[-1]
    weights = match_space.weights.abs().double()
    flat = observed.flatten(0, -2)
    shown = torch.zeros(len(weights), dtype=torch.float64)
    for size in (weights[:, D:].sum(-1), flat.std(0), flat.abs().amax(0), torch.ones(())):
        shown = torch.where(shown > 0, shown, size)
    seen = (weights[:, :D] / shown[:, None]).amax(0)
    turned = match_space.angles.abs().double().sum(0)
    seen = torch.where(turned > 0, turned, seen)
    return shown, 1 / torch.where(seen > 0, seen, 1.0)


def _shown_entries(match_space: MatchSpace) -> set[int]:
    """Indices of the state's entries on which the observation depends."""
    D = match_space.angles.shape[-1]
    sizes = [D, *2 * [len(match_space.angles)]]
    plain, sines, cosines = match_space.weights.abs().sum(0).split(sizes)
    through_angles = (sines + cosines) @ match_space.angles.abs()
    return set((plain + through_angles).nonzero().flatten().tolist())
