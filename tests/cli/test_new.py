"""``pmil new``: a robot that TorchRL takes, demonstrations of it, and nothing that it replaces."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from tests.helpers.run_script import run_command
from torch_pmil.control.policy_file import load_policy
from torch_pmil.demonstrations import load_demonstrations
from torch_pmil.envs import AdaptedEnv

Script = Callable[..., None]
FILES = {"robot.py", "demonstrations.csv", "train.py"}


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Script:
    """The command, run with arguments in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return partial(run_command, monkeypatch, "new")


def files_in(folder: str) -> set[str]:
    return {path.name for path in Path(folder).iterdir()}


def test_template_is_written_and_said(script: Script, capsys: pytest.CaptureFixture[str]) -> None:
    script("robot", "an arm/of mine")
    assert files_in("an arm/of mine") == FILES
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "wrote an arm/of mine/"
    assert lines[-1] == "next: cd 'an arm/of mine' && python train.py"
    assert {line.split()[0] for line in lines[1:-1]} == FILES


def test_robot_is_an_environment_that_its_seed_determines_and_gravity_moves(
    script: Script,
) -> None:
    script("robot")
    Arm = runpy.run_path("my_robot/robot.py")["Arm"]
    check_env_specs(Arm())
    starts = [AdaptedEnv(Arm, 0.1, seed=seed).reset()["observation"] for seed in (1, 1, 2)]
    assert torch.equal(starts[0], starts[1]) and not torch.equal(starts[0], starts[2])
    torque = 3.0 * torch.tensor([0.5]).double().sin()
    rollout = AdaptedEnv(Arm, 0.1, seed=0).rollout(300, lambda shown: torque)
    balanced = torch.tensor([0.5, 0.0], dtype=torch.float64)
    torch.testing.assert_close(rollout["next", "observation"][-1], balanced, atol=1e-3, rtol=0)


def test_demonstrations_are_of_the_robot_at_its_control_rate(script: Script) -> None:
    script("robot")
    demonstrations = load_demonstrations("my_robot/demonstrations.csv", time_step=0.1)
    assert demonstrations.names == ("q",)
    assert demonstrations.positions.shape == (5, 21, 1)
    reached = demonstrations.positions[:, -1]
    torch.testing.assert_close(reached, torch.ones_like(reached))


@pytest.mark.parametrize("name", sorted(FILES))
def test_nothing_is_replaced_and_then_nothing_is_written(script: Script, name: str) -> None:
    Path("mine").mkdir()
    Path("mine", name).write_text("mine")
    with pytest.raises(SystemExit) as stop:
        script("robot", "mine")
    assert stop.value.code == f"error: mine/{name} is there already: pmil new replaces nothing"
    assert files_in("mine") == {name} and Path("mine", name).read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [100, 101, 102])
def test_template_learns_its_motion(
    script: Script,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    seed: int,
) -> None:
    script("robot")
    monkeypatch.chdir("my_robot")
    monkeypatch.syspath_prepend(".")
    monkeypatch.delitem(sys.modules, "robot", raising=False)
    lines = Path("train.py").read_text()
    assert "seed=0" in lines
    Path("train.py").write_text(lines.replace("seed=0", f"seed={seed}"))
    runpy.run_path("train.py")
    assert int(re.search(r"^success rate (\d+)%$", capsys.readouterr().out, re.MULTILINE)[1]) >= 95
    assert load_policy("policy.pt").space.names == ("q", "dq")
