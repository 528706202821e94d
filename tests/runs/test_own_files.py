"""A run replaces and removes the files that it has listed, and no others."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests.helpers.finished_run import SUMMARY
from tests.helpers.short_run import quick_fits, run, short_experiment
from torch_pmil.runs.own_files import (
    FIGURES,
    FILES,
    LIST,
    ForeignFileError,
    check_free,
    files_of,
    own,
)
from torch_pmil.runs.report import write_report
from torch_pmil.runs.report.captions import CAPTIONS
from torch_pmil.runs.run_folder import FinishedRunError, clear_folder
from torch_pmil.runs.summaries import RunError

OF_A_RUN = (
    *FILES,
    *("figures/policy.png", "figures/trajectories_target_1.png"),
    *("checkpoints/checkpoint-000000000003.torchrl", "logs/a/b_seed_0/scalars/loss.csv"),
)
OF_A_PERSON = (
    *("thesis.tex", "figures/chapter1.pdf", "figures/photo.jpg", "checkpoints/my_llm.safetensors"),
    *("checkpoints/checkpoint-backup.torchrl", "logs/a/b_seed_0/notes.txt", "logs/mine.csv"),
    *(".lock", ".video.7.mp4", "policy.pt.bak", "figures/.writing.3.png"),
)


def fill(out: Path, names: tuple[str, ...]) -> dict[str, bytes]:
    """Make files that hold their names."""
    for name in names:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(name)
    return contents(out)


def contents(out: Path) -> dict[str, bytes]:
    paths = [path for path in out.rglob("*") if path.is_file()]
    return {str(path.relative_to(out)): path.read_bytes() for path in paths}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_figure_of_the_report_has_a_name_of_a_run() -> None:
    assert {*FIGURES} == {*CAPTIONS}


def test_only_listed_files_are_removed(tmp_path: Path) -> None:
    kept = fill(tmp_path, OF_A_PERSON)
    for name in OF_A_RUN:
        own(tmp_path, name)
    fill(tmp_path, OF_A_RUN)
    assert files_of(tmp_path) == {*OF_A_RUN}
    with pytest.raises(FinishedRunError):
        clear_folder(tmp_path)
    clear_folder(tmp_path, overwrite=True)
    assert contents(tmp_path) == kept


@pytest.mark.parametrize("record", ["run.json", "summary.json", "neither"])
def test_files_of_an_earlier_version_are_known_by_name_where_a_run_was(
    record: str, tmp_path: Path
) -> None:
    before = fill(tmp_path, (*OF_A_PERSON, *OF_A_RUN))
    shown = {"run.json": {"command": "pmil train"}, "summary.json": SUMMARY, "neither": {}}[record]
    (tmp_path / (record if shown else "summary.json")).write_text(json.dumps(shown))
    if shown:
        clear_folder(tmp_path, overwrite=True)
        assert contents(tmp_path) == {name: before[name] for name in OF_A_PERSON}
        return
    before = contents(tmp_path)
    with pytest.raises(ForeignFileError, match="is not of a run here: move it, or choose another"):
        clear_folder(tmp_path, overwrite=True)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("name", OF_A_RUN)
@pytest.mark.parametrize("kind", ["file", "link", "folder"])
def test_foreign_file_of_a_name_that_a_run_writes_is_refused(
    name: str, kind: str, tmp_path: Path
) -> None:
    path, out = tmp_path / "out" / name, tmp_path / "out"
    path.parent.mkdir(parents=True)
    if kind == "link":
        path.symlink_to(tmp_path / "nowhere")
    else:
        path.touch() if kind == "file" else path.mkdir()
    for attempt in (lambda: clear_folder(out, overwrite=True), lambda: own(out, name)):
        with pytest.raises(ForeignFileError, match=f"{path} is not of a run here"):
            attempt()
    assert os.path.lexists(path) and not (out / LIST).exists()


@pytest.mark.parametrize("folder", ["figures", "checkpoints", "logs", "logs/a_seed_0/scalars"])
def test_folder_that_is_a_link_is_not_followed(folder: str, tmp_path: Path) -> None:
    names = ("policy.png", "checkpoint-000000000003.torchrl", "loss.csv")
    before, out = fill(tmp_path / "elsewhere", names), tmp_path / "out"
    (out / folder).parent.mkdir(parents=True)
    for name in (*OF_A_RUN, "logs/a_seed_0/scalars/loss.csv"):
        own(out, name)
    (out / folder).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ForeignFileError, match=f"{out / folder} is not of a run here"):
        clear_folder(out, overwrite=True)
    assert contents(tmp_path / "elsewhere") == before


LISTS = {
    "above": '{"files": ["../thesis.tex"]}',
    "above by a known name": '{"files": ["logs/../../a_seed_0/scalars/a.csv"]}',
    "absolute": '{"files": ["/etc/passwd"]}',
    "of no run": '{"files": ["thesis.tex"]}',
    "a number": '{"files": [3]}',
    "text": '{"files": "policy.pt"}',
    "a list": "[]",
    "empty": "",
    "not JSON": "files",
    "too large": " " * (2**22 + 1),
}


@pytest.mark.parametrize("content", LISTS.values(), ids=LISTS)
def test_list_that_is_damaged_or_hostile_removes_nothing(content: str, tmp_path: Path) -> None:
    fill(tmp_path, ("out/thesis.tex", "out/policy.pt", "thesis.tex"))
    (tmp_path / "out" / LIST).write_text(content)
    before = contents(tmp_path)
    with pytest.raises(RunError, match=rf"{LIST} is damaged \(.*\): without it, a run's files are"):
        clear_folder(tmp_path / "out", overwrite=True)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("out", [".", "", "..", "{}", "../{name}", "link"])
def test_working_folder_and_those_above_are_refused_where_other_files_lie(
    out: str, here: Path
) -> None:
    (here / "link").symlink_to(here)
    folder = Path(out.format(here, name=here.name))
    with pytest.raises(ForeignFileError, match=r"out must be a folder of its own, got .*runs/mine"):
        check_free(folder)
    (here / "link").unlink()
    own(here, "metrics.csv")
    if folder.resolve() == here:
        check_free(folder)  # a run is there


def test_run_beside_a_persons_files_leaves_them_and_is_replaced_without_them(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    out, task = here / "out", short_experiment()
    kept = fill(out, OF_A_PERSON)
    run(out, task=task, logger="csv", trials=1)
    first = contents(out)
    assert {name for name in first if name not in kept} == {*files_of(out), LIST} & first.keys()
    write_report(out)
    run(out, task=task, logger="csv", trials=1, overwrite=True)
    assert contents(out).keys() == first.keys()
    assert kept.items() <= contents(out).items()
    (out / "policy.pt").unlink()
    (out / LIST).write_text(json.dumps({"files": sorted(files_of(out) - {"policy.pt"})}))
    (out / "policy.pt").write_text("mine")
    with pytest.raises(ForeignFileError, match=r"policy\.pt is not of a run here"):
        run(out, task=task, trials=2, resume=True)
    assert (out / "policy.pt").read_text() == "mine" and (out / "summary.json").exists()
