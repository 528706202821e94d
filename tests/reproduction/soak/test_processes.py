"""Runs in processes of their own: each end is recognised, and stops no other run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from reproduction.soak import processes
from reproduction.soak.processes import Attempt, End, Job, Limits, attempts_in, has_ended, size_of
from torch_pmil.runs.lock import alone_in

LEAVE = "touch summary.json report.html"
LIMITS = Limits(seconds=60.0, free_bytes=0)


def job(root: Path, name: str, script: str) -> Job:
    """A shell script in the folder of a run."""
    folder = root / name
    return Job(folder, ("sh", "-c", f"cd {folder}; {script}"))


def tried(jobs: list[Job], limits: Limits = LIMITS, at_once: int = 2) -> dict[str, Attempt]:
    """What came of each job, by the name of its folder."""
    told: list[tuple[Job, Attempt]] = []
    processes.attempt_all(jobs, limits, at_once, lambda *one: told.append(one))
    return {job.folder.name: attempt for job, attempt in told}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "POLL_S", 0.02)
    monkeypatch.setattr(processes, "SIZE_EVERY_S", 0.02)


def test_a_crash_stops_no_other_run_and_is_told_by_its_last_line(tmp_path: Path) -> None:
    jobs = [
        job(tmp_path, "crashed", "echo fine; echo error: a line; echo; exit 3"),
        job(tmp_path, "killed", "kill -9 $$"),
        job(tmp_path, "without_report", "touch summary.json"),
        job(tmp_path, "well", LEAVE),
    ]
    told = tried(jobs)
    names = "crashed", "killed", "without_report", "well"
    assert [told[name].end for name in names] == [*[End.CRASHED] * 3, End.ENDED]
    assert (told["crashed"].exit_code, told["crashed"].said) == (3, "error: a line")
    assert told["killed"].exit_code == -signal.SIGKILL
    assert told["well"].said == ""
    assert [has_ended(one.folder) for one in jobs] == [False, False, False, True]


def test_a_run_that_hangs_is_ended_with_all_that_it_started(tmp_path: Path) -> None:
    hanging = job(tmp_path, "hanging", "sleep 600 & echo $! > child; wait")
    told = tried([hanging, job(tmp_path, "well", LEAVE)], Limits(seconds=0.5, free_bytes=0))
    assert (told["hanging"].end, told["well"].end) == (End.HUNG, End.ENDED)
    child = int((hanging.folder / "child").read_text())
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(child)], capture_output=True, text=True)
    assert state.stdout.strip()[:1] in ("", "Z")


def test_a_run_whose_folder_grows_too_large_is_ended(tmp_path: Path) -> None:
    growing = job(tmp_path, "growing", "head -c 20000 /dev/zero > zeros; sleep 600")
    limits = Limits(seconds=60.0, folder_bytes=10_000, free_bytes=0)
    assert tried([growing], limits)["growing"].end == End.TOO_LARGE
    assert size_of(growing.folder) > 20_000


def test_attempts_are_counted_until_one_ends(tmp_path: Path) -> None:
    flaky = job(tmp_path, "flaky", f"test -e tried && {LEAVE} || {{ touch tried; exit 1; }}")
    assert attempts_in(flaky.folder) == [] and not has_ended(flaky.folder)
    first, second = tried([flaky])["flaky"], tried([flaky])["flaky"]
    assert attempts_in(flaky.folder) == [first, second]
    assert [first.end, second.end] == [End.CRASHED, End.ENDED]


def test_computing_is_that_of_the_process_and_of_one_thread(tmp_path: Path) -> None:
    burn = (
        "import os, time\nwhile time.process_time() < 0.5: pass\n"
        "print(os.environ['OMP_NUM_THREADS'])"
    )
    folder = tmp_path / "burning"
    told = tried([Job(folder, (sys.executable, "-c", burn)), job(tmp_path, "idle", "sleep 0.3")])
    assert told["burning"].cpu_seconds >= 0.5 > told["idle"].cpu_seconds
    assert told["burning"].said == "1"


def test_a_run_begins_when_nobody_else_is_in_its_folder(tmp_path: Path) -> None:
    waiting = job(tmp_path, "waiting", LEAVE)
    hold = (
        "import fcntl, sys, time\nfile = open(sys.argv[1], 'w')\nfcntl.flock(file, fcntl.LOCK_EX)\n"
        "print(flush=True)\ntime.sleep(float(sys.argv[2]))"
    )
    waiting.folder.mkdir()

    def held(seconds: float) -> subprocess.Popen:
        words = [sys.executable, "-c", hold, str(waiting.folder / ".pmil.lock"), str(seconds)]
        holder = subprocess.Popen(words, stdout=subprocess.PIPE)
        assert holder.stdout is not None and holder.stdout.readline()
        return holder

    with held(0.5) as holder:
        attempt = tried([waiting])["waiting"]
        assert attempt.end == End.ENDED and attempt.wall_seconds > 0.3
        assert holder.poll() is not None or holder.wait() == 0
    with held(600.0) as holder:
        attempt = tried([waiting], Limits(seconds=0.3, free_bytes=0))["waiting"]
        assert (attempt.end, attempt.exit_code) == (End.HUNG, None)
        assert attempt.said == "another process is in its folder"
        holder.kill()
    with alone_in(waiting.folder):
        pass


def test_an_interruption_ends_the_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = job(tmp_path, "endless", "echo $$ > number; exec sleep 600")

    def interrupt(seconds: float) -> None:
        if (endless.folder / "number").is_file():
            raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        tried([endless])
    with pytest.raises(ProcessLookupError):
        os.kill(int((endless.folder / "number").read_text()), 0)
    assert attempts_in(endless.folder) == []


def test_no_run_begins_on_a_full_disk_and_those_that_run_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes.check_disk(tmp_path / "new", 1)
    with pytest.raises(OSError, match="GiB free"):
        processes.check_disk(tmp_path, 2**80)
    jobs = [job(tmp_path, name, LEAVE) for name in ("first", "second")]
    free = iter((100, 0))
    monkeypatch.setattr(
        processes.shutil, "disk_usage", lambda folder: SimpleNamespace(free=next(free))
    )
    with pytest.raises(OSError, match=r"second must have .* GiB free, got 0\.0 GiB"):
        tried(jobs, Limits(free_bytes=50))
    assert [has_ended(one.folder) for one in jobs] == [True, False]
