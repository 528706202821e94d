"""A robot from any MJCF file, without writing a class."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
import torch
from torch import Tensor

from torch_pmil.envs.actuators import actuator_kinds
from torch_pmil.envs.mujoco import MujocoRobotEnv
from torch_pmil.envs.mujoco_actions import Chosen, choose_actuators, hold_others, moved_joint
from torch_pmil.envs.mujoco_model import dividing_time_step
from torch_pmil.envs.mujoco_start import WholeStart
from torch_pmil.envs.robot import Array

HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
Start = str | int | Sequence[float] | Tensor | None
PICTURE = (480, 640)
CAMERA_DISTANCE = 3.0  # from the centre of what moves, in its radii
AMBIENT, DIFFUSE = 0.4, 0.6  # least light from the camera
SKY = (0.85, 0.9, 0.95)  # red, green, blue


class MujocoRobot:
    """Makes environments of a robot that an MJCF file describes.

    The state has the joints' positions, named as the joints, then their velocities, with a ``d``
    before the name. Actions are what the actuators take, torques or targets. A position servo of a
    joint gets the joint's name if its gear is 1: the state itself is then the action that holds the
    robot there. Pictures are taken by the model's camera ``"front"``, or by an added one that sees
    all of it.

    A keyframe also gives the start of hidden joints, activations and mocap bodies. Actuators that
    are not actions keep its controls. Servos for which it has no control hold their position.
    Hidden joints that equalities tie to observed ones follow them.

    Args:
        xml: the MJCF or URDF file, its text, or a specification.
        joints: names of the observed hinge and slide joints; other joints are hidden.
        actions: names of the actuators, or the lowest and highest action by name; None for all as
            they are. The name of a joint stands for its only actuator. Others at the same joints
            are switched off. A range little larger than the task needs is safer: far from its data
            the policy commands the middle of the range.
        rate: control rate, Hz. If its period is not a whole number of the model's time steps, they
            become as much shorter as it takes, and a warning says so.
        start: mean start positions of the joints (J,), rad or m; or the name or number of a
            keyframe; None for the model's first keyframe, or its default pose.
        start_std: standard deviations of positions and velocities at a start, one for all, or one
            for each entry of the state, (2 J,). Starts end at the joints' stops.

    Raises:
        FileNotFoundError: there is no such file.
        TypeError: ``xml`` is neither a path, nor text, nor a specification.
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
        actions: Chosen = None,
        rate: float = 20.0,
        start: Start = None,
        start_std: float | Sequence[float] | Tensor = 0.02,
    ) -> None:
        if not (math.isfinite(rate) and rate > 0):
            raise ValueError(f"rate must be positive and finite, in Hz, got {rate}")
        spec = _read(xml)
        self.name, self.joints, self.control_period = spec.modelname, tuple(joints), 1 / rate
        _check_joints(spec, self.joints)
        spec.option.timestep = dividing_time_step(self.control_period, spec.option.timestep)
        if "front" not in [camera.name for camera in spec.cameras]:
            _add_camera(spec, _compiled(spec, xml))
        self.model = _compiled(spec, xml)
        self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        self.actuators = choose_actuators(self.model, actions)
        keyframe, positions = _start(self.model, self.joints, start)
        given = (False, False) if keyframe is None else _gives(spec.keys[keyframe])
        self.whole_start = WholeStart(self.model, self.joints, positions, keyframe, given)
        hold_others(self.model, list(self.actuators.values()), self.whole_start.controls)
        self.initial_mean = self.whole_start.mean
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
            actuators=self.actuators,
            whole_start=self.whole_start,
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
    def bounds(self) -> list[tuple[float, float]]:
        """Lowest and highest value of each entry of the state, infinite if unknown."""
        unknown = (-math.inf, math.inf)
        joints = [self.model.joint(name) for name in self.joints]
        known = [tuple(each.range.tolist()) if each.limited[0] else unknown for each in joints]
        return known + [unknown] * len(joints)

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

    @property
    def held(self) -> Callable[[Tensor], Tensor] | None:
        """Maps states (*batch, D) to the actions (*batch, F) that have them as targets.

        It is None unless all actions are targets of position servos of the observed joints.
        """
        kinds, entries, gears = actuator_kinds(self.model), list[int](), list[float]()
        for number in self.actuators.values():
            joint = moved_joint(self.model, number)
            if kinds[number] != "position" or joint not in self.joints:
                return None
            entries.append(self.joints.index(joint))
            gears.append(self.model.actuator_gear[number, 0])
        factors = torch.tensor(gears, dtype=torch.float64)
        return lambda states: states[..., entries] * factors


def _read(xml: str | os.PathLike[str] | mujoco.MjSpec) -> mujoco.MjSpec:
    if isinstance(xml, mujoco.MjSpec):
        return xml.copy()
    if not isinstance(xml, str | os.PathLike):
        raise TypeError(f"xml must be a path, XML text or an MjSpec, got {type(xml).__name__}")
    text = isinstance(xml, str) and xml.lstrip().startswith("<")
    if not text and not Path(xml).is_file():
        raise FileNotFoundError(f"{xml}: there is no such file")
    try:
        return mujoco.MjSpec.from_string(xml) if text else mujoco.MjSpec.from_file(str(xml))
    except ValueError as error:
        raise ValueError(
            f"{_label(xml)} must be a model that MuJoCo reads: {_line(error)}"
        ) from error


def _compiled(spec: mujoco.MjSpec, xml: str | os.PathLike[str] | mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise ValueError(f"{_label(xml)} must compile: {_line(error)}") from error


def _label(xml: object) -> str:
    text = isinstance(xml, str) and xml.lstrip().startswith("<")
    return "xml" if text or isinstance(xml, mujoco.MjSpec) else str(xml)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _check_joints(spec: mujoco.MjSpec, joints: tuple[str, ...]) -> None:
    named = [joint.name for joint in spec.joints if joint.type in (HINGE, SLIDE) and joint.name]
    unknown = [name for name in joints if name not in named]
    if unknown or not joints:
        raise ValueError(
            f"joints must be hinges and slides among {', '.join(named) or 'those with names'}, got "
            f"{', '.join(unknown) or 'none'}"
        )
    if len(set(joints)) < len(joints):
        raise ValueError(f"joints must be different ones, got {', '.join(joints)}")


def _start(
    model: mujoco.MjModel, joints: tuple[str, ...], start: Start
) -> tuple[int | None, Array | None]:
    """Number of the keyframe, and the positions (J,) of the joints if they are given."""
    keyframe = 0 if model.nkey else None
    names = [model.key(number).name for number in range(model.nkey)]
    if start is None:
        return keyframe, None
    if isinstance(start, str | int):
        number = names.index(start) if start in names else start
        if number not in range(model.nkey):
            known = ", ".join(name or str(number) for number, name in enumerate(names)) or "none"
            raise ValueError(f"start must be one of the model's keyframes, {known}, got {start!r}")
        return int(number), None
    positions = torch.as_tensor(start, dtype=torch.float64)
    if positions.shape != (len(joints),) or not positions.isfinite().all():
        raise ValueError(f"start must be {len(joints)} finite positions, got {positions.tolist()}")
    return keyframe, positions.numpy()


def _gives(keyframe: mujoco.MjsKey) -> tuple[bool, bool]:
    """Whether a keyframe has controls, and whether it has activations."""
    return len(keyframe.ctrl) > 0, len(keyframe.act) > 0


def _add_camera(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Add a camera that sees what moves from the front left and above, light, and a bright sky.

    It looks at the middle of what moves in the default pose, from far enough to see all of it
    stretched out.
    """
    centre, radius = _moving(model)
    distance = CAMERA_DISTANCE * radius
    right, up = (math.sqrt(0.5), -math.sqrt(0.5), 0.0), (-0.25, -0.25, math.sqrt(0.875))
    away = torch.linalg.cross(torch.tensor(right), torch.tensor(up)).double().numpy()
    spec.worldbody.add_camera(name="front", pos=centre + distance * away, xyaxes=[*right, *up])
    headlight = spec.visual.headlight
    headlight.ambient = np.maximum(headlight.ambient, AMBIENT)
    headlight.diffuse = np.maximum(headlight.diffuse, DIFFUSE)
    sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX
    if all(texture.type != sky for texture in spec.textures):
        flat = mujoco.mjtBuiltin.mjBUILTIN_FLAT
        spec.add_texture(type=sky, builtin=flat, rgb1=SKY, width=8, height=48)


def _moving(model: mujoco.MjModel) -> tuple[np.ndarray, float]:
    """Centre and radius of a sphere around the geoms that joints move.

    They are in the default pose, and slide as far as the limits of one slide joint let them.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moves = model.body_weldid[model.geom_bodyid] > 0
    if not moves.any():
        return model.stat.center, model.stat.extent
    places, radii = data.geom_xpos[moves], model.geom_rbound[moves][:, None]
    low, high = (places - radii).min(0), (places + radii).max(0)
    slides = (model.jnt_type == SLIDE) & (model.jnt_limited > 0)
    reach = np.abs(model.jnt_range[slides]).max(initial=0.0)
    return (low + high) / 2, float(np.linalg.norm(high - low) / 2 + reach)
