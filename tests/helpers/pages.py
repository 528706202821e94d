"""The documentation's pages as a reader takes them: what to paste, and what that should print."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts
)  # notebooks/ is a link, which rglob does not follow
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NAMED = re.compile(r"`([\w.-]+\.\w+)`:\s*\Z")  # the end of "Save it as `config.yaml`:"
COMMAND = re.compile(r"(?:\w+=\S+ )*((?:pmil|python|make|pip) (?:.*\\\n)*.*)")
INDENTED = re.compile(rf"^ {{4}}{COMMAND.pattern}", re.MULTILINE)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Block:
    """What stands between two fences.

    Args:
        language: that the opening fence names.
        text: without the fences.
        line: number of its first line in the page, from 0.
        file: that the words before the block name, or "".
        follows: whether the block stands directly below the one before it.
    """

    language: str
    text: str
    line: int
    file: str
    follows: bool

    @property
    def is_promise(self) -> bool:
        """Whether it is what the block above it prints."""
        return self.language == "text" and self.follows

    @property
    def is_pasted(self) -> bool:
        """Whether it is Python without prompts; pytest runs that with prompts as doctests."""
        return self.language == "python" and not self.text.startswith(">>>")

    @property
    def is_of_pmil(self) -> bool:
        """Whether it is a shell block of commands of pmil alone."""
        return self.language == "sh" and {program for program, *_ in self.commands} == {"pmil"}

    @property
    def commands(self) -> list[list[str]]:
        """The words of each command of a shell block."""
        return [words(text) for text in COMMAND.findall(self.text)]


def blocks(text: str) -> list[Block]:
    """The fenced blocks of a page, from top to bottom."""
    return list(_blocks(text))


def _blocks(text: str) -> Iterator[Block]:
    end = 0
    for fence in FENCE.finditer(text):
        before = text[end : fence.start()]
        named = NAMED.search(before)
        yield Block(
            fence[1],
            fence[2],
            text[: fence.start(2)].count("\n"),
            named[1] if named else "",
            not before.strip(),
        )
        end = fence.end()


def commands(text: str) -> list[list[str]]:
    """The words of each command of a page, in indented lines and in shell blocks."""
    fenced = [block.commands for block in blocks(text) if block.language == "sh"]
    indented = [words(command) for command in INDENTED.findall(FENCE.sub("", text))]
    return [*indented, *(command for block in fenced for command in block)]


def words(command: str) -> list[str]:
    """The words of a command as a shell reads them."""
    return shlex.split(command.replace("\\\n", " "), comments=True)


def not_printed(promised: str, printed: str) -> list[str]:
    """The lines of a promise that no printed line keeps.

    A printed line may have other numbers and other spaces, but a success rate may be at most ten
    percent points less than promised. ``...`` stands for anything.
    """
    lines = printed.splitlines()
    return [
        line
        for line in promised.splitlines()
        if line.strip() and not any(_keeps(line, other) for other in lines)
    ]


def _keeps(promised: str, printed: str) -> bool:
    pattern = r"\s+".join(map(_any_numbers, promised.split()))
    if not re.fullmatch(rf"\s*{pattern}\s*", printed):
        return False
    return all(
        float(rate) >= float(least) - 10
        for rate, least in zip(_rates(printed), _rates(promised), strict=True)
    )


def _any_numbers(word: str) -> str:
    pieces = [NUMBER.pattern.join(map(re.escape, NUMBER.split(p))) for p in word.split("...")]
    return ".*".join(pieces)


def _rates(line: str) -> list[str]:
    return re.findall(r"success rate\s+(\d+)%", line)
