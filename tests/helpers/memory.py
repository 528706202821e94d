"""How large the arrays are that a computation makes."""

from __future__ import annotations

from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode


class LargestResult(TorchDispatchMode):
    """Records how many numbers the largest array computed inside has; views do not count."""

    def __init__(self) -> None:
        super().__init__()
        self.numbers = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        result = func(*args, **(kwargs or {}))
        if not func.is_view:
            results = result if isinstance(result, (tuple, list)) else (result,)
            sizes = [one.numel() for one in results if isinstance(one, Tensor)]
            self.numbers = max(self.numbers, *sizes, 0)
        return result
