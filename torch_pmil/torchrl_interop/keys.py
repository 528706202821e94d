"""TorchRL's keys of beliefs, and functions that read beliefs from a TensorDict."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian

# plain values, not beliefs
OBSERVATION, ACTION, NEXT_OBSERVATION = "observation", "action", ("next", "observation")
STATE_BELIEF = [("observation", "mean"), ("observation", "var")]
# the cross covariance is Sigma_x^-1 cov(x, u)
ACTION_BELIEF = [("action", "mean"), ("action", "var"), ("action", "cross_covariance")]
# Sigma_f^-1 cov(f, u) for features f that are not the state
FEATURE_CROSS_COVARIANCE = ("action", "feature_cross_covariance")
NEXT_BELIEF = [("next", "observation", "mean"), ("next", "observation", "var")]


def raw_space(dim: int) -> StateSpace:
    """State space without angles, of which models and policies see the entries as they are.

    Example:
        >>> raw_space(2).feature_names
        ('x0', 'x1')
    """
    names, units = tuple(f"x{i}" for i in range(dim)), ("",) * dim
    return StateSpace(names, units, (), joint_match(names, units))


def lookup(tensordict: TensorDictBase, key: NestedKey, shape: tuple[int, ...]) -> Tensor | None:
    """The entry of a key in float64, or None where the key or a part of its path is missing.

    Raises:
        ValueError: its last dimensions are not ``shape``.
    """
    path = key if isinstance(key, tuple) else (key,)
    for part in path[:-1]:
        tensordict = tensordict.get(part, None)
        if not isinstance(tensordict, TensorDictBase):
            return None
    value = tensordict.get(path[-1], None)
    if not isinstance(value, Tensor):
        return None
    if value.shape[value.ndim - len(shape) :] != shape:
        raise ValueError(
            f"{key} must have shape (*batch, {', '.join(map(str, shape))}), got "
            f"{tuple(value.shape)}"
        )
    return value.double()


def lookup_belief(
    tensordict: TensorDictBase, keys: Sequence[NestedKey], dim: int
) -> Gaussian | None:
    """The belief under two keys, ``mean`` and ``var``, or None where there is no ``mean``.

    It is certain where there is no ``var``.
    """
    mean_key, var_key = keys
    mean, var = lookup(tensordict, mean_key, (dim,)), lookup(tensordict, var_key, (dim, dim))
    if mean is None:
        return None
    return Gaussian(mean, mean.new_zeros(*mean.shape, dim) if var is None else var)
