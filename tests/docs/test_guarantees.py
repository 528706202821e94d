"""Each promise of docs/guarantees.md has its test."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "guarantees.md").read_text()
ROWS = [line for line in TEXT.partition("## Quiet motions")[0].splitlines() if line[:2] == "| "]
NAMED = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", TEXT)


def test_every_promise_names_a_test() -> None:
    promises = [row for row in ROWS if not row.startswith(("| promise", "| ---"))]
    assert len(promises) > 15
    assert [row for row in promises if "`tests/" not in row] == []


@pytest.mark.parametrize(("path", "name"), NAMED)
def test_tests_that_are_named_are_there(path: str, name: str) -> None:
    assert f"\ndef {name}(" in (ROOT / path).read_text()
