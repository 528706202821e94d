r"""Limits of a robot's motion, and the probability that a predicted motion leaves them.

Each finite limit b of an entry z of the state or of the match space leaves a margin, z - b below
and b - z above, which is negative outside. Under a Gaussian marginal with standard deviation
:math:`\sigma_t` the limit is kept with probability :math:`\Phi(m_t / \sigma_t)`, where :math:`m_t`
is the margin of the mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.nn.functional import pad

from torch_pmil.checks import check_positive
from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.gp.gaussian import Gaussian


@dataclass(frozen=True, eq=False)
class StateBox:
    r"""A box in which a robot's motion shall stay: limits of entries that are named.

    The entries are those of the state, as joint angles and speeds, and those of the match space, as
    the position of the tip. The box is no guarantee: what is predicted are Gaussian approximations
    under a learned model, and what is watched are the states at the ends of control periods. It
    does not take the place of an emergency stop, nor of limits in the robot's own controller.

    Args:
        space: the robot's state space.
        limits: lowest and highest value of each limited entry, in its unit; -inf and inf for none.
        threshold: predicted probability of leaving up to which a rollout is admitted.

    Raises:
        ValueError: there is no such entry, or no finite limit, or a lowest value is not below the
            highest one, or the threshold is not between 0 and 1.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> names, units = ("q", "dq"), ("rad", "rad/s")
        >>> space = StateSpace(names, units, (0,), joint_match(names, units))
        >>> box = StateBox(space, {"dq": (-10.0, 10.0)})
        >>> box.guard(torch.tensor([[0.0, 1.0], [0.0, 12.3]]))
        'dq = 12.3 rad/s left its limits of -10 to 10 rad/s'
        >>> certain = Gaussian(torch.tensor([[0.0, 1.0]]), 1e-9 * torch.eye(2)[None])
        >>> box.leaving_probability(certain)
        tensor(0.)
    """

    space: StateSpace
    limits: Mapping[str, tuple[float, float]]
    threshold: float = 0.05

    def __post_init__(self) -> None:
        known = self._names
        for name, (low, high) in self.limits.items():
            if name not in known:
                raise ValueError(f"limits must be of {', '.join(known)}, got {name}")
            if not low < high:
                raise ValueError(f"limits of {name} must be low < high, got {low} and {high}")
        if not self._bounds.isfinite().any():
            raise ValueError(f"limits must hold a finite number, got {dict(self.limits)}")
        check_positive("threshold", self.threshold)
        if self.threshold >= 1:
            raise ValueError(f"threshold must be below 1, got {self.threshold}")

    @property
    def settings(self) -> dict[str, object]:
        """The limits by name, null where there is none, and the threshold, as JSON has them."""
        finite = {
            name: [bound if abs(bound) < torch.inf else None for bound in bounds]
            for name, bounds in self.limits.items()
        }
        return {"limits": finite, "threshold": self.threshold}

    def guard(self, states: Tensor) -> str:
        """Why states (*batch, D) are outside, in one line; "" if all are within."""
        margins = self.margins(states).reshape(-1, len(self._sides))
        outside = (margins < 0).nonzero()
        if not len(outside):
            return ""
        state, side = outside[0].tolist()
        entry = self._entries[side]
        value = self._limited(states.reshape(-1, self.space.dim)[state])[entry].item()
        name, unit = self._limited.names[entry], self._limited.units[entry]
        low, high = self._bounds[entry].tolist()
        return f"{name} = {value:.3g} {unit} left its limits of {low:g} to {high:g} {unit}"

    def margins(self, states: Tensor) -> Tensor:
        """Distances of states (*batch, D) from all limits, negative outside: (*batch, limits)."""
        return self._margins(self._limited(states))

    def leaving_by_step(self, states: Gaussian) -> Tensor:
        r"""Bound on the probability that a state is outside, step by step (Boole's inequality).

        .. math:: p_t \le \min\left(1, \sum_b \Phi(-m_{tb} / \sigma_{tb})\right)

        It is exact where one entry alone is limited.

        Args:
            states: predicted marginals, mean (*batch, T, D).

        Returns:
            (*batch, T).
        """
        return torch.special.ndtr(-self._standardised(states)).sum(-1).clamp(max=1)

    def leaving_probability(self, states: Gaussian) -> Tensor:
        r"""Bound on the probability that a rollout leaves the box at any of its steps.

        It is the sum of :meth:`leaving_by_step`, at most 1 (Boole's inequality). The bound is that
        of the predicted marginals, which are Gaussian approximations: it is no guarantee.

        Args:
            states: predicted marginals at t = 1..T, mean (*batch, T, D).

        Returns:
            (*batch).
        """
        return self.leaving_by_step(states).sum(-1).clamp(max=1)

    def penalty(self, states: Gaussian, weight: float = 1.0) -> Tensor:
        r"""Penalty of predicted states that may leave, in nats, smooth and steep far outside.

        .. math:: -w \sum_b \log \Phi(m_{tb} / \sigma_{tb})

        Args:
            states: predicted marginals, mean (*batch, T, D).
            weight: w.

        Returns:
            (*batch, T).
        """
        return -weight * torch.special.log_ndtr(self._standardised(states)).sum(-1)

    def _standardised(self, states: Gaussian) -> Tensor:
        """Margins of the means in standard deviations, (*batch, limits)."""
        limited = self._limited.moments(states)
        variance = limited.cov.diagonal(dim1=-2, dim2=-1)
        std = variance.clamp(min=torch.finfo(variance.dtype).tiny).sqrt()
        return self._margins(limited.mean) / std[..., self._entries]

    def _margins(self, values: Tensor) -> Tensor:
        bounds = self._bounds.to(values)[self._entries, self._sides]
        return (2 * self._sides - 1) * (bounds - values[..., self._entries])

    @property
    def _names(self) -> tuple[str, ...]:
        """Names of all entries that can be limited: of the state, then of the match space."""
        state, match_space = self.space.names, self.space.match_space
        return (*state, *(name for name in match_space.names if name not in state))

    @cached_property
    def _bounds(self) -> Tensor:
        """Lowest and highest values of the limited entries, (K, 2)."""
        return torch.tensor(list(self.limits.values()), dtype=torch.float64).reshape(-1, 2)

    @cached_property
    def _entries(self) -> Tensor:
        """Limited entry of each finite limit."""
        return self._bounds.isfinite().nonzero()[:, 0]

    @cached_property
    def _sides(self) -> Tensor:
        """Side of each finite limit: 0 below, 1 above."""
        return self._bounds.isfinite().nonzero()[:, 1]

    @cached_property
    def _limited(self) -> MatchSpace:
        """The space of the K limited entries."""
        space, match_space = self.space, self.space.match_space
        sines = match_space.weights.shape[-1] - space.dim
        units = dict(zip(match_space.names, match_space.units, strict=True))
        rows = dict(zip(match_space.names, match_space.weights.double(), strict=True))
        units |= zip(space.names, space.units, strict=True)
        rows |= zip(
            space.names, pad(torch.eye(space.dim, dtype=torch.float64), (0, sines)), strict=True
        )
        return MatchSpace(
            tuple(self.limits),
            tuple(units[name] for name in self.limits),
            match_space.angles,
            torch.stack([rows[name] for name in self.limits]),
        )
