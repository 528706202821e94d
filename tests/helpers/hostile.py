"""Files that somebody made to do harm, of files that we wrote."""

from __future__ import annotations

import json
import os
import pickle
import random
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tests.helpers.damaged_contents import CONTENTS, VALUES


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
    """Damage a file, or one of a folder, at random places, and say how.

    A trap among what it holds then would make a folder ``SPRUNG`` beside it.
    """
    if path.is_dir():
        return _damaged_set(path, source)
    inside = _inside(path)
    kind = source.choice((*BYTES, "trap", *inside))
    if kind == "trap":
        path.write_bytes(pickle_of_a_trap(path))
    elif kind in BYTES:
        path.write_bytes(_other_bytes(path.read_bytes(), kind, source))
    else:
        inside[kind](path, kind, source)
    return kind


ARCHIVE = ("swap", "lose", "flip member", "cut member", "number", "trap member")
ARRAY_OF_OBJECTS = (
    np.lib.format.magic(1, 0)
    + b"\x3a\0"
    + (b"{'descr': '|O', 'fortran_order': False, 'shape': (), }".ljust(57) + b"\n")
)
Change = Callable[[Path, str, random.Random], None]
BYTES = ("flip", "cut", "zeros", "gap")
SPRUNG = "sprung"


def pickle_of_a_trap(path: Path) -> bytes:
    """A pickle that makes a folder beside a file."""
    return pickle.dumps(Trap(path.with_name(SPRUNG)), protocol=2)  # as torch.save


def _inside(path: Path) -> dict[str, Change]:
    """Damages of what a file holds, whose checksums are right again."""
    if path.suffix == ".json":
        return dict.fromkeys(("digit", "value"), change_json)
    if path.suffix == ".csv":
        return dict.fromkeys(("digit", "value", "swap", "lose"), change_table)
    if path.suffix in CONTENTS:
        return dict.fromkeys(("swap", "lose", "value", "trap value"), _change_contents)
    return dict.fromkeys(ARCHIVE, _change_archive)


def _damaged_set(folder: Path, source: random.Random) -> str:
    """Damage a file of a folder, or put another in its place."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    one, other = source.choice(files), source.choice(files)
    kind = source.choice(("file",) * 6 + ("swap files", "lose file"))
    if kind == "file":
        return f"{one.name}: {damaged(one, source)}"
    content = one.read_bytes()
    if kind == "swap files":
        one.write_bytes(other.read_bytes())
        other.write_bytes(content)
    else:
        one.unlink()
    return f"{one.name}: {kind}"


def _other_bytes(whole: bytes, kind: str, source: random.Random) -> bytes:
    content = bytearray(whole)
    place = source.randrange(max(1, len(content)))
    if kind == "flip" and content:
        content[place] ^= 1 << source.randrange(8)
    elif kind == "cut":
        del content[place:]
    elif kind == "zeros":
        content[place : place + 64] = bytes(64)
    elif kind == "gap":
        del content[place : place + source.randrange(1, 64)]
    return bytes(content)


def change_json(path: Path, kind: str, source: random.Random) -> None:
    """Change a digit of the text, or put something else in the place of a value."""
    if kind == "digit":
        path.write_bytes(_other_digit(path.read_bytes(), source))
        return
    content = json.loads(path.read_bytes())
    holder, key = source.choice(list(_places(content)))
    holder[key] = source.choice(VALUES)
    path.write_text(json.dumps(content))


def _places(content: object) -> Iterator[tuple[Any, Any]]:
    """Each list or dictionary with each of its keys."""
    keys = content if isinstance(content, dict) else range(len(content))  # type: ignore[arg-type]
    for key in keys:
        value = content[key]  # type: ignore[index]
        yield content, key
        if isinstance(value, dict | list):
            yield from _places(value)


def change_table(path: Path, kind: str, source: random.Random) -> None:
    """Change a digit, put something else into a cell, swap two cells, or leave one out."""
    if kind == "digit":
        path.write_bytes(_other_digit(path.read_bytes(), source))
        return
    rows = [line.split(",") for line in path.read_text().splitlines()]
    one, other = source.choice(rows), source.choice(rows)
    place = source.randrange(len(one))
    if kind == "swap":
        column = source.randrange(len(other))
        one[place], other[column] = other[column], one[place]
    elif kind == "lose":
        del one[place]
    else:
        one[place] = str(source.choice(VALUES))
    path.write_text("\n".join(map(",".join, rows)))


def _other_digit(whole: bytes, source: random.Random) -> bytes:
    """A digit becomes another, a bracket or a letter."""
    content = bytearray(whole)
    digits = [place for place, byte in enumerate(content) if chr(byte).isdigit()]
    if digits:
        content[source.choice(digits)] = source.choice(b"0987654321]}xN-")
    return bytes(content)


def _change_contents(path: Path, kind: str, source: random.Random) -> None:
    CONTENTS[path.suffix](path, kind, source, pickle_of_a_trap(path))


def _change_archive(path: Path, kind: str, source: random.Random) -> None:
    members = members_of(path)
    if kind == "trap member":
        name = source.choice(sorted(members))
        beginning = ARRAY_OF_OBJECTS if name.endswith(".npy") else b""
        write_members(path, {**members, name: beginning + pickle_of_a_trap(path)})
    else:
        write_members(path, _other_members(members, kind, source))


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
    if kind == "number":
        content = bytearray(_other_digit(bytes(content), source))
    elif content:
        content[source.randrange(len(content))] ^= 1 << source.randrange(8)
    return {**members, one: bytes(content)}
