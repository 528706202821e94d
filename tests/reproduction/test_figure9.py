"""Figure 9: the paper's recordings, and each number at its frequency."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from scipy import stats
from torch import Tensor

from reproduction.figure9 import needed_runs, read_score, recorded_movements, results
from reproduction.sampling_frequency import Recording
from torch_pmil.envs.biorob import START, TORQUE_LIMIT
from torch_pmil.runs.summaries import RunError
from torch_pmil.tasks.biorob_targets import REACH


@pytest.fixture(scope="module")
def movements() -> list[Recording]:
    return recorded_movements(seed=0)


def test_recordings_are_24_s_of_motion_around_the_start(movements: list[Recording]) -> None:
    states, torques = map(torch.stack, zip(*movements, strict=True))
    assert states.shape == (12, 201, 6) and torques.shape == (12, 200, 3)
    away = (states[..., :3] - torch.tensor(START[:3])).abs().amax((0, 1)).rad2deg()
    reach = torch.tensor(REACH)
    assert (away > reach / 2).all() and (away < 2 * reach).all()  # light joints overshoot
    assert (torques.abs() <= torch.tensor(TORQUE_LIMIT)).all()


def test_torques_are_held_for_a_control_period_and_differ_by_seed(
    movements: list[Recording],
) -> None:
    for _, torques in movements:
        changes = torques.diff(dim=0).abs().amax(-1).nonzero().flatten() + 1
        assert changes.tolist() == list(range(10, 200, 10))
    for seed, same in ((0, True), (1, False)):
        assert torch.equal(recorded_movements(seed)[1].states, movements[1].states) is same


def test_numbers_are_means_over_recordings_at_their_frequency_and_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def values(inputs: Tensor, targets: Tensor, folds: int, max_iterations: int) -> Tensor:
        best_at_60 = torch.full((folds, 6), -abs(len(inputs) - 60.0)).double()
        return best_at_60 + targets[0, 0]

    monkeypatch.setattr("reproduction.sampling_frequency.held_out_log_likelihood", values)
    runs = needed_runs(tmp_path, quick=True)
    for run in runs:
        run.learn(run.out, "test")
    made = results([run.out for run in runs], quick=True)
    assert made.headline["best_frequency_raw_6s_hz"] == 10.0
    assert made.details["6s"]["transitions"] == [30, 60, 120]
    first = [recorded_movements(seed)[0].states[[0, 10], 0].diff().item() for seed in (0, 1)]
    assert made.headline["raw_6s_10hz"] == pytest.approx(sum(first) / 2)
    half_width = stats.t.ppf(0.975, 1) * torch.tensor(first).std().item() / 2**0.5
    assert made.details["6s"]["half_widths"]["raw"][1] == pytest.approx(half_width, rel=1e-4)
    titles = [panel.get_title() for panel in made.figures["figure9_6s"].axes]
    assert titles == ["raw", "standardised"]


def test_each_score_has_a_folder_of_its_own_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    runs = needed_runs(tmp_path, quick=False)
    assert len({run.out for run in runs}) == len(runs) == 2 * 10 * 3
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(RunError, match=r"summary\.json is no score of a frequency: 'frequency'"):
        read_score(tmp_path)


@pytest.mark.slow
def test_quick_scores_of_the_next_state_rise_with_frequency(tmp_path: Path) -> None:
    runs = needed_runs(tmp_path, quick=True)
    for run in runs:
        run.learn(run.out, "test")
    headline = results([run.out for run in runs], quick=True).headline
    assert headline["raw_6s_5hz"] < headline["raw_6s_10hz"] < headline["raw_6s_20hz"]
