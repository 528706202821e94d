"""A connection that delays messages and loses some."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

Message = TypeVar("Message")


@dataclass(frozen=True)
class Disturbance:
    """How bad a connection is.

    Args:
        delay: mean seconds that a message takes.
        jitter: largest difference from that, s; all differences are equally likely.
        loss: share of messages that never arrive.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0


class Connection(Generic[Message]):
    """Gives messages out in their order, each after its delay.

    Args:
        disturbance: how bad it is.
        generator: of delays and losses.

    Example:
        >>> late = Connection(Disturbance(delay=0.5), np.random.default_rng(0))
        >>> late.put("hello", now=0.0)
        >>> [*late.arrived(now=0.4)], [*late.arrived(now=0.5)]
        ([], ['hello'])
    """

    def __init__(self, disturbance: Disturbance, generator: np.random.Generator) -> None:
        self._disturbance, self._generator = disturbance, generator
        self._under_way: deque[tuple[float, Message]] = deque()

    def put(self, message: Message, now: float) -> None:
        """Send a message."""
        if self._generator.random() < self._disturbance.loss:
            return
        jitter = self._disturbance.jitter
        arrival = now + max(0.0, self._disturbance.delay + self._generator.uniform(-jitter, jitter))
        before = self._under_way[-1][0] if self._under_way else arrival
        self._under_way.append((max(arrival, before), message))

    def arrived(self, now: float) -> Iterator[Message]:
        """Messages that have arrived since the last call."""
        while self._under_way and self._under_way[0][0] <= now:
            yield self._under_way.popleft()[1]
