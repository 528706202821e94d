"""The wrappers and transforms around an environment, and what each of them does to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.transforms import Compose

from torch_pmil.envs.gym_tasks import gymnasium

TRIED_STEPS = 5
ALIKE = 1e-6  # relative difference of readings that are the same


def transforms_of(env: EnvBase) -> list[object]:
    """Transforms of an environment of TorchRL, the innermost first."""
    found: list[object] = []
    while isinstance(env, TransformedEnv):
        own = env.transform
        found = [*(own if isinstance(own, Compose) else [own]), *found]
        env = env.base_env
    return [env, *found]


def wrappers_of(env: EnvBase) -> list[Any]:
    """Environments of gymnasium inside one of TorchRL, the innermost first; [] if there is none."""
    layer = getattr(transforms_of(env)[0], "_env", None)
    if gymnasium is None or not isinstance(layer, gymnasium.Env):
        return []
    layers = [layer]
    while isinstance(layers[0], gymnasium.Wrapper):
        layers.insert(0, layers[0].env)
    return layers


def resetting_layer(env: EnvBase) -> str:
    """Class of the wrapper or transform that resets an environment by itself; "" if none does."""
    layers = [*wrappers_of(env), *transforms_of(env)]
    names = [type(layer).__name__ for layer in layers]
    return next((name for name in names if "autoreset" in name.lower().replace("_", "")), "")


def unrepeatable_layer(env: EnvBase) -> str:
    """Class of the innermost layer that shows something else after a reset by the same seed."""
    for layer in wrappers_of(env):
        first, second = _readings(layer), _readings(layer)
        if not np.allclose(first, second, rtol=ALIKE, atol=ALIKE, equal_nan=True):
            return type(layer).__name__
    base, *transforms = transforms_of(env)
    moving = [type(each).__name__ for each in transforms if "Norm" in type(each).__name__]
    return ", ".join(moving) or type(base).__name__


@contextmanager
def counted(env: EnvBase) -> Iterator[Counter[str]]:
    """Counts of the calls of ``reset`` and ``step`` of the innermost environment of gymnasium."""
    calls: Counter[str] = Counter()
    layers = wrappers_of(env)
    if not layers:
        yield calls
        return
    base, names = layers[0], ("reset", "step")
    own = {name: vars(base)[name] for name in names if name in vars(base)}
    for name in names:
        setattr(base, name, _counting(name, getattr(base, name), calls))
    try:
        yield calls
    finally:
        for name in names:
            delattr(base, name)
        vars(base).update(own)


def _counting(name: str, method: Callable[..., Any], calls: Counter[str]) -> Callable[..., Any]:
    def called(*args: Any, **given: Any) -> Any:
        calls[name] += 1
        return method(*args, **given)

    return called


def _readings(layer: Any) -> np.ndarray:
    """Readings (T + 1, D) after a seeded reset and seeded random actions."""
    layer.action_space.seed(0)
    shown = [layer.reset(seed=0)[0]]
    shown += [layer.step(layer.action_space.sample())[0] for _ in range(TRIED_STEPS)]
    return np.stack([gymnasium.spaces.flatten(layer.observation_space, each) for each in shown])
