"""A file is either whole or not there, and a stranger's is what it must be or refused."""

from __future__ import annotations

import io
import os
import socket
import zipfile
from pathlib import Path

import pytest

from torch_pmil.files import (
    FileError,
    in_words,
    opened,
    parse_json,
    read_bytes,
    read_json,
    read_text,
    read_zip,
    remove_temporaries,
    replacing,
)


def test_block_that_ends_well_leaves_its_file_and_nothing_else(tmp_path: Path) -> None:
    with replacing(tmp_path / "numbers.csv") as temporary:
        temporary.write_text("1,2")
    assert (tmp_path / "numbers.csv").read_text() == "1,2"
    assert os.listdir(tmp_path) == ["numbers.csv"]


def test_old_file_stays_whole_until_the_block_ends_and_for_who_opened_it(tmp_path: Path) -> None:
    """The new file takes the old one's name, not its place on the disk."""
    path = tmp_path / "numbers.csv"
    path.write_text("old")
    with path.open() as reader:
        with replacing(str(path)) as temporary:
            temporary.write_text("a longer new text")
            assert path.read_text() == "old"
        assert reader.read() == "old"
    assert path.read_text() == "a longer new text"


def test_block_that_raises_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "numbers.csv"
    path.write_text("old")
    with pytest.raises(RuntimeError, match="half way"), replacing(path) as temporary:
        temporary.write_text("ne")
        raise RuntimeError("half way")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["numbers.csv"]


def test_block_that_raises_before_it_writes_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="at once"), replacing(tmp_path / "numbers.csv"):
        raise RuntimeError("at once")
    assert os.listdir(tmp_path) == []


def test_temporary_name_lies_in_the_same_folder_and_keeps_the_suffix(tmp_path: Path) -> None:
    """A rename is atomic within one file system only; writers choose the format by the suffix."""
    with replacing(tmp_path / "video.mp4") as temporary:
        temporary.write_text("")
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".mp4")


@pytest.mark.parametrize(
    ("folder", "kind"), [("nowhere", FileNotFoundError), ("file", NotADirectoryError)]
)
def test_path_below_no_folder_is_an_oserror(
    tmp_path: Path, folder: str, kind: type[OSError]
) -> None:
    (tmp_path / "file").write_text("old")
    with pytest.raises(kind), replacing(tmp_path / folder / "numbers.csv") as temporary:
        temporary.write_text("1,2")
    assert (tmp_path / "file").read_text() == "old"
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_folder_without_permission_is_an_oserror(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError), replacing(tmp_path / "numbers.csv") as temporary:
        temporary.write_text("1,2")


def test_path_that_is_a_folder_is_an_oserror_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError), replacing(tmp_path / "folder") as temporary:
        temporary.write_text("1,2")
    assert os.listdir(tmp_path) == ["folder"]


def test_file_of_the_size_is_read_and_one_larger_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"four")
    assert read_bytes(tmp_path / "a", 4) == b"four"
    with pytest.raises(FileError, match="of at most 3 bytes, got 4 bytes"):
        read_bytes(tmp_path / "a", 3)


def test_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("here")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert read_text(tmp_path / "b") == "here"


def test_pipe_is_refused_without_waiting_for_a_writer(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileError, match="got a pipe"):
        read_bytes(tmp_path / "pipe", 10)


def test_pipe_that_takes_the_name_of_a_file_is_refused_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the look at the name and the opening."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    before = os.stat(tmp_path / "file")
    with monkeypatch.context() as patch:
        patch.setattr(os, "stat", lambda *arguments, **options: before)
        with pytest.raises(FileError, match="got a pipe"), opened(tmp_path / "pipe", 10):
            pass


def test_socket_and_folder_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("s")
        with pytest.raises(FileError, match="got a socket"):
            read_bytes("s", 10)
    with pytest.raises(FileError, match="got a folder"):
        read_bytes(tmp_path, 10)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs Linux")
def test_file_that_says_no_size_is_bounded_too() -> None:
    with pytest.raises(FileError, match="of at most 10 bytes, got more"):
        read_bytes("/proc/self/maps", 10)


def test_missing_file_is_an_oserror(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_json(tmp_path / "nothing")


@pytest.mark.parametrize("text", [b"", b"{", b"\xff", b"[" * 10**5, b"1" * 10**5])
def test_what_is_no_json_is_refused_in_one_line(text: bytes) -> None:
    with pytest.raises(FileError, match=r"^must be JSON, got .*$"):
        parse_json(text)


@pytest.mark.parametrize("text", [b"NaN", b"[-Infinity]", b'{"a": Infinity}'])
def test_numbers_that_json_has_not_may_be_refused(text: bytes) -> None:
    parse_json(text)
    with pytest.raises(FileError, match=r"must be JSON, got -?(NaN|Infinity)"):
        parse_json(text, finite=True)


def packed(method: int, *contents: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for number, content in enumerate(contents):
            archive.writestr(str(number), content)
    return buffer.getvalue()


def test_packed_members_are_read_where_they_may_be_up_to_their_bound() -> None:
    content = packed(zipfile.ZIP_DEFLATED, bytes(600), bytes(400))
    assert read_zip(content, most=1000, stored=False) == {"0": bytes(600), "1": bytes(400)}
    with pytest.raises(FileError, match="at most 999 bytes together, got 1000 bytes"):
        read_zip(content, most=999, stored=False)
    with pytest.raises(FileError, match="must be stored as they are, got '0' packed"):
        read_zip(content, most=1000)


def test_member_that_unpacks_to_more_than_it_says_is_cut_and_refused() -> None:
    content = packed(zipfile.ZIP_DEFLATED, bytes(10**6))
    said = (10**6).to_bytes(4, "little")
    with pytest.raises(FileError):
        read_zip(content.replace(said, (100).to_bytes(4, "little")), most=1000, stored=False)


def test_archive_of_very_many_members_is_refused_before_they_are_listed() -> None:
    with pytest.raises(FileError, match="at most 20000 members, got more"):
        read_zip(b"PK\1\2" * 20_001, most=10**9)


def test_what_is_there_under_the_temporary_name_is_never_written_to(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("content")
    debris = tmp_path / f".numbers.{os.getpid()}.csv"
    for leave in (lambda: debris.symlink_to(tmp_path / "precious"), lambda: debris.touch(0o400)):
        leave()
        with replacing(tmp_path / "numbers.csv") as temporary:
            assert temporary == debris and not debris.is_symlink()
            temporary.write_text("1,2")
        assert (tmp_path / "numbers.csv").read_text() == "1,2"
    assert (tmp_path / "precious").read_text() == "content"
    assert sorted(os.listdir(tmp_path)) == ["numbers.csv", "precious"]


def test_temporary_file_is_as_readable_as_any(tmp_path: Path) -> None:
    with replacing(tmp_path / "numbers.csv") as temporary:
        temporary.write_text("1,2")
    (tmp_path / "plain").touch()
    assert (tmp_path / "numbers.csv").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_only_temporaries_of_that_name_are_removed(tmp_path: Path) -> None:
    kept = ("video.mp4", ".video.mp4", ".video.12a.mp4", ".video.12.mp4.bak", ".other.12.mp4")
    for name in (*kept, ".video.12.mp4"):
        (tmp_path / name).touch()
    (tmp_path / ".video.13.mp4").mkdir()
    remove_temporaries(tmp_path / "video.mp4")
    assert set(os.listdir(tmp_path)) == {*kept, ".video.13.mp4"}
    remove_temporaries(tmp_path / "*.mp4")
    assert set(os.listdir(tmp_path)) == {*kept, ".video.13.mp4"} - {".other.12.mp4"}
    remove_temporaries(tmp_path / "nowhere" / "video.mp4")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("recorded.csv", "there is no file recorded.csv"),
        ("nowhere/else/recorded.csv", "there is no folder nowhere"),
        ("dangling", "dangling: No such file or directory"),
        ("folder", "folder: Is a directory"),
        ("file/recorded.csv", "file/recorded.csv: Not a directory"),
    ],
)
def test_what_the_system_says_is_put_into_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dangling").symlink_to("nothing")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(OSError) as error:
        Path(name).read_text()
    assert in_words(error.value) == said


def test_error_without_a_file_has_no_number() -> None:
    assert in_words(OSError(28, "No space left on device")) == "No space left on device"
    assert in_words(OSError("ffmpeg is missing")) == "ffmpeg is missing"
    assert in_words(ValueError("seed must be")) == "seed must be"
