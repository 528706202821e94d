"""A run that is killed at any of its file operations goes on and leaves what no kill would change.

A run is what ``pmil train`` makes: checkpoints, logs, policy, model, numbers, figures, video, GIF
and report. PyTorch's gradients do not work in a process that was forked from one in which they had
threads, so that this file is for a process of its own: ``test_killed.py`` starts one.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from tests.helpers.killing import LASTING, Operations, Place, end_of, fork
from tests.helpers.leftovers import differences, left_in
from tests.helpers.short_run import SEED, TRIALS, quick_fits, short_experiment
from torch_pmil.cli import resume, train
from torch_pmil.plotting.video import write_video
from torch_pmil.runs import pictures
from torch_pmil.runs.lock import RunGoingOnError, alone_in
from torch_pmil.runs.settings import RunSettings
from torch_pmil.runs.training import RunResult
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.task import Task

pytestmark = pytest.mark.slow
STEPS = 2
COMMAND = ["pmil", "train", f"seed={SEED}", f"trials={TRIALS}"]


def small_figures(task: Task, result: RunResult) -> Iterator[tuple[str, Figure]]:
    for name in ("learning_curve", "policy"):
        figure = Figure(figsize=(0.2, 0.2))
        figure.add_axes((0, 0, 1, 1)).plot([trial.loss for trial in result.trials])
        yield name, figure


def small_film(task: Task, result: RunResult, path: Path) -> None:
    write_video(path, [np.full((16, 16, 3), shade, np.uint8) for shade in range(3)], fps=50)


@pytest.fixture(scope="module", autouse=True)
def quick(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Learning, figures and a video of a second together."""
    gradient = torch.ones(1, requires_grad=True).sum().backward
    if end_of(fork(gradient, tmp_path_factory.mktemp("gradient") / "log")) != 0:
        pytest.skip("other tests were run in this process before")
    with pytest.MonkeyPatch.context() as patch:
        quick_fits(patch)
        patch.setattr("torch_pmil.tasks.task.MEASURED_STARTS", 2)
        patch.setattr(pictures, "figures_of", small_figures)
        patch.setattr(pictures, "film", small_film)
        yield


def run(folder: Path) -> None:
    """As ``pmil train ... resume=true``, with which a run begins or goes on."""
    torch.manual_seed(0)
    np.random.seed(0)
    random.seed(0)
    settings = RunSettings(seed=SEED, trials=TRIALS, out=str(folder), resume=True, logger="csv")
    task = short_experiment(STEPS, search=SearchSettings(0, 1, 1, first_horizon=1.0))
    with alone_in(folder):
        result = train.learned("", False, task, settings, COMMAND)
        train.show("", task, result, folder)


def go_on(folder: Path) -> None:
    """As ``pmil resume`` where the folder says how the run was begun."""
    if (folder / "run.json").exists():
        assert resume.overrides(folder, [])[:2] == COMMAND[2:]
    run(folder)


def watched(operations: Operations, report: Path) -> None:
    operations.watch()
    run(operations.folder)
    report.write_text(json.dumps(operations.made))


@dataclass(frozen=True)
class Undisturbed:
    """What a run that nothing killed left, and its operations; those killed take its folder."""

    folder: Path
    left: dict[str, Any]
    operations: list[str]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    folder = tmp_path_factory.mktemp("runs") / "run"
    report, log = folder.with_name("operations"), folder.with_name("log")
    code = end_of(fork(lambda: watched(Operations(folder), report), log))
    assert code == 0, log.read_text()
    return Undisturbed(folder, left_in(folder), json.loads(report.read_text()))


def places(operations: list[str], count: int) -> list[Place]:
    """Places for kills: half of them amid an operation, and half while a checkpoint is written."""
    kinds: dict[tuple[bool, bool], list[Place]] = {}
    for number, operation in enumerate(operations):
        for amid in (False, True) if operation.startswith(LASTING) else (False,):
            kinds.setdefault((".stage-" in operation, amid), []).append(Place(number, amid))
    return [place for kind in kinds.values() for place in spread(kind, count // len(kinds))]


def spread(among: list[Place], count: int) -> list[Place]:
    """One of each of so many parts of a list."""
    ends = [part * len(among) // count for part in range(count + 1)]
    chosen = random.Random(0)
    return [among[chosen.randrange(*part)] for part in pairwise(ends)]


def what_differs(place: Place, undisturbed: Undisturbed) -> str:
    """Kill a run at a place, let it go on, and say what is not as it would be; or nothing."""
    folder, log = undisturbed.folder, undisturbed.folder.with_name("log")
    shutil.rmtree(folder)
    died = end_of(fork(lambda: watched(Operations(folder, place), log), log))
    if died != -signal.SIGKILL:
        return f"{place} was not reached: {log.read_text()}"
    if end_of(fork(lambda: go_on(folder), log)) != 0:
        return f"cannot go on: {log.read_text()}"
    return ", ".join(differences(left_in(folder), undisturbed.left))


def killed(undisturbed: Undisturbed, count: int) -> list[str]:
    """Kill a run at so many places, and return those after which something differs."""
    sample = places(undisturbed.operations, count)
    found = [
        (f"{place} {undisturbed.operations[place.number]}", what_differs(place, undisturbed))
        for place in sample
    ]
    failed = [f"{place}: {what}" for place, what in found if what]
    print(
        f"{len(undisturbed.operations)} file operations; killed at {len(sample)} places, "
        f"{sum(place.amid for place in sample)} of them amid an operation; "
        f"{len(sample) - len(failed)} went on to the same files, bit for bit"
    )
    return failed


def test_run_that_is_killed_goes_on_to_the_same_files(undisturbed: Undisturbed) -> None:
    assert killed(undisturbed, 4) == []


def test_run_that_is_killed_again_and_again_goes_on_to_the_same_files(
    undisturbed: Undisturbed,
) -> None:
    folder, log = undisturbed.folder, undisturbed.folder.with_name("log")
    shutil.rmtree(folder)
    numbers = random.Random(0)
    for _ in range(8):
        place = Place(numbers.randrange(len(undisturbed.operations) // 2), amid=True)
        process = fork(lambda place=place: watched(Operations(folder, place), log), log)
        assert end_of(process) == -signal.SIGKILL, log.read_text()
    assert end_of(fork(lambda: go_on(folder), log)) == 0, log.read_text()
    assert differences(left_in(folder), undisturbed.left) == []


def test_run_that_is_killed_anywhere_goes_on_to_the_same_files(undisturbed: Undisturbed) -> None:
    assert killed(undisturbed, 200) == []


def test_second_run_is_told_of_the_first_as_long_as_that_lives(undisturbed: Undisturbed) -> None:
    folder, log = undisturbed.folder, undisturbed.folder.with_name("log")
    shutil.rmtree(folder)
    half = Place(len(undisturbed.operations) // 2)
    stopping = Operations(folder, half, kill=lambda: os.kill(os.getpid(), signal.SIGSTOP))
    first = fork(lambda: watched(stopping, log), log)
    assert os.WIFSTOPPED(os.waitpid(first, os.WUNTRACED)[1])
    before = left_in(folder)
    with pytest.raises(RunGoingOnError, match=rf"going on in .* \(process {first}\): wait"):
        run(folder)
    assert left_in(folder) == before
    os.kill(first, signal.SIGKILL)
    assert end_of(first) == -signal.SIGKILL
