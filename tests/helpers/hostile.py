"""Files that somebody made to do harm, of files that we wrote."""

from __future__ import annotations

import os
import random
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path


class Trap:
    """A pickle of it makes a folder when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable, tuple]:
        return os.mkdir, (str(self.path),)


def members_of(path: Path) -> dict[str, bytes]:
    """All members of a ZIP archive."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write_members(path: Path, members: Mapping[str, bytes]) -> None:
    """Write a ZIP archive as ``torch.save`` and TorchRL do, with right checksums."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def damaged(path: Path, source: random.Random) -> str:
    """Damage a ZIP archive at random places, and say how."""
    content, kind = bytearray(path.read_bytes()), source.choice(DAMAGES)
    place = source.randrange(len(content))
    if kind == "flip":
        content[place] ^= 1 << source.randrange(8)
    elif kind == "cut":
        del content[place:]
    elif kind == "zeros":
        content[place : place + 64] = bytes(64)
    elif kind == "gap":
        del content[place : place + source.randrange(1, 64)]
    if kind in ("flip", "cut", "zeros", "gap"):
        path.write_bytes(content)
    else:
        write_members(path, _other_members(members_of(path), kind, source))
    return kind


DAMAGES = ("flip", "cut", "zeros", "gap", "swap", "lose", "flip member", "cut member", "number")


def _other_members(members: dict[str, bytes], kind: str, source: random.Random) -> dict[str, bytes]:
    """Members that are damaged, with a checksum that says they are not."""
    one, other = source.sample(sorted(members), 2)
    content = bytearray(members[one])
    if kind == "swap":
        return {**members, one: members[other], other: members[one]}
    if kind == "lose":
        return {name: held for name, held in members.items() if name != one}
    if kind == "cut member":
        return {**members, one: members[one][: len(content) // 2]}
    if kind == "number":  # of text: a digit becomes another, a bracket or a letter
        digits = [place for place, byte in enumerate(content) if chr(byte).isdigit()]
        if digits:
            content[source.choice(digits)] = source.choice(b"0987654321]}xN-")
    elif content:
        content[source.randrange(len(content))] ^= 1 << source.randrange(8)
    return {**members, one: bytes(content)}
