"""Random numbers and short runs of tasks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    import torch


@pytest.fixture
def generator() -> torch.Generator:
    """The same numbers for every test."""
    import torch  # not for every process

    return torch.Generator().manual_seed(0)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The model's fits end after a few iterations."""
    from tests.helpers.short_run import quick_fits

    quick_fits(monkeypatch)
