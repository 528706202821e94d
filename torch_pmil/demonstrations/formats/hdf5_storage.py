"""Where the numbers of an HDF5 file lie: in the file itself, and unpacked no larger than they are.

HDF5 follows links into other files of the machine, reads numbers from them, and unpacks a chunk to
whatever size it has. None of that is left to it.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import Any

from torch_pmil.demonstrations.errors import DemonstrationError, check_count, optional
from torch_pmil.files import MIB

GZIP, SHUFFLE, CHECKSUM, LZF = 1, 2, 3, 32_000  # numbers of HDF5's filters
FILTERS = {GZIP, SHUFFLE, CHECKSUM, LZF}
LZF_BYTES = 4 * MIB  # of a chunk, which unpacks to at most 88 times that
CHUNKS = 2**17  # in what is read; each takes some microseconds and 2 kB, an empty one too


def member(group: Any, path: str) -> Any:
    """What a group holds under a path, or None.

    Raises:
        DemonstrationError: there is a link, which may lead to anywhere.
    """
    h5py = optional("h5py")
    for part in path.split("/"):
        link = group.get(part, getlink=True) if isinstance(group, h5py.Group) else None
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise DemonstrationError(f"{part} must lie in the file itself, got a link")
        group = group[part]
    return group


def check_storage(datasets: Sequence[Any]) -> None:
    """Check where numbers lie and how many they are, before one is read.

    Raises:
        DemonstrationError: some lie in other files, are packed to more than they are or in an
            unknown way, or are too many.
    """
    for data in datasets:
        if data.is_virtual or data.external:
            raise DemonstrationError(
                f"{data.name} must hold its numbers itself, got some of other files"
            )
    check_count(sum(max(data.size, math.prod(data.chunks or ())) for data in datasets))
    chunks = sum(_chunk_count(data) for data in datasets if data.chunks)
    if chunks > CHUNKS:
        raise DemonstrationError(f"what is read must have at most {CHUNKS} chunks, got {chunks}")
    for data in datasets:
        if data.chunks:
            _check_packed(data)


def _chunk_count(data: Any) -> int:
    return math.prod(-(-n // size) for n, size in zip(data.shape, data.chunks, strict=True))


def _check_packed(data: Any) -> None:
    """Unpack chunks one by one, as far as they may go."""
    properties = data.id.get_create_plist()
    filters = [properties.get_filter(index)[0] for index in range(properties.get_nfilters())]
    if len(set(filters)) != len(filters) or set(filters) - FILTERS or {GZIP, LZF} <= set(filters):
        raise DemonstrationError(
            f"{data.name} must be packed by gzip or lzf or not at all, got filters {filters}"
        )
    stored: list[Any] = []
    if filters:
        data.id.chunk_iter(stored.append)
    most = math.prod(data.chunks) * data.dtype.itemsize
    for chunk in stored:
        if GZIP in filters and not chunk.filter_mask >> filters.index(GZIP) & 1:
            packed = data.id.read_direct_chunk(chunk.chunk_offset)[1]
            # a checksum has four bytes
            larger = len(zlib.decompressobj().decompress(packed, most + 5)) > most + 4
        else:
            larger = LZF in filters and chunk.size > LZF_BYTES
        if larger:
            raise DemonstrationError(f"{data.name} has a chunk of more than {most} bytes")
