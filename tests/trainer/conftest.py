"""Runs of the trainer take seconds."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    """The model's fits end after a few iterations."""
    from tests.helpers.short_run import quick_fits  # its imports are not for every process

    with pytest.MonkeyPatch.context() as patch:
        quick_fits(patch)
        yield
