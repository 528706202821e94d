"""Calling custom autograd functions."""

from __future__ import annotations

import torch
from torch import Tensor


def apply(function: type[torch.autograd.Function], *arguments: object) -> Tensor | tuple[Tensor, ...]:
    """``function.apply``; where no graph is recorded its forward pass alone, which small tensors notice.

    The function must have a ``setup_context``, so that its ``forward`` takes no context.
    """
    return (function.apply if torch.is_grad_enabled() else function.forward)(*arguments)
