"""Six- and seven-joint arms with servos that learn to carry a bottle and turn it, led by hand.

The models of UR5e and Panda are those of robosuite 1.5.2 (MIT licence; its meshes are of the arms'
makers), which only has to lie there: nothing of it is imported. Added are servos in the place of
motors, the rotors' inertia that robosuite gives them when it runs, a bottle in the hand, and a
floor. The servos' gains, the bottle and the motions are estimates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import BPoly
from tensordict.nn import TensorDictModule
from torch import Tensor

from reproduction.teachers.hand import Hand, lead_by_hand
from torch_pmil.control.exploration import Exploration
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.demonstrations.distribution import demonstration_spread
from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.envs.rollouts import of_states, states_of
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.target_costs import SaturatingCost
from torch_pmil.tasks.cost_task import CostTask
from torch_pmil.tasks.method import SURE
from torch_pmil.tasks.own_robot import own_robot
from torch_pmil.tasks.pilco import with_cost
from torch_pmil.tasks.task import Task

INSTALL = "pip install --no-deps robosuite==1.5.2"
RATE, DURATION, COUNT = 20.0, 3.0, 5  # Hz and s of a motion, and number of demonstrations
TIME_STEP = 0.002  # s, of the simulation
MARGIN = 0.4  # rad by which targets go beyond what was demonstrated
BOTTLE = 1.5  # kg
SITE, SETTLING = "hand", 0.3  # what the person holds, and for how long before the recording, s
HAND = Hand(
    stiffness=1500.0,
    damping=200.0,
    force=120.0,
    turning_stiffness=60.0,
    turning_damping=15.0,
    torque=20.0,
)
PASSING = 0.4  # speed at a pose that is passed, over that from the pose before to the one after it
START_STD, WAY_STD, TIMES_STD = math.radians(1.5), math.radians(2.5), 0.05  # of a person; rad, s
SPEED_STD = 0.01  # rad/s, of a start
NOISE_STD = 0.04  # rad
TOLERATED = 1.25  # rms distance from the mean demonstration, over the demonstrations' spread
RANDOM_ACTION = 0.12  # of half the range of the targets
LEAST_WIDTHS = (0.3, 0.5)  # rad, rad/s
SEARCH = SearchSettings(
    mean_iterations=0, stage_iterations=20, final_iterations=40, trust_threshold=1.0
)
COST_WIDTH, MOST_SPEED = 0.5, 3.0  # of PILCO's cost: rad, rad/s
# as many iterations, all over the whole horizon: the first policy is not far from the last pose
COST_SEARCH = replace(
    SEARCH, first_horizon=1.0, skip_matched_steps=False, trust_threshold=SURE.trust_threshold
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arm:
    """An arm of robosuite, and the motion that a person shows it.

    Args:
        name: of the arm, and of its folder in robosuite.
        joints: names of its J joints.
        stiffness: of the servos, N·m/rad; they are damped critically.
        poses: of the motion, (K, J), rad: where the arm rests at first, what it passes, and where
            it rests in the end.
        times: of these poses, s.
    """

    name: str
    joints: tuple[str, ...]
    stiffness: tuple[float, ...]
    poses: tuple[tuple[float, ...], ...]
    times: tuple[float, ...]

    @property
    def rotors(self) -> Array:
        """Inertia of the rotors, (J,), kg m², as robosuite sets it."""
        return 5.0 / np.arange(1, len(self.joints) + 1)


UR5E = Arm(
    "ur5e",
    (
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ),
    (500.0, 500.0, 320.0, 150.0, 120.0, 100.0),
    (
        (-0.3, -1.2, 1.6, -0.4, -1.57, 0.0),
        (0.15, -1.5, 1.7, -0.5, -1.4, 0.3),
        (0.6, -1.25, 1.5, -0.55, -1.3, 1.5),
        (0.5, -1.35, 1.6, -0.45, -1.35, 0.9),
    ),
    (0.0, 1.0, 1.95, 2.8),
)
PANDA = Arm(
    "panda",
    tuple(f"joint{number}" for number in range(1, 8)),
    (500.0, 500.0, 400.0, 320.0, 150.0, 120.0, 100.0),
    (
        (-0.3, 0.2, 0.0, -2.2, 0.0, 2.4, 0.8),
        (0.1, 0.0, 0.1, -2.4, 0.1, 2.5, 1.0),
        (0.5, 0.3, 0.2, -2.0, 0.3, 2.4, 2.1),
        (0.45, 0.15, 0.15, -2.2, 0.2, 2.45, 1.6),
    ),
    (0.0, 1.0, 1.95, 2.8),
)


def arm_spec(arm: Arm) -> mujoco.MjSpec:
    """The model of an arm with servos, a bottle in its hand, and a floor.

    Raises:
        ModuleNotFoundError: robosuite is not there; the message says how to install it.
    """
    package = find_spec("robosuite")
    if package is None or package.origin is None:
        raise ModuleNotFoundError(f"the models of the arms need robosuite: {INSTALL}")
    folder = Path(package.origin).parent / "models" / "assets" / "robots" / arm.name
    spec = mujoco.MjSpec.from_file(str(folder / "robot.xml"))
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name, actuator, inertia, stiffness in zip(
        arm.joints, spec.actuators, arm.rotors, arm.stiffness, strict=True
    ):
        joint, limit = spec.joint(name), actuator.ctrlrange[1]
        joint.armature, joint.frictionloss = inertia, 0.1
        actuator.set_to_position(kp=stiffness, kv=2 * math.sqrt(stiffness * (inertia + 0.5)))
        actuator.forcelimited, actuator.forcerange = True, [-limit, limit]
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
        geom.group = geom.group if geom.group else 3  # collision shapes are not drawn
    _add_bottle(spec.body("right_hand"))
    _add_surroundings(spec)
    return spec


def _add_bottle(hand: mujoco.MjsBody) -> None:
    hand.add_site(name=SITE)
    hand.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[0.035, 0.11, 0.0],
        pos=[0.0, 0.0, 0.06],
        quat=[math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0],
        mass=BOTTLE,
        rgba=[0.15, 0.5, 0.3, 1.0],
        contype=0,
        conaffinity=0,
        group=1,
    )


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.95, 0.97, 1.0],
        rgb2=[0.75, 0.82, 0.9],
        width=64,
        height=64,
    )
    world = spec.worldbody
    world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[2.0, 2.0, 0.1],
        rgba=[0.9, 0.9, 0.88, 1.0],
        contype=0,
        conaffinity=0,
        group=1,
    )
    world.add_light(pos=[1.0, -1.5, 2.5], dir=[-0.4, 0.5, -1.0], diffuse=[0.8, 0.8, 0.8])
    world.add_camera(
        name="front", pos=[1.5, -0.95, 0.95], xyaxes=[0.54, 0.84, 0.0, -0.33, 0.21, 0.92]
    )


def motion(poses: Array, times: Array) -> Callable[[float], Array]:
    """Positions over time of a smooth motion through poses (K, J) at times (K,)."""
    still = np.zeros_like(poses[0])
    slope = (poses[2:] - poses[:-2]) / (times[2:] - times[:-2])[:, None]
    knots = [-SETTLING, *times, max(DURATION, times[-1]) + SETTLING]
    passed = [[pose, PASSING * speed] for pose, speed in zip(poses[1:-1], slope, strict=True)]
    ends = [[[pose, still, still]] * 2 for pose in (poses[0], poses[-1])]
    return BPoly.from_derivatives(knots, [*ends[0], *passed, *ends[1]])


@cache
def demonstrations(arm: Arm) -> Demonstrations:
    """Joint positions of the motion, shown five times by hand and never twice the same."""
    model, generator = arm_spec(arm).compile(), np.random.default_rng(0)
    stride, shown = round(1 / RATE / TIME_STEP), []
    for _ in range(COUNT):
        poses, times = np.array(arm.poses), np.array(arm.times)
        poses[0] += generator.normal(0, START_STD, len(arm.joints))
        poses[1:] += generator.normal(0, WAY_STD, poses[1:].shape)
        times[1:] += generator.normal(0, TIMES_STD, len(times) - 1)
        led = lead_by_hand(model, arm.joints, SITE, motion(poses, times), DURATION, HAND, SETTLING)
        shown.append(led[::stride, : len(arm.joints)])
    return Demonstrations(torch.from_numpy(np.stack(shown)), 1 / RATE, arm.joints)


@cache
def arm_robot(arm: Arm) -> MujocoRobot:
    """The arm, starting where the demonstrations do, with targets little beyond them."""
    shown, count = demonstrations(arm).positions, len(arm.joints)
    low, high = shown.amin((0, 1)) - MARGIN, shown.amax((0, 1)) + MARGIN
    spec = arm_spec(arm)
    ranges = zip(spec.actuators, low.tolist(), high.tolist(), strict=True)
    return MujocoRobot(
        spec,
        arm.joints,
        actions={actuator.name: (least, most) for actuator, least, most in ranges},
        rate=RATE,
        start=shown[:, 0].mean(0),
        start_std=[START_STD] * count + [SPEED_STD] * count,
    )


@cache
def arm_experiment(arm: Arm) -> Task:
    """The motion, to be learned by joint targets at 20 Hz; the first one goes along it.

    A success is a rollout whose rms distance from the mean demonstration, over joints and times, is
    at most 1.25 times the demonstrations' spread.
    """
    shown, robot, count = demonstrations(arm), arm_robot(arm), len(arm.joints)
    widths = [width for width in LEAST_WIDTHS for _ in range(count)]
    return own_robot(
        robot,
        shown,
        robot.control_period,
        name=arm.name,
        noise_std=NOISE_STD,
        num_centres=80,
        input_scale=2.0,
        least_widths=torch.tensor(widths, dtype=torch.float64),
        initial_weight_std=0.01,
        error=of_states(Distance(shown)),
        tolerance=TOLERATED * spread(shown),
        random_action=RANDOM_ACTION,
        explore_demonstrated=True,
        velocities_alone=True,
        search=SEARCH,
    )


@dataclass(frozen=True, eq=False)
class Distance:
    """Root mean square distance of the joints from the mean demonstration, rad.

    Args:
        shown: the demonstrations.
    """

    shown: Demonstrations

    def __call__(self, states: Tensor) -> Tensor:
        """Of states x_0..x_T, (*batch, T + 1, D), over joints and t = 1..T: (*batch)."""
        mean = self.shown.positions.mean(0)
        apart = states[..., 1:, : mean.shape[-1]] - mean[1:]
        return apart.square().mean((-2, -1)).sqrt()


def spread(shown: Demonstrations) -> float:
    """Root mean square over the joints of the demonstrations' spread, rad."""
    return demonstration_spread(shown).square().mean().sqrt().item()


@dataclass(frozen=True, eq=False, kw_only=True)
class ArmPilco(CostTask):
    """The motion's last pose by PILCO's cost, with the first policy and motion of the imitation."""

    imitation: Task

    @property
    def exploration(self) -> Exploration:
        """That of the imitation, along its demonstrations."""
        return self.imitation.exploration

    def make_policy(self, generator: torch.Generator) -> AnyPolicy:
        """A new policy with centres near demonstrated states."""
        return self.policy_near(self.space.features(self.imitation.demonstrated_states), generator)


def pilco_experiment(arm: Arm) -> ArmPilco:
    """The same arm and first motion, with PILCO's cost of the distance from the last pose."""
    task = arm_experiment(arm)
    last, names = task.demonstrations.positions[:, -1].mean(0), task.space.match_space.names
    cost = SaturatingCost(target=dict(zip(names, last.tolist(), strict=True)), width=COST_WIDTH)
    alone = task.with_settings(explore_demonstrated=False)
    pilco = with_cost(alone, f"{arm.name}_pilco", cost, MOST_SPEED)
    same: dict[str, Any] = {entry.name: getattr(pilco, entry.name) for entry in fields(pilco)}
    method = replace(alone.method, search=COST_SEARCH)
    return ArmPilco(**(same | {"method": method}), imitation=task)


@torch.no_grad()
def servo_alone(experiment: Task, starts: int, seed: int) -> Tensor:
    """States (starts, T + 1, D) of the servos whose targets are the mean demonstration.

    The target of a step is the sample at its end.
    """
    targets = iter(experiment.demonstrations.positions.mean(0)[1:])
    module = TensorDictModule(
        lambda state: next(targets).expand(len(state), -1),
        in_keys=["observation"],
        out_keys=["action"],
    )
    return states_of(experiment.robots(starts, seed).rollout(experiment.horizon, module))
