"""The README's Python is that of a file which learns what the text says, its numbers are those of
the results, and its moving picture is what it should be.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

from tests.helpers.extensions import extension

summaries = extension("summaries")

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
EXAMPLE = (ROOT / "examples" / "inverted_pendulum.py").read_text()
(LINES,) = re.findall(r"^```python\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
(PICTURE,) = re.findall(r'<img src="([^"]+)"', README)
OURS, ENSEMBLE, BCO = (
    f"{{success_25s_{name}:.0%}} ({{lower_25s_{name}..upper_25s_{name}:.0%}})"
    for name in ("ours", "ensemble_cem", "bco")
)
ROWS = {  # the end of each row of results, with fields for its numbers
    "tasks/double_pendulum": "| {seeds} seeds | {median_experience_s:.1f} s "
    "({runs/experience_s:.1f} s) |",
    "soak": "| {runs} | {saved_at_95} ({tasks/inverted_pendulum/at_95..tasks/biorob/at_95} of "
    "{tasks/biorob/runs} for each task) |",
    "paper/peers_double_pendulum": f"| {{seeds}} seeds each | ours {OURS}, an ensemble of networks "
    f"{ENSEMBLE}, behavioural cloning from observation {BCO} |",
    "paper/biorob": "after {max_experience_s:.1f} s of experience | {seeds} seeds | "
    "{seeds_solved_by_trial_4} hit from {hit_rate:.0%} of 20 starts |",
    "paper/ur5e": "| {seeds} seeds | {median_ratio:.2f} ({measured/ur5e/ratio:.2f}); the servos "
    "alone {servo_alone_ratio_ur5e:.2f} |",
}


def test_numbers_are_those_of_the_summaries() -> None:
    rows = [line for line in README.splitlines() if line.startswith("| **")]
    ends = [summaries.fill(name, template) for name, template in ROWS.items()]
    assert [(row, end) for row, end in zip(rows, ends, strict=True) if not row.endswith(end)] == []


def test_it_says_that_some_results_are_of_earlier_sources_if_some_are() -> None:
    assert ("earlier sources" in " ".join(README.split())) is any(map(summaries.is_older, ROWS))


def test_it_is_short_and_its_twelve_lines_are_those_of_the_example() -> None:
    assert len(README.split()) <= 700 and EXAMPLE.endswith(LINES)
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


def test_picture_moves_for_ever_and_is_loaded_soon() -> None:
    with Image.open(ROOT / PICTURE) as picture:
        assert picture.n_frames > 50 and picture.info["loop"] == 0
    assert (ROOT / PICTURE).stat().st_size < 1_500_000
