"""Fixtures that several tests share."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

from tests.helpers.draws import Draws

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


@pytest.fixture
def draws() -> Draws:
    """The same numbers for every test."""
    return Draws(seed=0)


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    """A headless Chromium; without one the test is skipped."""
    api = pytest.importorskip("playwright.sync_api", reason="needs the extra test")
    if BROWSER is None:
        pytest.skip("no Chromium on this machine")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER)
        yield browser
        browser.close()
