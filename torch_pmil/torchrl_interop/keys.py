"""TorchRL's keys of beliefs, and functions that read beliefs from a TensorDict."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from torch_pmil.checks import check_tensor
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian

# keys of plain values, then of beliefs
OBSERVATION, ACTION, NEXT_OBSERVATION = "observation", "action", ("next", "observation")
STATE_BELIEF = [("observation", "mean"), ("observation", "var")]
# the last is Sigma_x^-1 cov(x, u)
ACTION_BELIEF = [("action", "mean"), ("action", "var"), ("action", "cross_covariance")]
# Sigma_f^-1 cov(f, u) for features f that are not the state
FEATURE_CROSS_COVARIANCE = ("action", "feature_cross_covariance")
NEXT_BELIEF = [("next", "observation", "mean"), ("next", "observation", "var")]


def raw_space(dim: int) -> StateSpace:
    """State space of entries x0, x1, ... without angles."""
    names, units = tuple(f"x{i}" for i in range(dim)), ("",) * dim
    return StateSpace(names, units, (), joint_match(names, units))


def lookup(tensordict: TensorDictBase, key: NestedKey, shape: tuple[int, ...]) -> Tensor | None:
    """The entry of a key in float64, or None where a part of its path is missing.

    Raises ValueError where its last dimensions are not ``shape``.
    """
    value = tensordict
    for part in key if isinstance(key, tuple) else (key,):
        value = value.get(part, None) if isinstance(value, TensorDictBase) else None
    if not isinstance(value, Tensor):
        return None
    check_tensor(str(key), value, ("*batch", *shape), finite=False)
    return value.double()


def required(tensordict: TensorDictBase, key: NestedKey, dim: int) -> Tensor:
    """The entry (*batch, dim) of a key; KeyError where it is missing."""
    value = lookup(tensordict, key, (dim,))
    if value is None:
        raise KeyError(f"expected {key} (*batch, {dim}), got the keys {keys_of(tensordict)}")
    return value


def keys_of(tensordict: TensorDictBase) -> list[NestedKey]:
    """All keys, for an error."""
    return list(tensordict.keys(include_nested=True, leaves_only=True))


def lookup_belief(
    tensordict: TensorDictBase, keys: Sequence[NestedKey], dim: int
) -> Gaussian | None:
    """The belief under two keys, or None without a mean; certain if there is no variance."""
    mean_key, var_key = keys
    mean, var = lookup(tensordict, mean_key, (dim,)), lookup(tensordict, var_key, (dim, dim))
    if mean is None:
        return None
    return Gaussian(mean, mean.new_zeros(*mean.shape, dim) if var is None else var)
