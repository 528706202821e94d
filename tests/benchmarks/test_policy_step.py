"""The time of a policy's step, from a few of them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import torch

from benchmarks import policy_step


def test_every_form_has_its_times(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "new" / "summary.json"
    monkeypatch.setattr(sys, "argv", ["policy_step.py", "--steps", "5", "--json", str(file)])
    policy_step.main()
    report = json.loads(file.read_text())
    assert report["command"].startswith("python -m benchmarks.policy_step --steps 5")
    assert [row["form"] for row in report["rows"]] == ["numpy", "torch", "exported"]
    for row in report["rows"]:
        assert 0 < row["cpu_us_min"] <= row["cpu_us_median"]
        assert 0 < row["wall_us_median"] <= row["wall_us_99_percent"]
    assert len(capsys.readouterr().out.splitlines()) == 4


def test_forms_give_the_same_torque() -> None:
    torques = [torch.as_tensor(step()) for step in policy_step.make_forms().values()]
    for torque in torques[1:]:
        torch.testing.assert_close(torque, torques[0], rtol=0, atol=1e-12)


def test_no_steps_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["policy_step.py", "--steps", "0"])
    with pytest.raises(SystemExit):
        policy_step.main()
    assert "steps must be at least 1, got 0" in capsys.readouterr().err
