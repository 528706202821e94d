"""The page of the report: the contents of a run's folder in one HTML file."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

import torch_pmil
from torch_pmil.files import MIB, FileError, read_bytes, replacing
from torch_pmil.runs.own_files import own
from torch_pmil.runs.printing import making_the_rest
from torch_pmil.runs.report.captions import Caption, caption_of, place_of
from torch_pmil.runs.report.tables import tables
from torch_pmil.runs.report.words import headline, next_steps, percent, say
from torch_pmil.runs.summaries import RunError, judged_alone, read_summary

MEDIA_BYTES = 64 * MIB  # of a figure or video, some 100 kB
PNG = b"\x89PNG\r\n\x1a\n"
DENSITY = 1.5  # pixels of a picture to one of the page, as it is shown
DENSEST = 2.8  # the most of them with which its text can still be read
GUIDES = "docs/how_to"  # of the repository
BUILT_GUIDES = "docs/_build/html/how_to"


@dataclass(frozen=True)
class Picture:
    """A picture of the page: width and height of its file in pixels, and the file in base64."""

    caption: Caption
    pixels: tuple[int, int]
    data: str

    @property
    def size(self) -> tuple[int, int]:
        """Width and height on a page that is wide enough, in pixels of the page."""
        width, height = self.pixels
        return round(width / DENSITY), round(height / DENSITY)

    @property
    def least_width(self) -> int:
        """Width in pixels of the page below which the picture scrolls and does not shrink."""
        return round(self.pixels[0] / DENSEST)


def write_report(folder: Path | str, drawn: bool = True) -> Path:
    """Write ``report.html`` from what a finished run left: summary, figures, video; its path.

    The page loads nothing from elsewhere. What a run did not leave is left out.

    Args:
        folder: of the run.
        drawn: False before figures and video are drawn: then the page says that they follow.

    Raises:
        RunError: there is no summary, or it or a figure is damaged.
        ForeignFileError: there is a ``report.html`` that no run wrote.
        OSError: the page cannot be written.

    Example:
        >>> write_report("runs/double_pendulum/seed_0")  # doctest: +SKIP
        PosixPath('runs/double_pendulum/seed_0/report.html')
    """
    folder = Path(folder)
    summary = read_summary(folder)
    try:
        text = _page(folder, summary, drawn)
    except (RunError, OSError):
        raise
    except Exception as error:  # entries of other types fail where they are written, with any type
        reason = f"{type(error).__name__}: {error}"
        raise RunError(f"{folder}: summary.json is damaged: {reason}") from error
    page = own(folder, "report.html")
    with replacing(page) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return page


def page_of(name: str) -> tuple[str, str | None]:
    """Path of a page of the documentation in the repository, and its address on this machine.

    The address is that of the built page or of its source, or None if there is neither.

    Example:
        >>> page_of("diagnosis")[0]
        'docs/how_to/diagnosis.md'
    """
    clone, path = Path(torch_pmil.__file__).parents[1], f"{GUIDES}/{name}.md"
    places = (clone / BUILT_GUIDES / f"{name}.html", clone / path)
    return path, next((place.as_uri() for place in places if place.exists()), None)


def _page(folder: Path, summary: dict, drawn: bool) -> str:
    environment = Environment(
        loader=PackageLoader("torch_pmil.runs", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"say": say, "percent": percent, "page": page_of}
    video = folder / "video.mp4"
    return environment.get_template("page.html").render(
        summary=summary,
        headline=headline(summary),
        judged_alone=judged_alone(summary),
        following=None if drawn else _remedy(summary, folder),
        pictures=_pictures(folder, summary) if drawn else [],
        video=_encoded(_content(video)) if drawn and video.exists() else None,
        tables=list(tables(summary)),
        steps=list(next_steps(summary, folder)),
    )


def _remedy(summary: dict, folder: Path) -> str:
    """What makes the missing files of a run."""
    of_command = str(summary.get("command", "")).startswith("pmil train")
    return making_the_rest(folder) if of_command else "learn(resume=True)"


def _pictures(folder: Path, summary: dict) -> list[Picture]:
    """All figures, in the order of the page."""
    targets = list(summary.get("saved_success_rate_by_target", {}))
    paths = sorted((folder / "figures").glob("[!.]*.png"), key=lambda path: place_of(path.stem))
    alone = judged_alone(summary)
    return [
        Picture(caption_of(path.stem, targets, alone), *_pixels_and_text(path)) for path in paths
    ]


def _pixels_and_text(path: Path) -> tuple[tuple[int, int], str]:
    """Width and height of a PNG file, and its bytes as text."""
    content = _content(path)
    if len(content) < 24 or not content.startswith(PNG):
        raise RunError(f"{path} must be a PNG file, got one that begins with {content[:8]!r}")
    size = int.from_bytes(content[16:20], "big"), int.from_bytes(content[20:24], "big")
    return size, _encoded(content)


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path, MEDIA_BYTES)
    except FileError as error:
        raise RunError(f"{path}: {error}") from error


def _encoded(content: bytes) -> str:
    return base64.b64encode(content).decode()
