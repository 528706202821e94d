"""Two runs are never in one folder at the same time."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from torch_pmil.runs import lock
from torch_pmil.runs.lock import RunGoingOnError, alone_in

# takes the lock with the standard library alone, says so, and waits to be ended
HOLDER = """
import fcntl, os, sys
file = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT)
fcntl.flock(file, fcntl.LOCK_EX)
os.write(file, str(os.getpid()).encode())
print("locked", flush=True)
sys.stdin.read()
"""


def test_second_process_is_told_of_the_first_and_comes_in_when_that_was_killed(
    tmp_path: Path,
) -> None:
    command = [sys.executable, "-c", HOLDER, str(tmp_path / ".pmil.lock")]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as holder:
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(RunGoingOnError, match=rf"going on in .*process {holder.pid}\): wait"):
            enter(tmp_path)
        holder.kill()
    assert (tmp_path / ".pmil.lock").exists()  # and keeps nobody out
    with alone_in(tmp_path):
        assert (tmp_path / ".pmil.lock").read_text() == str(os.getpid())
    assert os.listdir(tmp_path) == []


def enter(folder: Path) -> None:
    with alone_in(folder):
        pass


def test_same_thread_may_come_in_again_another_one_may_not_and_an_error_ends_it(
    tmp_path: Path,
) -> None:
    with pytest.raises(KeyboardInterrupt), alone_in(tmp_path / "run"):
        enter(tmp_path / "run")
        with ThreadPoolExecutor() as pool, pytest.raises(RunGoingOnError):
            pool.submit(enter, tmp_path / "run").result()
        assert os.listdir(tmp_path / "run") == [".pmil.lock"]
        raise KeyboardInterrupt
    assert os.listdir(tmp_path / "run") == []


def test_folder_that_was_renamed_meanwhile_leaves_the_lock_of_its_successor(tmp_path: Path) -> None:
    with alone_in(tmp_path / "run"):
        (tmp_path / "run").rename(tmp_path / "elsewhere")
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / ".pmil.lock").write_text("of another")
    assert (tmp_path / "run" / ".pmil.lock").read_text() == "of another"


def test_lock_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("content")
    (tmp_path / ".pmil.lock").symlink_to(tmp_path / "precious")
    with pytest.raises(OSError, match=r"\.pmil\.lock"):
        enter(tmp_path)
    assert (tmp_path / "precious").read_text() == "content"


def test_system_without_locks_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "fcntl", None)
    enter(tmp_path)
    assert os.listdir(tmp_path) == []
