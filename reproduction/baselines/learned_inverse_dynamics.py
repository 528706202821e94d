"""Tracking with learned inverse dynamics and a PD controller (Eq. 29).

States are [q1, dq1, q2, dq2, ...], rad and rad/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import FitResult

POSITION_GAIN = 0.5  # N·m/rad, K_p of Eq. 29
VELOCITY_GAIN = 0.25  # N·m s/rad, K_d
PILCO_SIGNAL_TO_NOISE = 500.0  # no moments of this model are matched, whose rounding would count


class InverseDynamics:
    r"""GPs of the torques, the inverse model of Eq. 29.

    .. math:: u_t = f_{\mathrm{inv}}(q_t, \dot q_t, q_{t+1}, \dot q_{t+1}, \ddot q_{t+1})

    The GPs are those of the forward model (Section 3.2) with the roles exchanged. Here too, sin and
    cos stand in place of each angle, and the next state is given by its difference from the present
    one: the same inputs as the paper's, but with x_{t+1} itself a GP of few data shares what
    depends on the pose, such as gravity, between two inputs that are nearly the same.

    Args:
        space: of the robot's states, two entries for each joint.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> names, units = ("q", "dq"), ("rad", "rad/s")
        >>> inverse = InverseDynamics(StateSpace(names, units, (), joint_match(names, units)))
        >>> states = torch.linspace(-1, 1, 10).double()[:, None].expand(10, 2)
        >>> rest = torch.zeros(10, 1).double()
        >>> result = inverse.fit(states, states, rest, states[:, :1])
        >>> torch.allclose(inverse(states, states, rest), states[:, :1], atol=0.02)
        True
    """

    def __init__(self, space: StateSpace) -> None:
        if space.dim % 2:
            raise ValueError(
                f"a state must hold a position and a velocity of each joint, got {space.names}"
            )
        self.space = space
        joints = space.dim // 2
        inputs = len(space.feature_names) + space.dim + joints
        self.gp = GPDynamics(inputs, joints, "successor", PILCO_SIGNAL_TO_NOISE)

    def fit(
        self, states: Tensor, next_states: Tensor, accelerations: Tensor, torques: Tensor
    ) -> FitResult:
        """Learn from all transitions so far; the hyper-parameters go on from the last ones.

        Args:
            states: x_t, (n, D).
            next_states: x_{t+1}, (n, D).
            accelerations: of the joints at t + 1, (n, D / 2), rad/s².
            torques: held from t to t + 1, (n, D / 2), N·m.

        Raises:
            ValueError: shapes do not fit, an entry is not finite, or fewer than two data.
        """
        return self.gp.fit(self._inputs(states, next_states, accelerations), torques)

    @torch.no_grad()
    def __call__(self, states: Tensor, next_states: Tensor, accelerations: Tensor) -> Tensor:
        """Mean torques (*batch, D / 2) that lead from states to next ones (*batch, D).

        Raises RuntimeError before any data.
        """
        return self.gp.expansion.mean(self._inputs(states, next_states, accelerations))

    def _inputs(self, states: Tensor, next_states: Tensor, accelerations: Tensor) -> Tensor:
        return torch.cat([self.space.features(states), next_states - states, accelerations], -1)


@dataclass(frozen=True, eq=False)
class Reference:
    """The motion to track, at the control steps and between them.

    Args:
        states: at every step of the feedback, (T * hold + 1, D).
        accelerations: of the joints at every control step, (T + 1, D / 2), rad/s².
    """

    states: Tensor
    accelerations: Tensor

    def __post_init__(self) -> None:
        (fine, dim), (coarse, joints) = self.states.shape, self.accelerations.shape
        if coarse < 2 or (fine - 1) % (coarse - 1) or dim != 2 * joints:
            raise ValueError(
                f"states must be (T * hold + 1, D) and accelerations (T + 1, D / 2), "
                f"got {tuple(self.states.shape)} and {tuple(self.accelerations.shape)}"
            )

    @property
    def hold(self) -> int:
        """Steps of the feedback in one control step."""
        return (len(self.states) - 1) // (len(self.accelerations) - 1)


class TrackingController:
    r"""Learned torques, held for a control step, and a PD controller around the reference (Eq. 29).

    .. math:: u = f_{\mathrm{inv}}(q_t, \dot q_t,
            q^{\exp}_{t+1}, \dot q^{\exp}_{t+1}, \ddot q^{\exp}_{t+1})
        + K_p (q^{\exp} - q) + K_d (\dot q^{\exp} - \dot q), \qquad K_p = 0.5 I, \quad K_d = 0.25 I

    Args:
        inverse: f_inv.
        reference: what to track.
        u_max: torque limits (F,), N·m.
    """

    def __init__(self, inverse: InverseDynamics, reference: Reference, u_max: Tensor) -> None:
        self.inverse, self.reference, self.u_max = inverse, reference, u_max
        self._feedforward = torch.zeros_like(u_max)

    def __call__(self, step: int, states: Tensor) -> Tensor:
        """Torques (*batch, F), N·m, in states (*batch, D) at a step of the feedback.

        Steps come one after the other from 0 on.
        """
        reference, hold = self.reference, self.reference.hold
        if step % hold == 0:
            target = reference.states[step + hold].expand_as(states)
            acceleration = reference.accelerations[step // hold + 1].expand(*states.shape[:-1], -1)
            self._feedforward = self.inverse(states, target, acceleration)
        error = reference.states[step] - states
        feedback = POSITION_GAIN * error[..., 0::2] + VELOCITY_GAIN * error[..., 1::2]
        return (self._feedforward + feedback).clamp(-self.u_max, self.u_max)


def accelerations_from_velocities(velocities: Tensor, time_step: float) -> Tensor:
    """Accelerations of one rollout: slopes of a cubic spline through velocities (T + 1, J), T >= 3.

    Example:
        >>> t = torch.linspace(0, 1, 11, dtype=torch.float64)[:, None]
        >>> torch.allclose(accelerations_from_velocities(t**3, time_step=0.1), 3 * t**2)
        True
    """
    times = time_step * np.arange(len(velocities))
    return torch.from_numpy(CubicSpline(times, velocities.numpy())(times, 1))
