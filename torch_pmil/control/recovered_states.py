"""States of a robot that show what was observed of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torch_pmil.control.state_space import MatchSpace

STAYING = 3e-4  # weight of an entry's change between samples, beside what the change shows
DAMPING = 1e-3  # of the first step
FOUND, MOST_STEPS = 1e-10, 100  # last step of a search, in sizes of changes, and their number


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
    sizes, before, found = _sizes(match_space, observed), start.double(), []
    for sample in observed.unbind(1):
        before = before + _change(match_space, sample, before.expand(len(sample), -1), *sizes)
        found.append(before)
    states = torch.stack(found, 1)
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


def _change(
    match_space: MatchSpace, sample: Tensor, before: Tensor, shown: Tensor, sizes: Tensor
) -> Tensor:
    """Changes (N, D) of states (N, D) after which they show samples (N, M); see :func:`_sizes`.

    By the method of Levenberg and Marquardt, for all trajectories at once. The unknown is the
    change divided by its size, beginning at zero, so that steps of the search are relative.
    """
    change, each = torch.zeros_like(before), torch.eye(before.shape[-1], dtype=torch.float64)
    damping = torch.full((len(before), 1, 1), DAMPING, dtype=torch.float64)

    def linearised(change: Tensor) -> tuple[Tensor, Tensor]:
        """How far (N, M + D, 1) a state is from the sample and how much it changed; its slopes."""
        state = before + sizes * change
        apart = torch.cat([(match_space(state) - sample) / shown, STAYING * change], -1)
        slopes = match_space.slopes(state) * sizes / shown[:, None]
        return apart[..., None], torch.cat(
            [slopes, (STAYING * each).expand(len(state), -1, -1)], -2
        )

    apart, slopes = linearised(change)
    for _ in range(MOST_STEPS):
        curvature = slopes.mT @ slopes + damping * each
        step = torch.linalg.solve(curvature, -slopes.mT @ apart)
        then, then_slopes = linearised(change + step[..., 0])
        better = then.square().sum(-2, keepdim=True) <= apart.square().sum(-2, keepdim=True)
        change = torch.where(better[..., 0], change + step[..., 0], change)
        apart, slopes = torch.where(better, then, apart), torch.where(better, then_slopes, slopes)
        damping = torch.where(better, damping / 10, damping * 10)
        if step.abs().max() < FOUND:
            break
    return sizes * change


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
