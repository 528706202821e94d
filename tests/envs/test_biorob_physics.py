"""The physics of the BioRob's model, its racket and the ball. ``-s`` prints what was measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.linalg import eigh

from tests.envs.driving import physics
from torch_pmil.envs.biorob import BALL, HELD, JOINTS, ROTORS, START, BioRobEnv, biorob_model
from torch_pmil.envs.equilibrium import Equilibrium

Array = NDArray[np.float64]

FAR = (3.0, 3.0, 1.0)  # where the ball is out of the way
LIFTED = (0.0, 0.6, 1.0)
FRICTION = (0.8, 1.5, 0.8)  # N·m
# Hz, of a prototype with these estimates, to their last digit
FREQUENCIES = np.array([(2.9, 4.1), (3.1, 6.2), (6.4, 11.7)])
each_joint = pytest.mark.parametrize("joint", [0, 1, 2])


@dataclass
class Arm:
    """A robot, at rest in its equilibrium until told otherwise."""

    ball: Sequence[float] = FAR
    model: mujoco.MjModel = field(init=False)

    def __post_init__(self) -> None:
        self.model = biorob_model(self.ball)
        self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        self.data = mujoco.MjData(self.model)
        self.equilibrium = Equilibrium(self.model, JOINTS, ROTORS, HELD)
        self.joints, self.rotors = (
            [self.model.joint(name).dofadr[0] for name in names] for names in (JOINTS, ROTORS)
        )

    def rest(self, pose: Sequence[float]) -> Array:
        """Put it in a pose, at rest; the torques (3,) that hold it."""
        places, torques = self.equilibrium(np.array([pose]))
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = places[0]
        self.data.ctrl[:] = torques[0]
        mujoco.mj_forward(self.model, self.data)
        return torques[0]

    def swing(self, seconds: float, extra: Callable[[float], Array] | None = None) -> Array:
        """Angles (n, 2, 3) of joints and rotors under the torques of now and ``extra`` (3,)."""
        torques, angles = self.data.ctrl.copy(), []
        for step in range(round(seconds / self.model.opt.timestep)):
            if extra is not None:
                self.data.ctrl[:] = torques + extra(step * self.model.opt.timestep)
            mujoco.mj_step(self.model, self.data)
            # all hinges: their places are their dofs
            angles.append([self.data.qpos[self.joints], self.data.qpos[self.rotors]])
        return np.array(angles)

    def racket_speed(self, speed: float) -> None:
        """Turn the joints so that the racket moves along its normal, in m/s."""
        racket, jacobian = self.data.site("racket"), np.empty((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, jacobian, None, racket.id)
        velocity = speed * racket.xmat.reshape(3, 3)[:, 0]
        self.data.qvel[self.joints] = np.linalg.pinv(jacobian[:, self.joints]) @ velocity

    def modes(self, pose: Sequence[float]) -> tuple[Array, Array]:
        """Undamped eigenfrequencies (3,) in Hz and modes (3, 3) of joints with still rotors."""
        self.rest(pose)
        stiffness, inertia = np.empty((2, self.model.nv, self.model.nv))
        self.data.qacc[:] = 0
        mujoco.mj_inverse(self.model, self.data)
        mujoco.mjd_inverseFD(self.model, self.data, 1e-7, False, stiffness, *[None] * 6)
        mujoco.mj_fullM(self.model, self.data, inertia)
        K, M = (matrix[np.ix_(self.joints, self.joints)] for matrix in (stiffness, inertia))
        squares, modes = eigh((K + K.T) / 2, M)
        return np.sqrt(squares) / (2 * np.pi), modes


def pulse(joint: int, size: float) -> Callable[[float], Array]:
    """A torque of ``size`` N·m on one motor that comes at once after 0.5 s."""
    return lambda time: size * np.eye(3)[joint] * (time > 0.5)


def ramp(joint: int, size: float, rise: float = 0.8) -> Callable[[float], Array]:
    """The same torque, which comes smoothly within ``rise`` seconds."""

    def torque(time: float) -> Array:
        s = np.clip((time - 0.5) / rise, 0, 1)
        return size * np.eye(3)[joint] * s**3 * (10 - 15 * s + 6 * s**2)

    return torque


def ringing(deflection: Array, window: int = 300) -> float:
    """Peak to peak in degrees of what is faster than a moving mean over ``window`` time steps."""
    slow = np.convolve(deflection, np.ones(window) / window, "valid")
    return float(np.rad2deg(np.ptp(deflection[window // 2 : window // 2 + len(slow)] - slow)))


@pytest.mark.parametrize("pose", [START[:3], (0.1, 0.72, 1.35), (0.0, 0.5, 0.9), (0.0, 1.0, 0.5)])
def test_joints_ring_with_locked_motors_in_the_range_of_the_prototype(
    pose: tuple[float, ...],
) -> None:
    frequencies, _ = Arm().modes(pose)
    print("eigenfrequencies (Hz) at", pose, frequencies.round(2))
    assert (frequencies > FREQUENCIES[:, 0] - 0.1).all()
    assert (frequencies < FREQUENCIES[:, 1] + 0.1).all()


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_simulated_free_response_has_the_frequency_of_the_linearisation(mode: int) -> None:
    arm = Arm()
    frequencies, modes = arm.modes(LIFTED)
    arm.model.dof_damping[arm.rotors] = 1e6  # locked
    arm.model.dof_frictionloss[:] = 0
    arm.rest(LIFTED)
    arm.data.qvel[arm.joints] = 0.3 * modes[:, mode] / np.abs(modes[:, mode]).max()
    angles = arm.swing(4.0)[:, 0] @ np.linalg.inv(modes).T  # of the modes
    centred = (angles[:, mode] - angles[:, mode].mean()) * np.hanning(len(angles))
    spectrum = np.abs(np.fft.rfft(centred, 2**17))
    peak = np.fft.rfftfreq(2**17, arm.model.opt.timestep)[spectrum.argmax()]
    # the wrist's springs give way a little
    assert peak == pytest.approx(frequencies[mode], rel=0.06)


@each_joint
def test_kick_moves_a_joint_many_times_more_than_its_motor(joint: int) -> None:
    arm = Arm()
    arm.rest(LIFTED)
    before = arm.data.qpos[[arm.joints, arm.rotors]]
    arm.data.qvel[arm.joints[joint]] = 0.1
    moved = np.rad2deg(np.abs(arm.swing(1.0) - before).max(0)[:, joint])
    print(f"kick of 0.1 rad/s: {JOINTS[joint]} {moved[0]:.2f} deg, its motor {moved[1]:.3f} deg")
    assert moved[0] > 0.1 and moved[0] > 10 * moved[1]


@each_joint
def test_slack_cable_halves_the_stiffness_and_no_cable_pushes(joint: int) -> None:
    arm = Arm()
    arm.model.jnt_stiffness[:] = 0
    arm.model.opt.gravity[:] = 0
    cables = [index for index in range(6) if index // 2 == joint]
    offsets = np.linspace(-0.2, 0.2, 401)
    pulls = []
    for cable in cables:
        stiffness = arm.model.tendon_stiffness.copy()
        arm.model.tendon_stiffness[np.arange(arm.model.ntendon) != cable] = 0
        pulls.append(np.array([_spring(arm, joint, offset) for offset in offsets]))
        arm.model.tendon_stiffness[:] = stiffness
    assert (pulls[0] <= 0).all(), "the lifting cable pulls back on its rotor"
    assert (pulls[1] >= 0).all(), "the lowering cable pulls forwards"
    stiffness = -np.gradient(sum(pulls), offsets)
    taut, slack = stiffness[200], stiffness[[5, -5]]
    print(f"{JOINTS[joint]}: {taut:.0f} N·m/rad with both cables, {slack[0]:.0f} with one")
    assert taut == pytest.approx([120, 150, 70][joint]) and slack == pytest.approx([taut / 2] * 2)


def _spring(arm: Arm, joint: int, offset: float) -> float:
    """Torque on a rotor that is turned by ``offset`` while all else is at zero."""
    mujoco.mj_resetData(arm.model, arm.data)
    arm.data.qpos[arm.rotors[joint]] = offset
    mujoco.mj_forward(arm.model, arm.data)
    return arm.data.qfrc_spring[arm.rotors[joint]]


@pytest.mark.parametrize(("joint", "size"), [(0, 3.0), (1, 4.0), (2, 2.0)])
def test_abrupt_torque_rings_and_a_smooth_one_of_the_same_size_does_not(
    joint: int, size: float
) -> None:
    rings = []
    for torque in (pulse(joint, size), ramp(joint, size)):
        arm = Arm()
        arm.rest(LIFTED)
        angles = arm.swing(2.0, torque)
        rings.append(ringing((angles[:, 0] @ arm.equilibrium.ratio.T - angles[:, 1])[:, joint]))
    print(f"{size} N·m on {JOINTS[joint]} ring by {rings[0]:.2f} deg, smooth {rings[1]:.2f} deg")
    assert rings[0] > 0.5 and rings[1] < 0.25 and rings[0] > 4 * rings[1]


@each_joint
def test_stiction_holds_the_arm_against_small_torques_and_yields_to_larger_ones(joint: int) -> None:
    moved = []
    for fraction in (0.9, 1.3):
        arm = Arm()
        arm.rest(LIFTED)
        angles = arm.swing(2.0, lambda _, size=fraction * FRICTION[joint]: size * np.eye(3)[joint])
        moved.append(np.rad2deg(np.abs(angles[-1] - angles[0]))[1, joint])
    print(f"{ROTORS[joint]}: {moved} deg in 2 s under 0.9 and 1.3 of the friction")
    assert moved[0] < 0.15 and moved[1] > 5


def test_full_torques_swing_the_racket_as_fast_as_the_robot_was_measured() -> None:
    env = BioRobEnv(FAR, seed=0)
    start = torch.tensor([0.0, -0.5, 0.3, 0.0, 0.0, 0.0], dtype=torch.float64)
    motion = env.replay(start, torch.tensor([[5.0, 20.0, 10.0]] * 5, dtype=torch.float64), 50)
    velocities = [physics(env.model, state).sensor("racket_velocity").data for state in motion]
    speeds = np.linalg.norm(velocities, axis=-1)
    print(f"top speed of a plain swing: {max(speeds):.2f} m/s")
    assert 6.5 < max(speeds) < 7.6


def test_drag_of_the_racket_is_felt_at_speed() -> None:
    """A plate across the stream: F = rho·C·A·v² in MuJoCo's ellipsoid model, A of the blade."""
    arm = Arm()
    arm.rest(LIFTED)
    forces = []
    for speed in (3.5, 7.0):
        arm.data.qvel[:] = 0
        arm.racket_speed(speed)
        mujoco.mj_forward(arm.model, arm.data)
        power = -arm.data.qfrc_fluid @ arm.data.qvel
        forces.append(power / speed)
    print(f"drag: {forces[0]:.2f} N at 3.5 m/s, {forces[1]:.2f} N at 7 m/s")
    assert 0.5 < forces[1] < 5 and 3.5 < forces[1] / forces[0] < 4.5


@pytest.mark.parametrize("speed", [1.0, 3.0, 5.0, 7.0, 9.0])
@pytest.mark.parametrize(
    "offset", [(0.0, 0.0), (0.05, 0.0), (-0.05, 0.0), (0.0, 0.055), (0.0, -0.055)]
)
def test_ball_is_hit_and_never_passed_through(speed: float, offset: tuple[float, float]) -> None:
    pose = (0.1, 0.72, 1.35)
    arm = Arm()
    arm.rest(pose)
    racket = arm.data.site("racket")
    axes = racket.xmat.reshape(3, 3)
    arm = Arm(racket.xpos + axes @ [0.006 + 0.02 + 0.01, *offset])  # 1 cm ahead of the blade
    arm.rest(pose)
    arm.racket_speed(speed)
    arm.data.qvel[arm.rotors] = arm.equilibrium.ratio @ arm.data.qvel[arm.joints]
    racket, touched, normal, deepest = arm.data.site("racket"), False, [], 0.0
    for _ in range(60):
        mujoco.mj_step(arm.model, arm.data)
        touched |= arm.data.sensor("racket_ball_contact").data[0] > 0
        deepest = min(deepest, arm.data.sensor("racket_ball_distance").data[0])
        normal.append(racket.xmat.reshape(3, 3)[:, 0] @ (arm.data.body("ball").xpos - racket.xpos))
    flight = np.linalg.norm(arm.data.joint("ball").qvel[:3])
    if offset == (0.0, 0.0):
        print(f"at {speed} m/s: ball {flight:.1f} m/s, sank in by {-1000 * deepest:.1f} mm")
    assert touched and min(normal) > 0 and normal[-1] > 0.026 and flight > 0.9 * speed


@pytest.mark.parametrize("ball", [FAR, BALL])
def test_energy_never_grows_without_torque(ball: tuple[float, ...]) -> None:
    generator = np.random.default_rng(0)
    for _ in range(3):
        arm = Arm(ball)
        arm.rest((0.1, 0.6, 1.3))
        arm.data.ctrl[:] = 0
        arm.data.qvel[:8] = generator.normal([0.5, 0.5, 2.5, 3.5, 2.5, 2.5, 0, 0])
        energies = []
        for _ in range(1500):
            mujoco.mj_step(arm.model, arm.data)
            energies.append(arm.data.energy.sum())
        growth = energies - np.minimum.accumulate(energies)
        # J; the contact stores some for a moment
        assert growth.max() < (1e-9 if ball == FAR else 5e-2)
        assert max(energies) == energies[0] and energies[0] - energies[-1] > 1


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_motion_hardly_depends_on_the_time_step(seed: int) -> None:
    torques = np.random.default_rng(seed).uniform(-1, 1, (18, 3)) * [3, 8, 4]
    courses = []
    for halves in (0, 1):
        arm = Arm()
        arm.model.opt.timestep /= 2**halves
        arm.rest(START[:3])
        angles = arm.swing(1.8, lambda time: torques[int(time / 0.1 + 1e-6)])
        courses.append(angles[2**halves - 1 :: 2**halves, 0])
    error = np.rad2deg(np.abs(courses[1] - courses[0]).max())
    print(f"time step halved: {error:.3f} deg in 1.8 s")
    assert error < 0.15


def test_arm_stays_in_every_pose_that_its_torques_hold() -> None:
    generator = np.random.default_rng(0)
    for pose in generator.uniform([-1, -0.8, 0.1], [1, 1.8, 2.2], (5, 3)):
        arm = Arm()
        arm.model.dof_frictionloss[:] = 0  # nothing else holds it
        arm.rest(pose)
        np.testing.assert_allclose(arm.swing(1.0)[-1, 0], pose, atol=1e-6)


def test_rotors_turn_with_the_joints_over_the_shoulder_pulley() -> None:
    """The elbow's cables are wound on by half of the shoulder's angle."""
    expected = [[1, 0, 0], [0, 1, 0], [0, 0.5, 1]]
    np.testing.assert_allclose(Arm().equilibrium.ratio, expected, atol=1e-12)


def test_keyframe_is_the_start_in_equilibrium() -> None:
    model = biorob_model()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    np.testing.assert_allclose([data.joint(name).qpos[0] for name in JOINTS], START[:3])
    places, torques = Equilibrium(model, JOINTS, ROTORS, HELD)(np.array([START[:3]]))
    np.testing.assert_allclose(data.qpos, places[0], atol=1e-5)
    np.testing.assert_allclose(data.ctrl, torques[0], atol=1e-5)


def test_impossible_equilibrium_is_refused_in_one_line() -> None:
    model = biorob_model()
    model.tendon_stiffness[model.tendon("yaw_left").id] = np.nan
    with pytest.raises((RuntimeError, ValueError)) as error:
        Equilibrium(model, JOINTS, ROTORS, HELD)(np.array([START[:3]]))
    assert "\n" not in str(error.value)
