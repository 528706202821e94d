r"""Velocities of a robot that measures positions alone.

The filter is the critically damped g-h filter, also called fading-memory filter (E. Brookner,
Tracking and Kalman Filtering Made Easy, Wiley 1998, Sec. 1.2.6). It fits a motion of constant
velocity to the positions; a reading that is k readings old has weight :math:`\theta^k`.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_pmil.checks import check_positive
from torch_pmil.envs.physical.physical_robot import Numbers, PhysicalRobot
from torch_pmil.envs.physical.robot_checks import check_robot, finite_vector

ANEW = 1.0  # s by which an earlier stamp means another clock, and not a late message


class VelocityFilter:
    r"""Velocities from positions, by a fading memory of ``time_constant`` seconds.

    With dt seconds since the last reading z and :math:`\theta = e^{-dt / \tau}`,

    .. math:: r = z - (q + \dot q\, dt), \qquad
        q \leftarrow z - \theta^2 r, \qquad
        \dot q \leftarrow \dot q + \frac{(1 - \theta)^2}{dt}\, r .

    A constant velocity is estimated exactly. With readings dt apart, the velocity at a constant
    acceleration is :math:`\frac{dt}{2} \frac{1 + 3 \theta}{1 - \theta}` seconds late
    (:meth:`delay`), and the noise of the positions is amplified by
    :math:`\frac{\sqrt 2}{dt} \left(\frac{1 - \theta}{1 + \theta}\right)^{3/2}`
    (:meth:`noise_gain`). Without memory, velocities are finite differences.

    Args:
        time_constant: τ in s; 0 for no memory.

    Raises:
        ValueError: the time constant is negative or not finite.

    Example:
        >>> smooth = VelocityFilter(0.1)
        >>> for step in range(100):
        ...     velocity = smooth.update(torch.tensor([2.0 * 0.02 * step]), stamp=0.02 * step)
        >>> velocity
        tensor([2.0000], dtype=torch.float64)
    """

    def __init__(self, time_constant: float) -> None:
        self.time_constant = check_positive("time_constant", time_constant, zero=True)
        self._stamp: float | None = None
        self._q = self._dq = torch.zeros(0, dtype=torch.float64)

    def update(self, positions: Numbers, stamp: float) -> Tensor:
        """Velocities (J,), per second, after a reading; zero at the first one.

        Args:
            positions: z, (J,).
            stamp: time of the reading in s. A repeated or earlier one changes nothing. If it is
                more than a second earlier, the clock was restarted, and so is the filter.

        Raises:
            ValueError: an argument is not finite, or the number of positions has changed.
        """
        z = finite_vector("positions", positions, None if self._stamp is None else len(self._q))
        if not math.isfinite(stamp):
            raise ValueError(f"stamp must be a finite number of seconds, got {stamp}")
        if self._stamp is None or stamp < self._stamp - ANEW:
            self._stamp, self._q, self._dq = stamp, z.clone(), torch.zeros_like(z)
        dt = stamp - self._stamp
        if dt > 0:
            theta = self._theta(dt)
            r = z - (self._q + self._dq * dt)
            self._q = z - theta**2 * r
            self._dq = self._dq + (1 - theta) ** 2 / dt * r
            self._stamp = stamp
        return self._dq.clone()

    def delay(self, period: float) -> float:
        """Seconds by which velocities are late at a constant acceleration.

        Example:
            >>> VelocityFilter(0.0).delay(0.1)
            0.05
        """
        period = check_positive("period", period)
        theta = self._theta(period)
        return period / 2 * (1 + 3 * theta) / (1 - theta)

    def noise_gain(self, period: float) -> float:
        """Standard deviation of the velocities over that of the positions, in 1/s.

        Example:
            >>> round(VelocityFilter(0.0).noise_gain(0.1), 3)
            14.142
        """
        period = check_positive("period", period)
        theta = self._theta(period)
        return math.sqrt(2) / period * ((1 - theta) / (1 + theta)) ** 1.5

    def _theta(self, dt: float) -> float:
        return math.exp(-dt / self.time_constant) if self.time_constant else 0.0


class WithVelocities:
    """Adds velocities to a robot that reads positions (J,), so that its state is (2J,).

    The filter gets one reading in a control period. It forgets during the operator's pause between
    two rollouts.

    Args:
        robot: its ``read_state`` gives positions.
        velocity_filter: estimates the velocities.
        positions_first: whether the state is ``[q1, q2, ..., dq1, dq2, ...]`` instead of ``[q1,
            dq1, q2, dq2, ...]``.
    """

    def __init__(
        self, robot: PhysicalRobot, velocity_filter: VelocityFilter, positions_first: bool = False
    ) -> None:
        check_robot(robot)
        self._robot, self._filter, self._positions_first = robot, velocity_filter, positions_first

    def read_state(self) -> tuple[Tensor, float]:
        """State (2J,) and its time stamp."""
        positions, stamp = self._robot.read_state()
        dq = self._filter.update(positions, stamp)
        pairs = torch.stack([finite_vector("positions", positions), dq], dim=-1)
        return (pairs.T if self._positions_first else pairs).flatten(), stamp

    def send(self, action: Numbers) -> Numbers | None:
        """Send an action."""
        return self._robot.send(action)

    def stop(self) -> None:
        """Stop the robot."""
        self._robot.stop()
