"""What the operator may answer."""

from __future__ import annotations

import io
from contextlib import nullcontext

import pytest

from torch_pmil.envs.operator import QUESTION, RolloutDiscarded, RunStopped, prompt


@pytest.mark.parametrize(
    ("typed", "end"),
    [
        ("\n", None),
        ("x\nyes\n\n", None),
        ("d\n", RolloutDiscarded),
        (" D \n", RolloutDiscarded),
        ("q\n", RunStopped),
        ("", RunStopped),
        ("x\n", RunStopped),
    ],
)
def test_enter_runs_d_discards_and_q_or_the_end_of_the_input_ends(
    typed: str,
    end: type[Exception] | None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    with pytest.raises(end) if end else nullcontext():
        prompt()
    asked = typed.count("\n") + (not typed.endswith("q\n") and end is RunStopped)
    assert capsys.readouterr().out == asked * QUESTION
