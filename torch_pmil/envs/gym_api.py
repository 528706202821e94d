"""Environments of gymnasium in TorchRL, with one line for those that have the API of gym."""

from __future__ import annotations

from inspect import signature
from typing import Any

from torchrl.envs import GymWrapper


class GymnasiumEnv(GymWrapper):
    """TorchRL's wrapper of an environment of gymnasium.

    Raises:
        ValueError: ``reset`` or ``step`` has the arguments or results of the old gym, when the
            environment is wrapped or when it is used.

    Example:
        >>> import gymnasium
        >>> GymnasiumEnv(gymnasium.make("Pendulum-v1")).rollout(3)["observation"].shape
        torch.Size([3, 3])
    """

    def __init__(self, env: Any, **settings: Any) -> None:
        taken = signature(env.reset)
        try:
            taken.bind(seed=0)
        except TypeError as error:
            raise _old(f"reset{taken}") from error
        super().__init__(env, **settings)

    def _reset_output_transform(self, reset_data: Any) -> Any:
        _check("reset", reset_data, 2)
        return super()._reset_output_transform(reset_data)

    def _output_transform(self, step_outputs_tuple: Any) -> Any:
        _check("step", step_outputs_tuple, 5)
        return super()._output_transform(step_outputs_tuple)


def _check(method: str, found: object, count: int) -> None:
    if not isinstance(found, tuple | list):
        raise _old(f"{type(found).__name__} from {method}")
    if len(found) != count:
        raise _old(f"{len(found)} values from {method}")


def _old(got: str) -> ValueError:
    # no TypeError, which TorchRL takes for a reset without a seed
    return ValueError(
        "env must have gymnasium's API: reset(seed=None, options=None) returns (observation, "
        "info), and step(action) (observation, reward, terminated, truncated, info); got "
        f"{got}: change it, or convert an environment of gym by shimmy"
    )
