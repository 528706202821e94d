"""Kinesthetic teaching of the BioRob: a person leads the racket by hand (Section 5.2.2).

The motors are limp and the states are recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly

from reproduction.teachers.hand import LOST, Hand
from torch_pmil.envs.biorob import BALL, JOINTS, ROTORS, START
from torch_pmil.envs.equilibrium import Equilibrium
from torch_pmil.envs.mujoco_model import FULL_PHYSICS

Array = NDArray[np.floating]

HAND = Hand()
SETTLING = 0.3  # s at the start, before the recording
MAX_ITERATIONS = 50  # of inverse kinematics
NEAR = 1e-9  # m, from where the racket is to be


@dataclass(frozen=True)
class Strike:
    """The strike that the teacher means: back, then fast up through the ball, then rest.

    Unless told otherwise, the ball is at ``BALL``.

    Angles of [yaw, shoulder, elbow] in rad, times in s after the start of the recording.

    Args:
        start: where the arm rests at first.
        back: where it is drawn back to.
        hit: where the racket meets the ball.
        hit_velocity: with which it passes there, rad/s.
        stop: where it comes to rest.
        times: of back, hit and stop.
        duration: of the recording.
    """

    start: tuple[float, ...] = START[: len(JOINTS)]
    back: tuple[float, ...] = (-0.35, 0.05, 0.55)
    hit: tuple[float, ...] = (0.1, 0.72, 1.35)
    hit_velocity: tuple[float, ...] = (0.6, 2.0, 2.5)
    stop: tuple[float, ...] = (0.2, 0.92, 1.7)
    times: tuple[float, float, float] = (0.8, 1.25, 1.6)
    duration: float = 1.8

    def path(self) -> BPoly:
        """Angles over time, (3,) at each.

        The arm is at rest at the start, drawn back, and in the end; between these the acceleration
        is smooth.
        """
        still = [0.0, 0.0, 0.0]
        knots = [-SETTLING, 0.0, *self.times, max(self.duration, self.times[-1]) + 0.1]
        before = [[pose, still, still] for pose in (self.start, self.start, self.back)]
        after = [[self.stop, still, still]] * 2
        return BPoly.from_derivatives(knots, [*before, [self.hit, self.hit_velocity], *after])

    def towards(self, ball: Sequence[float] | Array, model: mujoco.MjModel) -> Strike:
        """This strike, moved to a ball elsewhere: a smooth function of the ball's place.

        It is this strike itself if the ball is at ``BALL``.

        The racket meets the ball as it did, by inverse kinematics of its centre; where the arm is
        drawn back to turns along with the yaw, and where it comes to rest moves along in all
        angles. Start, times and speed are the same.

        Args:
            ball: where it hangs, (3,) in m.
            model: of the robot.

        Raises:
            ValueError: the arm does not reach it.

        Example:
            >>> from torch_pmil.envs.biorob import biorob_model
            >>> strike = Strike().towards((0.757, 0.276, 0.967), biorob_model())
            >>> np.round(strike.hit, 2), np.round(strike.back, 2)
            (array([0.35, 0.68, 1.13]), array([-0.1 ,  0.05,  0.55]))
        """
        place = _racket_path(model, np.array([self.hit]))[0] + (np.asarray(ball) - BALL)
        turn = _angles_at(model, self.hit, place) - self.hit
        moved: dict[str, Any] = {
            name: tuple(getattr(self, name) + turn * along)
            for name, along in (("back", (1, 0, 0)), ("hit", 1), ("stop", 1))
        }
        return replace(self, **moved)


@dataclass(frozen=True)
class Variation:
    """Standard deviations of what a person varies from one demonstration to the next.

    Args:
        start, rest: of each angle at the start, and where the arm is drawn back and comes to rest,
            rad.
        hit: of the racket's place at the ball, m along each axis.
        time: of each of the three times, s.
        speed: of the speed at the ball, as a fraction.
    """

    start: float = np.deg2rad(1.5)
    rest: float = np.deg2rad(2.5)
    hit: float = 0.008
    time: float = 0.04
    speed: float = 0.08

    def of(self, strike: Strike, model: mujoco.MjModel, generator: np.random.Generator) -> Strike:
        """A random strike near the one that is meant."""
        draw = generator.normal
        return replace(
            strike,
            start=tuple(strike.start + draw(0, self.start, 3)),
            back=tuple(strike.back + draw(0, self.rest, 3)),
            hit=tuple(strike.hit + _angles_for(model, strike.hit, draw(0, self.hit, 3))),
            hit_velocity=tuple(np.array(strike.hit_velocity) * (1 + draw(0, self.speed))),
            stop=tuple(strike.stop + draw(0, self.rest, 3)),
            times=tuple(np.array(strike.times) + draw(0, self.time, 3)),
        )


@dataclass(frozen=True, eq=False)
class RecordedStrike:
    """The recording of a strike at every time step of the simulation.

    Args:
        time_step: s.
        states: [q, dq] of yaw, shoulder and elbow from the start on, (n, 6), rad and rad/s.
        hit_time: s, when the racket touched the ball; None if it did not.
        physics: full simulation states, as ``MujocoRobotEnv.draw`` takes them, (n, P).
    """

    time_step: float
    states: Array
    hit_time: float | None
    physics: Array


def record_strike(model: mujoco.MjModel, strike: Strike) -> RecordedStrike:
    """Lead the racket along a strike with a compliant hand, the motors limp.

    The hand pulls with a spring and a damper, and with 120 N at the most; the robot's weight,
    friction, rotors and cables do the rest.

    Args:
        model: of the robot and its ball.
        strike: what to do.

    Raises:
        RuntimeError: the racket was lost: it ended more than 0.1 m from where it was led.

    Example:
        >>> from torch_pmil.envs.biorob import biorob_model
        >>> recording = record_strike(biorob_model(), Strike())
        >>> recording.states.shape, recording.hit_time is not None
        ((1801, 6), True)
    """
    data = mujoco.MjData(model)
    steps = round((strike.duration + SETTLING) / model.opt.timestep)
    led = _racket_path(model, strike.path()(np.arange(steps + 1) * model.opt.timestep - SETTLING))
    speeds = np.gradient(led, model.opt.timestep, axis=0)
    _set_angles(data, JOINTS, strike.start)
    ratio = Equilibrium(model, JOINTS, ROTORS).ratio
    _set_angles(data, ROTORS, ratio @ strike.start)  # the two cables of each joint pull alike
    joints = [data.joint(name) for name in JOINTS]
    physics = np.empty((steps + 1, mujoco.mj_stateSize(model, FULL_PHYSICS)))
    states, touched = [], []
    for place, velocity, now in zip(led, speeds, physics, strict=True):
        mujoco.mj_getState(model, data, now, FULL_PHYSICS)
        mujoco.mj_step1(model, data)
        states.append([joint.qpos[0] for joint in joints] + [joint.qvel[0] for joint in joints])
        HAND.pull(model, data, "racket", place, velocity)
        mujoco.mj_step2(model, data)
        touched.append(data.sensor("racket_ball_contact").data[0] > 0)
    distance = np.linalg.norm(data.site("racket").xpos - led[-1])
    if distance > LOST:
        raise RuntimeError(
            f"the hand must keep the racket within {LOST} m, it ended {distance:.2f} m away"
        )
    begun = round(SETTLING / model.opt.timestep)
    hits = np.flatnonzero(touched[begun:])
    hit_time = hits[0] * model.opt.timestep if len(hits) else None
    return RecordedStrike(model.opt.timestep, np.array(states[begun:]), hit_time, physics[begun:])


def _set_angles(
    data: mujoco.MjData, joints: Sequence[str], angles: Sequence[float] | Array
) -> None:
    for name, angle in zip(joints, angles, strict=True):
        data.joint(name).qpos = angle


def _racket_path(model: mujoco.MjModel, angles: Array) -> Array:
    """Places of the racket's centre, (n, 3) in m, at angles (n, 3)."""
    data, path = mujoco.MjData(model), []
    for each in angles:
        _set_angles(data, JOINTS, each)
        mujoco.mj_kinematics(model, data)
        path.append(data.site("racket").xpos.copy())
    return np.array(path)


def _angles_for(model: mujoco.MjModel, angles: tuple[float, ...], shift: Array) -> Array:
    """Change of the angles (3,) that shifts the racket by ``shift`` (3,), m, to first order."""
    data, jacobian = mujoco.MjData(model), np.empty((3, model.nv))
    _set_angles(data, JOINTS, angles)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("racket").id)
    return np.linalg.solve(jacobian[:, [model.joint(name).dofadr[0] for name in JOINTS]], shift)


def _angles_at(model: mujoco.MjModel, near: tuple[float, ...], place: Array) -> Array:
    """Angles (3,) at which the racket's centre is at ``place`` (3,), m.

    Newton's method starts from ``near``.
    """
    angles = np.array(near)
    low, high = np.array([model.joint(name).range for name in JOINTS]).T
    for _ in range(MAX_ITERATIONS):
        rest = place - _racket_path(model, angles[None])[0]
        if np.linalg.norm(rest) < NEAR and ((low <= angles) & (angles <= high)).all():
            return angles
        angles += _angles_for(model, tuple(angles), rest)
    raise ValueError(
        "the arm must reach the ball: no pose within the joints' ranges has the racket's centre "
        f"at {place.round(3).tolist()}"
    )
