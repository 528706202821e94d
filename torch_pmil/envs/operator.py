"""The person who resets a robot between two rollouts, and what ends a rollout or a run there."""

from __future__ import annotations

QUESTION = (
    "Put the robot at its start. Enter runs it, d discards the last rollout, q ends the run: "
)


class RobotError(RuntimeError):
    """A robot cannot be reached or does not do what it must; one line says what went wrong.

    What was recorded is kept, and ``resume`` goes on.
    """


class RunStopped(Exception):
    """The operator ends the run, which ``resume`` goes on with."""


class RolloutDiscarded(Exception):
    """The operator takes the last rollout out of the data."""


def prompt() -> None:
    """Ask the operator at the terminal, and return when the robot is at its start.

    Enter runs the next rollout. An end of the input, as without a terminal, ends the run.

    Raises:
        RolloutDiscarded: the answer is d.
        RunStopped: the answer is q, or there is none.

    Example:
        >>> import io, sys
        >>> sys.stdin = io.StringIO("q")
        >>> try:  # doctest: +NORMALIZE_WHITESPACE
        ...     prompt()
        ... except RunStopped as stopped:
        ...     print(f"\\n{stopped}")
        ... finally:
        ...     sys.stdin = sys.__stdin__
        Put the robot at its start. Enter runs it, d discards the last rollout, q ends the run:
        the operator ended the run; resume goes on with it
    """
    while True:
        match _answer():
            case "":
                return
            case "d":
                raise RolloutDiscarded("the operator discarded the last rollout")
            case "q":
                raise RunStopped("the operator ended the run; resume goes on with it")


def _answer() -> str:
    try:
        return input(QUESTION).strip().lower()
    except EOFError:
        return "q"
