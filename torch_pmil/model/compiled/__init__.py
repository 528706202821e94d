"""The prediction and its gradient as compiled kernels: the same formulas, some ten times as fast.

:func:`serves` decides when they are used: for float64 on the CPU, with gradients in start beliefs,
policies and the inputs of drawn functions only. The formulas in PyTorch remain the reference, and
compute all else: on a GPU, in float32, with gradients in data and hyper-parameters. They also name
what the kernels cannot compute, where a matrix has no Cholesky factor or a number is not finite.

``TORCH_PMIL_COMPILED=0`` turns the kernels off; they need Numba. The first prediction compiles
them, which takes some 20 s once; ``pmil compile`` does so beforehand.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import warnings
from collections.abc import Sequence
from functools import cache
from types import ModuleType

import torch
from torch import Tensor

SLOWER = "predictions are computed by PyTorch alone, some ten times as slowly: "


@cache
def available() -> bool:
    """Whether there are kernels; the first answer that there are none comes with a warning."""
    if os.environ.get("TORCH_PMIL_COMPILED") == "0":
        reason = "TORCH_PMIL_COMPILED is 0"
    elif importlib.util.find_spec("numba") is None:
        reason = "Numba is not installed (pip install numba)"
    elif os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        reason = "NUMBA_DISABLE_JIT is set"
    else:
        return True
    warnings.warn(SLOWER + reason, RuntimeWarning, stacklevel=2)
    return False


def serves(constant: Sequence[Tensor], differentiable: Sequence[Tensor]) -> bool:
    """Whether kernels compute with these tensors.

    Args:
        constant: tensors in which the kernels have no gradient.
        differentiable: tensors in which they have a gradient, which can be taken once.
    """
    ordinary = all(
        tensor.device.type == "cpu" and tensor.dtype == torch.float64
        for tensor in (*constant, *differentiable)
    )
    graph = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in constant)
    return ordinary and not graph and available()


@cache
def kernels() -> ModuleType:
    """:mod:`torch_pmil.model.compiled.prediction`, compiled; it needs Numba, so it comes late."""
    module = importlib.import_module("torch_pmil.model.compiled.prediction")
    module.compile_all()
    return module
