"""``pmil compile`` says what it has done, and where the result is kept."""

from __future__ import annotations

import pytest

from tests.helpers.run_script import run_command
from torch_pmil.model.compiled import available, building

Printed = pytest.CaptureFixture[str]


def test_command_says_where_the_kernels_are_or_that_no_folder_can_be_written(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    run_command(monkeypatch, "compile")
    folder = building._cache_folder()
    assert folder is not None and any(folder.rglob("*.nbi"))
    said = capsys.readouterr().out
    assert said.startswith("the prediction is compiled (")
    assert said.endswith(f" CPU s), kept in {folder}\n")
    monkeypatch.setattr(building, "_cache_folder", lambda: None)
    run_command(monkeypatch, "compile")
    assert capsys.readouterr().out.endswith("but not kept: no folder can be written to\n")


def test_command_says_why_there_is_nothing_to_compile(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.setenv("TORCH_PMIL_COMPILED", "0")
    available.cache_clear()
    try:
        with (
            pytest.warns(RuntimeWarning, match="TORCH_PMIL_COMPILED is 0"),
            pytest.raises(SystemExit, match="error: the prediction cannot be compiled"),
        ):
            run_command(monkeypatch, "compile")
    finally:
        available.cache_clear()
    assert capsys.readouterr().out == ""
