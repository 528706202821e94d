"""Pages whose code is meant to be pasted: it runs, in order, and does what the page says."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "your_robot.md"


@pytest.mark.slow
def test_page_about_your_robot_learns_its_robot(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.py").write_text(
        "\n".join(re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL))
    )
    runpy.run_path("arm.py")
    printed = capsys.readouterr().out
    rate, experience = map(
        int, re.search(r"success rate (\d+)% after (\d+) s on the robot", printed).groups()
    )
    assert rate >= 90 and experience <= 12
    assert abs(float(re.search(r"the arm is at (.*) rad", printed)[1]) - 1) < 0.15
