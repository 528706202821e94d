"""What a prediction asks of a policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor, nn

from torch_pmil.checks import check_positive_entries, check_tensor

Act = Callable[[Tensor], Tensor]  # actions (*batch, F) at features of the state (*batch, D')


class Policy(Protocol):
    """Anything that gives a controller to a prediction.

    A :class:`~torch_pmil.control.rbf_policy.Controller` acts on beliefs too, so that moments are
    known in closed form. Any other function of the features is predicted by samples.
    """

    @property
    def controller(self) -> Act:
        """Controller of one state, or of N states for N targets."""


class PolicyNetwork(nn.Module):
    """Base class of policies with parameters, from features to actions within their range.

    Args:
        scale: typical size of each input (D',), in its unit.
        u_max: largest distances (F,) of an action from the middle of its range, in its unit.
        u_middle: middles of the actions' ranges (F,); None for zero.

    Raises:
        TypeError: one of them is not a tensor.
        ValueError: one has another shape, or a number is not finite or not positive.
    """

    u_max: Tensor
    u_middle: Tensor
    scale: Tensor

    def __init__(self, scale: Tensor, u_max: Tensor, u_middle: Tensor | None = None) -> None:
        super().__init__()
        check_tensor("scale", scale, ("inputs",))
        check_tensor("u_max", u_max, ("F",))
        check_positive_entries("scale", scale)
        check_positive_entries("u_max", u_max)
        u_middle = torch.zeros_like(u_max) if u_middle is None else u_middle
        check_tensor("u_middle", u_middle, (len(u_max),))
        self.register_buffer("u_max", u_max.double())
        self.register_buffer("u_middle", u_middle.double())
        self.register_buffer("scale", scale.double())

    @property
    def num_inputs(self) -> int:
        """Number D' of features that it sees, and of a target's entries."""
        return len(self.scale)
