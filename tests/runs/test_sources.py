"""The hash of the sources changes with code, and with nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from torch_pmil.runs.sources import code_of, hash_of_sources

SOURCE = '''"""A module."""

# its number
def one() -> int:
    """One."""
    # exact
    return 1


SHOWN = """
text
"""


def two() -> int:
    """Two."""
    return 2
'''
CODE = '''def one() -> int:
    return 1
SHOWN = """
text
"""
def two() -> int:
    return 2
'''


@pytest.mark.parametrize(
    ("before", "after", "changes"),
    [
        ("A module.", "Another\n\ntext.", False),
        ("its number", "another comment", False),
        ("    # exact\n", "\n\n", False),
        ("return 1", "return 2", True),
        ("def two", "def three", True),
        ("\ntext\n", "\nanother\n", True),
        ("return 1", "return 1  # beside code", True),
    ],
)
def test_hash_is_of_code_alone(tmp_path: Path, before: str, after: str, changes: bool) -> None:
    assert code_of(SOURCE) == CODE
    found = []
    for source in (SOURCE, SOURCE.replace(before, after)):
        (tmp_path / "module.py").write_text(source)
        found.append(hash_of_sources.__wrapped__(tmp_path))
    assert (found[0] != found[1]) is changes


def test_hash_knows_the_names_of_modules(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text(SOURCE)
    before = hash_of_sources.__wrapped__(tmp_path)
    (tmp_path / "one.py").rename(tmp_path / "two.py")
    assert hash_of_sources.__wrapped__(tmp_path) != before


@pytest.mark.parametrize(
    ("module", "changes"),
    [
        ("runs/report/module.py", False),
        ("tasks/sampling_choice.py", False),
        ("runs/module.py", True),
        ("tasks/sampling.py", True),
    ],
)
def test_what_shows_a_run_and_the_choice_that_it_keeps_do_not_count(
    tmp_path: Path, module: str, changes: bool
) -> None:
    before = hash_of_sources.__wrapped__(tmp_path)
    (tmp_path / module).parent.mkdir(parents=True)
    (tmp_path / module).write_text(SOURCE)
    assert (hash_of_sources.__wrapped__(tmp_path) != before) is changes
