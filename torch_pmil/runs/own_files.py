"""The list of a run's own files, the only ones that it replaces and removes."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path, PurePosixPath

from torch_pmil.files import LineError, read_json, short, write_json
from torch_pmil.runs.summaries import RunError, read_summary, words_of

LIST = "run_files.json"
MOTION, SAMPLING = "first_motion.pt", "sampling.json"
FILES = (  # beside checkpoints, logs and figures
    *("video.mp4", "video.gif", "report.html", "policy.pt", "dynamics.pt", "metrics.csv"),
    *("settings.yaml", "run.json", "summary.json", MOTION, SAMPLING),
)
FIGURES = (
    *("learning_curve", "trajectories", "kl_per_step", "policy", "calibration", "model"),
    *("poses", "writing", "robot"),
)
FOLDERS = ("checkpoints", "figures", "logs")
# all names that a run may write: whatever its list says, nothing else is removed
NAMES = re.compile(
    rf"{'|'.join(map(re.escape, FILES))}|figures/(?:{'|'.join(FIGURES)})(?:_target_\d+)?\.png"
    r"|checkpoints/checkpoint-\d{12}\.torchrl|logs/.+_seed_\d+/scalars/.+\.csv"
)


class ForeignFileError(LineError):
    """A file or link that no run wrote is where a run would write."""


def own(out: Path, name: str) -> Path:
    """The path of a file that the run in ``out`` writes next, which is listed before it is there.

    Raises:
        ForeignFileError: there is such a file already, and no run has listed it.
        RunError: the list is damaged.
    """
    listed, path = files_of(out), out / name
    if name not in listed:
        if os.path.lexists(path):
            raise _foreign(path)
        write_json(out / LIST, {"files": sorted({*listed, name})})
    return path


def files_of(out: Path) -> set[str]:
    """The names that the run in a folder has listed; empty if there was no run.

    Earlier versions of this package left no list. Their files are those of the names that a run
    writes, if ``run.json`` or ``summary.json`` shows that a run was there.

    Raises:
        RunError: the list is damaged, or names what no run writes.
    """
    path = out / LIST
    if not os.path.lexists(path):
        return _found(out) if _was_here(out) else set()
    try:
        if path.is_symlink():
            raise ValueError("it is a link")
        names = read_json(path)["files"]
        for name in names:
            if not NAMES.fullmatch(name) or ".." in PurePosixPath(name).parts:
                raise ValueError(f"no run writes {short(name)}")
        return set(names)
    except (ValueError, TypeError, LookupError, OSError) as error:
        message = f"{path} is damaged ({error}): without it, a run's files are known by their names"
        raise RunError(message) from error


def check_free(out: Path) -> None:
    """Raise ForeignFileError if a new or resumed run would write where another's files are.

    This is so if one of them has a name that a run writes, if one of a run's folders is a link, or
    if ``out`` is the working folder, or one above it, and has held no run. RunError if the list is
    damaged.
    """
    listed = files_of(out)
    others = sorted(path.name for path in out.iterdir() if not path.name.startswith(".pmil"))
    if others and not listed and Path.cwd().is_relative_to(out.resolve()):
        raise ForeignFileError(
            f"out must be a folder of its own, got {str(out)!r}, in which {others[0]} and the "
            "working folder lie: as out=runs/mine"
        )
    folders = {*FOLDERS, *(str(each) for name in listed for each in PurePosixPath(name).parents)}
    for path in sorted(out / folder for folder in folders - {"."}):
        if path.is_symlink() or (path.exists() and not path.is_dir()):
            raise _foreign(path)
    for name in sorted(_found(out) - listed):
        raise _foreign(out / name)


def remove_files(out: Path) -> None:
    """Remove the listed files, then empty folders; :func:`check_free` must have been called.

    ``summary.json``, which shows that the run has ended, is removed last.
    """
    names = files_of(out)
    for name in sorted(names, key=lambda name: (name == "summary.json", name)):
        (out / name).unlink(missing_ok=True)
    folders = {parent for name in names for parent in PurePosixPath(name).parents}
    for folder in sorted(folders - {PurePosixPath(".")}, reverse=True):
        with suppress(OSError):  # something else is in it
            (out / folder).rmdir()
    (out / LIST).unlink(missing_ok=True)


def _foreign(path: Path) -> ForeignFileError:
    return ForeignFileError(f"{path} is not of a run here: move it, or choose another out")


def _found(out: Path) -> set[str]:
    """The existing files whose names a run may write."""
    paths = [path for name in FILES if os.path.lexists(path := out / name)]
    paths += [path for folder in FOLDERS for path in (out / folder).rglob("*")]
    names = {path.relative_to(out).as_posix() for path in paths}
    return {name for name in names if NAMES.fullmatch(name)}


def _was_here(out: Path) -> bool:
    with suppress(OSError, ValueError, TypeError, LookupError):
        words_of(read_json(out / "run.json")["command"])
        return True
    with suppress(RunError):
        read_summary(out)
        return True
    return False
