"""Telling what was learned: steps after a run's end, none of which can fail the run."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from torch_pmil.files import bounded_line

Step = tuple[str, Callable[[], object]]  # what it makes, and how


def tell(steps: Iterable[Step]) -> list[str]:
    """Take each step in turn, whatever became of those before it.

    Args:
        steps: names of what is made, each with a function that makes it.

    Returns:
        A line for each step that failed. Ctrl-C is the failure of a step, and of those after it.

    Example:
        >>> tell([("figures", lambda: 1 / 0), ("report", lambda: None)])
        ['figures: division by zero']
    """
    failures, stopped = [], False
    for name, step in steps:
        try:
            if not stopped:
                step()
        except KeyboardInterrupt:
            stopped = True
        except Exception as error:  # whatever it is: what was learned is saved
            failures.append(f"{name}: {bounded_line(error)}")
        if stopped:
            failures.append(f"{name}: stopped")
    return failures


def making_the_rest(out: Path) -> str:
    """The command that makes what is missing of what a run leaves.

    Example:
        >>> making_the_rest(Path("my runs/a"))
        "pmil resume 'my runs/a'"
    """
    folder = f"./{out}" if str(out).startswith("-") else str(out)
    return shlex.join(["pmil", "resume", folder])


def warn_incomplete(label: str, failures: list[str], remedy: str) -> None:
    """Say on standard error, in one line, what is missing and what makes it, if anything is."""
    if failures:
        print(
            f"{label}the report is incomplete: {'; '.join(failures)}; {remedy} makes the rest "
            "later, pmil report the page alone",
            file=sys.stderr,
            flush=True,
        )
