"""The page on one's own robot learns its robot on three seeds, and with each kind of past."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from torch_pmil import PMIL

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "your_robot.md"
CODE = "\n".join(re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL))
ROBOT = CODE.partition("from torch_pmil import PMIL")[0]  # and its demonstrations


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


@pytest.mark.slow
@pytest.mark.parametrize(
    "past",
    [
        {"past_actions": 1},
        {"past_entries": 2},
        {"positions_only": True, "past_actions": 1},
        {"past_entries": 2, "past_actions": 2, "tied_lengthscales": True},
    ],
    ids=lambda past: "_".join(past),
)
def test_robot_of_the_page_learns_with_its_past(
    past: dict, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "arm"}
    exec(ROBOT, names)
    state = {"state": ("q", "dq"), "units": ("rad", "rad/s")}
    learner = PMIL(names["Arm"](), "demonstrations.csv", control_period=0.1, **state, **past)
    assert learner.learn(trials=7, seed=100, out="run").evaluate() >= 0.9
