"""The export script: what it writes and says, and that it fails in one line."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch

from tests.helpers.draws import Draws
from tests.helpers.run_script import run_command
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.policy_file import load_policy, save_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match

COMMAND = "export"
Script = Callable[..., None]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Script:
    """The script, run with arguments in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return partial(run_command, monkeypatch, COMMAND)


@pytest.fixture
def saved(tmp_path: Path, draws: Draws) -> Path:
    policy = RBFPolicy(draws.normal(5, 3), torch.tensor([3.5]), torch.ones(3))
    with torch.no_grad():
        policy.weights.copy_(draws.normal(5, 1))
    space = StateSpace(
        ("q", "dq"), ("rad", "rad/s"), (0,), joint_match(("q", "dq"), ("rad", "rad/s"))
    )
    actions = ActionSpace.around(policy.u_middle, policy.u_max, ("tau",), ("N·m",))
    save_policy(tmp_path / "policy.pt", policy, space, 0.1, actions=actions)
    return tmp_path / "policy.pt"


@pytest.mark.parametrize(("options", "shape"), [((), (2,)), (("--batch",), (7, 2))])
def test_exported_file_is_the_saved_policy(
    script: Script,
    saved: Path,
    draws: Draws,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    shape: tuple[int, ...],
) -> None:
    script("policy.pt", "policy.pt2", *options)
    states = draws.normal(*shape)
    program = torch.export.load("policy.pt2").module()
    torch.testing.assert_close(program(states), load_policy(saved)(states), rtol=0, atol=1e-12)
    expected = (
        "wrote policy.pt2: state q (rad), dq (rad/s); actions tau (N·m) from -3.5 to 3.5; "
        "every 0.1 s\n"
    )
    assert capsys.readouterr().out == expected
    assert sorted(os.listdir()) == ["policy.pt", "policy.pt2"]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            ("policy.pt", "policy.onnx"),
            "error: an exported policy must be a .pt2 file, got policy.onnx",
        ),
        (
            ("policy.pt", "nowhere/policy.pt2"),
            "error: there is no folder nowhere",
        ),
        (("other.pt", "policy.pt2"), "error: there is no file other.pt"),
        (
            ("text.pt", "policy.pt2"),
            "error: text.pt: must be a file of save_policy: must be a whole ZIP archive, got",
        ),
    ],
)
def test_failure_is_one_line_and_leaves_nothing(
    script: Script, saved: Path, arguments: tuple[str, str], complaint: str
) -> None:
    Path("text.pt").write_text("q,dq")
    with pytest.raises(SystemExit) as stop:
        script(*arguments)
    assert stop.value.code.startswith(complaint) and "\n" not in stop.value.code
    assert sorted(os.listdir()) == ["policy.pt", "text.pt"]
