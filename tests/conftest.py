"""Fixtures that several tests share."""

from __future__ import annotations

import pytest

from tests.draws import Draws


@pytest.fixture
def draws() -> Draws:
    """The same numbers for every test."""
    return Draws(seed=0)
