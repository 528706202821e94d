"""A hand of finite strength that leads a point of a robot (kinesthetic teaching)."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
LOST = 0.1  # m of the site from where it is led


@dataclass(frozen=True)
class Hand:
    """Spring, damper and strength of a hand that holds a site of a robot.

    Args:
        stiffness: N/m.
        damping: N·s/m.
        force: the most, N.
        turning_stiffness: N·m/rad.
        turning_damping: N·m·s/rad.
        torque: the most, N·m; 0 for a hand in which the site turns freely.
    """

    stiffness: float = 1500.0
    damping: float = 70.0
    force: float = 120.0
    turning_stiffness: float = 0.0
    turning_damping: float = 0.0
    torque: float = 0.0

    def pull(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        site: str,
        place: Array,
        velocity: Array,
        matrix: Array | None = None,
        rotation: Array | None = None,
    ) -> None:
        """Pull a site to a place (3,), m, moving with a velocity (3,), m/s, in ``qfrc_applied``.

        Args:
            model, data: of the robot, after ``mj_step1``.
            site: its name.
            place, velocity: where the hand is, and how fast.
            matrix, rotation: how the hand is turned, (3, 3), and how fast, (3,), rad/s.
        """
        held = data.site(site)
        jacobian, turning = np.empty((3, model.nv)), np.empty((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, turning, held.id)
        slip = velocity - jacobian @ data.qvel
        force = self.stiffness * (place - held.xpos) + self.damping * slip
        applied = jacobian.T @ force * _limited(force, self.force)
        if self.torque and matrix is not None and rotation is not None:
            apart = rotation_between(held.xmat.reshape(3, 3), matrix)
            slip = rotation - turning @ data.qvel
            torque = self.turning_stiffness * apart + self.turning_damping * slip
            applied = applied + turning.T @ torque * _limited(torque, self.torque)
        data.qfrc_applied[:] = applied


def _limited(force: Array, most: float) -> float:
    """Factor that makes a force (3,) at most as large."""
    return most / max(float(np.linalg.norm(force)), most)


def rotation_between(first: Array, second: Array) -> Array:
    """Axis times angle (3,), rad, of the rotation from a rotation matrix (3, 3) to another one.

    Example:
        >>> quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        >>> rotation_between(np.eye(3), quarter).round(3)
        array([0.   , 0.   , 1.571])
    """
    quaternion, turned = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, (second @ first.T).ravel())
    mujoco.mju_quat2Vel(turned, quaternion, 1.0)
    return turned


def lead_by_hand(
    model: mujoco.MjModel,
    joints: Sequence[str],
    site: str,
    path: Callable[[float], Array],
    duration: float,
    hand: Hand,
    settling: float = 0.0,
) -> Array:
    """States of a robot whose site a hand leads, at every time step of the simulation.

    The actuators are without power, and the robot carries its own weight, as arms do that are made
    to be led by hand. The hand means to move the site as it would move if the joints moved along
    the path; compliance, inertia and friction do the rest.

    Args:
        model: of the robot; it is not changed.
        joints: names of its J joints.
        site: what the hand holds.
        path: positions of the joints (J,) at a time, s; from ``-settling`` on.
        duration: of the recording, s.
        hand: that leads.
        settling: time before the recording in which the hand already holds the robot, s.

    Returns:
        Positions and velocities of the joints (n, 2 J).

    Raises:
        RuntimeError: the site ended more than 0.1 m from where it was led.

    Example:
        >>> from torch_pmil.envs.double_pendulum import double_pendulum_model
        >>> path = lambda time: np.array([0.3 + 0.2 * time, 0.5])
        >>> led = lead_by_hand(double_pendulum_model(), ("q1", "q2"), "tip", path, 0.5, Hand())
        >>> led.shape, bool(abs(led[-1, 0] - 0.4) < 0.05)
        ((251, 4), True)
    """
    limp = copy.copy(model)
    limp.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    limp.opt.gravity[:] = 0
    data, meant = mujoco.MjData(limp), mujoco.MjData(limp)
    places = [limp.joint(name).qposadr[0] for name in joints]
    speeds = [limp.joint(name).dofadr[0] for name in joints]
    step = limp.opt.timestep

    def frame(time: float) -> tuple[Array, Array]:
        meant.qpos[places] = path(time)
        mujoco.mj_kinematics(limp, meant)
        return meant.site(site).xpos.copy(), meant.site(site).xmat.reshape(3, 3).copy()

    data.qpos[places] = path(-settling)
    states, before = [], frame(-settling)
    for count in range(round((settling + duration) / step) + 1):
        now = frame(count * step - settling)
        velocity, rotation = now[0] - before[0], rotation_between(before[1], now[1])
        mujoco.mj_step1(limp, data)
        states.append(np.concatenate([data.qpos[places], data.qvel[speeds]]))
        hand.pull(limp, data, site, now[0], velocity / step, now[1], rotation / step)
        mujoco.mj_step2(limp, data)
        before = now
    distance = float(np.linalg.norm(data.site(site).xpos - before[0]))
    if distance > LOST:
        raise RuntimeError(
            f"the hand must keep {site} within {LOST} m, it ended {distance:.2f} m away"
        )
    return np.array(states[round(settling / step) :])
