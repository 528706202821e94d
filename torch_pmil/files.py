"""Files that are written wholly or not at all, and untrusted files that are read with bounds.

Before a byte is read, a file must be a regular one of at most a given size. Before a member of a
ZIP archive is unpacked, the number and sizes of all members are checked.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import reprlib
import stat
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

MIB = 2**20
# a run leaves a few hundred kB of JSON and CSV; Python needs about 30 times that to parse it
TEXT_BYTES = 4 * MIB
LINE = 1000  # characters of an error's message
ZIP_MEMBERS = 20_000  # of any archive; that of a run has about a hundred
KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 120


class LineError(ValueError):
    """An error whose message is one line of bounded length, whatever a file contains.

    Example:
        >>> str(LineError("column a\\nb")), len(str(LineError("x" * 10**6)))
        ('column a b', 1000)
    """

    def __init__(self, message: object) -> None:
        super().__init__(bounded_line(message))


class FileError(LineError):
    """A file is not as expected."""


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """A temporary file beside ``path``, which replaces it when the block ends without an error.

    Otherwise it is removed. It is new and empty: a file or link of its name is removed, and never
    written to.

    Args:
        path: the file to make or to replace. The temporary name keeps its suffix.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "numbers.csv"
        >>> with replacing(path) as temporary:
        ...     _ = temporary.write_text("1,2")
        >>> path.read_text()
        '1,2'
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    with _errors_name(path):
        _make_new(temporary)
    try:
        yield temporary
        with _errors_name(path):
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def _errors_name(path: Path) -> Iterator[None]:
    """Let errors name this file, not its temporary name."""
    try:
        yield
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from error


def _make_new(path: Path) -> None:
    """Make an empty file where an earlier process of our number may have left one."""
    path.unlink(missing_ok=True)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
    os.close(os.open(path, flags, 0o666))


def remove_temporaries(path: Path | str) -> None:
    """Remove what :func:`replacing` left beside ``path`` when its process was killed.

    A path ``*.png`` stands for all files of that suffix in its folder.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> (folder / ".video.4711.mp4").touch()
        >>> remove_temporaries(folder / "video.mp4")
        >>> list(folder.iterdir())
        []
    """
    path = Path(path)
    stem = ".+" if path.stem == "*" else re.escape(path.stem)
    name = re.compile(rf"\.{stem}\.\d+{re.escape(path.suffix)}")
    for left in path.parent.iterdir() if path.parent.is_dir() else ():
        if name.fullmatch(left.name) and not left.is_dir():
            left.unlink(missing_ok=True)


def write_json(path: Path | str, content: object) -> None:
    """Write a JSON file, wholly or not at all; raises ValueError at NaN and infinity."""
    text = json.dumps(content, indent=2, allow_nan=False)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n")


@contextmanager
def opened(path: Path | str, most: int) -> Iterator[BinaryIO]:
    """A regular file of at most ``most`` bytes, open for reading. Links are followed.

    It never waits, as for the writer of a pipe.

    Raises:
        FileError: it is not a regular file, or is larger.
        OSError: it cannot be opened.

    Example:
        >>> opened("/dev/zero", most=100).__enter__()
        Traceback (most recent call last):
        torch_pmil.files.FileError: must be a regular file of at most 100 bytes, got a device
    """
    _check_regular(os.stat(path), most)
    with open(path, "rb", opener=_open_at_once) as file:
        _check_regular(os.fstat(file.fileno()), most)  # another file may have taken its name
        yield file


def read_bytes(path: Path | str, most: int) -> bytes:
    """All of a regular file of at most ``most`` bytes. Errors are those of :func:`opened`."""
    with opened(path, most) as file:
        content = file.read(most + 1)  # files in /proc do not report their size
    if len(content) > most:
        raise FileError(f"must be a regular file of at most {_size(most)}, got more")
    return content


def read_text(path: Path | str, most: int = TEXT_BYTES) -> str:
    """All of a UTF-8 file. Errors are those of :func:`opened`; FileError if it is not UTF-8."""
    try:
        return read_bytes(path, most).decode()
    except UnicodeDecodeError as error:
        raise FileError(f"must be UTF-8, got {error}") from error


def read_json(path: Path | str, most: int = TEXT_BYTES, finite: bool = False) -> Any:
    """The content of a JSON file. Errors are those of :func:`opened` and :func:`parse_json`."""
    return parse_json(read_bytes(path, most), finite)


def parse_json(text: bytes, finite: bool = False) -> Any:
    """The content of JSON in UTF-8; raises FileError if it is not JSON.

    With ``finite`` NaN, Infinity and decimal fractions beyond float64 are errors too.

    Example:
        >>> parse_json(b'{"seed": 0}')
        {'seed': 0}
    """
    try:
        number = _finite if finite else None
        return json.loads(text.decode(), parse_constant=number, parse_float=number)
    except RecursionError as error:
        raise FileError("must be JSON, got lists in lists without end") from error
    except ValueError as error:
        raise FileError(f"must be JSON, got {error}") from error


def read_zip(content: bytes, most: int, stored: bool = True) -> dict[str, bytes]:
    """Members of a ZIP archive by name; their checksums are compared.

    Args:
        content: the archive.
        most: largest sum of the members' sizes.
        stored: whether compressed members are refused; then all are no larger than the archive.

    Raises:
        FileError: it is not such an archive.

    Example:
        >>> buffer = io.BytesIO()
        >>> with zipfile.ZipFile(buffer, "w") as archive:
        ...     archive.writestr("a.txt", "ab")
        >>> read_zip(buffer.getvalue(), most=100)
        {'a.txt': b'ab'}
    """
    if content.count(b"PK\1\2") > ZIP_MEMBERS:  # with which each entry of the directory begins
        raise FileError(f"must be an archive of at most {ZIP_MEMBERS} members, got more")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            _check_members(members, min(most, len(content)) if stored else most, stored)
            return {member.filename: _member(archive, member) for member in members}
    except FileError:
        raise
    except Exception as error:  # zipfile raises any type at other bytes
        raise FileError(f"must be a whole ZIP archive, got: {error}") from error


def bounded_line(message: object) -> str:
    """A message without line breaks and control characters, and without its middle if it is long.

    For an error without a message it is the name of its type.

    Example:
        >>> bounded_line(ValueError("first\\nsecond\\x1b[31m"))
        'first second [31m'
    """
    text = str(message).strip() or type(message).__name__
    if len(text) > LINE:
        half = LINE // 2 - 3
        text = f"{text[:half]} .... {text[-half:]}"
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def in_words(error: Exception) -> str:
    """The message of an error; for the system's errors the file and the reason, without a number.

    Example:
        >>> try:
        ...     open("nowhere/recorded.csv")
        ... except OSError as error:
        ...     print(in_words(error))
        there is no folder nowhere
    """
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    if error.filename is None:
        return error.strerror
    path = Path(os.fsdecode(error.filename))
    if not isinstance(error, FileNotFoundError) or path.is_symlink():
        return f"{path}: {error.strerror}"
    missing = [folder for folder in reversed(path.parents) if not folder.exists()]
    return f"there is no folder {missing[0]}" if missing else f"there is no file {path}"


def short(value: object) -> str:
    """A value in one line of bounded length, for messages.

    Example:
        >>> short(["x\\n", 10**30]), len(short("x" * 10**6))
        ("['x\\\\n', 1000000000000000000000000000000]", 120)
    """
    return " ".join(_SHORT.repr(value).split())


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check_regular(status: os.stat_result, most: int) -> None:
    kind = stat.S_IFMT(status.st_mode)
    if kind == stat.S_IFREG and status.st_size <= most:
        return
    came = KINDS.get(kind, "another kind") if kind != stat.S_IFREG else _size(status.st_size)
    raise FileError(f"must be a regular file of at most {_size(most)}, got {came}")


def _size(count: int) -> str:
    return f"{count / MIB:.0f} MiB" if count >= MIB else f"{count} bytes"


def _finite(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text[:40]}, which is not finite")
    return number


def _check_members(members: list[zipfile.ZipInfo], most: int, stored: bool) -> None:
    seen: set[str] = set()
    for member in members:
        if member.filename in seen:
            raise FileError(f"must hold each member once, got {member.filename!r} twice")
        if member.flag_bits & 1 or (stored and member.compress_type != zipfile.ZIP_STORED):
            raise FileError(f"members must be stored as they are, got {member.filename!r} packed")
        seen.add(member.filename)
    total = sum(member.file_size for member in members)
    if total > most:
        raise FileError(f"members must have at most {_size(most)} together, got {_size(total)}")


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """A member of the size that was checked; a compressed one may unpack to more than it says."""
    with archive.open(member) as file:
        content = b"".join(iter(partial(file.read, MIB), b""))
    if len(content) != member.file_size:
        raise FileError(f"{member.filename!r} must have {member.file_size} bytes, got other")
    return content
