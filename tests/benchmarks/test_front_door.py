"""What newcomers hand over comes out right or is named."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("gymnasium")
from benchmarks.front_door import KINDS, Case, handed_over

CASES = [each for kind in KINDS for each in kind()]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=[f"{each.kind}, {each.name}" for each in CASES])
def test_case_is_right_or_named(case: Case, tmp_path: Path) -> None:
    result = handed_over(case, tmp_path)
    assert result.startswith("named" if case.named else "right"), result
