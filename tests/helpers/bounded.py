"""Loads of files in a process of their own, which measures their time and memory."""

from __future__ import annotations

import gc
import json
import os
import resource
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import NoReturn

import torch

SECONDS, WALL_SECONDS = 5, 60  # of processor and of the clock, after which a load is ended
MEMORY = 16 * 2**30  # of addresses, which protects the machine
MIB = 2**20


@dataclass(frozen=True)
class Load:
    """What became of a load.

    Args:
        refusal: the line with which it was refused; None if it was accepted.
        failure: what went wrong, "" for nothing: a traceback, or how the process ended.
        seconds: of the processor.
        megabytes: by which the process had grown at most, since its first load.
    """

    refusal: str | None = None
    failure: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0


def measured(loads: Iterable[Callable[[], None]], *documented: type[BaseException]) -> list[Load]:
    """Call each in a forked process, which ends where one takes too long.

    Args:
        loads: each returns where it accepts its file. They are made in the process, one by one.
        documented: errors with which a file may be refused.

    Returns:
        What became of each. After one that ended the process there is no other.
    """
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # newer Pythons warn of threads, of which none is used
        process = os.fork()
    if not process:
        os.close(reading)
        _work(writing, loads, documented)
    os.close(writing)
    with os.fdopen(reading) as lines:
        done = [Load(**json.loads(line)) for line in lines]
    _, status = os.waitpid(process, 0)
    code = os.waitstatus_to_exitcode(status)
    return done if not code else [*done, Load(failure=f"the process ended with {code}")]


def _work(
    pipe: int, loads: Iterable[Callable[[], None]], documented: tuple[type[BaseException], ...]
) -> NoReturn:
    torch.set_num_threads(1)
    for kind in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(kind, signal.SIG_DFL)  # ends a library that never returns, too
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    code = 1
    try:
        with os.fdopen(pipe, "w") as lines, open(os.devnull, "w") as nowhere:
            gc.freeze()  # so that what the loads leave is collected soon
            before = _peak()
            for load in loads:
                with redirect_stdout(nowhere):
                    line = _measure(load, documented)
                line["megabytes"] = _peak() - before
                gc.collect()
                print(json.dumps(line), file=lines, flush=True)
        code = 0
    finally:
        os._exit(code)


def _measure(
    load: Callable[[], None], documented: tuple[type[BaseException], ...]
) -> dict[str, object]:
    line: dict[str, object] = {}
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.alarm(WALL_SECONDS)
    begun = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            load()
    except documented as error:
        line["refusal"] = str(error)
    except BaseException:
        line["failure"] = traceback.format_exc()
    line["seconds"] = time.process_time() - begun
    signal.alarm(0)
    signal.setitimer(signal.ITIMER_PROF, 0)
    return line


def _peak() -> float:
    """Largest memory of this process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MIB
