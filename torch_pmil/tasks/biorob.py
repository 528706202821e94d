"""Section 5.2: a compliant arm learns to hit a ball from three kinesthetic demonstrations."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.control.exploration import PDMovements
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.biorob import JOINTS, BioRobEnv, holding_torques
from torch_pmil.envs.racket import distance_along
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.fitting import simulated_parts
from torch_pmil.tasks.method import EndingSettings, Method, PolicySettings
from torch_pmil.tasks.task import Task

NOISE_STD = (0.03, 0.03, 0.03, 0.3, 0.3, 0.3)  # rad, rad/s
INPUT_WIDTHS = (0.2, 0.4, 0.6, 0.5, 2.0, 2.5)  # rad, rad/s
LEAST_REACH = 6.0  # degrees, three times the standard deviation of a joint's start
STIFFNESS = (20.0, 25.0, 10.0)  # N·m/rad
# N·m·s/rad: more, held for 0.1 s, makes these light joints swing from limit to limit
DAMPING = (0.5, 1.0, 0.3)
# nats per step and observed entry; with 0.75 the search stalls where the strike begins
SEARCH = SearchSettings(mean_iterations=0, final_iterations=160, trust_threshold=2.0)


def biorob_space() -> StateSpace:
    """State [q, dq] of yaw, shoulder and elbow, matched as it is; no joint turns round.

    Example:
        >>> biorob_space().names
        ('q_yaw', 'q_shoulder', 'q_elbow', 'dq_yaw', 'dq_shoulder', 'dq_elbow')
    """
    names = tuple(f"{quantity}_{joint}" for quantity in ("q", "dq") for joint in JOINTS)
    units = ("rad",) * len(JOINTS) + ("rad/s",) * len(JOINTS)
    return StateSpace(names, units, (), joint_match(names, units))


def distance_from_ball(rollout: TensorDictBase) -> Tensor:
    """Least distance (m) of racket and ball in rollouts (*batch, T), 0 for a hit; (*batch)."""
    info = rollout["next", "info"]
    hit, distance = info["hit"][..., 0].any(-1), info["racket_ball_distance"][..., 0].amin(-1)
    return torch.where(hit, torch.zeros_like(distance), distance)


def holding_torques_at(states: Tensor) -> Tensor:
    """Motor torques (*batch, 3), N·m, that hold the joints in states (*batch, 6)."""
    return holding_torques(states[..., : len(JOINTS)])


def demonstrated_reach(positions: Tensor, start: Tensor) -> Tensor:
    """Whole degrees (3,) that demonstrated positions (..., 3), rad, go from the start, or more.

    Example:
        >>> demonstrated_reach(torch.tensor([[0.0, 0.5, -0.2]]), torch.zeros(3))
        tensor([ 6., 29., 12.])
    """
    farthest = (positions - start).abs().flatten(0, -2).amax(0)
    return farthest.rad2deg().ceil().clamp(min=LEAST_REACH)


def movements_around(start: Tensor, reach: Tensor, u_max: Tensor) -> PDMovements:
    """Movements around the start, 3 times 2 s at 10 Hz, a new target every 0.5 s (Section 5.2.4).

    The start is a state (6,), the reach in degrees (3,), and ``u_max`` the torque limits (3,), N·m.
    """
    still = torch.zeros(len(JOINTS), dtype=torch.float64)
    reach = torch.cat([reach.deg2rad(), still])
    pose = torch.cat([start[: len(JOINTS)], still])
    gains = [torch.tensor(gain, dtype=torch.float64).diag() for gain in (STIFFNESS, DAMPING)]
    gain = torch.cat(gains, 1)
    return PDMovements(
        pose, reach, gain, u_max, hold=5, rollouts=3, steps=20, feedforward=holding_torques_at
    )


def biorob(demonstrations: Demonstrations | None = None) -> Task:
    """The experiment of Section 5.2.4: one ball.

    It has 80 basis functions, 738 policy parameters, and 1.8 s at 10 Hz with the shipped
    demonstrations.

    A success is a hit, which says little of how alike the motions are: a run goes on until four own
    rollouts in a row have hit.

    Args:
        demonstrations: entries of :func:`biorob_space` at 10 Hz; None for the package's own.
            Others raise :class:`DemonstrationError`.
    """
    env = BioRobEnv()
    parts = simulated_parts("biorob", env, biorob_space(), demonstrations)
    positions, start = parts["demonstrations"].positions, env.initial_mean
    reach = demonstrated_reach(positions[..., : len(JOINTS)], start[: len(JOINTS)])
    return Task(
        **parts,
        make_env=BioRobEnv,
        noise_std=torch.tensor(NOISE_STD, dtype=torch.float64),
        error=distance_from_ball,
        tolerance=0.0,
        predicted_error=distance_along,
        holding_actions=holding_torques_at,
        method=Method(
            policy=PolicySettings(
                num_centres=80, input_widths=torch.tensor(INPUT_WIDTHS, dtype=torch.float64)
            ),
            exploration=movements_around(start, reach, parts["actions"].half_range),
            search=SEARCH,
            ending=EndingSettings(confirmations=4),
        ),
    )
