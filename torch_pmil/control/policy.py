"""What a prediction asks of a policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from torch import Tensor

Act = Callable[[Tensor], Tensor]  # actions (*batch, F) at features of the state (*batch, D')


class Policy(Protocol):
    """Anything that gives a controller to a prediction.

    A :class:`~torch_pmil.control.rbf_policy.Controller` acts on beliefs too, so that moments are
    known in closed form. Any other function of the features is predicted by samples.
    """

    @property
    def controller(self) -> Act:
        """Controller of one state, or of N states for N targets."""
