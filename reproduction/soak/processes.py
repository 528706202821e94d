"""Runs in processes of their own, each watched: it may crash, hang or fill the disk alone."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

from torch_pmil.files import bounded_line, read_json, write_json
from torch_pmil.runs.lock import RunGoingOnError, alone_in

GIB = 2**30
POLL_S = 0.2
SIZE_EVERY_S = 10.0
TAIL = 4096  # bytes of a run's output, the last line of which says why it failed
ELSEWHERE = "another process is in its folder"
RECORD, OUTPUT = "soak.json", "output.txt"


class End(StrEnum):
    """How an attempt at a run ended."""

    ENDED = "ended"  # by itself, with a summary and a report
    CRASHED = "crashed"
    HUNG = "hung"
    TOO_LARGE = "too large"


@dataclass(frozen=True)
class Limits:
    """What a run may take.

    Args:
        seconds: wall time of one attempt; then it is ended, and counts as hung.
        folder_bytes: size of its folder; when it is larger, the run is ended.
        free_bytes: of the disk; with less no run is begun.
    """

    seconds: float = 1800.0
    folder_bytes: int = GIB
    free_bytes: int = 4 * GIB


@dataclass(frozen=True)
class Job:
    """A process that learns a run in its folder, or goes on with it.

    Args:
        folder: of the run.
        words: of the command.
    """

    folder: Path
    words: tuple[str, ...]


@dataclass(frozen=True)
class Attempt:
    """What came of a process.

    Args:
        end: how it ended.
        exit_code: of the process; -N where signal N ended it, None where it could not begin.
        wall_seconds: until its end.
        cpu_seconds: of the process and those that it started.
        said: the last line of its output, ``""`` if all is well.
    """

    end: End
    exit_code: int | None
    wall_seconds: float
    cpu_seconds: float
    said: str


def attempts_in(folder: Path) -> list[Attempt]:
    """All attempts at a run, in order; none where there is no record of them."""
    if not (folder / RECORD).is_file():
        return []
    records = read_json(folder / RECORD)
    return [Attempt(**{**record, "end": End(record["end"])}) for record in records]


def has_ended(folder: Path) -> bool:
    """Whether the last attempt at a run came to its end."""
    return bool(attempts := attempts_in(folder)) and attempts[-1].end == End.ENDED


def check_disk(folder: Path, least: int) -> None:
    """Raise OSError unless the disk of a folder has that many bytes free."""
    folder.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(folder).free
    if free < least:
        raise OSError(
            f"the disk of {folder} must have {least / GIB:.1f} GiB free, got {free / GIB:.1f} GiB"
        )


def size_of(folder: Path) -> int:
    """Bytes in the files below a folder, which may come and go meanwhile."""
    size = 0
    for path, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                size += os.lstat(os.path.join(path, name)).st_size
    return size


def attempt_all(
    jobs: Sequence[Job],
    limits: Limits,
    at_once: int,
    on_end: Callable[[Job, Attempt], object],
) -> None:
    """Try each job once, some at once; what one of them does stops none of the others.

    Each attempt is written into ``soak.json`` in the folder of its run, and what the process prints
    into ``output.txt``. Whatever ends this function ends the processes too; killed for good, they
    come to their own end, for which the next call waits.

    Args:
        jobs: in the order in which they begin.
        limits: of each.
        at_once: number of processes.
        on_end: called with each job and what came of it.

    Raises:
        OSError: there is too little space on the disk to begin another one, when the others are
            through.
    """
    waiting, active = deque(jobs), list[_Process]()
    shortage: OSError | None = None
    try:
        while active or (waiting and shortage is None):
            while waiting and len(active) < at_once and shortage is None:
                shortage = _begin_next(waiting, active, limits)
            time.sleep(POLL_S)
            for process in list(active):
                attempt = process.attempt()
                if attempt is not None:
                    active.remove(process)
                    _record(process.job.folder, attempt)
                    on_end(process.job, attempt)
    finally:
        for process in active:
            process.kill()
    if shortage is not None:
        raise shortage


def _begin_next(waiting: deque[Job], active: list[_Process], limits: Limits) -> OSError | None:
    """Let the next job become active, or return why it cannot."""
    try:
        check_disk(waiting[0].folder, limits.free_bytes)
    except OSError as error:
        return error
    active.append(_Process(waiting.popleft(), limits))
    return None


def _record(folder: Path, attempt: Attempt) -> None:
    write_json(folder / RECORD, [asdict(one) for one in (*attempts_in(folder), attempt)])


class _Process:
    """One attempt at a job; it begins as soon as nobody else is in the folder.

    Whoever is there was begun before, and takes the core that this attempt waits with.
    """

    def __init__(self, job: Job, limits: Limits) -> None:
        self.job, self._limits = job, limits
        self._began = self._measured = time.monotonic()
        self._process: subprocess.Popen | None = None

    def attempt(self) -> Attempt | None:
        """What came of it, or None while it goes on."""
        if self._process is None and _is_free(self.job.folder):
            self._process = self._begin()
        if self._process is None:
            return self._attempt(End.HUNG, 0.0, ELSEWHERE) if self._is_late else None
        end = self._overstepped()
        if end is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
        pid, status, usage = os.wait4(self._process.pid, os.WNOHANG if end is None else 0)
        if not pid:
            return None
        self._process.returncode = os.waitstatus_to_exitcode(status)
        end = end or (End.ENDED if self._is_whole else End.CRASHED)
        said = "" if end == End.ENDED else _last_line(self.job.folder / OUTPUT)
        return self._attempt(end, usage.ru_utime + usage.ru_stime, said)

    def kill(self) -> None:
        """End the process, wherever it is."""
        if self._process is not None and self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    @property
    def _is_late(self) -> bool:
        return time.monotonic() - self._began > self._limits.seconds

    @property
    def _is_whole(self) -> bool:
        assert self._process is not None
        there = [(self.job.folder / name).is_file() for name in ("summary.json", "report.html")]
        return self._process.returncode == 0 and all(there)

    def _begin(self) -> subprocess.Popen:
        """The process, with one thread and with its output in a file, in a group of its own."""
        with (self.job.folder / OUTPUT).open("ab") as output:
            return subprocess.Popen(
                self.job.words,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
                start_new_session=True,
            )

    def _overstepped(self) -> End | None:
        """The limit that it is beyond."""
        if self._is_late:
            return End.HUNG
        if time.monotonic() - self._measured < SIZE_EVERY_S:
            return None
        self._measured = time.monotonic()
        return End.TOO_LARGE if size_of(self.job.folder) > self._limits.folder_bytes else None

    def _attempt(self, end: End, cpu_seconds: float, said: str) -> Attempt:
        code = None if self._process is None else self._process.returncode
        wall_seconds = time.monotonic() - self._began
        return Attempt(end, code, round(wall_seconds, 2), round(cpu_seconds, 2), said)


def _is_free(folder: Path) -> bool:
    try:
        with alone_in(folder):
            return True
    except RunGoingOnError:
        return False


def _last_line(path: Path) -> str:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - TAIL))
        lines = file.read().decode(errors="replace").split("\n")
    return next((bounded_line(line) for line in reversed(lines) if line.strip()), "")
