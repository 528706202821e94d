"""A file is either whole or not there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from torch_pmil.files import remove_temporaries, replacing


def test_block_that_ends_well_leaves_its_file_and_nothing_else(tmp_path: Path) -> None:
    with replacing(tmp_path / "numbers.csv") as temporary:
        temporary.write_text("1,2")
    assert (tmp_path / "numbers.csv").read_text() == "1,2"
    assert os.listdir(tmp_path) == ["numbers.csv"]


def test_path_may_be_a_string(tmp_path: Path) -> None:
    with replacing(str(tmp_path / "numbers.csv")) as temporary:
        temporary.write_text("1,2")
    assert (tmp_path / "numbers.csv").read_text() == "1,2"


def test_old_file_stays_whole_until_the_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "numbers.csv"
    path.write_text("old")
    with replacing(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"


def test_file_opened_before_keeps_what_it_was(tmp_path: Path) -> None:
    """The new file takes the old one's name, not its place on the disk."""
    path = tmp_path / "numbers.csv"
    path.write_text("old")
    with path.open() as reader:
        with replacing(path) as temporary:
            temporary.write_text("a longer new text")
        assert reader.read() == "old"


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
    """A rename is atomic within one file system only, and writers choose their format by the
    suffix.
    """
    with replacing(tmp_path / "video.mp4") as temporary:
        temporary.write_text("")
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".mp4")


def test_folder_that_is_not_there_is_an_oserror_of_the_writer(tmp_path: Path) -> None:
    with (
        pytest.raises(FileNotFoundError),
        replacing(tmp_path / "nowhere" / "numbers.csv") as temporary,
    ):
        temporary.write_text("1,2")


def test_path_below_a_file_is_an_oserror(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")
    with (
        pytest.raises(NotADirectoryError),
        replacing(tmp_path / "file" / "numbers.csv") as temporary,
    ):
        temporary.write_text("1,2")
    assert (tmp_path / "file").read_text() == "old"


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
