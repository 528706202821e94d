"""Check a release: the source archive holds what git holds, the wheel the package alone.

Example:
    python scripts/check_dist.py dist
"""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "torch_pmil/"
MADE = {"PKG-INFO"}  # by setuptools, in the source archive, beside torch_pmil.egg-info


def main() -> None:
    """Print one line for each archive, or what is wrong and exit with 1."""
    if len(sys.argv) != 2:
        sys.exit(f"expected one argument, the folder of the archives, got {len(sys.argv) - 1}")
    folder, tracked = Path(sys.argv[1]), tracked_files()
    source, wheel = only(folder, "*.tar.gz"), only(folder, "*.whl")
    in_source = {
        name for name in source_files(source) - MADE if not name.startswith("torch_pmil.egg-info/")
    }
    in_wheel = {name for name in wheel_files(wheel) if ".dist-info/" not in name}
    compare(source, in_source, tracked)
    compare(wheel, in_wheel, {name for name in tracked if name.startswith(PACKAGE)})
    if not any(name.endswith(".dist-info/licenses/LICENSE") for name in wheel_files(wheel)):
        sys.exit(f"{wheel} lacks the LICENSE")
    print(f"{source}: {len(in_source)} files, {source.stat().st_size / 1e6:.1f} MB")
    print(f"{wheel}: {len(in_wheel)} files, {wheel.stat().st_size / 1e6:.1f} MB")


def tracked_files() -> set[str]:
    """The files that git holds; a link to a folder stands for the files of that folder."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    names = set(filter(None, listed.stdout.split("\0")))
    links = {
        name: (ROOT / name).resolve().relative_to(ROOT).as_posix()
        for name in names
        if (ROOT / name).is_dir()
    }
    behind = {
        link + name.removeprefix(folder)
        for link, folder in links.items()
        for name in names
        if name.startswith(f"{folder}/")
    }
    return (names - links.keys()) | behind


def only(folder: Path, pattern: str) -> Path:
    """The one file of that pattern."""
    found = list(folder.glob(pattern))
    if len(found) != 1:
        sys.exit(f"expected one {pattern} in {folder}, got {len(found)}")
    return found[0]


def source_files(archive: Path) -> set[str]:
    """Files of a source archive, without its outermost folder."""
    with tarfile.open(archive) as content:
        return {member.name.partition("/")[2] for member in content if member.isfile()}


def wheel_files(archive: Path) -> set[str]:
    """Files of a wheel."""
    with zipfile.ZipFile(archive) as content:
        return set(content.namelist())


def compare(archive: Path, held: set[str], wanted: set[str]) -> None:
    """Exit with 1 unless the archive holds what it should and nothing else."""
    for names, verb in ((wanted - held, "lacks"), (held - wanted, "holds what git does not:")):
        if names:
            more = " ..." if len(names) > 10 else ""
            sys.exit(f"{archive} {verb} {', '.join(sorted(names)[:10])}{more}")


if __name__ == "__main__":
    main()
