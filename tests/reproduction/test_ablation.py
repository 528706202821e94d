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
    Variation,
    needed_runs,
    results,
    success_and_experience,
    variations,
)
from reproduction.learned import load_learned
from tests.helpers.short_run import quick_fits, run, short_experiment
from tests.helpers.summaries import leave_summary, summary, trial
from torch_pmil.runs.training import make_trainer
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.method import ON_SAMPLES
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

CHANGED = {
    "ours": set(),
    "no_samples": {"search"},
    "matched": {"search"},
    "no_growing_horizon": {"search"},
    "no_mean_start": {"search"},
    "plain_angles": {"space", "least_widths"},
    "successors": {"successors", "model"},
    "all_entries": {"model"},
    "tied_lengthscales": {"model"},
}


@pytest.fixture(scope="module")
def varied() -> dict[str, Variation]:
    return variations()


def choices(variation: Variation) -> dict[str, object]:
    """All that may be made otherwise."""
    owners = variation, variation.method, variation.method.policy
    found = {entry.name: getattr(owner, entry.name) for owner in owners for entry in fields(owner)}
    return {name: found[name] for name in found.keys() - {"name", "method", "policy"}}


def differs(one: object, other: object) -> bool:
    if isinstance(one, torch.Tensor):
        return not torch.equal(one, other)
    return one is not other and one != other


def short(variation: Variation) -> Variation:
    """The same of the first steps, with searches of a few evaluations, but for what it varies."""
    few, search, policy = short_experiment(), variation.method.search, variation.method.policy
    kept = CHANGED[variation.name.removeprefix("double_pendulum_ablation_")] | {"name", "method"}
    quick = SearchSettings(
        min(search.mean_iterations, 1),
        1,
        1,
        first_horizon=search.first_horizon,
        sample_steps=min(search.sample_steps, 2),
    )
    policy = replace(few.method.policy, least_widths=policy.least_widths)
    method = replace(few.method, policy=policy, search=quick, model=variation.method.model)
    shared = {entry.name: getattr(few, entry.name) for entry in fields(Task)}
    changes = {name: shared[name] for name in shared.keys() - kept}
    return replace(variation, **changes, method=method)


def test_each_variation_differs_from_ours_in_its_own_choice_and_in_name(
    varied: dict[str, Variation],
) -> None:
    ours = choices(varied["ours"])
    for name, variation in varied.items():
        own = choices(variation)
        assert {entry for entry in own if differs(own[entry], ours[entry])} == CHANGED[name]
    assert varied.keys() == LABELS.keys() == CHANGED.keys()
    assert len({variation.name for variation in varied.values()}) == len(varied)
    assert len({json.dumps(variation.settings) for variation in varied.values()}) == len(varied)


def test_ours_learns_as_the_double_pendulum_does(varied: dict[str, Variation]) -> None:
    trainers = [
        make_trainer(task, 0, 1, False, print)
        for task in (varied["ours"], load_experiment("double_pendulum"))
    ]
    for trainer in trainers:
        trainer.loss_module.dynamics.set_data(torch.eye(8).double(), torch.ones(8, 2).double())
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


def test_search_and_model_are_of_the_kind_that_is_varied(varied: dict[str, Variation]) -> None:
    assert not varied["successors"].make_dynamics().targets.matrix.any()
    assert [varied[name].make_dynamics().num_outputs for name in ("ours", "all_entries")] == [2, 4]
    assert varied["ours"].method.search == ON_SAMPLES
    assert not varied["no_samples"].method.search.sample_steps
    assert not varied["matched"].method.search.trust_what_is_sure
    assert varied["no_growing_horizon"].method.search.first_horizon == 1.0
    assert varied["no_mean_start"].method.search.mean_iterations == 0


@pytest.mark.parametrize("name", CHANGED)
def test_each_variation_learns_is_saved_and_loaded(
    varied: dict[str, Variation], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    task = short(varied[name])
    result = run(tmp_path, task=task, seed=0, trials=1)
    loaded = load_learned(tmp_path, task)
    torch.testing.assert_close(
        loaded.predicted(task).mean, result.outcomes[0].predicted.mean, rtol=0, atol=1e-10
    )
    assert torch.equal(loaded.dynamics.targets.matrix, result.dynamics.targets.matrix)
    assert json.loads((tmp_path / "summary.json").read_text())["experiment"] == varied[name].name


def test_all_variations_run_with_all_seeds(tmp_path: Path) -> None:
    full, quick = needed_runs(tmp_path, False), needed_runs(tmp_path, True)
    assert [run.out.name for run in full] == [f"seed_{seed}" for seed in range(10)] * len(LABELS)
    assert {run.learn.keywords["trials"] for run in full} == {8}
    names = [run.out.parent.name.removeprefix("double_pendulum_ablation_") for run in quick]
    assert names == list(LABELS)


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
            run = summary_of(index / 20 + seed / 100, [False, seed == 1, name == "plain_angles"])
            folders.append(leave_summary(tmp_path / name / str(seed), **run))
    made = results(folders, quick=False)
    expected = {
        "ours_success": 0.005,
        "successors_success": 0.305,
        "successors_success_10s": 0.305,
        "ours_first_success_s": (10 + 5) / 2,
        "plain_angles_first_success_s": (7.5 + 5) / 2,
        "ours_runs_with_success": 1,
        "plain_angles_runs_with_success": 2,
    }
    assert {name: made.headline[name] for name in expected} == pytest.approx(expected)
    more = made.details["more_first_success_s"]["successors"]
    assert (more["difference"], more["pairs"]) == (0.0, 2)
    for numbers in ("success", "first_success_s"):
        assert np.array(made.details[numbers]).shape == (len(LABELS), 2)
    ours, *variants = LABELS.values()
    left, right = made.figures["ablation"].axes
    assert [tick.get_text() for tick in left.get_yticklabels()] == [ours, *reversed(variants)]
    assert "never" in [tick.get_text() for tick in right.get_xticklabels()]
    json.dumps({**made.headline, **made.details})
