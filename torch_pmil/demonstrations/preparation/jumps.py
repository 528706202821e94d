"""Jumps in a recording, where a tracker followed a wrong point."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torch_pmil.demonstrations.preparation.alignment import AlignmentError, check_samples

# share of the samples; beyond it nobody knows which half is right
MOST_DROPPED = 0.5


def without_jumps(values: Tensor, times: Tensor, fastest: float | Tensor) -> tuple[Tensor, Tensor]:
    """Values (T', M) and times (T',) of samples that change no faster than ``fastest``.

    They are a longest chain of samples, each within that speed of the others. Single samples and
    stretches beside the track are left out, also at the start or the end. ``resample`` closes the
    gaps with its spline.

    Args:
        values: of one recording, (T, M).
        times: of the samples, increasing, in s, (T,).
        fastest: largest speed of each column, or one for all of them, per second; may be infinite.

    Raises:
        AlignmentError: a shape is wrong, a number is not finite, a speed is not positive, times do
            not increase, or fewer than half of the samples fit together.

    Example:
        >>> values, times = torch.tensor([[0.0], [0.5], [9.0], [1.5]]), torch.arange(4.0)
        >>> [part.flatten().tolist() for part in without_jumps(values, times, 2.0)]
        [[0.0, 0.5, 1.5], [0.0, 1.0, 3.0]]
    """
    limit = torch.as_tensor(fastest, dtype=torch.float64)
    check_samples(values, times, 1)
    if not (limit > 0).all():
        raise AlignmentError(f"fastest must be positive, got {limit.tolist()}")
    if limit.shape not in ((), values.shape[1:]):
        raise AlignmentError(f"fastest must be a number or (M,), got {tuple(limit.shape)}")
    kept = _longest_chain(values.double().numpy() / limit.numpy(), times.double().numpy())
    if len(kept) < MOST_DROPPED * len(times):
        raise AlignmentError(
            f"at least half of the {len(times)} samples must fit a motion of speed "
            f"{limit.tolist()}, got {len(kept)}"
        )
    return values[kept], times[kept]


def _longest_chain(places: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Indices of the longest chain of samples with a speed of at most 1 from each to the next."""
    length, before = np.ones(len(times), dtype=int), np.full(len(times), -1)
    for now in range(1, len(times)):
        distance = np.abs(places[now] - places[:now]).max(1)
        reached = distance <= (times[now] - times[:now]) * (1 + 1e-9)
        chains = np.where(reached, length[:now], 0)
        if reached.any():
            # of equally long chains, the one that ends last
            before[now] = now - 1 - int(chains[::-1].argmax())
            length[now] = chains.max() + 1
    chain = [int(length.argmax())]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return np.array(chain[::-1])
