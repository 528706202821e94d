"""The person who resets a robot between two rollouts, and how a rollout or a run ends there."""

from __future__ import annotations

QUESTION = (
    "Put the robot at its start. Enter runs it, d discards the last rollout, q ends the run: "
)


class RobotError(RuntimeError):
    """A robot cannot be reached or misbehaves; one line says what went wrong.

    Recorded data is kept, and ``resume`` continues.
    """


class RunStopped(Exception):
    """The operator ends the run; ``resume`` continues it."""


class RolloutDiscarded(Exception):
    """The operator removes the last rollout from the data."""


def prompt() -> None:
    """Ask the operator at the terminal, and return when the robot is at its start.

    Raises:
        RolloutDiscarded: the answer is d.
        RunStopped: the answer is q, or the input ends, as without a terminal.

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
        try:
            answer = input(QUESTION).strip().lower()
        except EOFError:
            answer = "q"
        match answer:
            case "":
                return
            case "d":
                raise RolloutDiscarded("the operator discarded the last rollout")
            case "q":
                raise RunStopped("the operator ended the run; resume goes on with it")
