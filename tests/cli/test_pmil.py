"""The command ``pmil``: its help, its errors, and that it works wherever it is called."""

from __future__ import annotations

import errno
import gc
import io
import json
import os
import subprocess
import sys
from contextlib import nullcontext
from importlib.metadata import entry_points
from pathlib import Path
from unittest.mock import Mock

import pytest

from tests.helpers.run_script import ROOT, run_command
from tests.helpers.short_run import quick_fits, replace_task, short_experiment
from tests.runs.report.test_report import OLD, run_of
from torch_pmil import cli
from torch_pmil.cli.resume import overrides
from torch_pmil.runs.run_folder import write_origin
from torch_pmil.search import policy_search

Printed = pytest.CaptureFixture[str]


@pytest.mark.parametrize("arguments", [(), ("--help",), ("-h",)])
def test_help_is_one_screen_with_all_commands(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed, arguments: tuple[str, ...]
) -> None:
    run_command(monkeypatch, *arguments)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 24 and max(map(len, lines)) <= 110
    named = {line.split()[0] for line in lines if line.startswith("  ") and "  pmil" not in line}
    assert named == set(cli.COMMANDS)


def test_every_file_of_the_folder_is_a_command() -> None:
    files = {path.stem for path in Path(cli.__file__).parent.glob("*.py")} - {"__init__"}
    assert files == set(cli.COMMANDS)


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_has_help(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed, command: str
) -> None:
    try:
        run_command(monkeypatch, command, "--help")
    except SystemExit as ended:
        assert not ended.code
    assert f"pmil {command}" in capsys.readouterr().out


def test_what_a_command_imports_is_left_out_of_garbage_collection(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    gc.unfreeze()
    with pytest.raises(SystemExit):
        run_command(monkeypatch, "report", "--help")
    assert gc.get_freeze_count() > 0 and gc.isenabled()


def test_command_is_installed() -> None:
    (command,) = entry_points(group="console_scripts", name="pmil")
    assert command.load() is cli.main


def test_module_is_the_command_too_and_is_found_beside_a_clone_of_its_name(tmp_path: Path) -> None:
    """A folder without ``__init__.py`` is a package of that name too, unless another is found."""
    (tmp_path / "torch_pmil").symlink_to(ROOT)
    module = [sys.executable, "-m", "torch_pmil", "--version"]
    printed = subprocess.run(module, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert printed.stdout.startswith("pmil ")


def test_stopped_run_is_resumed_by_its_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Printed
) -> None:
    replace_task(monkeypatch, short_experiment(4))
    monkeypatch.chdir(tmp_path)
    quick_fits(monkeypatch)

    def interrupted(*args: object, **kwargs: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(policy_search, "minimise_function", interrupted)
        run_command(patch, "train", "trials=1", "seed=7", "out=here it is", "logger=null")
    run_command(monkeypatch, "resume", "here it is")
    summary = json.loads((tmp_path / "here it is" / "summary.json").read_text())
    assert (summary["seed"], summary["settings"]["trials"]) == (7, 1)
    assert "policy of trial 1" in capsys.readouterr().out


def test_changed_settings_take_the_place_of_those_of_the_run(tmp_path: Path) -> None:
    folder = tmp_path / "it's"
    folder.mkdir()
    write_origin(folder, {"command": "pmil train trials=3 seed=1 out=elsewhere overwrite=true"})
    quoted = str(folder).replace("'", "\\'")
    resumed = ["seed=1", "trials=9", f"out='{quoted}'", "resume=true"]
    assert overrides(folder, ["trials=9"]) == resumed


@pytest.mark.parametrize("content", ["", "[]", "{}"])
def test_damaged_origin_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, content: str
) -> None:
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(SystemExit, match=r"^error: .*run.json is damaged"):
        run_command(monkeypatch, "resume", tmp_path)


@pytest.mark.parametrize(
    ("command", "remedy"),
    [("pmil train seed=1", "pmil resume '{}'"), ("python own.py", "learn(resume=True)")],
)
def test_report_says_what_it_has_to_do_without(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Printed, command: str, remedy: str
) -> None:
    folder = run_of(tmp_path / "a run", OLD | {"command": command})
    run_command(monkeypatch, "report", folder)
    page, remedy = folder / "report.html", remedy.format(folder)
    assert capsys.readouterr().out == (
        f"wrote {page}, without figures (there are none) and video (there is no video.mp4): "
        f"{remedy} makes what the robot allows\n"
    )
    whole = run_of(tmp_path / "whole", OLD, "poses")
    (whole / "video.mp4").touch()
    run_command(monkeypatch, "report", whole)
    assert capsys.readouterr().out == f"wrote {tmp_path / 'whole' / 'report.html'}\n"


def test_command_that_is_stopped_by_ctrl_c_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.setattr(cli, "_imported", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(SystemExit) as stop:
        run_command(monkeypatch, "align")
    assert stop.value.code == 130 and capsys.readouterr() == ("", "\nstopped\n")


def test_working_folder_that_is_gone_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    message = r"^error: the working folder cannot be used: No such file"
    with pytest.raises(SystemExit, match=message):
        run_command(monkeypatch, "report", "run")


@pytest.mark.parametrize(
    ("number", "said"), [(errno.EPIPE, None), (errno.ENOSPC, "error: standard output: No space")]
)
def test_output_that_nobody_reads_ends_quietly_and_one_that_is_lost_with_an_error(
    monkeypatch: pytest.MonkeyPatch, number: int, said: str | None
) -> None:
    class Broken(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(sys, "stdout", Broken())
    with pytest.raises(SystemExit, match=said) if said else nullcontext():
        run_command(monkeypatch, "--help")


def test_closed_streams_are_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    run_command(monkeypatch, "--help")
