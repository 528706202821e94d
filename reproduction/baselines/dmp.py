r"""Dynamic movement primitives: a motion as a spring-damper that a learned force shapes.

====================  =====================================================
Ijspeert et al. 2013  here
====================  =====================================================
tau                   ``duration`` (s); time in units of it is ``time``
alpha, beta           ``STIFFNESS``, ``STIFFNESS / 4`` (critically damped)
x, alpha_x            ``_phase``, ``PHASE_DECAY``
w                     ``weights`` (K, D)
g, y_0                ``goal``, ``start`` (D,)
====================  =====================================================

Source: A. J. Ijspeert, J. Nakanishi, H. Hoffmann, P. Pastor, S. Schaal (2013), Dynamical movement
primitives, Neural Computation 25. The force is not scaled by g - y_0, which is zero where a joint
ends as it began.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.polynomial.legendre import leggauss
from scipy.interpolate import CubicSpline
from torch import Tensor

STIFFNESS = 25.0
PHASE_DECAY = -math.log(0.01)  # the phase falls from 1 to 0.01
OVERLAP = 0.8  # of a basis function, at the centre of the next one
SAMPLES = 10  # of a demonstration's spline, in each of its time steps
PANELS = 16  # of the quadrature, for each duration
NODES = 16  # of Gauss and Legendre, in each panel


@dataclass(frozen=True, eq=False)
class DMP:
    r"""A motion of D joints as a dynamic movement primitive.

    .. math:: \tau^2 \ddot y = \alpha \left(\tfrac{\alpha}{4} (g - y) - \tau \dot y\right)
        + f(t / \tau), \qquad
        f = x \frac{\sum_k w_k \psi_k(x)}{\sum_k \psi_k(x)}, \quad x = e^{-\alpha_x t / \tau}

    It ends at the goal whatever the weights are, since the phase x takes the force away. Another
    duration, start or goal (``dataclasses.replace``) stretches the motion in time or draws it
    there.

    Args:
        start: y at t = 0, (D,), rad.
        start_rate: tau dy/dt there, (D,), rad: the velocity in units of the duration.
        goal: g, (D,), rad.
        weights: (K, D), with K >= 2.
        duration: tau, s.

    Example:
        >>> t = torch.linspace(0, 1, 21, dtype=torch.float64)
        >>> dmp = DMP.from_demonstrations(t.cos().expand(1, 1, -1).mT, time_step=0.05, num_basis=20)
        >>> y, dy, ddy = dmp(t)
        >>> bool((y[:, 0] - t.cos()).abs().max() < 1e-3), ddy.shape
        (True, torch.Size([21, 1]))
    """

    start: Tensor
    start_rate: Tensor
    goal: Tensor
    weights: Tensor
    duration: float

    def __post_init__(self) -> None:
        shape = tuple(self.goal.shape)
        others = (self.start.shape, self.start_rate.shape, self.weights.shape[1:])
        if len(shape) != 1 or any(tuple(other) != shape for other in others):
            raise ValueError(
                "start, start_rate and goal must be (D,) and weights (K, D), got "
                f"{tuple(self.start.shape)}, {tuple(self.start_rate.shape)}, {shape} and "
                f"{tuple(self.weights.shape)}"
            )
        if len(self.weights) < 2:
            raise ValueError(
                f"weights must be of at least two basis functions, got {len(self.weights)}"
            )
        if not (math.isfinite(self.duration) and self.duration > 0):
            raise ValueError(
                f"duration must be positive and finite, in seconds, got {self.duration}"
            )

    @classmethod
    def from_demonstrations(cls, positions: Tensor, time_step: float, num_basis: int) -> DMP:
        """Learn from demonstrated joint positions, by least squares of the force that they need.

        Velocities and accelerations are those of a cubic spline. Start and goal are the mean ones;
        where several demonstrations differ, the motion is their mean.

        Args:
            positions: (N, T + 1, D), rad, without jumps of 2 pi; the first sample at t = 0.
            time_step: s.
            num_basis: K.

        Raises:
            ValueError: fewer than four samples (a cubic spline needs them), a number that is not
                finite, or fewer than two basis functions.
        """
        enough = positions.ndim == 3 and positions.shape[0] >= 1 and positions.shape[1] >= 4
        if not (enough and positions.isfinite().all()):
            raise ValueError(
                "positions must be finite, (N, T + 1, D) with at least four samples, got "
                f"{tuple(positions.shape)}"
            )
        if num_basis < 2:
            raise ValueError(f"num_basis must be at least 2, got {num_basis}")
        steps = positions.shape[1] - 1
        values = positions.detach().cpu().double().numpy()
        spline = CubicSpline(np.linspace(0, 1, steps + 1), values, axis=1)
        time = torch.linspace(0, 1, steps * SAMPLES + 1, dtype=torch.float64)
        y, rate, curvature = (torch.from_numpy(spline(time.numpy(), order)) for order in range(3))
        goal = y[:, -1:]
        force = curvature - STIFFNESS * (STIFFNESS / 4 * (goal - y) - rate)
        return cls(
            start=y[:, 0].mean(0),
            start_rate=rate[:, 0].mean(0),
            goal=goal[:, 0].mean(0),
            weights=torch.linalg.lstsq(_basis(time, num_basis), force.mean(0)).solution,
            duration=steps * time_step,
        )

    def __call__(self, times: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        r"""Position (S, D, rad), velocity (rad/s) and acceleration (rad/s²) at times (S,) in s.

        Times are from 0 on, in any order.

        With u = t / tau, lambda = alpha / 2 and the force f, the solution is closed but for a
        quadrature:

        .. math:: y = g + (d + c u) e^{-\lambda u} + \int_0^u r e^{-\lambda r} f(u - r)\, dr,
            \qquad d = y_0 - g, \quad c = \tau \dot y_0 + \lambda d

        Raises:
            ValueError: times are no vector, none, negative or not finite.
        """
        if times.ndim != 1 or len(times) == 0 or not times.isfinite().all() or (times < 0).any():
            raise ValueError(
                f"times must be a vector of finite seconds from 0 on, got {times.tolist()}"
            )
        time = times.double()[:, None] / self.duration  # (S, 1)
        decay = STIFFNESS / 2
        offset = self.start - self.goal
        slope = self.start_rate + decay * offset
        nodes, node_weights = _quadrature(PANELS * math.ceil(max(time.max().item(), 1)))
        lag = time * nodes  # r, (S, n)
        shares = time * node_weights * torch.exp(-decay * lag)  # (S, n)
        force = self._force(time - lag) * shares[..., None]  # (S, n, D)
        free = torch.exp(-decay * time)
        y = self.goal + (offset + slope * time) * free + (lag[..., None] * force).sum(1)
        forced_rate = ((1 - decay * lag)[..., None] * force).sum(1)
        rate = (slope - decay * (offset + slope * time)) * free + forced_rate
        curvature = STIFFNESS * (STIFFNESS / 4 * (self.goal - y) - rate) + self._force(time[:, 0])
        return y, rate / self.duration, curvature / self.duration**2

    def _force(self, time: Tensor) -> Tensor:
        """The force (*batch, D) at times (*batch) in units of the duration."""
        return _basis(time, len(self.weights)) @ self.weights


def _quadrature(panels: int) -> tuple[Tensor, Tensor]:
    """Nodes and weights (n,) of an integral from 0 to 1."""
    nodes, weights = (torch.from_numpy(array) for array in leggauss(NODES))
    nodes = torch.arange(panels, dtype=torch.float64)[:, None] + (nodes + 1) / 2
    return nodes.flatten() / panels, weights.repeat(panels) / (2 * panels)


def _phase(time: Tensor) -> Tensor:
    return torch.exp(-PHASE_DECAY * time)


def _basis(time: Tensor, count: int) -> Tensor:
    """Normalised Gaussians in the phase, times the phase, (*batch, K).

    Their centres are equally spaced in time.
    """
    centres = _phase(torch.linspace(0, 1, count, dtype=torch.float64))
    gaps = centres.diff().square()
    phase = _phase(time)[..., None]
    exponents = math.log(OVERLAP) * (phase - centres).square() / torch.cat([gaps, gaps[-1:]])
    return phase * torch.softmax(exponents, -1)
