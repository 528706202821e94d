"""The page on one's own robot learns its robot on three seeds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "your_robot.md"
CODE = "\n".join(re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_page_about_your_robot_learns_its_robot(
    seed: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "seed=0" in CODE
    exec(CODE.replace("seed=0", f"seed={seed}"), {"__name__": "arm"})
    printed = capsys.readouterr().out
    assert int(re.search(r"^success rate (\d+)%$", printed, re.MULTILINE)[1]) >= 95
    assert len(re.findall(r"^trial ", printed, re.MULTILINE)) <= 7  # as the page says
