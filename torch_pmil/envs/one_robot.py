"""Any environment of a user as the one robot of an experiment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from tensordict.utils import NestedKey
from torchrl.data import Bounded
from torchrl.envs import EnvBase, FrameSkipTransform, TransformedEnv
from torchrl.record import PixelRenderTransform

from torch_pmil.checks import check_whole, whole_multiple
from torch_pmil.envs.adapter import AdaptedEnv, CosSin
from torch_pmil.envs.gym_api import GymnasiumEnv
from torch_pmil.envs.gym_tasks import check_gymnasium, gymnasium
from torch_pmil.envs.layers import resetting_layer
from torch_pmil.envs.robot import RobotEnv, check_num_envs
from torch_pmil.envs.turning import Turning
from torch_pmil.files import short

PICTURE = 3  # dimensions


class OneRobot:
    """Makes all environments of an experiment from a single one.

    They all move the same robot, so only one may be in use at a time. Several robots are replaced
    by one robot that starts several times, one rollout after the other. A physical robot is used
    as it is, and never as several.

    Args:
        env: an environment of TorchRL or gymnasium, or the name of one of gymnasium.
        control_period: seconds between two actions.
        angles: angles that the observation holds as cosine and sine.
        steps_per_action: steps of the environment for which an action is held. If None, a gymnasium
            environment holds it for the steps of ``dt`` in a control period, and an environment of
            TorchRL for one step.

    ``name`` is that of the environment; ``draws`` is True if it gives pictures, ``physical`` if it
    is a physical robot.

    Raises:
        TypeError: ``env`` is not an environment.
        ValueError: the control period is not a whole number of the environment's steps, or their
            length is unknown. The environment resets itself, or has the API of the old gym. A robot
            of this package has another period. Or a physical robot shows cosine and sine, or is
            asked for several times.
        ModuleNotFoundError: gymnasium is not installed.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> robot = OneRobot(DoublePendulumEnv(), control_period=0.1)
        >>> robot(num_envs=3, seed=0).rollout(5)["next", "observation"].shape
        torch.Size([3, 5, 4])
    """

    def __init__(
        self,
        env: Any,
        control_period: float,
        angles: Sequence[CosSin] = (),
        steps_per_action: int | None = None,
    ) -> None:
        if steps_per_action is not None:
            check_whole("steps_per_action", steps_per_action, 1)
        if isinstance(env, str):
            check_gymnasium()
            env = gymnasium.make(env, render_mode="rgb_array")
        self.control_period, self.angles = control_period, tuple(angles)
        self.turning_entries: tuple[Turning, ...] = ()  # of angles that are shown as they are
        self.physical = isinstance(env, RobotEnv) and env.physical
        if isinstance(env, RobotEnv):
            check_period(env.control_period, self.control_period, steps_per_action)
        if self.physical and self.angles:
            raise ValueError("a physical robot must show its angles, got cosine and sine of them")
        steps = steps_per_action or 1
        if isinstance(env, EnvBase):
            self.env, self.name = env, type(env).__name__
            self.draws = "pixels" in env.observation_spec
        elif gymnasium is not None and isinstance(env, gymnasium.Env):
            steps = steps_per_action or _steps_of(env, control_period)
            self.env = GymnasiumEnv(env)
            self.name = env.spec.id if env.spec else type(env.unwrapped).__name__
            self.draws = env.render_mode == "rgb_array"
        else:
            got = f"the class {env.__name__}" if isinstance(env, type) else type(env).__name__
            raise TypeError(
                "env must be an environment of TorchRL or gymnasium, or the name of one of "
                f"gymnasium (shimmy converts those of gym), got {got}"
            )
        if layer := resetting_layer(self.env):
            raise ValueError(
                f"env must not reset itself within a motion, got one with {layer}: remove it"
            )
        if steps > 1:
            self.env = TransformedEnv(self.env, FrameSkipTransform(steps))

    def __call__(
        self, num_envs: int | None = None, from_pixels: bool = False, seed: int | None = None
    ) -> RobotEnv:
        """The robot, or with ``num_envs`` the robot from that many starts in turn."""
        if self.physical:
            if num_envs is not None:
                raise ValueError(f"a physical robot is one, got num_envs = {num_envs}")
            self.env.turning_entries = self.turning_entries
            return self.env
        settings: dict[str, Any] = {
            "observation": self._observation,
            "angles": self.angles,
            "from_pixels": from_pixels,
            "seed": seed,
        }
        check_num_envs(num_envs)
        robot = AdaptedEnv(self._made, self.control_period, **settings)
        robot.turns, robot.turning_entries = num_envs, self.turning_entries
        return robot

    @property
    def dim(self) -> int:
        """Number of entries of its state."""
        return self(seed=0).observation_spec["observation"].shape[-1]

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Lowest and highest value of each observed entry, infinite if unknown."""
        spec = self.env.observation_spec[self._observation]
        if not isinstance(spec, Bounded):
            return [(-math.inf, math.inf)] * spec.shape[-1]
        return list(zip(spec.space.low.tolist(), spec.space.high.tolist(), strict=True))

    def _made(self, from_pixels: bool = False) -> EnvBase:
        if not from_pixels or "pixels" in self.env.observation_spec:
            return self.env
        return TransformedEnv(self.env, PixelRenderTransform(preproc=_picture))

    @property
    def _observation(self) -> NestedKey:
        """Key of the only vector, or else the usual key."""
        vectors = [
            key
            for key, spec in self.env.observation_spec.items(True, True)
            if spec.dtype.is_floating_point and spec.ndim == 1
        ]
        return vectors[0] if len(vectors) == 1 else "observation"


def _picture(rendered: Any) -> np.ndarray:
    """What ``render`` returned, in C order; RuntimeError unless it is a picture."""
    picture = np.ascontiguousarray(rendered)
    if picture.ndim != PICTURE:
        raise RuntimeError(
            f"render() must return a picture (height, width, 3), got {short(rendered)}"
        )
    return picture


def length_of_step(env: gymnasium.Env) -> float | None:
    """Seconds that a step of a gymnasium environment lasts, its ``dt``; None if it has none."""
    step: Any = getattr(env.unwrapped, "dt", None)
    number = isinstance(step, Real | np.number) and not isinstance(step, bool)
    return float(step) if number and 0 < step < math.inf else None


def check_period(
    own: float, control_period: float, steps: int | None, rounded: float = 1e-6
) -> None:
    """Raise ValueError unless a robot of this package is used at its own control period.

    The two may differ relatively by ``rounded``.
    """
    if not math.isclose(own, control_period, rel_tol=rounded) or steps not in (None, 1):
        raise ValueError(
            f"control_period must be that of the robot, {own:g} s, got "
            f"{control_period:g} s{f' and {steps} steps_per_action' if steps else ''}"
        )


def _steps_of(env: gymnasium.Env, control_period: float) -> int:
    """Number of the environment's steps in a control period."""
    step = length_of_step(env)
    if step is None:
        raise ValueError(
            f"steps_per_action must be given, since {type(env.unwrapped).__name__} has no dt: the "
            f"number of its steps in {control_period:g} s, got none"
        )
    steps = whole_multiple(control_period, step)
    if steps is None:
        raise ValueError(
            f"control_period must be a whole number of the environment's steps of {step:g} s, got "
            f"{control_period:g} s"
        )
    return steps
