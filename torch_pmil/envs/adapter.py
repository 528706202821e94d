"""Any TorchRL environment with continuous actions and a vector observation, as a robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec
from torchrl.envs import EnvBase, SerialEnv, step_mdp

from torch_pmil.envs.robot import RobotEnv, check_num_envs
from torch_pmil.envs.turning import Continued, within_half_a_turn
from torch_pmil.seeds import draw_seed

ENDS = ("terminated", "truncated")  # of an episode
MEND = {"observation": "; gymnasium.wrappers.FlattenObservation makes one vector"}
CIRCLE = 2.0  # radius, or its inverse, beyond which noise explains no cosine and sine


@dataclass(frozen=True)
class CosSin:
    """An angle that an environment shows as cosine and sine.

    Args:
        cos, sin: indices of the two entries of the observation.
        near: an angle near which episodes start (rad), because cosine and sine are the same after a
            whole turn.
    """

    cos: int
    sin: int
    near: float = 0.0


class AdaptedEnv(RobotEnv):
    """A robot made of a TorchRL environment, in float64 and with seeded starts.

    Keys: ``"observation"`` (*batch, D), ``"action"`` (*batch, F), ``"reward"`` (*batch, 1), all
    float64, and with ``from_pixels`` also ``"pixels"``. Actions are the environment's own, clipped
    to its range. Reward and ``"done"`` of the environment are ignored: an imitation runs for all
    its steps, unless ``guard`` ends it where the environment has terminated. An environment that
    resets itself cannot be used.

    Each ``reset`` seeds the environment from this class's own generator, which is in
    ``state_dict``. A checkpoint therefore resumes bit for bit at the start of an episode, if the
    environment respects ``set_seed``; it does not hold the state within an episode.

    Args:
        make_env: makes the environment; called with ``from_pixels=True`` only if pictures are
            wanted besides the observation. Example: ``functools.partial(GymEnv,
            "InvertedPendulum-v5", pixels_only=False)``.
        control_period: seconds between two actions, which an environment does not report.
        num_envs: None for one robot with the batch size of the environment, N for N of them with
            batch size (N,).
        observation, action: keys of the environment.
        angles: angles that the observation holds as cosine and sine. The angle, not limited to one
            turn, replaces the cosine; the sine is left out.
        from_pixels: whether to have pictures.
        seed: of the generator of the starts; None takes entropy from the system.

    Raises:
        TypeError: ``make_env`` does not make an environment.
        ValueError: the environment lacks the observation or action, or a setting is out of range.
        RuntimeError: in a step, if an observation is not finite, or has no cosine and sine where
            ``angles`` says so.

    Example:
        >>> from functools import partial
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> make_env = partial(DoublePendulumEnv, torque_limit=2.0)
        >>> env = AdaptedEnv(make_env, control_period=0.1, num_envs=3, seed=0)
        >>> env.rollout(5)["next", "observation"].shape
        torch.Size([3, 5, 4])
    """

    def __init__(
        self,
        make_env: Callable[..., EnvBase],
        control_period: float,
        *,
        num_envs: int | None = None,
        observation: NestedKey = "observation",
        action: NestedKey = "action",
        angles: Sequence[CosSin] = (),
        from_pixels: bool = False,
        seed: int | None = None,
    ) -> None:
        check_num_envs(num_envs)
        if isinstance(make_env, EnvBase):
            raise TypeError(f"make_env must make the environment, got {type(make_env).__name__}")
        make = partial(make_env, **({"from_pixels": True} if from_pixels else {}))
        env = make() if num_envs is None else SerialEnv(num_envs, make)
        if not isinstance(env, EnvBase):
            raise TypeError(f"make_env must make an EnvBase, got {type(env).__name__}")
        super().__init__(env.batch_size, float(control_period), from_pixels, seed)
        self.__dict__["base_env"] = env  # no submodule: its state is not ours to save
        self.angles, self._observation, self._action = tuple(angles), observation, action
        self._make_specs()

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the actions, if the environment is a robot of this package."""
        robot = self.base_env
        return robot.action_names if isinstance(robot, RobotEnv) else super().action_names

    @property
    def action_units(self) -> tuple[str, ...]:
        """Units of the actions, if the environment is a robot of this package."""
        robot = self.base_env
        return robot.action_units if isinstance(robot, RobotEnv) else super().action_units

    def close(self, **kwargs: Any) -> None:
        """Close the environment."""
        self.base_env.close(**kwargs)
        super().close(**kwargs)

    def _make_specs(self) -> None:
        batch_dims, shown = len(self.batch_size), self.base_env.observation_spec
        dim = _vector(shown, self._observation, "observation", batch_dims).shape[-1]
        limits = _box(self.base_env.full_action_spec, self._action, batch_dims)
        self._low, self._high = limits.space.low.double(), limits.space.high.double()
        self._kept = _kept_entries(self.angles, dim)
        more = {"pixels": _entry(shown, "pixels", "pictures").clone()} if self.from_pixels else {}
        self._set_specs(len(self._kept), self._low, self._high, more)

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is not None and not mask.all():
            raise ValueError(
                f"all robots must be reset together, got a mask with {int(mask.sum())} of "
                f"{mask.numel()}"
            )
        self.cut_short, self.terminated, self.unread = "", False, False
        self.base_env.set_seed(draw_seed(self._generator))
        self._last = self.base_env.reset()
        near = torch.tensor([angle.near for angle in self.angles], dtype=torch.float64)
        self._turned = near.expand(*self.batch_size, len(self.angles))
        self._continued = Continued(self.turning_entries)
        return self._measure()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"]
        if not action.isfinite().all():
            raise ValueError(f"action must be finite, got {action.tolist()}")
        action = action.clamp(self._low, self._high)
        dtype = self.base_env.full_action_spec[self._action].dtype
        why = self._act(self._last.set(self._action, action.to(dtype)))
        result = self._without_reward(self._measure())
        if why:
            self.cut_short, self.unread = why, True
            result["done"] = torch.ones_like(result["done"])
        return result

    def _act(self, commanded: TensorDictBase) -> str:
        """Take an action; return why there is no reading of what followed, or ""."""
        ends = _ends(commanded)
        try:
            following = step_mdp(self.base_env.step(commanded))
        except Exception as problem:  # of any kind: the environment is a user's
            if not ends:
                raise
            return f"the environment was {ends[0]} and takes no more actions ({problem!r:.80})"
        ends = _ends(following)
        self.terminated = "terminated" in ends
        if ends and not following[self._observation].isfinite().all():
            return "the environment ended without a reading"
        self._last = following
        return ""

    def _measure(self) -> TensorDictBase:
        shown = self._last[self._observation].double()
        if not shown.isfinite().all():
            raise RuntimeError(
                f"the environment's observation must be finite, got {shown.tolist()}: return the "
                "last reading where the simulation fails, or limit the actions"
            )
        measured = {"observation": self._state(self._continued(shown))}
        if self.from_pixels:
            measured["pixels"] = self._last["pixels"].clone()
        return TensorDict(measured, batch_size=self.batch_size)

    def _state(self, shown: Tensor) -> Tensor:
        """Observations with angles, each continued from the step before."""
        if not self.angles:
            return shown
        cosines, sines = [angle.cos for angle in self.angles], [angle.sin for angle in self.angles]
        radius = torch.hypot(shown[..., sines], shown[..., cosines])
        if not ((radius > 1 / CIRCLE) & (radius < CIRCLE)).all():
            raise RuntimeError(
                f"entries {cosines} and {sines} of the observation must be cosines and sines, got "
                f"{shown[..., cosines].tolist()} and {shown[..., sines].tolist()}"
            )
        change = torch.atan2(shown[..., sines], shown[..., cosines]) - self._turned
        self._turned = self._turned + within_half_a_turn(change)
        state = shown.clone()
        state[..., cosines] = self._turned
        return state[..., self._kept]


def _ends(step: TensorDictBase) -> list[str]:
    """How the episode of an environment ended, if it did."""
    return [name for name in ENDS if name in step and step[name].any()]


def _entry(specs: Composite, key: NestedKey, role: str) -> TensorSpec:
    names = sorted(str(name) for name in specs.keys(True, True))
    if str(key) not in names:
        raise ValueError(
            f"the environment must have {role} under {key!r}, got {', '.join(names) or 'nothing'}"
            f"{MEND.get(role, '')}"
        )
    return specs[key]


def _vector(specs: Composite, key: NestedKey, role: str, batch_dims: int) -> TensorSpec:
    spec = _entry(specs, key, role)
    if not spec.dtype.is_floating_point or len(spec.shape) != batch_dims + 1:
        kind = f"{type(spec).__name__} of {spec.dtype} with shape {tuple(spec.shape[batch_dims:])}"
        raise ValueError(
            f"the environment's {role} {key!r} must be a vector of real numbers, got {kind}"
            f"{MEND.get(role, '')}"
        )
    return spec


def _box(specs: Composite, key: NestedKey, batch_dims: int) -> TensorSpec:
    spec = _vector(specs, key, "action", batch_dims)
    bounded = isinstance(spec, Bounded)
    if not (bounded and spec.space.low.isfinite().all() and spec.space.high.isfinite().all()):
        raise ValueError(
            f"the environment's action {key!r} must have finite limits, got {type(spec).__name__}"
        )
    return spec


def _kept_entries(angles: Sequence[CosSin], dim: int) -> list[int]:
    """Indices of an observation that stay when angles replace cosines."""
    used = [index for angle in angles for index in (angle.cos, angle.sin)]
    if len(set(used)) < len(used) or not set(used) <= set(range(dim)):
        raise ValueError(
            f"angles must be of different entries of the {dim} observed, got "
            f"{', '.join(map(str, angles))}"
        )
    return [index for index in range(dim) if index not in {angle.sin for angle in angles}]
