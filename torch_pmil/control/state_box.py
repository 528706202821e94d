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
from torch_pmil.files import short
from torch_pmil.gp.gaussian import Gaussian


@dataclass(frozen=True, eq=False)
class StateBox:
    r"""Limits of named entries of the state (joint angles, speeds) or match space (a tip's place).

    The box is not a guarantee: predictions are Gaussian approximations under a learned model, and
    states are watched at the ends of control periods only. It replaces neither an emergency stop
    nor limits in the robot's own controller.

    Args:
        space: the robot's state space.
        limits: lowest and highest value of each limited entry, in its unit; -inf and inf for none.
        threshold: predicted probability of leaving up to which a rollout is admitted.

    Raises:
        ValueError: there is no such entry, no finite limit, or numbers are out of range.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> names, units = ("q", "dq"), ("rad", "rad/s")
        >>> space = StateSpace(names, units, (0,), joint_match(names, units))
        >>> box = StateBox(space, {"dq": (-10.0, 10.0)})
        >>> box.guard(torch.tensor([[0.0, 1.0], [0.0, 12.3]]))
        'dq = 12.3 rad/s left its limits of -10 to 10 rad/s'
    """

    space: StateSpace
    limits: Mapping[str, tuple[float, float]]
    threshold: float = 0.05

    def __post_init__(self) -> None:
        known = dict.fromkeys((*self.space.names, *self.space.match_space.names))
        for name, bounds in self.limits.items():
            if name not in known:
                raise ValueError(f"limits must be of {', '.join(known)}, got {name}")
            _check_bounds(name, bounds)
        if not len(self._finite[1]):
            raise ValueError(f"limits must hold a finite number, got {dict(self.limits)}")
        object.__setattr__(self, "threshold", check_positive("threshold", self.threshold))
        if self.threshold >= 1:
            raise ValueError(f"threshold must be below 1, got {self.threshold}")

    @property
    def settings(self) -> dict[str, object]:
        """The limits by name, with None for infinite ones, and the threshold."""
        finite = {
            name: [bound if abs(bound) < torch.inf else None for bound in bounds]
            for name, bounds in self.limits.items()
        }
        return {"limits": finite, "threshold": self.threshold}

    def guard(self, states: Tensor) -> str:
        """Why states (*batch, D) are outside, in one line; "" if all are within."""
        bounds, entries, _ = self._finite
        margins = self.margins(states).reshape(-1, len(entries))
        outside = (margins < 0).nonzero()
        if not len(outside):
            return ""
        state, side = outside[0].tolist()
        entry = entries[side]
        value = self._limited(states.reshape(-1, self.space.dim)[state])[entry].item()
        name, unit = self._limited.names[entry], self._limited.units[entry]
        low, high = bounds[entry].tolist()
        of_unit = f" {unit}" if unit else ""
        return f"{name} = {value:.3g}{of_unit} left its limits of {low:g} to {high:g}{of_unit}"

    def margins(self, states: Tensor) -> Tensor:
        """Distances of states (*batch, D) from all limits, negative outside: (*batch, limits)."""
        return self._margins(self._limited(states))

    def leaving_by_step(self, states: Gaussian) -> Tensor:
        r"""Bound on the probability that a state is outside, step by step (Boole's inequality).

        .. math:: p_t \le \min\left(1, \sum_b \Phi(-m_{tb} / \sigma_{tb})\right)

        It is exact where one limit is finite. ``states`` are predicted marginals, mean (*batch, T,
        D); the bound is (*batch, T).
        """
        return torch.special.ndtr(-self._standardised(states)).sum(-1).clamp(max=1)

    def penalty(self, states: Gaussian, weight: float = 1.0) -> Tensor:
        r"""Penalty (*batch, T) of states that may leave, in nats, smooth and steep far outside.

        .. math:: -w \sum_b \log \Phi(m_{tb} / \sigma_{tb})
        """
        return -weight * torch.special.log_ndtr(self._standardised(states)).sum(-1)

    def _standardised(self, states: Gaussian) -> Tensor:
        """Margins of the means in standard deviations, (*batch, limits)."""
        limited = self._limited.moments(states)
        variance = limited.cov.diagonal(dim1=-2, dim2=-1)
        std = variance.clamp(min=torch.finfo(variance.dtype).tiny).sqrt()
        return self._margins(limited.mean) / std[..., self._finite[1]]

    def _margins(self, values: Tensor) -> Tensor:
        bounds, entries, sides = self._finite
        return (2 * sides - 1) * (bounds.to(values)[entries, sides] - values[..., entries])

    @cached_property
    def _finite(self) -> tuple[Tensor, Tensor, Tensor]:
        """All bounds (K, 2), and entry and side (0 below, 1 above) of each finite one."""
        bounds = torch.tensor(list(self.limits.values()), dtype=torch.float64).reshape(-1, 2)
        entries, sides = bounds.isfinite().nonzero().unbind(-1)
        return bounds, entries, sides

    @cached_property
    def _limited(self) -> MatchSpace:
        """The space of the K limited entries."""
        space, match_space = self.space, self.space.match_space
        sines = match_space.weights.shape[-1] - space.dim
        units = dict(zip(match_space.names, match_space.units, strict=True))
        rows = dict(zip(match_space.names, match_space.weights.double(), strict=True))
        own = pad(torch.eye(space.dim, dtype=torch.float64), (0, sines))
        units |= zip(space.names, space.units, strict=True)
        rows |= zip(space.names, own, strict=True)
        return MatchSpace(
            tuple(self.limits),
            tuple(units[name] for name in self.limits),
            match_space.angles,
            torch.stack([rows[name] for name in self.limits]),
        )


def _check_bounds(name: str, bounds: object) -> None:
    """Raise ValueError unless these are two numbers, the lower one first."""
    try:
        low, high = torch.as_tensor(bounds, dtype=torch.float64)
        rising = bool(low < high)
    except (TypeError, ValueError, RuntimeError):
        rising = False
    if not rising:
        raise ValueError(f"limits of {name} must be two numbers, low < high, got {short(bounds)}")
