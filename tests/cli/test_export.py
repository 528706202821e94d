"""``pmil export``: what it writes and says."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
import torch

from tests.helpers.draws import Draws
from tests.helpers.run_script import run_command
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.policy_file import load_policy, save_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match


@pytest.fixture
def saved(tmp_path: Path, draws: Draws) -> Path:
    policy = RBFPolicy(draws.normal(5, 3), torch.tensor([3.5]), torch.ones(3))
    with torch.no_grad():
        policy.weights.copy_(draws.normal(5, 1))
    names, units = ("q", "dq"), ("rad", "rad/s")
    space = StateSpace(names, units, (0,), joint_match(names, units))
    actions = ActionSpace.around(policy.u_middle, policy.u_max, ("tau",), ("N·m",))
    save_policy(tmp_path / "policy.pt", policy, space, 0.1, actions=actions)
    return tmp_path / "policy.pt"


@pytest.mark.parametrize(("options", "shape"), [((), (2,)), (("--batch",), (7, 2))])
def test_exported_file_is_the_saved_policy(
    monkeypatch: pytest.MonkeyPatch,
    saved: Path,
    draws: Draws,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    shape: tuple[int, ...],
) -> None:
    monkeypatch.chdir(saved.parent)
    run_command(monkeypatch, "export", "policy.pt", "policy.pt2", *options)
    states = draws.normal(*shape)
    program = torch.export.load("policy.pt2").module()
    torch.testing.assert_close(program(states), load_policy(saved)(states), rtol=0, atol=1e-12)
    expected = (
        "wrote policy.pt2: state q (rad), dq (rad/s); actions tau (N·m) from -3.5 to 3.5; "
        "every 0.1 s\n"
    )
    assert capsys.readouterr().out == expected
    assert sorted(os.listdir()) == ["policy.pt", "policy.pt2"]


def test_file_of_onnx_is_said_to_be_one_and_a_missing_extra_ends_the_command(
    monkeypatch: pytest.MonkeyPatch, saved: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(saved.parent)
    with monkeypatch.context() as missing:
        missing.setitem(sys.modules, "onnx", None)
        with pytest.raises(SystemExit, match=r"^error: .* needs onnx and onnxscript: pip install"):
            run_command(missing, "export", "policy.pt", "policy.onnx")
    for library in ("onnx", "onnxscript"):
        pytest.importorskip(library, reason="needs the extra onnx")
    run_command(monkeypatch, "export", "policy.pt", "policy.onnx")
    assert capsys.readouterr().out.startswith("wrote policy.onnx: state q (rad), dq (rad/s); ")
    assert sorted(os.listdir()) == ["policy.onnx", "policy.pt"]
