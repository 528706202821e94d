"""The arrays of a MATLAB file, measured before SciPy reads them.

An array states its shape, and what SciPy makes of it has that shape, however few bytes follow. Here
no array may have more numbers, cells or structures than bytes. SciPy takes what is in an array as
it comes, whatever the array says of its end, so the walk goes from element to element too.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator

from torch_pmil.demonstrations.errors import TEXT_BYTES, DemonstrationError
from torch_pmil.files import MIB

HEADER = 128  # bytes before the first element of a file
PACKED, ARRAY = 15, 14  # numbers of elements
FLAGS = 16  # bytes at the beginning of an array
ELEMENTS = 1000  # of a file; those of the set have a handful
ARRAYS = 20_000  # within each other; those of the set have some fifty


def check_arrays(content: bytes) -> None:
    """Unpack and walk through all elements of a file; ``struct`` or ``zlib`` fails at damage.

    Raises:
        DemonstrationError: they are too many, or larger than what they hold.
    """
    order = "<" if content[HEADER - 2 : HEADER] == b"IM" else ">"
    arrays = 0
    for element in _elements(content, order):
        place = 0
        while place + 8 <= len(element):
            kind, size = struct.unpack_from(f"{order}2I", element, place)
            if kind == ARRAY and size:
                arrays += 1
                place = _behind_shape(element, place + 8, size, order)
            else:
                place = _next(element, place, order)
            if arrays > ARRAYS:
                raise DemonstrationError(f"must have at most {ARRAYS} arrays, got more")


def _elements(content: bytes, order: str) -> Iterator[bytes]:
    """The elements of a file, unpacked piece by piece as far as they may go."""
    place, total = HEADER, 0
    for _ in range(ELEMENTS):
        if place + 8 > len(content):
            return
        kind, size = struct.unpack_from(f"{order}2I", content, place)
        if kind != PACKED:
            yield content[place : place + 8 + size]
        else:
            unpacking, left, parts = zlib.decompressobj(), content[place + 8 : place + 8 + size], []
            while left and not unpacking.eof:
                parts.append(unpacking.decompress(left, MIB))
                total, left = total + len(parts[-1]), unpacking.unconsumed_tail
                if total > TEXT_BYTES:
                    raise DemonstrationError(
                        f"must have at most {TEXT_BYTES} bytes unpacked, got more"
                    )
            yield b"".join(parts)
        place += 8 + size
    raise DemonstrationError(f"must have at most {ELEMENTS} elements, got more")


def _next(element: bytes, place: int, order: str) -> int:
    """The place behind what begins at a place: eight bytes for all of it where that is enough."""
    kind, size = struct.unpack_from(f"{order}2I", element, place)
    return place + 8 + (0 if kind >> 16 else -(-size // 8) * 8)


def _behind_shape(element: bytes, place: int, size: int, order: str) -> int:
    """Check the shape of an array, and return the place behind it."""
    place += FLAGS
    kind, length = struct.unpack_from(f"{order}2I", element, place)
    at, length = (place + 4, kind >> 16) if kind >> 16 else (place + 8, length)
    shape = struct.unpack_from(f"{order}{min(length, size) // 4}i", element, at)
    if min(shape, default=0) < 0 or math.prod(shape) > size:
        raise DemonstrationError(f"an array of {size} bytes cannot have the shape {shape[:9]}")
    return _next(element, place, order)
