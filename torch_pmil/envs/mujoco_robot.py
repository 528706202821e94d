"""A robot from any MJCF file, without writing a class."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
import torch
from torch import Tensor

from torch_pmil.envs.actuators import actuator_kinds
from torch_pmil.envs.mujoco import MujocoRobotEnv

HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
OF_JOINT = mujoco.mjtTrn.mjTRN_JOINT
PICTURE = (480, 640)
CAMERA_DISTANCE = 2.2  # from the model's centre, in its extents


class MujocoRobot:
    """Makes environments of a robot that an MJCF file describes.

    The state has the joints' positions, named as the joints, then their velocities, with a ``d``
    before the name. Actions are what the actuators take, torques or targets. A position servo of a
    joint gets the joint's name, which marks its action as that joint's target: the state itself is
    then the action that holds the robot there. Pictures are taken by the model's camera
    ``"front"``, or by an added one that sees all of it.

    Args:
        xml: the MJCF or URDF file, or a specification.
        joints: names of the observed hinge and slide joints; other joints are hidden.
        actions: names of the actuators, or the lowest and highest action by name; other actuators
            are removed. None keeps all as they are. A range little larger than the task needs is
            safer: far from its data the policy commands the middle of the range.
        rate: control rate, Hz; its period must be a whole number of the model's time steps.
        start: mean start positions of the joints (J,), rad or m; None for the model's first
            keyframe, or zero.
        start_std: standard deviations of positions and velocities at a start, one for all, or one
            for each entry of the state, (2 J,).

    Raises:
        FileNotFoundError: there is no such file.
        TypeError: ``xml`` is neither a path nor a specification.
        ValueError: MuJoCo cannot read the file, it lacks a joint or actuator, or a number is out
            of range.

    Example:
        >>> from torch_pmil.envs.double_pendulum import double_pendulum_spec
        >>> robot = MujocoRobot(double_pendulum_spec((0.5, 0.5)), ["q1", "q2"], rate=10)
        >>> robot.names, robot().action_names
        (('q1', 'q2', 'dq1', 'dq2'), ('tau1', 'tau2'))
        >>> robot(num_envs=3, seed=0).rollout(5)["next", "observation"].shape
        torch.Size([3, 5, 4])
    """

    draws, physical = True, False
    angles: tuple[()] = ()  # shown as cosine and sine

    def __init__(
        self,
        xml: str | os.PathLike[str] | mujoco.MjSpec,
        joints: Sequence[str],
        actions: Sequence[str] | Mapping[str, tuple[float, float]] | None = None,
        rate: float = 20.0,
        start: Sequence[float] | Tensor | None = None,
        start_std: float | Sequence[float] | Tensor = 0.02,
    ) -> None:
        if not (math.isfinite(rate) and rate > 0):
            raise ValueError(f"rate must be positive and finite, in Hz, got {rate}")
        spec = _read(xml)
        self.name, self.joints, self.control_period = spec.modelname, tuple(joints), 1 / rate
        _check_joints(spec, self.joints)
        _choose_actuators(spec, actions)
        model = _compiled(spec)
        _call_servos_as_their_joints(spec, model)
        if "front" not in [camera.name for camera in spec.cameras]:
            _add_camera(spec, model)
        self.model = _compiled(spec)
        self.initial_mean = torch.cat([self._start(start), torch.zeros(len(self.joints)).double()])
        std = torch.as_tensor(start_std, dtype=torch.float64)
        self.initial_std = std.expand(2 * len(self.joints)) if std.ndim == 0 else std
        self()  # raises what is wrong with the numbers

    def __call__(
        self, num_envs: int | None = None, from_pixels: bool = False, seed: int | None = None
    ) -> MujocoRobotEnv:
        """One robot, or ``num_envs`` of them."""
        return MujocoRobotEnv(
            self.model,
            self.joints,
            initial_mean=self.initial_mean,
            initial_std=self.initial_std,
            positions_first=True,
            control_period=self.control_period,
            num_envs=num_envs,
            from_pixels=from_pixels,
            pixel_size=PICTURE,
            seed=seed,
        )

    @property
    def dim(self) -> int:
        """Number of entries of the state."""
        return 2 * len(self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of the state."""
        return self.joints + tuple(f"d{name}" for name in self.joints)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the entries of the state."""
        turns = [self.model.joint(name).type[0] == HINGE for name in self.joints]
        units = tuple("rad" if turn else "m" for turn in turns)
        return units + tuple(f"{unit}/s" for unit in units)

    @property
    def turning(self) -> tuple[str, ...]:
        """Names of the hinges without a range, which may turn more than once."""
        joints = [self.model.joint(name) for name in self.joints]
        free = [joint for joint in joints if joint.type[0] == HINGE and not joint.limited[0]]
        return tuple(joint.name for joint in free)

    def _start(self, start: Sequence[float] | Tensor | None) -> Tensor:
        if start is None:
            qpos = self.model.key_qpos[0] if self.model.nkey else self.model.qpos0
            return torch.tensor([qpos[self.model.joint(name).qposadr[0]] for name in self.joints])
        positions = torch.as_tensor(start, dtype=torch.float64)
        if positions.shape != (len(self.joints),):
            raise ValueError(
                f"start must be {len(self.joints)} positions, got {positions.tolist()}"
            )
        return positions


def _read(xml: str | os.PathLike[str] | mujoco.MjSpec) -> mujoco.MjSpec:
    if isinstance(xml, mujoco.MjSpec):
        return xml.copy()
    if not isinstance(xml, str | os.PathLike):
        raise TypeError(f"xml must be a path or an MjSpec, got {type(xml).__name__}")
    if not Path(xml).is_file():
        raise FileNotFoundError(f"{xml}: there is no such file")
    try:
        return mujoco.MjSpec.from_file(str(xml))
    except ValueError as error:
        raise ValueError(f"{xml} must be a model that MuJoCo reads: {error}") from error


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise ValueError(f"{spec.modelname} must compile: {error}") from error


def _check_joints(spec: mujoco.MjSpec, joints: tuple[str, ...]) -> None:
    known = {joint.name: joint for joint in spec.joints if joint.type in (HINGE, SLIDE)}
    unknown = [name for name in joints if name not in known]
    if unknown or not joints:
        raise ValueError(
            f"joints must be hinges and slides among {', '.join(known)}, got "
            f"{', '.join(unknown) or 'none'}"
        )


def _choose_actuators(
    spec: mujoco.MjSpec, actions: Sequence[str] | Mapping[str, tuple[float, float]] | None
) -> None:
    """Keep the actuators that are actions, with their ranges."""
    known = {actuator.name: actuator for actuator in spec.actuators}
    names = list(known) if actions is None else list(actions)
    if unknown := [name for name in names if name not in known]:
        raise ValueError(
            f"actions must be actuators among {', '.join(known)}, got {', '.join(unknown)}"
        )
    for name, actuator in known.items():
        if name not in names:
            spec.delete(actuator)
        elif isinstance(actions, Mapping):
            actuator.ctrllimited, actuator.ctrlrange = True, actions[name]


def _call_servos_as_their_joints(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    for actuator, kind in zip(spec.actuators, actuator_kinds(model), strict=True):
        if kind == "position" and actuator.trntype == OF_JOINT:
            actuator.name = actuator.target


def _add_camera(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Add a camera that sees the whole model from the front left and above."""
    distance = CAMERA_DISTANCE * model.stat.extent
    right, up = (math.sqrt(0.5), -math.sqrt(0.5), 0.0), (-0.25, -0.25, math.sqrt(0.875))
    away = torch.linalg.cross(torch.tensor(right), torch.tensor(up)).double().numpy()
    spec.worldbody.add_camera(
        name="front", pos=model.stat.center + distance * away, xyaxes=[*right, *up]
    )
    if not spec.lights:
        spec.worldbody.add_light(pos=model.stat.center + np.array([0, 0, distance]), dir=[0, 0, -1])
