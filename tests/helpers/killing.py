"""Processes of their own, and their death at one of the operations that change a folder."""

from __future__ import annotations

import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import torch
from torchrl.record.loggers.csv import CSVExperiment

LONGEST = 120  # s that a process may take
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
CHANGES = {  # events by which Python tells of a change: positions of each path and of its folder
    "open": ((0, None),),
    "write": ((0, None),),
    "os.mkdir": ((0, 2),),
    "os.remove": ((0, 1),),
    "os.rename": ((0, 2), (1, 3)),
    "os.rmdir": ((0, 1),),
    "os.truncate": ((0, None),),
}
FFMPEG = "subprocess.Popen"
LASTING = ("open", "write", FFMPEG)  # that take some time, in whose midst a process may die
BEGINNING = 0.03  # s until ffmpeg is at work


@dataclass(frozen=True)
class Place:
    """An operation at which a process is killed.

    Args:
        number: of the operation, from 0.
        amid: whether the operation has begun, if it is one that takes time: a file holds half of
            what is written to it, or ffmpeg is at work. Otherwise nothing of it is done.
    """

    number: int
    amid: bool = False


@dataclass
class Operations:
    """Counts the operations that change a folder, and kills the process at one of them.

    Args:
        folder: whose changes count, with all that is below it.
        place: where to kill; None for nowhere.
        kill: ends the process.
    """

    folder: Path
    place: Place | None = None
    kill: Callable[[], None] = lambda: os.kill(os.getpid(), signal.SIGKILL)
    made: list[str] = field(default_factory=list)
    _begun: list[tuple[Path, int]] | None = None  # files in the midst, and their sizes before

    def watch(self) -> None:
        """Begin. It lasts until the process ends, so it is for a process of its own."""
        sys.addaudithook(self._heard)
        write, log = os.write, CSVExperiment.add_scalar

        def audited_write(file: int, content: bytes) -> int:
            sys.audit("write", file)
            return write(file, content)

        def audited_log(self: CSVExperiment, name: str, *values: Any, **options: Any) -> None:
            sys.audit("write", f"{self.log_dir}/scalars/{name}.csv")
            log(self, name, *values, **options)

        os.write, CSVExperiment.add_scalar = audited_write, audited_log

    def _heard(self, event: str, arguments: tuple[Any, ...]) -> None:
        paths = self._changed(event, arguments)
        if not paths:
            return
        if self._begun is not None:
            begun, self._begun = self._begun, None
            self._die_amid(begun)
        self.made.append(f"{event} {' '.join(map(str, paths))}")
        if self.place is None or len(self.made) != self.place.number + 1:
            return
        if not self.place.amid or event not in LASTING:
            self.kill()
        elif event == FFMPEG:
            self._begun = []
            signal.signal(signal.SIGALRM, lambda *_: self.kill())
            signal.setitimer(signal.ITIMER_REAL, BEGINNING)
        else:
            self._begun = [(path, _size(path)) for path in paths]

    def _die_amid(self, begun: list[tuple[Path, int]]) -> None:
        for path, before in begun:
            if path.exists():
                os.truncate(path, (before + _size(path)) // 2)
        self.kill()

    def _changed(self, event: str, arguments: tuple[Any, ...]) -> list[Path]:
        """The paths in the folder that an operation changes; ffmpeg may change any."""
        if event == FFMPEG:
            return [Path("ffmpeg")] if "ffmpeg" in str(arguments[0]) else []
        if event not in CHANGES or (event == "open" and not arguments[2] & WRITING):
            return []
        paths = [
            _path(arguments[name], None if folder is None else arguments[folder])
            for name, folder in CHANGES[event]
        ]
        return [path for path in paths if path.is_relative_to(self.folder)]


def fork(action: Callable[[], object], log: Path) -> int:
    """Let a process of its own, with one thread, do something; return its number at once.

    Args:
        action: what it does.
        log: file for what it prints, and for the error with which it ends.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which are idle here
        process = os.fork()
    if process == 0:
        _do(action, log)
    return process


def end_of(process: int) -> int:
    """Wait for a process, and return its exit code, or minus the number of its signal."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def _do(action: Callable[[], object], log: Path) -> NoReturn:
    code = 1
    try:
        signal.alarm(LONGEST)
        with log.open("w") as output:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
            sys.stdout = sys.stderr = output
            torch.set_num_threads(1)
            try:
                action()
                code = 0
            except BaseException:
                traceback.print_exc()
    finally:
        os._exit(code)


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _path(name: Any, folder: int | None) -> Path:
    """The path of an open file, or of a name in an open folder."""
    if isinstance(name, int):
        return Path(os.readlink(f"/proc/self/fd/{name}"))
    start = Path.cwd() if folder in (None, -1) else _path(folder, None)
    return start / os.fsdecode(name)
