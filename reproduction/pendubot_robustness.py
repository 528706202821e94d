"""The robustness score of the AI Olympics with RealAIGym, from its published rules.

Six criteria, each the fraction of its cases in which 10 s from hanging end with the tip above the
line at 0.45 m: parameters of the plant, one at a time; noise of the velocities that the policy
sees; noise of the torque; a torque that follows what is asked late or beyond; a delay of the
measured state; pushes. The score is their mean. Each quantity is varied in 21 steps; there are 50
profiles of pushes.

Published: the rules, the ranges of the quantities, the plant. Of the pushes there are two versions
of the ranges; here are the shorter, stronger ones. Chosen here: above the line at the end is so for
the last 0.5 s, which a link that turns through does not do; a noisy case counts if most of
``REPETITIONS`` succeed; noise of the torque is drawn at each time step of 2 ms; velocities are
not filtered; pushes are on the motor and within its limit. The controller acts at 25 Hz, from the
last state that is measured. The leaderboard's own act at 500 Hz.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor

from reproduction.pendubot_plant import STEPS, TIME_STEP, Plant, simulated, stacked
from torch_pmil.envs.double_pendulum import HANGING
from torch_pmil.envs.pendubot import CONTROL_PERIOD, tip_height
from torch_pmil.tasks.one_motor import LINE

LEVELS = 21
REPETITIONS = 10  # of each level of a noise
PROFILES = 50  # of pushes
FINAL_STEPS = 250  # 0.5 s, of which the tip is above the line
PUSHES = 6  # of a profile, at least 1 s apart
TORQUE_LIMIT = 6.0  # N·m
FACTORS = {"m1r1", "I1", "m2r2", "m2", "I2"}  # varied by 25 %
RANGES = {  # of the others, N·m·s/rad and N·m of friction
    "Ir": (0.0, 1e-4),
    "b1": (-0.1, 0.1),
    "cf1": (-0.2, 0.2),
    "b2": (-0.1, 0.1),
    "cf2": (-0.2, 0.2),
}
MOST_VELOCITY_NOISE = 0.5  # rad/s, standard deviation
MOST_TORQUE_NOISE = 1.1  # N·m, standard deviation
RESPONSES = (0.1, 2.0)
MOST_DELAY = 0.04  # s
PUSH_WIDTHS, PUSH_TORQUES = (0.05, 0.1), (0.5, 5.0)  # s and N·m

# TVLQR, AR-EAPO and MC-PILCO + LQR of the pendubot's second simulation leaderboard,
# and the best of the acrobot's, in percent
PUBLISHED = {
    "TVLQR": (62.9, 90.5, 100.0, 100.0, 42.9, 64.0),
    "AR-EAPO": (87.6, 81.0, 100.0, 100.0, 81.0, 98.0),
    "MC-PILCO": (24.8, 76.2, 61.9, 95.2, 28.6, 82.0),
    "TVLQR, acrobot": (48.1, 19.0, 100.0, 95.2, 23.8, 78.0),
}
CRITERIA = ("model", "velocity_noise", "torque_noise", "torque_response", "delay", "perturbations")


# torques (N, 1), N·m, of a control step and the measured states (N, 4)
Controller = Callable[[int, Tensor], Tensor]


@dataclass(frozen=True, eq=False)
class Cases:
    """N simulations of one criterion.

    Args:
        repetitions: of each case; it counts if most of them succeed.
        plants: N of them; of all others the entries are (N,) too.
        velocity_noise, torque_noise: standard deviations, rad/s and N·m.
        response: part of the way to the asked torque that a time step of 2 ms goes.
        delay: time steps of 2 ms since the measured state.
        pushes: torques on the motor, (STEPS, N), N·m.
    """

    repetitions: int
    plants: list[Plant]
    velocity_noise: Tensor
    torque_noise: Tensor
    response: Tensor
    delay: Tensor
    pushes: Tensor


def cases(plants: list[Plant], repetitions: int = 1, **varied: Tensor) -> Cases:
    """Cases in which all is as it should be, but for what is varied."""
    count = len(plants)
    still = {
        "velocity_noise": torch.zeros(count).double(),
        "torque_noise": torch.zeros(count).double(),
        "response": torch.ones(count).double(),
        "delay": torch.zeros(count).long(),
        "pushes": torch.zeros(STEPS, count).double(),
    }
    return Cases(repetitions, plants, **(still | varied))


def varied_plants() -> list[Plant]:
    """The plant with each parameter at each of its levels."""
    nominal, plants = Plant(), []
    for entry in fields(Plant):
        value = getattr(nominal, entry.name)
        if entry.name in FACTORS:
            low, high = 0.75 * value, 1.25 * value
        else:
            low, high = RANGES[entry.name]
        levels = np.linspace(low, high, LEVELS).tolist()
        plants += [replace(nominal, **{entry.name: level}) for level in levels]
    return plants


def push_profiles(generator: np.random.Generator) -> Tensor:
    """Random pushes (STEPS, PROFILES), N·m: sums of Gaussian bells of either sign."""
    times, last = TIME_STEP * np.arange(STEPS)[:, None], STEPS * TIME_STEP
    free = (last - (PUSHES + 1)) / PUSHES  # s, beyond the second between two
    profiles = []
    for _ in range(PROFILES):
        centres = np.cumsum(1 + free * generator.random(PUSHES))
        own = generator.permutation(centres)[: PUSHES // 2]  # the others are on the other joint
        widths = generator.uniform(*PUSH_WIDTHS, PUSHES // 2)
        torques = generator.uniform(*PUSH_TORQUES, PUSHES // 2)
        torques *= generator.choice([-1, 1], PUSHES // 2)
        profiles.append((torques * np.exp(-(((times - own) / widths) ** 2) / 2)).sum(-1))
    return torch.from_numpy(np.stack(profiles, -1))


def criteria(generator: np.random.Generator) -> dict[str, Cases]:
    """The cases of each criterion, by its name in ``CRITERIA``."""

    def levels(low: float, high: float, repetitions: int = 1) -> Tensor:
        return torch.linspace(low, high, LEVELS).double().repeat_interleave(repetitions)

    once, often = [Plant()] * LEVELS, [Plant()] * (LEVELS * REPETITIONS)
    velocity, torque = (
        levels(0.0, most, REPETITIONS) for most in (MOST_VELOCITY_NOISE, MOST_TORQUE_NOISE)
    )
    delay = (levels(0.0, MOST_DELAY) / TIME_STEP).round().long()
    return {
        "model": cases(varied_plants()),
        "velocity_noise": cases(often, REPETITIONS, velocity_noise=velocity),
        "torque_noise": cases(often, REPETITIONS, torque_noise=torque),
        "torque_response": cases(once, response=levels(*RESPONSES)),
        "delay": cases(once, delay=delay),
        "perturbations": cases([Plant()] * PROFILES, pushes=push_profiles(generator)),
    }


def robustness(controller: Controller, joint: int, seed: int) -> dict[str, float]:
    """The fraction of successes of each criterion, and their mean as ``"score"``.

    Args:
        controller: acts at 25 Hz.
        joint: that it moves, 0 or 1.
        seed: of noise and pushes.
    """
    known, generator = criteria(np.random.default_rng(seed)), torch.Generator().manual_seed(seed)
    found = {name: fraction(controller, own, joint, generator) for name, own in known.items()}
    return found | {"score": sum(found.values()) / len(found)}


@torch.no_grad()
def fraction(controller: Controller, own: Cases, joint: int, generator: torch.Generator) -> float:
    """The fraction of the cases that succeed."""
    start = torch.tensor(HANGING, dtype=torch.float64)
    torques = motor(controller, own, joint, generator)
    end = simulated(stacked(own.plants), start, torques)[-FINAL_STEPS:]
    succeeded = (tip_height(end) > LINE).all(0).double().reshape(-1, own.repetitions).mean(-1)
    return (succeeded > 0.5).double().mean().item()


def motor(
    controller: Controller, own: Cases, joint: int, generator: torch.Generator
) -> Callable[[int, Tensor], Tensor]:
    """Torques (N, 2) that the cases apply at a time step, from its number and the states so far."""
    held = round(CONTROL_PERIOD / TIME_STEP)
    everyone = torch.arange(len(own.plants))
    asked, applied = (torch.zeros(len(own.plants)).double() for _ in range(2))

    def drawn(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    def torques(step: int, states: Tensor) -> Tensor:
        if step % held == 0:
            seen = states[(step - own.delay).clamp_min(0), everyone].clone()
            seen[:, 1::2] += own.velocity_noise[:, None] * drawn(len(everyone), 2)
            asked[:] = controller(step // held, seen)[:, 0]
        applied[:] = applied + own.response * (asked - applied)
        noise = own.torque_noise * drawn(len(everyone))
        both = torch.zeros(len(everyone), 2).double()
        both[:, joint] = (applied + noise + own.pushes[step]).clamp(-TORQUE_LIMIT, TORQUE_LIMIT)
        return both

    return torques
