"""The README's Python works where it is pasted, and does what the text says; its moving picture is
what it should be.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from PIL import Image

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(
    r"^```python\n(?!>>>)(.*?)^```$", README, re.MULTILINE | re.DOTALL
)  # pytest runs those with prompts as doctests
PICTURES = re.findall(r'<img src="([^"]+)"', README)


@pytest.fixture
def threads() -> Iterator[int]:
    """The number of PyTorch's threads, which the README changes."""
    before = torch.get_num_threads()
    yield before
    torch.set_num_threads(before)


@pytest.mark.usefixtures("threads")
def test_pasted_lines_learn_what_the_readme_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (block,) = BLOCKS
    exec(block, {})
    told = re.findall(
        r"^trial (\d): KL ([\d.]+) nats predicted, at most ([\d.]+) m from",
        capsys.readouterr().out,
        re.MULTILINE,
    )
    assert [trial for trial, *_ in told] == ["1", "2", "3", "4"]
    _, kl, distance = map(float, told[-1])
    assert kl < 2 and distance < 0.1  # as the README says below
    assert not list(tmp_path.iterdir())


def test_pasted_lines_are_about_twenty() -> None:
    (block,) = BLOCKS
    assert len([line for line in block.splitlines() if line]) <= 25


@pytest.mark.parametrize("path", PICTURES)
def test_picture_moves_for_ever_and_is_loaded_soon(path: str) -> None:
    with Image.open(ROOT / path) as picture:
        assert picture.n_frames > 50
        assert picture.info["loop"] == 0
    assert (ROOT / path).stat().st_size < 1_500_000
