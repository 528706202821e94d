"""A server that another program starts, kills and starts again."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType

ROOT = Path(__file__).parents[2]


class ServerProcess:
    """A server in a process of its own, with sockets in a folder of its own.

    Args:
        options: of the command line of ``server.py``, besides the addresses.

    ``states`` and ``commands`` are its addresses. It runs within a ``with`` block.
    """

    def __init__(self, *options: str) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self.states = f"ipc://{self._folder.name}/states"
        self.commands = f"ipc://{self._folder.name}/commands"
        module = [sys.executable, "-m", "examples.robot_server.server"]
        addresses = ["--states", self.states, "--commands", self.commands]
        self._command = [*module, *addresses, *options]

    def start(self) -> None:
        """Start it, and wait until it serves. Raises RuntimeError where it does not."""
        self._process = subprocess.Popen(self._command, cwd=ROOT, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        with self._process.stdout as told:
            if not told.readline():
                raise RuntimeError(f"the robot server ended with code {self._process.wait()}")

    def kill(self) -> None:
        """``kill -9``, once or more."""
        self._process.kill()
        self._process.wait()

    def __enter__(self) -> ServerProcess:
        """Start it."""
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType
    ) -> None:
        """Kill it."""
        self.kill()
        self._folder.cleanup()
