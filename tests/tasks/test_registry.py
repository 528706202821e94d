"""Tasks of a user's own module: loaded by name, refused in one line, executed only if trusted."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import torch

from tests.helpers.run_script import run_command
from tests.helpers.short_run import quick_fits
from torch_pmil.cli.resume import overrides
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.demonstrations.errors import DemonstrationError
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.runs.summaries import RunError
from torch_pmil.tasks.registry import is_own, load_experiment

OWN = """
from dataclasses import replace

from beside_it import NAME
from tests.helpers.short_run import short_experiment

COUNT = 3


def arm(demonstrations=None):
    task = replace(short_experiment(4), name=NAME)
    return task if demonstrations is None else replace(task, demonstrations=demonstrations)


def none():
    return 3


def of_size(size):
    return 3


def broken():
    raise RuntimeError("the arm is broken")
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a module of a task, and one beside it that it imports."""
    (tmp_path / "mine.py").write_text(OWN)
    (tmp_path / "beside_it.py").write_text('NAME = "my_arm"\n')
    package = tmp_path / "arms"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "six.py").write_text(OWN.replace("beside_it", "arms.beside"))
    (package / "beside.py").write_text('NAME = "six_axes"\n')
    (tmp_path / "fails.py").write_text("import math\n\nprint(1 / 0)\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "own"),
    [("mine.py:arm", "my_arm"), ("arms.six:arm", "six_axes"), ("{}/mine.py:arm", "my_arm")],
)
def test_function_of_a_module_makes_the_task(folder: Path, name: str, own: str) -> None:
    name = name.format(folder)
    assert is_own(name) and load_experiment(name).name == own
    shown = shipped_demonstrations("double_pendulum")
    assert load_experiment(name, shown).demonstrations is shown


def test_function_that_takes_something_else_is_named() -> None:
    shown = shipped_demonstrations("double_pendulum")
    with pytest.raises(ValueError, match=r"none must take the demonstrations .* function of \(\)"):
        load_experiment("mine.py:none", shown)
    with pytest.raises(ValueError, match=r"of_size must need no argument, .* function of \(size\)"):
        load_experiment("mine.py:of_size")


def test_module_is_found_from_elsewhere_with_what_stands_beside_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    (folder / "beside_it.py").rename(folder / "next_to_it.py")
    (folder / "mine.py").write_text(OWN.replace("beside_it", "next_to_it"))
    assert load_experiment("../mine.py:arm").name == "my_arm"


@pytest.mark.parametrize(
    ("name", "kind", "message"),
    [
        ("absent.py:arm", FileNotFoundError, "[Errno 2] No such file or directory: 'absent.py'"),
        ("arms.absent:arm", ModuleNotFoundError, "No module named 'arms.absent'"),
        ("mine.py:leg", ValueError, "mine.py must have a function leg, found none of that name"),
        (
            "mine.py:COUNT",
            ValueError,
            "mine.py must have a function COUNT, found none of that name",
        ),
        ("arms.six:leg", ValueError, "arms.six must have a function leg, found none of that name"),
        ("mine.py:none", ValueError, "mine.py:none must return a Task, got int"),
        ("mine.py:broken", RuntimeError, "the arm is broken"),
        ("fails.py:arm", ZeroDivisionError, "division by zero"),
        ("fails:arm", ZeroDivisionError, "division by zero"),
    ],
)
def test_what_makes_no_task_is_one_line(name: str, kind: type[Exception], message: str) -> None:
    """What a module itself raises is not swallowed."""
    with pytest.raises(kind) as error:
        load_experiment(name)
    assert str(error.value) == message


def test_recordings_that_a_task_does_not_align_are_refused() -> None:
    time = torch.arange(3).double()
    recordings = Recordings(("1",), (time,), (time[:, None],), ("x",))
    with pytest.raises(DemonstrationError, match="got Recordings; pmil align aligns recordings"):
        load_experiment("cart_pole", recordings)


@pytest.mark.parametrize(
    "name", ["absent.py:arm", "arms.absent:arm", "mine.py:leg", "mine.py:none"]
)
def test_command_ends_in_that_line_before_there_is_a_folder(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        run_command(monkeypatch, "train", f"experiment={name}", "out=run")
    said = str(stop.value.code)
    assert said.startswith("error: ") and "\n" not in said
    assert not os.path.exists("run")


def test_run_of_an_own_task_is_resumed_if_its_module_is_named_again(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    """Its module would be executed, which the folder of a run must not decide."""
    quick_fits(monkeypatch)
    run_command(monkeypatch, "train", "experiment=mine.py:arm", "trials=1")
    run = Path("runs/arm/seed_0")
    trials = json.loads((run / "summary.json").read_text())["trials"]
    assert json.loads((run / "summary.json").read_text())["experiment"] == "my_arm"
    settings = (run / "settings.yaml").read_text()
    assert 'experiment: "mine.py:arm"' in settings

    (folder / "mine.py").write_text(OWN + "\nraise RuntimeError('executed')\n")
    for words in (("resume", run), ("train", f"settings={run}/settings.yaml", "out=again")):
        with pytest.raises(SystemExit) as stop:
            run_command(monkeypatch, *words)
        assert "executed" in stop.value.code and "executed'" not in stop.value.code
    assert stop.value.code.startswith("error: runs/arm/seed_0/settings.yaml: experiment must be ")
    with pytest.raises(SystemExit) as stop:
        run_command(monkeypatch, "resume", run)
    way_out = stop.value.code.partition("go on with: ")[2]
    assert way_out == "pmil resume runs/arm/seed_0 experiment=mine.py:arm"

    (folder / "mine.py").write_text(OWN)
    run_command(monkeypatch, *way_out.split()[1:], "trials=2")
    resumed = json.loads((run / "summary.json").read_text())["trials"]
    assert resumed[0] == trials[0] and len(resumed) == 2


def test_module_is_not_hidden_behind_a_reference(folder: Path) -> None:
    (folder / "run").mkdir()
    command = "pmil train 'experiment=${demonstrations}' demonstrations=mine.py:arm"
    (folder / "run" / "run.json").write_text(json.dumps({"command": command}))
    with pytest.raises(
        RunError, match=r"damaged: a setting must be NAME=VALUE, got 'experiment=\$"
    ):
        overrides(Path("run"), [])
