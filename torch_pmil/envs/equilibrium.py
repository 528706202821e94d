"""Static equilibrium of any robot whose rotors pull its joints by cables."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from torch_pmil.envs.robot import Array

TOLERANCE = 1e-9  # N·m, of what is left unbalanced
MAX_ITERATIONS = 30
DIFFERENCE_STEP = 1e-7  # rad


class Equilibrium:
    r"""Static equilibrium of a robot whose driven joints are held by their rotors.

    At rest the generalised forces are :math:`\tau(q) = g(q) - f(q)`, with gravity g and the pull f
    of cables and springs. Newton's method finds the positions of rotors and passive joints at which
    driven and passive joints need no torque. The rotors' part of :math:`\tau` then holds the robot.
    Friction and contacts are not included.

    Args:
        model: rotors and joints are hinges or slides, the cables fixed tendons.
        driven: names of the joints whose positions are given.
        rotors: names of the rotors, one for each driven joint.
        passive: names of the joints that yield until their springs bear the load.

    Example:
        >>> from torch_pmil.envs.biorob import JOINTS, ROTORS, biorob_model
        >>> equilibrium = Equilibrium(biorob_model(), JOINTS, ROTORS, ("wrist_roll", "wrist_pitch"))
        >>> qpos, torques = equilibrium(np.array([[0.0, 0.5, 0.9]]))
        >>> torques.round(1) + 0.0
        array([[0. , 3. , 2.2]])
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        driven: Sequence[str],
        rotors: Sequence[str],
        passive: Sequence[str] = (),
    ) -> None:
        self._model = copy.copy(model)
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._data = mujoco.MjData(self._model)
        self._driven = [model.joint(name) for name in driven]
        self._rotors = [model.joint(name) for name in rotors]
        self._passive = [model.joint(name) for name in passive]
        self.ratio = _ratio(model, _dofs(self._driven), _dofs(self._rotors))  # (F, F)

    def __call__(self, positions: Array) -> tuple[Array, Array]:
        """All positions (N, nq), as in ``MjData.qpos``, and torques (N, F) of the rotors.

        They are those at equilibrium with the driven joints at ``positions`` (N, F).

        Raises:
            RuntimeError: no equilibrium was found.
        """
        places, torques = zip(*map(self._solve, positions), strict=True)
        return np.array(places), np.array(torques)

    def moving_torques(self, positions: Array, velocities: Array, accelerations: Array) -> Array:
        """Torques (N, F) of the rotors in a motion (N, F) of the driven joints, with friction.

        The cables keep their length at equilibrium, so each rotor moves with its joint. Raises
        RuntimeError if no equilibrium was found.
        """
        model, data, places = self._model, self._data, self(positions)[0]
        along = np.zeros((model.nv, len(self._driven)))  # motion of all with the driven joints
        along[_dofs(self._driven)] = np.eye(len(self._driven))
        along[_dofs(self._rotors)] = self.ratio
        torques = np.empty_like(positions)
        motion = zip(places, velocities, accelerations, strict=True)
        for row, (place, velocity, acceleration) in enumerate(motion):
            data.qpos[:], data.qvel[:], data.qacc[:] = place, along @ velocity, along @ acceleration
            mujoco.mj_inverse(model, data)
            torques[row] = np.linalg.solve(self.ratio.T, along.T @ data.qfrc_inverse)
        return torques

    def _solve(self, positions: Array) -> tuple[Array, Array]:
        model, data = self._model, self._data
        balanced, free = _dofs(self._driven + self._passive), _dofs(self._rotors + self._passive)
        places = [joint.qposadr[0] for joint in self._rotors + self._passive]
        mujoco.mj_resetData(model, data)
        data.qpos[[joint.qposadr[0] for joint in self._driven]] = positions
        data.qpos[places[: len(self._rotors)]] = self.ratio @ positions
        stiffness = np.empty((model.nv, model.nv))  # derivative of the force of dof j by position i
        for _ in range(MAX_ITERATIONS):
            mujoco.mj_inverse(model, data)
            unbalanced = data.qfrc_inverse[balanced]
            if np.abs(unbalanced).max() < TOLERANCE:
                return data.qpos.copy(), data.qfrc_inverse[_dofs(self._rotors)]
            mujoco.mjd_inverseFD(
                model, data, DIFFERENCE_STEP, False, stiffness, None, None, None, None, None, None
            )
            data.qpos[places] -= np.linalg.solve(stiffness[np.ix_(free, balanced)].T, unbalanced)
        raise RuntimeError(
            f"no equilibrium at {positions.tolist()}: {np.abs(unbalanced).max():.2g} N·m stay "
            "unbalanced"
        )


def _dofs(joints: Sequence) -> list[int]:
    return [joint.dofadr[0] for joint in joints]


def _ratio(model: mujoco.MjModel, driven: list[int], rotors: list[int]) -> Array:
    """Turn of the rotors per turn of each driven joint at constant cable lengths, (F, F)."""
    moments = np.zeros((model.ntendon, model.nv))
    for tendon in range(model.ntendon):
        first = model.tendon_adr[tendon]
        for wrap in range(first, first + model.tendon_num[tendon]):
            if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT:
                moments[tendon, model.jnt_dofadr[model.wrap_objid[wrap]]] = model.wrap_prm[wrap]
    return np.linalg.lstsq(moments[:, rotors], -moments[:, driven])[0]
