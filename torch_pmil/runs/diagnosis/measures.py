"""Numbers by which a run that learned differs from one that did not, and their thresholds.

The thresholds were set on runs without a search on samples: they lay beyond what was measured of
any that learned, of which the comments give the nearest. ``python -m benchmarks.diagnosis`` gives
the share of today's runs that learned and lie beyond.
``executed`` rollouts are x_0..x_T, (N, T + 1, D), and ``predicted`` their marginals at t = 1..T,
mean (T, D).
"""

from __future__ import annotations

from torch import Tensor

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.calibration import within_two_sigma
from torch_pmil.search.policy_search import SearchSettings

LEARNED = 0.95  # success rate of a run that has nothing to explain: the paper's
COVERED = 0.75  # share of one-step errors within two standard deviations; learned: 0.81 and more
# share of executed entries within two predicted standard deviations; learned: 0.75 and more
FOLLOWED = 0.7
UNKNOWN = 0.2  # share of the executed steps at which the model knows little; learned: up to 0.04
LITTLE = 0.5  # posterior over prior standard deviation, from which on it knows little
# nats of an entry, up to which a step of the prediction matches
MATCHED = SearchSettings().trust_threshold
MISMATCH = 1.5  # largest loss of a step over what is right; learned: up to 1.31
NEAR_LIMIT = 0.95  # of half the range of an action, from its middle
SATURATED = 0.5  # share of the steps near the limit; learned: up to 0.38
MOVED = 0.25  # farthest from the start, over the demonstrated; learned: 0.77 and more
FEWEST_STEPS = 20  # for which a share is computed
RARE = 0.05  # probability below which failures are not due to chance
# nats by which the past explains a motion better; learned: up to 94, by hidden motors
# (benchmarks/past_evidence.py)
EVIDENCE = 100.0


def saturated_fraction(actions: Tensor, space: ActionSpace) -> Tensor:
    """Fraction (F,) of steps at which each action (N, T, F) is near an end of its range.

    Near means at a distance of at most 5 % of half the range.

    Example:
        >>> import torch
        >>> limits = torch.zeros(2), torch.tensor([3.5, 3.5])
        >>> space = ActionSpace.around(*limits, ("tau1", "tau2"), ("N·m", "N·m"))
        >>> saturated_fraction(torch.tensor([[[3.5, 0.0], [-3.4, 1.0]]]), space)
        tensor([1., 0.], dtype=torch.float64)
    """
    away = (actions - space.middle).abs()
    return (away >= NEAR_LIMIT * space.half_range).double().mean((0, 1))


def covered_fraction(residuals: Tensor) -> Tensor:
    """Share of standardised one-step errors (S, D) within two standard deviations, (D,)."""
    return (residuals.abs() <= 2).double().mean(0)


def first_departure(predicted: Gaussian, executed: Tensor) -> tuple[int, int] | None:
    """First step t, and entry, where most rollouts are beyond two predicted standard deviations.

    None if they never are.
    """
    inside = within_two_sigma(predicted, executed).mean(0)
    left = (inside < 0.5).any(-1).nonzero().flatten()
    if not len(left):
        return None
    return int(left[0]) + 1, int(inside[left[0]].argmin())


def first_mismatch(step_loss: Tensor, most: float) -> int | None:
    """First step t whose loss is above ``most``, if the loss of any step is far above it.

    Losses of the steps t = 1..T are (T,), in the unit of ``most``.

    Example:
        >>> import torch
        >>> first_mismatch(torch.tensor([0.1, 0.5, 4.0, 30.0]), most=3.0)
        3
    """
    if step_loss.amax() <= MISMATCH * most:
        return None
    return int((step_loss > most).nonzero()[0]) + 1


def moved_fraction(executed: Tensor, demonstrated: Tensor, noise_std: Tensor) -> float:
    """Distance of the robot from its start over that of the demonstrations.

    Both are trajectories in the match space, (N, T + 1, M). A distance is the median of their
    largest ones, in standard deviations of the observation noise, () or (M,).
    """
    moved, shown = (
        ((positions - positions[:, :1]) / noise_std).norm(dim=-1).amax(-1).median()
        for positions in (executed, demonstrated)
    )
    return (moved / shown).item()
