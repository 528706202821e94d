"""A cache of kernels that is damaged, full or another's: they are compiled again."""

from __future__ import annotations

import os
import random
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from numba.core import config
from numba.core.caching import UserProvidedCacheLocator

from torch_pmil.model.compiled import building, kernels
from torch_pmil.model.compiled.building import Kernel, compile_all
from torch_pmil.model.compiled.checked_cache import CheckedCache, _CheckedFiles, complain

AGAIN = "the compiled prediction in .* is damaged or not of this user: it is compiled again"


def triple(number: int) -> int:
    return 3 * number


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """A folder for the cache of one small kernel, looked for anew."""
    kernels()  # from where they are
    (tmp_path / "cache").mkdir()
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(building, "KERNELS", [])
    monkeypatch.setattr(CheckedCache, "lost", False)
    for function in (building._cache_folder, complain):
        function.cache_clear()
    yield tmp_path / "cache"
    building._cache_folder.cache_clear()


def hits() -> int:
    """Compile the kernel as a new process does, use it, and say whether it was in the cache."""
    kernel = Kernel(triple)
    assert kernel(14) == 42
    return sum(kernel.compile().stats.cache_hits.values())


def files_in(cache: Path) -> list[Path]:
    return sorted(path for path in cache.rglob("*") if path.is_file())


def test_files_are_this_users_alone_and_found_again(cache: Path) -> None:
    before = os.umask(0)
    try:
        assert hits() == 0
    finally:
        os.umask(before)
    index, data = sorted(files_in(cache), key=lambda path: path.suffix, reverse=True)
    assert (index.suffix, data.suffix) == (".nbi", ".nbc")
    assert {path.stat().st_mode & 0o777 for path in (index, data)} == {0o600}
    assert (cache / data.relative_to(cache).parts[0]).stat().st_mode & 0o777 == 0o700
    assert hits() == 1


def test_no_file_with_a_flipped_bit_cut_short_or_empty_is_read(cache: Path) -> None:
    hits()
    numbers, files = random.Random(0), _CheckedFiles("", "", None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        for path in files_in(cache):
            content = path.read_bytes()
            flips = [numbers.randrange(8 * len(content)) for _ in range(200)]
            flipped = [bytearray(content) for _ in flips]
            for copy, place in zip(flipped, flips, strict=True):
                copy[place // 8] ^= 1 << place % 8
            cuts = [content[:length] for length in (0, 1, 31, 32, 33, len(content) - 1)]
            for damaged in (*flipped, *cuts, content + b"\0", bytes(len(content))):
                path.write_bytes(damaged)
                with pytest.raises(OSError, match="damaged"):
                    files._read(str(path))
                assert not path.exists()
                path.touch(0o600)
            path.write_bytes(content)
            assert files._read(str(path)) == content[32:]


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", ["empty", "a flip", "another's", "for others", "a link"])
def test_damaged_cache_is_compiled_again_with_one_warning(
    suffix: str, damage: str, cache: Path, tmp_path: Path
) -> None:
    hits()
    (path,) = (path for path in files_in(cache) if path.suffix == suffix)
    content = path.read_bytes()
    if damage == "a link":
        path.rename(tmp_path / "elsewhere")
        path.symlink_to(tmp_path / "elsewhere")
        assert hits() == 0  # and its place is taken
    else:
        if damage == "another's":
            if os.geteuid():
                pytest.skip("only root may give files away")
            os.chown(path, 65534, 65534)
        elif damage == "for others":
            path.chmod(0o622)
        else:
            path.write_bytes(b"" if damage == "empty" else content[:-1] + bytes([content[-1] ^ 1]))
        with pytest.warns(RuntimeWarning, match=AGAIN) as warned:
            assert hits() == 0
        assert len(warned) == 1
    assert hits() == 1 and compile_all() == building._cache_folder() is not None


@pytest.mark.parametrize("flaw", ["owner", "group", "others", "link", "above"])
def test_folder_that_others_may_write_to_is_not_used(
    flaw: str, cache: Path, tmp_path: Path
) -> None:
    hits()
    (folder,) = cache.iterdir()
    if flaw == "owner":
        if os.geteuid():
            pytest.skip("only root may give folders away")
        os.chown(folder, 65534, 65534)
    elif flaw == "link":
        folder.rename(tmp_path / "elsewhere")
        folder.symlink_to(tmp_path / "elsewhere")
    elif flaw == "above":
        cache.chmod(0o777)
    else:
        folder.chmod(0o720 if flaw == "group" else 0o702)
    building._cache_folder.cache_clear()
    with pytest.warns(
        RuntimeWarning, match="can be written by this user alone, so every"
    ) as warned:
        assert hits() == 0 and compile_all() is None
    assert len(warned) == 1
    cache.chmod(0o1777)  # as /tmp
    building._cache_folder.cache_clear()
    assert flaw != "above" or hits() == 1


def full(*arguments: object) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("place", ["_open_for_write", "_write", "ensure_cache_path"])
def test_full_disk_is_one_warning_and_the_numbers_are_right(
    place: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = building._cache_folder()
    owner = UserProvidedCacheLocator if place == "ensure_cache_path" else _CheckedFiles
    monkeypatch.setattr(owner, place, full)
    with pytest.warns(RuntimeWarning, match=f"cannot be kept in {folder} .*compiles it") as warned:
        assert hits() == hits() == 0
        assert compile_all() is None
    assert len(warned) == 1 and files_in(cache) == []
