"""Forces that a motion takes, by inverse dynamics of a MuJoCo model."""

from __future__ import annotations

import mujoco
import numpy as np
import scipy
import torch
from torch import Tensor

from torch_pmil.envs.actuators import actions_for, actuator_units, answer_at_rest, force_limits
from torch_pmil.envs.robot import Array, RobotEnv

MOMENTS = 5  # of a control period, at which inverse dynamics are averaged


class ModelledRobot(RobotEnv):
    """A robot with a MuJoCo model, which determines the forces of its actuators."""

    model: mujoco.MjModel
    _actuators: dict[str, int]  # numbers of those that are actions, by the names of the actions
    _joints: tuple[str, ...]
    _state_columns: Tensor

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the actuators in the model that are actions.

        Example:
            >>> from torch_pmil.envs import DoublePendulumEnv
            >>> env = DoublePendulumEnv()
            >>> env.action_names, env.action_units
            (('tau1', 'tau2'), ('N·m', 'N·m'))
        """
        return tuple(self._actuators)

    @property
    def action_units(self) -> tuple[str, ...]:
        """Units of the actions; "" for an actuator that is neither a motor nor a servo."""
        units = actuator_units(self.model)
        return tuple(units[number] for number in self._actuators.values())

    @property
    def torque_limits(self) -> Tensor:
        """Largest torques or forces (F,) of motors and servos; infinite without a limit."""
        return torch.from_numpy(force_limits(self.model)[list(self._actuators.values())])

    def holding_actions(self, states: Tensor) -> Tensor:
        """Actions (S, F) that hold the joints against gravity where they are in states (S, D).

        The action of a position servo lies a little beyond the joint, because the difference is
        what pulls. Actions may lie beyond their range.

        Raises:
            ValueError: a joint has no actuator of its own, or is not in the state.

        Example:
            >>> from torch_pmil.envs import DoublePendulumServoEnv
            >>> env = DoublePendulumServoEnv()
            >>> env.holding_actions(torch.tensor([[3.0, 0.0, 0.0, 0.0]]).double()).round(decimals=2)
            tensor([[ 2.9300, -0.0200]], dtype=torch.float64)
        """
        positions = states[:, self._position_entries].numpy()
        still = np.zeros_like(positions)
        moved, torques = self._moved_joints, self._inverse_dynamics(positions, still, still)
        if moved is None or torques is None:
            raise ValueError(
                "a robot that is to be held must have an actuator at each joint, and all joints in "
                f"its state, got the joints {', '.join(self._joints)} and the actuators "
                f"{', '.join(self.action_names)}"
            )
        return torch.from_numpy(actions_for(self.model, torques, positions[:, moved]))

    def needed_torques(self, states: Tensor) -> Tensor | None:
        """Torques along a cubic spline through the positions, without regard to limits.

        The samples must resolve the motion. On swing-ups of the double pendulum the error is 5 % of
        the limit (rms). Spline and torques are wrong where a joint turns by a radian or more from
        sample to sample.

        Args:
            states: x_0..x_T at the control rate, (T + 1, D), T >= 2.

        Returns:
            Mean over each control period, (T, F), N·m. None if a joint has no actuator of its own
            or is not in the state.
        """
        times = self.control_period * np.arange(len(states))
        motion = scipy.interpolate.CubicSpline(times, states[:, self._position_entries].numpy())
        moments = self.control_period * (np.arange(MOMENTS) + 0.5) / MOMENTS
        between = (times[:-1, None] + moments).ravel()
        torques = self._inverse_dynamics(motion(between), motion(between, 1), motion(between, 2))
        if torques is None:
            return None
        return torch.from_numpy(torques.reshape(len(times) - 1, MOMENTS, -1).mean(1))

    def beyond_range(self, states: Tensor) -> Tensor:
        """Distance of the joints beyond their stops, rad or m: (*batch, J) of states (*batch, D).

        It is 0 within the stops.
        """
        low, high = self._stops
        positions = states[..., self._position_entries]
        return torch.maximum(positions - high, low - positions).clamp_min(0)

    @property
    def _stops(self) -> tuple[Tensor, Tensor]:
        """Lowest and highest positions of the joints, (J,) each; infinite without stops."""
        joints = [self.model.joint(name) for name in self._joints]
        unlimited = (-np.inf, np.inf)
        stops = np.array([joint.range if joint.limited[0] else unlimited for joint in joints])
        low, high = torch.from_numpy(stops).unbind(-1)
        return low, high

    @property
    def _position_entries(self) -> Tensor:
        """Entries of the state vector that are positions, in the order of the joints, (J,)."""
        return (self._state_columns <= self.model.nq).nonzero().flatten()

    @property
    def _moved_joints(self) -> list[int] | None:
        """The joint of the state that each actuator moves, if each joint has its own actuator."""
        model, ids = self.model, [self.model.joint(name).id for name in self._joints]
        by_joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT).all()
        moved = model.actuator_trnid[:, 0].tolist()
        known = answer_at_rest(model) and len(self._actuators) == model.nu
        if not (known and by_joint) or sorted(moved) != sorted(ids) or model.nv != len(ids):
            return None
        return [ids.index(joint) for joint in moved]

    def _inverse_dynamics(
        self, positions: Array, velocities: Array, accelerations: Array
    ) -> Array | None:
        """Torques (S, F) of a motion of the joints (S, J), or None if actuators move others."""
        moved = self._moved_joints
        if moved is None:
            return None
        dofs = [self.model.joint(name).dofadr[0] for name in self._joints]
        order = np.argsort(dofs)  # that of the model
        motion = positions[:, order], velocities[:, order], accelerations[:, order]
        return inverse_dynamics(self.model, *motion)[:, dofs][:, moved]


def inverse_dynamics(
    model: mujoco.MjModel, positions: Array, velocities: Array, accelerations: Array
) -> Array:
    """Generalised forces (S, V) of a motion (S, V) of a model with hinges and slides alone.

    The V joints are in the model's order. Limits of the actuators are ignored.
    """
    data, forces = mujoco.MjData(model), np.empty((len(positions), model.nv))
    for row, parts in enumerate(zip(positions, velocities, accelerations, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = parts
        mujoco.mj_inverse(model, data)
        forces[row] = data.qfrc_inverse
    return forces


def tracking_torques(model: mujoco.MjModel, states: Tensor, accelerations: Tensor) -> Tensor:
    """Torques (S, F), N·m, that give a robot these accelerations, without regard to limits.

    Args:
        model: of a robot with one motor for each joint.
        states: [q1, dq1, q2, dq2, ...], rad and rad/s, (S, D).
        accelerations: of the joints, rad/s², (S, D/2).

    Example:
        >>> from torch_pmil.envs.double_pendulum import double_pendulum_model
        >>> model = double_pendulum_model((0.5, 0.5))
        >>> to_the_right = torch.tensor([[torch.pi / 2, 0.0, 0.0, 0.0]], dtype=torch.float64)
        >>> tracking_torques(model, to_the_right, torch.zeros(1, 2)).round(decimals=3)
        tensor([[-4.9050, -1.2260]], dtype=torch.float64)
    """
    positions, velocities = states[:, ::2].numpy(), states[:, 1::2].numpy()
    return torch.from_numpy(inverse_dynamics(model, positions, velocities, accelerations.numpy()))
