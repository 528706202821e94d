"""Figures 2 to 6 from a run's folder: what is loaded was learned, and numbers are right."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from reproduction import one_dimension
from reproduction.figure6 import (
    agreement,
    comparison,
    gp_figure,
    moment_matching_figure,
    needed_runs,
    results,
)
from reproduction.learned import load_learned
from tests.helpers.draws import Draws
from tests.helpers.short_run import STEPS, quick_fits, replace_task, run, short_experiment
from torch_pmil.control.policy_file import PolicyFileError
from torch_pmil.envs.rollouts import states_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.runs.summaries import RunError
from torch_pmil.runs.training import RunResult
from torch_pmil.search.losses import TrajectoryKLLoss


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunResult]:
    """A run of seconds, and its folder."""
    folder = tmp_path_factory.mktemp("runs") / "seed_5"
    with pytest.MonkeyPatch.context() as patch:
        quick_fits(patch)
        return folder, run(folder, trials=1)


def test_what_is_loaded_predicts_what_the_run_predicted(learned: tuple[Path, RunResult]) -> None:
    folder, result = learned
    loaded, experiment = load_learned(folder, short_experiment()), short_experiment()
    predicted, expected = loaded.predicted(experiment), result.outcomes[0].predicted
    torch.testing.assert_close(predicted.mean, expected.mean, rtol=0, atol=1e-10)
    torch.testing.assert_close(predicted.cov, expected.cov, rtol=0, atol=1e-10)
    executed = states_of(loaded.rollouts(experiment, starts=3, seed=1))
    starts = experiment.make_env(num_envs=3, seed=1).reset()["observation"]
    torch.testing.assert_close(executed[:, 0], starts)
    assert executed.shape == (3, STEPS + 1, 4)


def test_run_of_another_experiment_is_refused(
    learned: tuple[Path, RunResult], tmp_path: Path
) -> None:
    summary = json.loads((learned[0] / "summary.json").read_text())
    (tmp_path / "summary.json").write_text(json.dumps(summary | {"experiment": "biorob"}))
    message = f"{tmp_path} must be a run of double_pendulum, got one of biorob"
    with pytest.raises(RunError, match=message):
        load_learned(tmp_path, short_experiment())


@pytest.mark.parametrize(
    ("name", "error"), [("dynamics.pt", RunError), ("policy.pt", PolicyFileError)]
)
@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04"])
def test_damaged_files_are_named_in_one_line(
    learned: tuple[Path, RunResult],
    tmp_path: Path,
    name: str,
    error: type[Exception],
    content: bytes,
) -> None:
    for file in ("summary.json", "dynamics.pt", "policy.pt"):
        (tmp_path / file).write_bytes((learned[0] / file).read_bytes())
    (tmp_path / name).write_bytes(content)
    with pytest.raises(error) as complaint:
        load_learned(tmp_path, short_experiment())
    assert str(tmp_path) in str(complaint.value) and "\n" not in str(complaint.value)


def test_report_has_all_figures_and_numbers_of_the_run(
    learned: tuple[Path, RunResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    short = short_experiment()
    replace_task(monkeypatch, short)
    made = results([learned[0]], quick=True)
    assert sorted(made.figures) == ["figure2", "figure3", "figure4", "figure5", "figure6"]
    labels = [panel.get_ylabel() for panel in made.figures["figure6"].axes]
    assert labels == ["x1 (m)", "y1 (m)", "x2 (m)", "y2 (m)"]
    assert len(made.figures["figure5"].axes[0].lines) == STEPS + 2
    assert made.headline["experience_s"] == learned[1].summary["experience_s"]
    assert made.headline["success_rate"] == 0  # nothing is upright after four steps
    loaded = load_learned(learned[0], short)
    objective = TrajectoryKLLoss(
        loaded.policy.policy, loaded.dynamics, short.space, short.demonstrated, short.noise_std
    )
    assert made.headline["kl_nats"] == pytest.approx(objective.per_step(short.initial).sum().item())


def test_run_is_that_of_the_training_script(tmp_path: Path) -> None:
    (full,), (quick,) = needed_runs(tmp_path, False), needed_runs(tmp_path, True)
    assert full.out == quick.out == tmp_path / "double_pendulum" / "seed_0"
    assert (full.learn.keywords["trials"], quick.learn.keywords["trials"]) == (12, 3)


def test_equal_distributions_compare_as_equal(draws: Draws) -> None:
    belief = Gaussian(draws.normal(6, 4), torch.diag_embed(draws.uniform(0.5, 2.0, 6, 4)))
    same = comparison(belief, belief)
    assert same == pytest.approx(
        {"kl_nats": 0, "largest_mean_difference_m": 0, "x1_std_correlation": 1}, abs=1e-9
    )
    moved = comparison(belief, Gaussian(belief.mean + 0.3, belief.cov))
    assert moved["largest_mean_difference_m"] == pytest.approx(0.3) and moved["kl_nats"] > 0


def test_moments_and_samples_disagree_in_standard_errors_and_by_a_ratio(draws: Draws) -> None:
    difference, ratio = "moment_matching_mean_difference_se", "moment_matching_std_ratio"
    numbers, _ = moment_matching_figure()
    assert abs(numbers[difference]) < 4 and abs(numbers[ratio] - 1) < 0.01
    samples = draws.normal(10_000)
    told = agreement(Gaussian(samples.mean()[None] + 0.05, 4 * samples.var()[None, None]), samples)
    assert told[difference] == pytest.approx(0.05 * 100 / samples.std().item())
    assert told[ratio] == pytest.approx(2)


def test_samples_at_a_certain_input_have_the_posterior_of_the_gp() -> None:
    gp, point = one_dimension.fitted_gp(), torch.tensor([one_dimension.TEST_INPUT]).double()
    certain = Gaussian(point, torch.zeros(1, 1).double())
    posterior = one_dimension.posterior(gp, point)
    samples = one_dimension.sample_output(gp, certain, 10_000, torch.Generator().manual_seed(1))
    assert abs(samples.mean() - posterior.mean.item()) < 4 * posterior.std.item() / 100
    assert abs(samples.std() / posterior.std.item() - 1) < 4 / 20_000**0.5


def test_the_gp_is_certain_near_its_data_and_falls_back_to_its_prior_far_away() -> None:
    gp, noise = one_dimension.fitted_gp(), one_dimension.NOISE_STD
    near = one_dimension.posterior(gp, gp.train_inputs[:, 0])
    true = one_dimension.true_function(gp.train_inputs)
    torch.testing.assert_close(near.mean, true, rtol=0, atol=4 * noise)
    assert near.std.max() < 2 * noise
    far, tested = (
        one_dimension.posterior(gp, torch.tensor([at]).double())
        for at in (100.0, one_dimension.TEST_INPUT)
    )
    torch.testing.assert_close(far.std[0].square(), gp.expansion.signal_variance)
    assert tested.std.item() > 0.8 * far.std.item()
    assert len(gp_figure().axes) == 1
