r"""Two ways of doing a task in one set of demonstrations, whose mean (Eq. 10) nobody showed.

Whole trajectories are split in two along their direction of largest spread. The test statistic is
the ratio R of the squared scatter within the two parts to that of all, along that direction. For
Gaussian trajectories of any covariance the scores along it, scaled to unit norm, are those of a
one-dimensional sample (the rows' distribution does not change under rotations, Langsrud 2005), so R
has one distribution for each N. R is compared with that of a uniform sample, the flattest unimodal
one (Hartigan and Hartigan 1985), by simulation. It lies lower at every N, so warnings are rarer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

SIMULATIONS = 50_000  # samples of the null distribution, for few trajectories
FEWEST_SIMULATIONS = 1000  # for many
DRAWS = 2_000_000  # numbers in all the samples, unless they are the fewest


@dataclass(frozen=True)
class Split:
    """The best split of N trajectories in two.

    Attributes:
        parts: numbers of the trajectories of each part, increasing; number 0 is in the first one.
        p_value: probability of a split as clear or clearer in a uniform sample of the same size.
        explained: share of all squared scatter that the difference of the parts makes up.
    """

    parts: tuple[tuple[int, ...], tuple[int, ...]]
    p_value: float
    explained: float


def split_in_two(trajectories: Tensor) -> Split | None:
    """The best split of trajectories in two, and how surprising it is.

    Args:
        trajectories: aligned, (N, ...), all entries in comparable units.

    Returns:
        None for fewer than three trajectories, or if all are the same.

    Example:
        >>> left, right = -torch.ones(4, 10), torch.ones(4, 10)
        >>> noise = 0.1 * torch.randn(8, 10, generator=torch.Generator().manual_seed(0))
        >>> split = split_in_two(torch.cat([left, right]) + noise)
        >>> split.parts, split.p_value < 0.001, split.explained > 0.9
        (((0, 1, 2, 3), (4, 5, 6, 7)), True, True)
    """
    deviation = trajectories.double().flatten(1) - trajectories.double().flatten(1).mean(0)
    scatter = deviation.square().sum().item()
    if len(deviation) < 3 or scatter == 0:
        return None
    scores = torch.linalg.svd(deviation, full_matrices=False)[0][:, 0].numpy()
    ratio, cut = (found.item() for found in _scatter_within(np.sort(scores)[None]))
    order = scores.argsort()
    first, second = sorted((sorted(order[: cut + 1].tolist()), sorted(order[cut + 1 :].tolist())))
    parts = [deviation[first], deviation[second]]
    within = sum((part - part.mean(0)).square().sum().item() for part in parts)
    p_value = (_uniform_ratios(len(scores)) <= ratio).mean().item()
    return Split((tuple(first), tuple(second)), p_value, 1 - within / scatter)


def _scatter_within(scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least scatter within two parts of sorted scores (S, N) over the total, (S,), and the cut.

    The cut is the index of the last score of the first part, (S,).
    """
    centred = scores - scores.mean(1, keepdims=True)
    count = np.arange(1, scores.shape[1])
    # sums of the first parts; those of the second parts are their negatives
    left = centred.cumsum(1)[:, :-1]
    between = left**2 * (1 / count + 1 / count[::-1])
    return 1 - between.max(1) / (centred**2).sum(1), between.argmax(1)


@cache
def _uniform_ratios(count: int) -> np.ndarray:
    simulations = min(SIMULATIONS, max(FEWEST_SIMULATIONS, DRAWS // count))
    samples = np.random.default_rng(0).uniform(size=(simulations, count))
    ratios, _ = _scatter_within(np.sort(samples, 1))
    return ratios
