"""What a check of demonstrations finds: a cause, and one line for the user."""

from __future__ import annotations

from dataclasses import dataclass

# causes that several checks find
UNREACHABLE = "demonstrations out of reach"
FEW = "too few demonstrations"
CONTRADICTORY = "contradictory demonstrations"
WRAPS = "angles that wrap"


@dataclass(frozen=True)
class Finding:
    """A flaw of demonstrations: one of a few causes, and a line with what, where and what to do.

    Nothing good can come of a fatal one.
    """

    cause: str
    message: str
    fatal: bool = False
