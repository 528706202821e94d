"""Record demonstrations of a task in simulation: positions that an observer sees, no torques.

Example:
    python scripts/record_demonstrations.py experiment=double_pendulum seed=0 out=demonstrations.npz
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import hydra
import numpy as np
import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torch import Tensor

import torch_pmil.demonstrations
from reproduction.teachers import reaching
from reproduction.teachers.gym_teachers import (
    CART_STEPS,
    PENDULUM_STEPS,
    balancing_teacher,
    pendulum_teacher,
)
from reproduction.teachers.kinesthetic_teaching import Strike, Variation, record_strike
from reproduction.teachers.one_motor_teacher import (
    ACROBOT,
    CART_POLE,
    PENDUBOT,
    SwingUp,
    one_motor_teacher,
)
from reproduction.teachers.swing_up import demonstrate, swing_up_teacher
from reproduction.teachers.trajectory_optimization import Array
from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.demonstrations.preparation.alignment import align
from torch_pmil.envs import AdaptedEnv, MujocoRobotEnv, hitting_plane
from torch_pmil.envs.biorob import BALL, BioRobEnv, biorob_model
from torch_pmil.envs.cart_pole import CartPoleEnv
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, link_positions
from torch_pmil.envs.gym_tasks import gym_pendulum_env, inverted_pendulum_env
from torch_pmil.envs.pendubot import AcrobotEnv, PendubotEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.files import in_words
from torch_pmil.tasks.biorob import biorob_space
from torch_pmil.tasks.cart_pole import cart_pole_space
from torch_pmil.tasks.double_pendulum import (
    REACH_DISTANCE,
    SUCCESS_DISTANCE,
    distance_from_target,
    distance_from_upright,
)
from torch_pmil.tasks.gym_pendulum import gym_pendulum_space
from torch_pmil.tasks.inverted_pendulum import inverted_pendulum_space
from torch_pmil.tasks.one_motor import one_motor_space
from torch_pmil.tasks.registry import load_experiment

DEMONSTRATIONS = 5  # paper
STRIKES = 3  # paper
STRIKES_AT_A_TARGET = 2  # paper
REACHES = 3  # of each target
RECORDED_PERIOD = 0.01  # s, of what the robot's sensors record while it is led
TORQUE_NOISE = 0.1  # of the teachers that act by torques, in the unit of the action
CART_DEMONSTRATIONS = 10  # of starts that differ in all four entries
LINK_ENDS = ("x1", "y1", "x2", "y2")
Teacher = Callable[[int, Array], Array]


def record_double_pendulum(seed: int, torque_noise: float) -> Demonstrations:
    """Five swing-ups from starts drawn with the seed, all successful.

    Args:
        seed: of the starts and of the teacher's noise.
        torque_noise: standard deviation of what the teacher adds to its torques, drawn anew at each
            step, in N·m.

    Raises:
        RuntimeError: a demonstration did not stay upright.
    """
    env = DoublePendulumEnv(num_envs=DEMONSTRATIONS, seed=seed)
    states, torques = demonstrate(env, swing_up_teacher(), seed, torque_noise)
    check_pendulums("upright", distance_from_upright(states), SUCCESS_DISTANCE, torques)
    return Demonstrations(link_positions(states), env.control_period, LINK_ENDS)


def record_double_pendulum_targets(seed: int, torque_noise: float) -> Demonstrations:
    """Three motions to each training target, from starts drawn with the seed, all successful.

    Arguments and errors are those of ``record_double_pendulum``.
    """
    targets = reaching.TRAINING_TARGETS.repeat_interleave(REACHES, 0)
    env = DoublePendulumEnv(num_envs=len(targets), seed=seed)
    states, torques = reaching.demonstrate_reaching(env, targets, seed, torque_noise)
    check_pendulums("the target", distance_from_target(states, targets), REACH_DISTANCE, torques)
    return Demonstrations(
        link_positions(states), env.control_period, LINK_ENDS, targets, ("x", "y")
    )


def check_pendulums(goal: str, distances: Tensor, tolerance: float, torques: Tensor) -> None:
    """Print a row for each of N demonstrations, and check that all reached their goal.

    Distances are (N,) in m, torques (N, T, 2) in N·m.

    Raises:
        RuntimeError: one did not stay at its goal.
    """
    title = f"largest distance from {goal} in the last 0.5 s (m)"
    print(f"demonstration  {title}  peak torque (N·m)")
    rows = zip(distances.tolist(), torques.abs().amax((1, 2)).tolist(), strict=True)
    for number, (distance, peak) in enumerate(rows):
        print(f"{number:13d}  {distance:{len(title)}.4f}  {peak:17.3f}")
    if not (distances < tolerance).all():
        raise RuntimeError(
            f"a demonstration must stay within {tolerance} m, got {distances.max():.3f} m"
        )


def record_inverted_pendulum(seed: int, torque_noise: float) -> Demonstrations:
    """Ten recoveries of gymnasium's InvertedPendulum-v5, all successful."""
    env, space = inverted_pendulum_env(CART_DEMONSTRATIONS, seed=seed), inverted_pendulum_space()
    teacher = balancing_teacher()
    return record_teacher("inverted_pendulum", env, space, teacher, CART_STEPS, seed, torque_noise)


def record_gym_pendulum(seed: int, torque_noise: float) -> Demonstrations:
    """Five swing-ups of gymnasium's Pendulum-v1, all successful."""
    env, space = gym_pendulum_env(DEMONSTRATIONS, seed=seed), gym_pendulum_space()
    teacher = pendulum_teacher()
    return record_teacher("gym_pendulum", env, space, teacher, PENDULUM_STEPS, seed, torque_noise)


def record_one_motor(
    name: str,
    make_env: Callable[..., MujocoRobotEnv],
    space: StateSpace,
    motion: SwingUp,
    seed: int,
    torque_noise: float,
) -> Demonstrations:
    """Five swing-ups of a robot with two joints and one motor, all successful."""
    env = make_env(num_envs=DEMONSTRATIONS, seed=seed)
    teacher = one_motor_teacher(make_env(), motion)
    return record_teacher(name, env, space, teacher, motion.steps, seed, torque_noise)


def record_teacher(
    name: str,
    env: AdaptedEnv | MujocoRobotEnv,
    space: StateSpace,
    teacher: Teacher,
    steps: int,
    seed: int,
    torque_noise: float,
) -> Demonstrations:
    """The demonstrations of a teacher, one of each robot of the environment.

    Raises:
        RuntimeError: a demonstration is not a success of the experiment.
    """
    noise = np.random.default_rng(seed).normal(size=(steps, *env.action_spec.shape))
    time = itertools.count()

    def imprecise_teacher(tensordict: TensorDictBase) -> TensorDictBase:
        step = next(time)
        actions = teacher(step, tensordict["observation"].numpy()) + torque_noise * noise[step]
        return tensordict.set("action", env.action_spec.project(torch.from_numpy(actions)))

    rollout = env.rollout(steps, imprecise_teacher)
    demonstrations = Demonstrations(
        space.observe(states_of(rollout)), env.control_period, space.match_space.names
    )
    experiment = load_experiment(name, demonstrations)
    errors, peaks = experiment.error(rollout), rollout["action"].abs().amax((1, 2))
    print("demonstration  error  peak action")
    for number, (error, peak) in enumerate(zip(errors.tolist(), peaks.tolist(), strict=True)):
        print(f"{number:13d}  {error:5.3f}  {peak:11.3f}")
    if not (errors <= experiment.tolerance).all():
        raise RuntimeError(
            f"a demonstration must have an error of at most {experiment.tolerance}, got "
            f"{errors.max():.3f}"
        )
    return demonstrations


def record_biorob(seed: int, torque_noise: None) -> Demonstrations:
    """Three strikes of the BioRob, led by hand, all hits, and aligned in time."""
    return record_strikes(seed, torch.tensor([BALL] * STRIKES, dtype=torch.float64))


def record_biorob_targets(seed: int, torque_noise: None) -> Demonstrations:
    """Two strikes of the BioRob at each of three balls, led by hand, all hits, aligned in time."""
    targets = hitting_plane.TRAINING_TARGETS.repeat_interleave(STRIKES_AT_A_TARGET, 0)
    strikes = record_strikes(seed, hitting_plane.ball_at(targets))
    return replace(strikes, targets=targets, target_names=hitting_plane.TARGET_NAMES)


def record_strikes(seed: int, balls: Tensor) -> Demonstrations:
    """Strikes of the BioRob, led by hand, at balls (N, 3), aligned in time.

    Raises:
        RuntimeError: a strike missed its ball.
    """
    generator, recordings = np.random.default_rng(seed), []
    for ball in balls:
        model = biorob_model(ball)
        strike = Variation().of(Strike().towards(ball.numpy(), model), model, generator)
        recordings.append(record_strike(model, strike))
    print("demonstration  time of the hit (s)")
    for number, recording in enumerate(recordings):
        print(f"{number:13d}  {recording.hit_time or float('nan'):19.3f}")
    if not all(recording.hit_time for recording in recordings):
        raise RuntimeError("every demonstration must hit the ball")
    stride = round(RECORDED_PERIOD / recordings[0].time_step)
    strikes = [torch.from_numpy(recording.states[::stride]) for recording in recordings]
    aligned = align(strikes, velocities=(3, 4, 5))
    space, period = biorob_space(), BioRobEnv().control_period
    positions = aligned[:, :: round(period / RECORDED_PERIOD)]
    return Demonstrations(positions, period, space.match_space.names)


RECORDERS: dict[str, Callable[..., Demonstrations]] = {
    "acrobot": partial(record_one_motor, "acrobot", AcrobotEnv, one_motor_space(), ACROBOT),
    "biorob": record_biorob,
    "biorob_targets": record_biorob_targets,
    "cart_pole": partial(record_one_motor, "cart_pole", CartPoleEnv, cart_pole_space(), CART_POLE),
    "double_pendulum": record_double_pendulum,
    "double_pendulum_targets": record_double_pendulum_targets,
    "gym_pendulum": record_gym_pendulum,
    "inverted_pendulum": record_inverted_pendulum,
    "pendubot": partial(record_one_motor, "pendubot", PendubotEnv, one_motor_space(), PENDUBOT),
}
LED_BY_HAND = {"biorob", "biorob_targets"}


def torque_noise_of(config: DictConfig) -> float | None:
    """The standard deviation of the teacher's noise; None for a teacher who applies no torques."""
    if config.experiment not in LED_BY_HAND:
        return TORQUE_NOISE if config.torque_noise is None else config.torque_noise
    if config.torque_noise is not None:
        raise ValueError(
            f"torque_noise must be null for {config.experiment}, which is led by hand, got "
            f"{config.torque_noise}"
        )
    return None


@hydra.main(version_base="1.3", config_path=".", config_name="record_demonstrations")
def main(config: DictConfig) -> None:
    """Record the demonstrations of one experiment and save them."""
    if config.experiment not in RECORDERS:
        sys.exit(f"experiment must be one of {sorted(RECORDERS)}, got {config.experiment}")
    shipped = Path(torch_pmil.demonstrations.__file__).parent / "data" / f"{config.experiment}.npz"
    out = Path(config.out or shipped)
    if not out.parent.is_dir():
        sys.exit(f"cannot write {out}: there is no folder {out.parent}")
    try:
        RECORDERS[config.experiment](config.seed, torque_noise_of(config)).save(out)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        sys.exit(f"cannot record {out}: {in_words(error)}")
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
