"""Fixtures that several tests share, and which tests are left to CI."""

from __future__ import annotations

import gc
import shutil
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.helpers.draws import Draws

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)

ROOT = Path(__file__).parents[1]
PARTS = {  # by folder; the first that fits
    "tests/runs/report/test_report_in_a_browser.py": "browser",
    "tests/benchmarks": "docs",
    "tests/docs": "docs",
    "docs": "docs",
    "notebooks": "docs",
    "README.md": "docs",
    "tests/envs": "robot",
    "tests/cli/test_train_gym.py": "robot",
    "tests/runs/diagnosis/test_after_a_run.py": "robot",
    "tests/runs/diagnosis/test_before_a_run.py": "robot",
    "tests/tasks": "robot",
    "tests/reproduction": "robot",
    "tests/scripts": "robot",
}


def part_of(path: Path) -> str:
    """The marker of the tests in a file or folder, or ""."""
    inside = path.relative_to(ROOT)
    folders = (str(folder) for folder in (inside, *inside.parents))
    return next((PARTS[folder] for folder in folders if folder in PARTS), "")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not import what ``-m`` leaves out as a whole: that takes seconds in each process."""
    part = part_of(collection_path)
    if not part or not config.option.markexpr:
        return None
    marks = [defaultdict(bool, {part: True, "slow": slow}) for slow in (False, True)]
    return None if any(eval(config.option.markexpr, {}, one) for one in marks) else True


@pytest.hookimpl(tryfirst=True)  # before markers leave tests out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of some folders, so that ``make test`` can leave them to CI."""
    for item in items:
        if part := part_of(item.path):
            item.add_marker(part)


def pytest_collection_finish() -> None:
    """Keep the garbage collector off what was imported: it frees robots and trainers far sooner."""
    gc.freeze()
    gc.collect()


@pytest.fixture
def draws() -> Draws:
    """The same numbers for every test."""
    from tests.helpers.draws import Draws  # its import of torch is not for every process

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
