"""Every page tried from top to bottom by pasting, with the output that it promises.

Python without prompts runs as one program in an empty folder, and so do shell blocks that promise
an output, a text block directly below. Files whose names the words before a block end with are
written. All other commands of a page are read, not run: there is such a command, and such settings.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.util import find_spec
from itertools import zip_longest
from pathlib import Path
from typing import NoReturn

import pytest
import torch
from omegaconf import DictConfig

from tests.helpers.pages import PAGES, ROOT, Block, blocks, commands, not_printed
from tests.helpers.run_script import run_command
from torch_pmil.cli import Parser, train
from torch_pmil.runs.overrides import check_overrides
from torch_pmil.runs.settings import settings_of
from torch_pmil.tasks.double_pendulum import SUCCESS_DISTANCE
from torch_pmil.tasks.registry import EXPERIMENTS, is_own

LEARNS = re.compile(r"\btrain\(|\.learn\(|^pmil (train|resume)\b", re.MULTILINE)
TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text() for page in PAGES}
MAKEFILE = (ROOT / "Makefile").read_text()
EXTRAS = (ROOT / "setup.cfg").read_text().partition("[options.extras_require]")[2]
LAWS = {  # of the numbers that a page prints, beyond its promise
    "docs/how_to/demonstrations.md": [(r"mean spread (\S+) m", lambda spread: spread < 0.02)],
    "docs/how_to/deploy.md": [
        (r"sent 25 torques in (\S+) s", lambda seconds: seconds > 2.3),
        (r"the tip is (\S+) m from", lambda distance: distance <= SUCCESS_DISTANCE),
        (r"differ by (\S+) N", lambda difference: difference < 1e-12),
        (r"differs by (\S+) N", lambda difference: difference < 1e-12),
    ],
    "docs/how_to/torchrl.md": [(r"itself: (\S+)\nfrom the rollout above: (\S+)", float.__eq__)],
}


def promised(text: str) -> Iterator[tuple[Block, str]]:
    """Each block of a page that is run, with the output that it promises."""
    found = blocks(text)
    for block, below in zip_longest(found, found[1:]):
        promise = below.text if below and below.is_promise else ""
        if block.file or block.is_pasted or (promise and block.is_of_pmil):
            yield block, promise


def learns(text: str) -> bool:
    """Whether pasting the page learns something, which takes its time."""
    return any(LEARNS.search(block.text) for block, _ in promised(text))


PASTED = [
    pytest.param(name, marks=pytest.mark.slow if learns(text) else ())
    for name, text in TEXTS.items()
    if any(promised(text))
]


@pytest.fixture
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An empty working folder; pages may change the number of PyTorch's threads."""
    monkeypatch.chdir(tmp_path)
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.usefixtures("empty_folder")
@pytest.mark.parametrize("name", PASTED)
def test_pasted_page_prints_what_it_promises(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"__name__": "__main__"}
    broken, everything = [], ""
    for block, promise in promised(TEXTS[name]):
        if block.file:
            Path(block.file).write_text(block.text)
        elif block.is_pasted:
            exec(compile("\n" * block.line + block.text, name, "exec"), names)
        else:
            for _, *arguments in block.commands:
                run_command(monkeypatch, *arguments)
        printed = capsys.readouterr().out
        everything += printed
        broken += [(line, printed) for line in not_printed(promise, printed)]
    assert broken == []
    for pattern, law in LAWS.get(name, []):
        numbers = re.search(pattern, everything).groups()
        assert law(*map(float, numbers)), (pattern, numbers)


def test_page_that_learns_says_how_long_it_takes() -> None:
    time = re.compile(r"(takes|about)\s[^.]*\s(second|minute|hour)")
    assert [name for name, text in TEXTS.items() if learns(text) and not time.search(text)] == []


def test_commands_of_all_pages_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = TEXTS | {"README.md": (ROOT / "README.md").read_text()}
    found = [(name, words) for name, text in texts.items() for words in commands(text)]
    assert len(found) > 50
    for name, words in found:
        assert not trouble(monkeypatch, words), (name, words)


def trouble(patch: pytest.MonkeyPatch, words: list[str]) -> str | list[str]:
    """What is wrong with a command line, or nothing."""
    program, *arguments = words
    if program == "pmil":
        return trouble_with_pmil(patch, arguments)
    if program == "python":
        module = arguments[0] == "-m"
        there = find_spec(arguments[1]) if module else (ROOT / arguments[0]).is_file()
        return [] if there else arguments
    if program == "make":
        return [word for word in arguments if "=" not in word and f"\n{word}:" not in MAKEFILE]
    extras = re.findall(r"\w+", "".join(re.findall(r"\[([\w,]+)\]", " ".join(arguments))))
    return [extra for extra in extras if f"\n{extra} =" not in EXTRAS]


def trouble_with_pmil(patch: pytest.MonkeyPatch, arguments: list[str]) -> str:
    """What is wrong with a command line of pmil, or nothing; a file of settings is not there."""
    arguments = [word for word in arguments if not word.startswith("settings=")]
    try:
        parsed = parsed_by_pmil(patch, arguments)
        if arguments[0] == "resume":
            check_overrides(parsed.settings, sweep=False)
        elif arguments[0] == "train" and parsed.multirun:
            check_overrides(parsed.overrides, sweep=True)
        elif arguments[0] == "train":
            with patch.context() as loading:
                loading.setattr(train, "run", load)
                run_command(loading, *arguments)
    except (ValueError, ImportError) as error:
        return str(error)
    except SystemExit as error:
        return str(error.code or "")  # 0 after --help
    return ""


def parsed_by_pmil(patch: pytest.MonkeyPatch, arguments: list[str]) -> argparse.Namespace | None:
    """What a command makes of its command line; None where it only shows its help."""
    parsed = []

    def stopping_after(name: str) -> Callable[..., NoReturn]:
        def parse_and_stop(parser: Parser, words: list[str] | None = None) -> NoReturn:
            parsed.append(getattr(argparse.ArgumentParser, name)(parser, words))
            raise StopIteration

        return parse_and_stop

    with patch.context() as parsing, suppress(StopIteration):
        for name in ("parse_args", "parse_intermixed_args"):
            parsing.setattr(Parser, name, stopping_after(name))
        run_command(parsing, *arguments)
    return parsed[0] if parsed else None


def load(config: DictConfig) -> None:
    """The experiment that the settings of a run name; a file of demonstrations is not there."""
    settings = settings_of(config)
    if is_own(settings.experiment):  # whose module a reader writes
        return
    if settings.demonstrations is None:
        train.task_of(settings)
    elif settings.experiment not in EXPERIMENTS:
        raise ValueError(f"there is no experiment {settings.experiment}")


def test_what_is_wrong_with_a_command_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = [
        "pmil learn",
        "pmil align recorded.csv",
        "pmil train sede=1",
        "pmil train trials=many",
        "pmil train experiment=none",
        "pmil train experiment=none demonstrations=mine.csv",
        "pmil train -m sede=1,2",
        "pmil resume runs/mine sede=1",
        "python scripts/none.py",
        "python -m none",
        "make none",
        "pip install 'torch_pmil[none]'",
    ]
    for line in wrong:
        (words,) = commands(f"    {line}\n")
        assert trouble(monkeypatch, words), line


def test_promise_is_kept_with_other_numbers_and_with_nothing_else() -> None:
    assert not_printed("wrote a.npz:  5 of 2.5 s", "some\nwrote a.npz: 12 of 1e-3 s\n") == []
    assert not_printed("wrote a.npz: 5", "wrote b.npz: 5") == ["wrote a.npz: 5"]
    assert not_printed("wrote 5", "wrote five") == ["wrote 5"]
    assert not_printed("wrote 5 (...)", "wrote 6 (as it said)") == []
    assert not_printed("wrote 5 (...)", "wrote 6, as it said") == ["wrote 5 (...)"]
    assert not_printed("success rate 95% of 20", "success rate  90% of 20") == []
    assert not_printed("success rate 95% of 20", "success rate 80% of 20") != []
