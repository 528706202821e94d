"""Two thousand damaged files of every kind that is read: none executes anything, takes long, needs
much memory or ends in more than a line.
"""

from __future__ import annotations

import pickle
import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from torchrl.checkpoint import CheckpointError

from reproduction.learned import load_learned
from tests.helpers.bounded import SECONDS, Load, measured
from tests.helpers.data_sets import WRITERS
from tests.helpers.hostile import SPRUNG, damaged, pickle_of_a_trap
from tests.helpers.short_run import SEED, quick_fits, run, short_experiment
from torch_pmil.cli.resume import overrides
from torch_pmil.cli.summarize import summarize
from torch_pmil.control.policy_file import PolicyFileError, load_policy
from torch_pmil.demonstrations import DemonstrationError, load_demonstrations, load_recordings
from torch_pmil.demonstrations.inspection import advice, describe
from torch_pmil.runs.overrides import check_overrides
from torch_pmil.runs.report import write_report
from torch_pmil.runs.settings import SettingsError
from torch_pmil.runs.summaries import RunError, count_trials
from torch_pmil.runs.training import make_trainer
from torch_pmil.trainer.checkpoints import rotation_in

MEGABYTES, LETTERS = 1000, 1200  # of growth, and of a line with the path of its file
FEW, MANY = 10, 125  # damaged files of a kind in the fast and in the slow test
CHECKPOINTS = 4  # times as many of them, which have the most parts
NEWEST = f"checkpoint-{1:012}.torchrl"  # after the last of its rollouts
OURS = {  # kinds of a run: what is copied, what of it is damaged, and how it may be refused
    "policy": ("policy.pt", "policy.pt", PolicyFileError),
    "model": ("*", "dynamics.pt", RunError),
    "checkpoint": (f"checkpoints/{NEWEST}", NEWEST, CheckpointError),
    "run.json": ("run.json", "run.json", (RunError, SettingsError)),
    "report": ("summary.json", "summary.json", RunError),
    "table": ("*.[cj]s*", "summary.json", RunError),
    "metrics": ("metrics.csv", "metrics.csv", RunError),
}


def load_a_policy(path: Path) -> None:
    policy = load_policy(path)
    assert policy(torch.zeros(len(policy.space.names))).isfinite().all()


def load_a_model(path: Path) -> None:
    learned = load_learned(path.parent, short_experiment())
    assert all(value.isfinite().all() for value in learned.policy.state_dict().values())


def resume(path: Path) -> None:
    rotation = rotation_in(path.parent)
    trainer = make_trainer(short_experiment(), SEED, 1, False, lambda trial: None, None, rotation)
    assert trainer.resume() is not None
    assert all(
        value.isfinite().all() for value in trainer.loss_module.actor_network.state_dict().values()
    )


def read_a_command(path: Path) -> None:
    check_overrides(overrides(path.parent, []), sweep=False)


def write_a_page(path: Path) -> None:
    assert " nan" not in write_report(path.parent).read_text()


def write_a_table(path: Path) -> None:
    summarize([path.parent], path.parent / "results", "pmil summarize")


LOADERS: dict[str, Callable[[Path], object]] = {
    "policy": load_a_policy,
    "model": load_a_model,
    "checkpoint": resume,
    "run.json": read_a_command,
    "report": write_a_page,
    "table": write_a_table,
    "metrics": lambda path: count_trials(path.parent),
}


def inspect(path: Path, options: dict) -> None:
    """As ``pmil inspect`` does, and as training does."""
    recordings = load_recordings(path, **options)
    assert all(one.isfinite().all() for one in (*recordings.values, *recordings.times))
    describe(recordings)
    advice(recordings, str(path), 0.1, [])
    assert load_demonstrations(path, **options).positions.isfinite().all()


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Args:
        whole: folder with an undamaged one.
        name: of what is damaged, in the folder; "" for the folder.
        load: takes its path.
        refusals: documented errors.
    """

    whole: Path
    name: str
    load: Callable[[Path], object]
    refusals: tuple[type[Exception], ...]


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    with pytest.MonkeyPatch.context() as patch:
        quick_fits(patch)
        run(folder, trials=1)
    return folder


def is_readable(name: str) -> bool:
    """Whether the library is there that a format needs."""
    library = WRITERS[name][1] if name in WRITERS else ""
    return not library or find_spec(library) is not None


def kind_of(name: str, learned: Path, folder: Path) -> Kind:
    """Write an undamaged one into a folder."""
    folder.mkdir()
    if name in OURS:
        copied, harmed, refusals = OURS[name]
        for path in learned.glob(copied):
            (shutil.copytree if path.is_dir() else shutil.copy)(path, folder / path.name)
        several = refusals if isinstance(refusals, tuple) else (refusals,)
        return Kind(folder, harmed, LOADERS[name], several)
    write, _, options = WRITERS[name]
    path = write(folder)
    return Kind(
        folder,
        path.relative_to(folder).as_posix(),
        lambda path: inspect(path, options),
        (DemonstrationError, FileNotFoundError),  # of a folder a file may be lost
    )


def loads_of(kind: Kind, count: int, source: random.Random) -> Iterator[Callable[[], None]]:
    """The loads of an undamaged copy, and then of damaged ones."""
    copy = kind.whole.with_name("copy")

    def load() -> None:
        try:
            kind.load(copy / kind.name)
        finally:
            assert not list(kind.whole.parent.rglob(SPRUNG)), "executed"

    for number in range(count + 1):
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(kind.whole, copy)
        if number:
            damaged(copy / kind.name, source)
        yield load


def checked(kind: Kind, count: int, seed: str) -> list[Load]:
    """The loads of damaged files, each accepted or refused as it must be."""
    loads = measured(loads_of(kind, count, random.Random(seed)), *kind.refusals)
    for number, load in enumerate(loads):
        assert not load.failure, f"file {number}: {load.failure}"
        assert "\n" not in (load.refusal or ""), number
        assert len(load.refusal or "") < LETTERS, number
    assert len(loads) == count + 1
    assert loads[0].refusal is None
    assert max(load.seconds for load in loads) < SECONDS
    assert max(load.megabytes for load in loads) < MEGABYTES
    return loads[1:]


def figures(name: str, loads: list[Load]) -> str:
    """The figures of some loads, in a line."""
    refused = sum(load.refusal is not None for load in loads)
    return (
        f"{name:12} {len(loads):5} files, {refused:5} refused, {len(loads) - refused:5} accepted, "
        f"at most {max(load.seconds for load in loads):.2f} s and "
        f"{max(load.megabytes for load in loads):.0f} MB"
    )


def test_trap_springs_where_it_is_unpickled(tmp_path: Path) -> None:
    pickle.loads(pickle_of_a_trap(tmp_path / "file"))
    assert (tmp_path / SPRUNG).is_dir()


@pytest.mark.parametrize("name", [*OURS, *WRITERS])
def test_damage_is_refused_in_a_line_or_accepted_whole(
    name: str, learned: Path, tmp_path: Path
) -> None:
    if not is_readable(name):
        pytest.skip(f"needs {WRITERS[name][1]}: pip install 'torch_pmil[formats]'")
    count = FEW * CHECKPOINTS if name == "checkpoint" else FEW
    loads = checked(kind_of(name, learned, tmp_path / "whole"), count, name)
    assert any(load.refusal for load in loads)


@pytest.mark.slow
def test_two_thousand_damaged_files(learned: Path, tmp_path: Path) -> None:
    """Run with ``-s`` it prints the figures."""
    every: list[Load] = []
    for name in (name for name in (*OURS, *WRITERS) if is_readable(name)):
        (tmp_path / name).mkdir()
        count = MANY * CHECKPOINTS if name == "checkpoint" else MANY
        loads = checked(kind_of(name, learned, tmp_path / name / "whole"), count, f"slow {name}")
        every += loads
        print(figures(name, loads))
    print(figures("all", every))
    assert sum(load.refusal is not None for load in every) > len(every) / 2
