"""The BioRob of Sec. 5.2: a light arm with elastic cables, a racket, and a ball on a string."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any, Unpack

import mujoco
import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Unbounded

from torch_pmil.envs.equilibrium import Equilibrium
from torch_pmil.envs.mujoco import MujocoRobotEnv, RobotSettings
from torch_pmil.envs.mujoco_model import asset, state_columns

JOINTS = ("yaw", "shoulder", "elbow")
ROTORS = ("yaw_motor", "shoulder_motor", "elbow_motor")
HELD = ("wrist_roll", "wrist_pitch")
TORQUE_LIMIT = (10.0, 20.0, 10.0)  # N·m, estimate
START = (-0.15, 0.35, 1.2, 0.0, 0.0, 0.0)  # rad, rad/s
START_STD = (0.03, 0.03, 0.03, 0.05, 0.05, 0.05)
BALL = (0.757, 0.076, 1.127)  # m
STRING = 1.02  # m, from the ceiling to the ball's centre


class BioRobEnv(MujocoRobotEnv):
    """The compliant, tendon-driven BioRob X4 with a racket, in MuJoCo, at 10 Hz (Sec. 5.2).

    The state is x = [q, dq] of yaw, shoulder and elbow (rad, rad/s): positions first. Yaw turns to
    the left; with shoulder and elbow at 0 the arm hangs, and positive angles lift it forwards. The
    action is the torque of the three motors in N·m, reflected to the joints. Cables alone couple
    motors and joints. Hence the motors' angles are hidden, like the ball: a reset puts the motors
    where cables and gravity balance, moving with their joints, and the ball at rest.

    ``("info", "racket_ball_distance")`` (*batch, 1), float64, is the least distance in m between
    the surfaces of racket and ball since the last step (at a reset: now), and ``("info",
    "centre_distance")`` that between their centres. ``("info", "hit")`` (*batch, 1), bool, is True
    once the racket has touched the ball since the reset. A hit does not end the episode.

    Stated in the paper: the structure, joints, controlled joints and control rate. Estimates: the
    start and all numbers of the model, explained in its file.

    Args:
        ball: where the ball hangs, (3,) for all robots or (num_envs, 3) one for each, in m; x
            forwards, y to the left, z up from the floor.
        settings: such as ``num_envs`` and ``seed``: see :class:`MujocoRobotEnv`.

    Raises:
        ValueError: a setting has the wrong shape or range.

    Example:
        >>> env = BioRobEnv(seed=0)
        >>> rollout = env.rollout(18)
        >>> rollout["next", "observation"].shape, rollout["next", "info", "hit"].dtype
        (torch.Size([18, 6]), torch.bool)
    """

    _hit: Tensor

    def __init__(
        self, ball: Sequence[float] | Tensor = BALL, **settings: Unpack[RobotSettings]
    ) -> None:
        num_envs = settings.get("num_envs")
        defaults = RobotSettings(initial_mean=START, initial_std=START_STD, pixel_size=(480, 480))
        super().__init__(
            _models(ball, num_envs),
            JOINTS,
            positions_first=True,
            torque_limit=TORQUE_LIMIT,
            **(defaults | settings),
        )
        self.register_buffer("_hit", torch.zeros(num_envs or 1, dtype=torch.bool))

    @cached_property
    def _equilibrium(self) -> Equilibrium:
        return Equilibrium(self.model, JOINTS, ROTORS, HELD)

    def _physics_from_state(self, state: Tensor, models: Sequence[mujoco.MjModel]) -> Tensor:
        physics = super()._physics_from_state(state, models)
        arm = self.model.joint("ball").qposadr[0]  # number of the arm's entries in qpos
        positions, velocities = state.to(torch.float64).numpy().reshape(-1, 2, 3).swapaxes(0, 1)
        speeds = state_columns(self.model, ROTORS, positions_first=True)[len(ROTORS) :]
        physics[:, 1 : 1 + arm] = torch.from_numpy(self._equilibrium(positions)[0])[:, :arm]
        physics[:, speeds] = torch.from_numpy(velocities @ self._equilibrium.ratio.T)
        return physics

    def _inverse_dynamics(
        self, positions: np.ndarray, velocities: np.ndarray, accelerations: np.ndarray
    ) -> np.ndarray:
        return self._equilibrium.moving_torques(positions, velocities, accelerations)

    def _make_specs(self) -> None:
        super()._make_specs()
        shape = (*self.batch_size, 1)
        for name in ("racket_ball_distance", "centre_distance"):
            self.observation_spec["info", name] = Unbounded(shape, dtype=torch.float64)
        self.observation_spec["info", "hit"] = Binary(shape=shape, dtype=torch.bool)

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        self._hit = torch.zeros_like(self._hit) if mask is None else self._hit & ~mask.flatten()
        return super()._reset(tensordict, **kwargs)

    def _measure(self, sensors: Tensor) -> TensorDictBase:
        distance = sensors[..., self.model.sensor("racket_ball_distance").adr[0]]
        contact = sensors[..., self.model.sensor("racket_ball_contact").adr[0]]
        self._hit = self._hit | (contact > 0).any(-1)
        first = self.model.sensor("ball_from_racket").adr[0]
        between = sensors[..., first : first + 3].norm(dim=-1)
        info = {
            "racket_ball_distance": distance.amin(-1),
            "centre_distance": between.amin(-1),
            "hit": self._hit,
        }
        measured = super()._measure(sensors)
        measured["info"] = TensorDict(
            {name: value.reshape(*self.batch_size, 1) for name, value in info.items()},
            batch_size=self.batch_size,
        )
        return measured


def _models(
    ball: Sequence[float] | Tensor, num_envs: int | None
) -> mujoco.MjModel | list[mujoco.MjModel]:
    """One model, or one for each robot if each has a place of its ball; equal places share."""
    places = torch.as_tensor(ball, dtype=torch.float64)
    if places.ndim != 2:
        return biorob_model(ball)
    if places.shape != (num_envs, 3):
        each = "" if num_envs is None else f" or ({num_envs}, 3)"
        raise ValueError(f"ball must have shape (3,){each}, got {tuple(places.shape)}")
    distinct, robots = places.unique(dim=0, return_inverse=True)
    models = [biorob_model(place) for place in distinct]
    return [models[index] for index in robots]


def biorob_model(ball: Sequence[float] | Tensor = BALL) -> mujoco.MjModel:
    """The MuJoCo model of the BioRob with its ball hanging at ``ball``, (3,) in m.

    Raises:
        ValueError: the place is not three finite numbers.

    Example:
        >>> biorob_model((0.8, 0.0, 1.1)).body("ball").pos
        array([0.8, 0. , 1.1])
    """
    place = torch.as_tensor(ball, dtype=torch.float64)
    if place.shape != (3,) or not place.isfinite().all():
        raise ValueError(f"ball must be 3 finite numbers in m, got {place.tolist()}")
    spec = asset("biorob/scene.xml")
    spec.body("ball").pos = place.numpy()
    spec.site("ceiling").pos = place.numpy() + np.array([0.0, 0.0, STRING])
    return spec.compile()


def holding_torques(q: Tensor) -> Tensor:
    """Motor torques (*batch, 3), N·m, that hold the arm at q (*batch, 3), rad, against gravity.

    Friction is not included, and torques may lie beyond the limits.

    Raises:
        RuntimeError: no equilibrium was found.

    Example:
        >>> holding_torques(torch.tensor([0.0, 0.5, 0.9])).round(decimals=1) + 0.0
        tensor([0.0000, 3.0000, 2.2000], dtype=torch.float64)
    """
    poses = q.detach().to(torch.float64).reshape(-1, 3).numpy()
    return torch.from_numpy(_default_equilibrium()(poses)[1]).reshape(q.shape)


@cache
def _default_equilibrium() -> Equilibrium:
    return Equilibrium(biorob_model(), JOINTS, ROTORS, HELD)
