"""What is done first when the process is told to end."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """Calls ``stop`` at Ctrl-C, SIGTERM and SIGHUP, and then does what was done at them before.

    Handlers belong to the main thread: outside it this does nothing. A signal that the process
    ignores stays ignored.

    Args:
        stop: called without arguments.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop
        self._before = {}
        if threading.current_thread() is threading.main_thread():
            before = {number: signal.getsignal(number) for number in NUMBERS}
            self._before = {
                number: handler
                for number, handler in before.items()
                if handler not in (signal.SIG_IGN, None)
            }
        for number in self._before:
            signal.signal(number, self._heard)

    def close(self) -> None:
        """Put the handlers back that were there before, unless others have come since."""
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                if signal.getsignal(number) == self._heard:
                    signal.signal(number, handler)

    def _heard(self, number: int, frame: FrameType | None) -> None:
        self._stop()
        handler = self._before[signal.Signals(number)]
        if callable(handler):
            handler(number, frame)
        else:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
