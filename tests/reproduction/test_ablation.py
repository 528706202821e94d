"""The ablation: each variation differs in one choice, and the numbers are those of the runs."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from reproduction.ablation import (
    LABELS,
    PARTICLES,
    Variation,
    needed_runs,
    results,
    success_and_experience,
    variations,
)
from reproduction.learned import load_learned
from tests.helpers.short_run import quick_fits, short_experiment, stop_in
from tests.helpers.summaries import leave_summary, summary, trial
from torch_pmil.model.particles import ParticlePrediction
from torch_pmil.runs.training import make_trainer, train
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.registry import load_experiment

CHANGED = {
    "ours": set(),
    "no_growing_horizon": {"search"},
    "no_mean_start": {"search"},
    "random_centres": {"random_centres"},
    "noise_0.02m": {"noise_std"},
    "noise_0.1m": {"noise_std"},
    "plain_angles": {"space", "demonstrated_states", "least_widths"},
    "successors": {"targets"},
    "particles": {"prediction"},
}


@pytest.fixture(scope="module")
def varied() -> dict[str, Variation]:
    return variations()


def differs(one: object, other: object) -> bool:
    if isinstance(one, torch.Tensor):
        return not torch.equal(one, other)
    return one is not other and one != other


def short(variation: Variation) -> Variation:
    """The same of the first steps, with searches of a few evaluations, but for what it varies."""
    few = {
        entry.name: getattr(short_experiment(), entry.name)
        for entry in fields(load_experiment("double_pendulum"))
    }
    kept = CHANGED[variation.name.removeprefix("double_pendulum_ablation_")] - {"search"} | {"name"}
    search = SearchSettings(
        min(variation.search.mean_iterations, 1), 1, 1, first_horizon=variation.search.first_horizon
    )
    return replace(
        variation, **{name: few[name] for name in few.keys() - kept} | {"search": search}
    )


@pytest.mark.parametrize("name", LABELS)
def test_each_variation_differs_from_ours_in_its_own_choice(
    varied: dict[str, Variation], name: str
) -> None:
    names = {entry.name for entry in fields(Variation)} - {"name"}
    ours, variation = varied["ours"], varied[name]
    assert {
        entry for entry in names if differs(getattr(variation, entry), getattr(ours, entry))
    } == CHANGED[name]


def test_variations_are_told_apart_by_name_and_by_settings(varied: dict[str, Variation]) -> None:
    assert varied.keys() == LABELS.keys() == CHANGED.keys()
    assert len({variation.name for variation in varied.values()}) == len(varied)
    assert len({json.dumps(variation.settings) for variation in varied.values()}) == len(varied)


def test_ours_learns_as_the_double_pendulum_does(varied: dict[str, Variation]) -> None:
    trainers = [
        make_trainer(task, 0, 1, False, print)
        for task in (varied["ours"], load_experiment("double_pendulum"))
    ]
    for trainer in trainers:
        trainer.loss_module.dynamics.set_data(torch.eye(8).double(), torch.ones(8, 4).double())
    one, other = (trainer.loss_module.per_step(trainer.initial) for trainer in trainers)
    assert torch.equal(one, other)
    assert torch.equal(*(trainer.loss_module.demonstrated_cov for trainer in trainers))


def test_plain_angles_are_seen_as_they_are_and_begin_where_the_robot_hangs(
    varied: dict[str, Variation],
) -> None:
    plain = varied["plain_angles"]
    assert plain.space.feature_names == ("q1", "dq1", "q2", "dq2")
    starts = plain.demonstrated_states.unflatten(0, (5, 26))[:, 0]
    assert ((starts - plain.initial.mean)[:, [0, 2]].abs() < 4 * 0.05).all()
    torch.testing.assert_close(
        plain.space.observe(plain.demonstrated_states),
        plain.space.observe(varied["ours"].demonstrated_states),
    )


def test_random_centres_lie_where_nothing_was_demonstrated(varied: dict[str, Variation]) -> None:
    """Of dq1, which the demonstrations hold between -4.6 and 0.7 rad/s."""
    for name, beyond in (("ours", False), ("random_centres", True)):
        policy = varied[name].make_policy(torch.Generator().manual_seed(0))
        assert ((policy.centres * policy.scale)[:, 0] > 2.5).any().item() is beyond


def test_loss_and_model_are_of_the_kind_that_is_varied(varied: dict[str, Variation]) -> None:
    assert not varied["successors"].make_dynamics().targets.matrix.any()
    particles = make_trainer(varied["particles"], 0, 1, False, print).loss_module
    assert particles.prediction == ParticlePrediction(PARTICLES)
    assert varied["no_growing_horizon"].search.first_horizon == varied["ours"].horizon
    assert varied["no_mean_start"].search.mean_iterations == 0


@pytest.mark.parametrize("name", CHANGED)
def test_each_variation_learns_is_saved_and_loaded(
    varied: dict[str, Variation], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    task = short(varied[name])
    result = train(task, seed=0, trials=1, out=tmp_path, command="", progress_bar=False)
    loaded = load_learned(tmp_path, task)
    torch.testing.assert_close(
        loaded.predicted(task).mean, result.outcomes[0].predicted.mean, rtol=0, atol=1e-10
    )
    assert torch.equal(loaded.dynamics.targets.matrix, task.make_dynamics().targets.matrix)
    assert json.loads((tmp_path / "summary.json").read_text())["experiment"] == varied[name].name


def test_run_on_particles_that_was_stopped_ends_as_one_that_was_not(
    varied: dict[str, Variation], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    arguments = {"seed": 0, "trials": 2, "command": "", "progress_bar": False}
    whole = train(short(varied["particles"]), out=tmp_path / "whole", **arguments)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_in(patch, "search", 5, stop)
        train(short(varied["particles"]), out=tmp_path / "stopped", **arguments)
    resumed = train(short(varied["particles"]), out=tmp_path / "stopped", resume=True, **arguments)
    assert all(
        torch.equal(one, other)
        for one, other in zip(whole.policy.parameters(), resumed.policy.parameters(), strict=True)
    )
    assert [trial.loss for trial in whole.trials] == [trial.loss for trial in resumed.trials]


def stop() -> None:
    raise KeyboardInterrupt


def test_all_variations_run_with_all_seeds(tmp_path: Path) -> None:
    full, quick = needed_runs(tmp_path, False), needed_runs(tmp_path, True)
    assert [run.out.name for run in full] == ["seed_0", "seed_1", "seed_2"] * len(LABELS)
    assert {run.learn.keywords["trials"] for run in full} == {10}
    assert [run.out.parent.name.removeprefix("double_pendulum_ablation_") for run in quick] == list(
        LABELS
    )


def summary_of(rate: float, successes: list[bool]) -> dict:
    trials = [trial(2.5 * n, rate, own_success=own) for n, own in enumerate(successes, start=1)]
    seconds = 2.5 * (len(successes) + 1)
    return summary(trials=trials, saved_success_rate=rate, experience_s=seconds)


def test_outcome_is_the_saved_policys_rate_and_the_experience_before_the_first_success() -> None:
    assert success_and_experience(summary_of(0.9, [False, True, False, True])) == (0.9, 5.0, True)
    assert success_and_experience(summary_of(0.0, [False, False])) == (0.0, 7.5, False)


def test_report_is_of_each_variation_over_its_seeds(tmp_path: Path) -> None:
    folders = []
    for index, name in enumerate(LABELS):
        for seed in range(2):
            run = summary_of(index / 10 + seed / 100, [False, seed == 1, index == 3])
            folders.append(leave_summary(tmp_path / name / str(seed), **run))
    made = results(folders, quick=False)
    assert made.headline["ours_success"] == pytest.approx(0.005)
    assert made.headline["particles_success"] == pytest.approx(0.805)
    assert made.headline["ours_first_success_s"] == pytest.approx((10 + 5) / 2)
    assert made.headline["random_centres_first_success_s"] == pytest.approx((7.5 + 5) / 2)
    assert (
        made.headline["ours_runs_with_success"],
        made.headline["random_centres_runs_with_success"],
    ) == (1, 2)
    assert (
        np.array(made.details["success"]).shape
        == np.array(made.details["first_success_s"]).shape
        == (len(LABELS), 2)
    )
    ours, *variants = LABELS.values()
    rows = [tick.get_text() for tick in made.figures["ablation"].axes[0].get_yticklabels()]
    assert rows == [ours, *reversed(variants)]
    assert "never" in [
        tick.get_text() for tick in made.figures["ablation"].axes[1].get_xticklabels()
    ]
    json.dumps({**made.headline, **made.details})
