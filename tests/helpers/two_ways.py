"""The two ways of a prediction, by compiled kernels and by the formulas in PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from torch_pmil.model import function_samples, rollout
from torch_pmil.model.function_samples import FunctionSamples
from torch_pmil.search import trajectory_loss
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.target_losses import ExpectedSaturatingCost


@contextmanager
def formulas_alone() -> Iterator[None]:
    """All is computed by the formulas in PyTorch."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (function_samples, rollout, trajectory_loss):
            patch.setattr(module, "serves", lambda *_: False)
        yield


@contextmanager
def kernels_alone() -> Iterator[None]:
    """The formulas must not be asked."""

    def refuse(*_: object) -> None:
        raise AssertionError("the kernels found no answer")

    with pytest.MonkeyPatch.context() as patch:
        for name in ("_trajectory", "_mean_trajectory"):
            patch.setattr(rollout, name, refuse)
        patch.setattr(FunctionSamples, "_sums", refuse)
        for loss in (TrajectoryKLLoss, ExpectedSaturatingCost):
            for name in ("_costs", "_mean_costs"):
                patch.setattr(loss, name, refuse)
        yield


def assert_told_alike(compute: Callable[[], Any], message: str) -> int | None:
    """Both ways raise the same error, with this message; return the step that it names, if any."""
    with formulas_alone():
        expected = _told(compute)
    assert _told(compute) == expected
    kind, said, step = expected
    assert message in said, f"{kind.__name__}: {said}"
    return step


def _told(compute: Callable[[], Any]) -> tuple[type, str, int | None]:
    with pytest.raises((RuntimeError, ValueError)) as error:
        compute()
    return error.type, str(error.value), getattr(error.value, "step", None)
