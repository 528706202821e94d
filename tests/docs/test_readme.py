"""The README's Python is that of a file which learns what the text says; its moving picture is
what it should be.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
EXAMPLE = (ROOT / "examples" / "inverted_pendulum.py").read_text()
(LINES,) = re.findall(r"^```python\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
PICTURES = re.findall(r'<img src="([^"]+)"', README)


def test_lines_are_those_of_the_example_and_at_most_twelve() -> None:
    assert EXAMPLE.endswith(LINES)
    assert len([line for line in LINES.splitlines() if line.strip(" )")]) <= 12


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_pasted_lines_learn_what_the_readme_says(
    seed: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    exec(LINES.replace("seed=0", f"seed={seed}"), {})
    rate = re.search(r"^success rate (\d+)% from 20", capsys.readouterr().out, re.MULTILINE)
    assert int(rate[1]) >= 95
    (report,) = tmp_path.glob("runs/*/*/report.html")
    assert (report.parent / "video.mp4").exists() and (tmp_path / "policy.pt").exists()


@pytest.mark.parametrize("path", PICTURES)
def test_picture_moves_for_ever_and_is_loaded_soon(path: str) -> None:
    with Image.open(ROOT / path) as picture:
        assert picture.n_frames > 50
        assert picture.info["loop"] == 0
    assert (ROOT / path).stat().st_size < 1_500_000
