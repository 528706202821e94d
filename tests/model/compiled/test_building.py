"""Where the kernels are kept, and what makes them be compiled anew."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from numba.core import config

from tests.helpers.run_script import ROOT
from torch_pmil.model.compiled import building, kernels
from torch_pmil.model.compiled.building import Kernel, _cache_folder, compile_all

ROOM = Path(building.__file__).parent


@pytest.fixture(autouse=True)
def folder_is_looked_for_anew() -> Iterator[None]:
    kernels()  # from where they are
    _cache_folder.cache_clear()
    yield
    _cache_folder.cache_clear()


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A copy of the room, which is taken for it."""
    copy = tmp_path / "compiled"
    shutil.copytree(ROOM, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(building, "__file__", str(copy / "building.py"))
    monkeypatch.setattr(config, "CACHE_DIR", "")
    return copy


@pytest.fixture
def nowhere(tmp_path: Path) -> Path:
    """A folder that nobody can make, not even who may write everywhere."""
    (tmp_path / "file").touch()
    return tmp_path / "file" / "folder"


def folder_now() -> Path | None:
    _cache_folder.cache_clear()
    return _cache_folder()


def double(number: int) -> int:
    return 2 * number


def new_kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    """The only kernel there is."""
    only: list[Kernel] = []
    monkeypatch.setattr(building, "KERNELS", only)
    return Kernel(double)


def test_folder_is_beside_the_sources(room: Path) -> None:
    folder = folder_now()
    assert folder is not None and folder.is_dir() and folder.parent == room / "__pycache__"


@pytest.mark.parametrize("name", sorted(path.name for path in ROOM.glob("*.py")))
def test_change_of_any_file_changes_the_folder(room: Path, name: str) -> None:
    source, before = room / name, folder_now()
    text = source.read_text()
    source.write_text(f"{text}\n")
    assert folder_now() != before
    source.write_text(text)
    assert folder_now() == before


def test_new_file_changes_the_folder(room: Path) -> None:
    before = folder_now()
    (room / "new.py").write_text("# nothing")
    assert folder_now() != before


def test_folder_that_is_asked_for_is_taken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "asked"))
    kernel = new_kernel(monkeypatch)
    assert kernel(21) == 42
    folder = compile_all()
    assert folder is not None and folder.parent == tmp_path / "asked"
    assert {path.suffix for path in folder.rglob("*") if path.is_file()} == {".nbi", ".nbc"}
    again = new_kernel(monkeypatch)
    assert again(21) == 42 and sum(again.compile().stats.cache_hits.values()) == 1
    assert str(tmp_path / "asked") == config.CACHE_DIR  # Numba's own for all others


def test_folder_of_the_user_is_the_second_choice(
    room: Path, nowhere: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(building, "__file__", str(nowhere / "building.py"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = folder_now()
    assert folder is not None and folder.is_relative_to(tmp_path / "cache" / "torch_pmil")


def test_without_a_folder_all_is_compiled_with_one_warning(
    nowhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(nowhere))
    with pytest.warns(RuntimeWarning, match=r"NUMBA_CACHE_DIR names another folder") as warned:
        assert new_kernel(monkeypatch)(21) == 42
        assert new_kernel(monkeypatch)(21) == 42
        assert compile_all() is None
    assert len(warned) == 1 and str(nowhere) in str(warned[0].message)


def test_compilation_is_told_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    new_kernel(monkeypatch)
    compile_all()
    said = "compiling the prediction for this processor, once: kernel 1 of 1\n"
    assert capsys.readouterr().err == said
    compile_all()
    new_kernel(monkeypatch)
    compile_all()  # from the folder
    assert capsys.readouterr().err == ""


def test_settings_of_numba_are_left_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [*building.EFFORT, "CACHE_DIR"]
    before = {name: getattr(config, name) for name in names}
    new_kernel(monkeypatch)(21)
    assert {name: getattr(config, name) for name in names} == before


FIRST_PREDICTION = """
import time
import numba
import torch
from tests.helpers.draws import Draws
from tests.helpers.losses import SPACE, make_parts
from torch_pmil.model.rollout import predict_trajectory

start, parts = Draws(0).belief(2, scale=0.05), make_parts(Draws(0))
begun = time.process_time()
predict_trajectory(start, *parts, SPACE, 3).mean.sum().backward()
print(time.process_time() - begun)
"""


@pytest.mark.slow
def test_first_prediction_of_a_process_takes_less_than_a_second() -> None:
    """Of this processor's time, besides imports, where the kernels are compiled."""
    command = [sys.executable, "-c", FIRST_PREDICTION]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    seconds = []
    for _ in range(3):
        printed = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        )
        seconds.append(float(printed.stdout))
    print("CPU seconds of the first prediction:", seconds)
    assert min(seconds) < 1
