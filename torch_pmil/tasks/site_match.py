"""The match space of a point of a robot: position and orientation of a site of its MuJoCo model."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from torch_pmil.control.state_space import MatchSpace
from torch_pmil.control.trigonometric_polynomial import (
    TrigonometricPolynomial,
    cosine,
    match_of,
    sine,
)
from torch_pmil.envs.mujoco_robot import MujocoRobot

# of a trigonometric polynomial's coefficients, m: what rounding leaves of a sine of half a turn
NEGLIGIBLE = 1e-10
Polynomials = NDArray[np.object_]


def site_match(robot: MujocoRobot, site: str, orientation: bool = False) -> MatchSpace:
    """Match space of the place of a site, and of its orientation.

    The place of a point of a chain of hinges is a sum of sines and cosines of sums of their angles,
    whose moments are exact. Orientation is compared by the first two axes of the site, six numbers
    without the jumps and whole turns that three angles have.

    Args:
        robot: whose observed joints are hinges between the world and the site. Other joints are
            taken to stay where they start.
        site: its name in the model.
        orientation: whether the axes are compared as well as the place.

    Returns:
        Entries x, y and z (m), with the orientation also x_x, x_y, x_z, y_x, y_y, y_z: its axes.

    Raises:
        TypeError: the robot is of another kind.
        ValueError: there is no such site, or an observed slide moves it, or a hidden joint that
            follows others.

    Example:
        >>> import torch
        >>> from torch_pmil.envs.double_pendulum import double_pendulum_spec
        >>> robot = MujocoRobot(double_pendulum_spec((0.5, 0.5)), ["q1", "q2"], rate=10)
        >>> place = site_match(robot, "tip")
        >>> upright = torch.zeros(4, dtype=torch.float64)
        >>> place.names, place(upright).round(decimals=3) + 0.0
        (('x', 'y', 'z'), tensor([0., 0., 1.], dtype=torch.float64))
    """
    if not isinstance(robot, MujocoRobot):
        raise TypeError(f"match by a site needs a MujocoRobot, got {type(robot).__name__}")
    model = robot.model
    names = [model.site(number).name for number in range(model.nsite)]
    if site not in names:
        raise ValueError(f"match must be one of the sites {', '.join(names)}, got {site!r}")
    placed = model.site(site)
    turned, moved = _frame(robot, placed.bodyid[0])
    entries = list(moved + turned @ _constants(placed.pos, len(robot.joints)))
    labels: tuple[str, ...] = ("x", "y", "z")
    units: tuple[str, ...] = ("m",) * 3
    if orientation:
        axes = turned @ _constants(_matrix(placed.quat), len(robot.joints))
        entries += list(axes[:, :2].T.ravel())
        labels += tuple(f"{axis}_{along}" for axis, along in itertools.product("xy", "xyz"))
        units += ("",) * 6
    exact, count = [_without_rounding(entry) for entry in entries], len(robot.joints)
    return match_of(exact, labels, units, dim=2 * count, angles=range(count))


def _frame(robot: MujocoRobot, body: int) -> tuple[Polynomials, Polynomials]:
    """Rotation (3, 3) and place (3,) of a body, polynomials of the observed angles."""
    model, count = robot.model, len(robot.joints)
    turned, moved = _constants(np.eye(3), count), _constants(np.zeros(3), count)
    for number in reversed(_ancestors(model, body)):
        moved = moved + turned @ _constants(model.body_pos[number], count)
        turned = turned @ _constants(_matrix(model.body_quat[number]), count)
        first = model.body_jntadr[number]
        for joint in range(first, first + model.body_jntnum[number]):
            if model.joint(joint).name not in robot.joints:
                rotation, by = _where_it_stays(robot, joint)
                about, shift = _constants(rotation, count), _constants(by, count)
                if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                    moved, turned = shift, about
                    continue
                moved = moved + turned @ shift
            else:
                about = _rotation(robot, joint)
            anchor = _constants(model.jnt_pos[joint], count)
            moved = moved + turned @ (anchor + about @ (-1.0 * anchor))
            turned = turned @ about
    return turned, moved


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and those it hangs from, up to the world, which is left out."""
    return [body, *_ancestors(model, model.body_parentid[body])] if body else []


def _rotation(robot: MujocoRobot, joint: int) -> Polynomials:
    r"""Rotation about a hinge's axis a, :math:`aa^\top + \cos q (I - aa^\top) + \sin q [a]_\times`.

    The angle counts from the model's reference.
    """
    model, count = robot.model, len(robot.joints)
    name, axis = model.joint(joint).name, model.jnt_axis[joint]
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
        raise ValueError(f"match by a site needs hinges on the way to it, got the slide {name}")
    along = np.outer(axis, axis)
    across = np.cross(axis, np.eye(3)).T
    reference = model.qpos0[model.jnt_qposadr[joint]]
    angle = tuple(int(name == other) for other in robot.joints)
    even = np.cos(reference) * (np.eye(3) - along) - np.sin(reference) * across
    odd = np.sin(reference) * (np.eye(3) - along) + np.cos(reference) * across
    return _constants(along, count) + _times(even, cosine(angle)) + _times(odd, sine(angle))


def _where_it_stays(
    robot: MujocoRobot, joint: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) and shift (3,) by a hidden joint, which stays where it starts."""
    model, quaternion = robot.model, np.eye(4)[0]
    kind = model.jnt_type[joint]
    if robot.whole_start.follows(joint):
        raise ValueError(
            "match by a site needs joints on the way to it that are observed or stay, got "
            f"{model.joint(joint).name or joint}, which follows others by an equality"
        )
    first, axis, shift = model.jnt_qposadr[joint], model.jnt_axis[joint], np.zeros(3)
    place = robot.whole_start.qpos[first:]
    if kind == mujoco.mjtJoint.mjJNT_HINGE:
        mujoco.mju_axisAngle2Quat(quaternion, axis, place[0] - model.qpos0[first])
    elif kind == mujoco.mjtJoint.mjJNT_SLIDE:
        shift = axis * (place[0] - model.qpos0[first])
    elif kind == mujoco.mjtJoint.mjJNT_BALL:
        quaternion = place[:4]
    else:
        shift, quaternion = place[:3], place[3:7]
    return _matrix(quaternion), shift


def _times(matrix: NDArray[np.float64], wave: TrigonometricPolynomial) -> Polynomials:
    return np.vectorize(lambda entry: float(entry) * wave, otypes=[object])(matrix)


def _constants(values: NDArray[np.float64], count: int) -> Polynomials:
    return _times(values, TrigonometricPolynomial({(0,) * count: 1 + 0j}))


def _matrix(quaternion: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion))
    return matrix.reshape(3, 3)


def _without_rounding(polynomial: TrigonometricPolynomial) -> TrigonometricPolynomial:
    kept = {n: c for n, c in polynomial.coefficients.items() if abs(c) > NEGLIGIBLE}
    return TrigonometricPolynomial(kept or {next(iter(polynomial.coefficients)): 0j})
