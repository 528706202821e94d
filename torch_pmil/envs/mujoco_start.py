"""Where all of a MuJoCo model starts: joints that are not observed, activations, mocap bodies."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
import torch
from torch import Tensor

from torch_pmil.envs.actuators import SCALAR, actuator_kinds, pointing_actions
from torch_pmil.envs.mujoco_model import FULL_PHYSICS, state_columns
from torch_pmil.envs.robot import Array

CLOSED = 1e-10  # m or rad, of what is left open of an equality
MAX_ITERATIONS = 30
PROBE = 1e-3  # rad or m, by which observed joints move to see what follows them
BEYOND = 0.01  # of a joint's range: how far its stop, which is soft, may be pressed in at a start


class WholeStart:
    """The full simulation state at a reset, given the state of the observed joints.

    The rest of the model starts as in a keyframe. What equalities tie to the observed joints, such
    as mimic joints and closed loops, follows them instead.

    Args:
        model: the robot's model; its mocap bodies are moved to where they start.
        joints: names of the observed joints.
        start: positions of these joints, (J,); None for those of the keyframe.
        keyframe: its number; None for the model's default pose.
        controls: whether the keyframe has controls, and whether it has activations. Servos for
            which it has none hold their position.

    Raises:
        ValueError: a joint starts beyond its range, or observed joints are tied to one another.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        joints: Sequence[str],
        start: Sequence[float] | Array | None,
        keyframe: int | None,
        controls: tuple[bool, bool],
    ) -> None:
        self._columns = state_columns(model, joints, positions_first=True)
        self._model = copy.copy(model)
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self._data = data = mujoco.MjData(self._model)
        if keyframe is not None:
            mujoco.mj_resetDataKeyframe(self._model, data, keyframe)
        places = self._columns[: len(joints)].numpy() - 1
        if start is not None:
            data.qpos[places] = start
        data.time, self._qpos, self._qvel = 0.0, data.qpos.copy(), data.qvel.copy()
        self._observed = self._columns[len(joints) :].numpy() - 1 - model.nq
        self._hidden = np.setdiff1d(np.arange(model.nv), self._observed)
        self.tied = bool(data.eq_active.any())
        self._check_independent(joints)
        if not self._close():
            data.qpos[:], data.qvel[:] = self._qpos, self._qvel
        self._qpos, self._qvel = data.qpos.copy(), data.qvel.copy()
        _check_ranges(model, self._qpos)
        _place_mocap_bodies(model, data)
        self.controls = _set_servos(self._model, data, controls)
        physics = np.empty(mujoco.mj_stateSize(model, FULL_PHYSICS))
        mujoco.mj_getState(model, data, physics, FULL_PHYSICS)
        self._physics = torch.from_numpy(physics)
        self.mean, self.qpos = self._physics[self._columns], self._qpos

    def __call__(self, state: Tensor) -> Tensor:
        """Full simulation states (N, P) at time 0 of robots in states (N, D)."""
        physics = self._physics.expand(len(state), -1).clone()
        physics[:, self._columns] = state.to(torch.float64)
        if self.tied:
            nq, nv = self._model.nq, self._model.nv
            for whole in physics.numpy():
                qpos, qvel = whole[1 : 1 + nq], whole[1 + nq : 1 + nq + nv]
                self._data.qpos[:], self._data.qvel[:] = qpos, qvel
                if self._close():
                    qpos[:], qvel[:] = self._data.qpos, self._data.qvel
        return physics

    def follows(self, joint: int) -> bool:
        """Whether an equality ties a hidden joint, of this number, to observed ones."""
        probe = self._physics[self._columns].expand(2, -1).clone()
        probe[1, : len(self._observed)] += PROBE
        first = 1 + self._model.jnt_qposadr[joint]
        before, after = self(probe)[:, first]
        return bool((after - before).abs() > CLOSED)

    def _close(self) -> bool:
        """Move what is hidden until equalities hold; whether that was possible."""
        data, along = self._data, np.zeros(self._model.nv)
        for _ in range(MAX_ITERATIONS):
            gaps, pulls = self._equalities()
            if not np.abs(gaps).max(initial=0.0) > CLOSED:
                rates = pulls @ data.qvel
                data.qvel[self._hidden] -= np.linalg.lstsq(pulls[:, self._hidden], rates)[0]
                return True
            along[self._hidden] = -np.linalg.lstsq(pulls[:, self._hidden], gaps)[0]
            mujoco.mj_integratePos(self._model, data.qpos, along, 1.0)
        return False

    def _equalities(self) -> tuple[Array, Array]:
        """Violations (E,) of the equalities and their derivatives by the motion, (E, V)."""
        mujoco.mj_fwdPosition(self._model, self._data)
        rows = self._data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        pulls = self._data.efc_J.reshape(-1, self._model.nv)
        return self._data.efc_pos[rows].copy(), pulls[rows].copy()

    def _check_independent(self, joints: Sequence[str]) -> None:
        """Raise ValueError if equalities tie observed joints to one another."""
        pulls = self._equalities()[1]
        left, sizes, _ = np.linalg.svd(pulls[:, self._hidden])
        rank = np.sum(sizes > 1e-9 * sizes.max(initial=1.0))
        ties = np.abs(left[:, rank:].T @ pulls[:, self._observed]).max(0, initial=0.0) > 1e-9
        if ties.any():
            names = [name for name, tied in zip(joints, ties, strict=True) if tied]
            raise ValueError(
                "joints must be independent of one another, but equalities of the model tie "
                f"{' and '.join(names)}: leave one of them out"
            )


def _check_ranges(model: mujoco.MjModel, qpos: Array) -> None:
    for number in np.flatnonzero(model.jnt_limited):
        joint = model.joint(number)
        scalar = joint.type[0] in SCALAR
        (low, high), place = joint.range, qpos[joint.qposadr[0]]
        if scalar and max(low - place, place - high) > BEYOND * (high - low):
            unit = "rad" if joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE else "m"
            raise ValueError(
                f"start must be within the joints' ranges, got {place:g} {unit} for "
                f"{joint.name or number}, whose range is {low:g} to {high:g} {unit}: give start=, "
                "or mend or add the model's keyframe"
            )


def _place_mocap_bodies(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Move mocap bodies in the model to their start: a simulation from a state has them there."""
    for body in np.flatnonzero(model.body_mocapid >= 0):
        mocap = model.body_mocapid[body]
        model.body_pos[body], model.body_quat[body] = data.mocap_pos[mocap], data.mocap_quat[mocap]


def _set_servos(model: mujoco.MjModel, data: mujoco.MjData, given: tuple[bool, bool]) -> Array:
    """Controls (nu,) at the start, where servos point to where they are unless they are given."""
    mujoco.mj_fwdPosition(model, data)
    here = pointing_actions(model, data.actuator_length)
    if not given[1]:
        for number in np.flatnonzero(model.actuator_actnum == 1):
            data.act[model.actuator_actadr[number]] = here[number]
    rates = np.array([kind == "rate" for kind in actuator_kinds(model)], dtype=bool)
    return data.ctrl.copy() if given[0] else np.where(rates, 0.0, here)
