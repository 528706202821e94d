"""Robustness: what the names say is varied, the start is known, each number is at its place."""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import torch
from torch import Tensor

from reproduction import robustness
from reproduction.robustness import (
    FACTORS,
    SEEDS,
    needed_runs,
    results,
    ten_demonstrations,
    varied_experiments,
    with_demonstrations,
    with_noise,
    with_start_std,
)
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs.double_pendulum import link_positions
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

RECORDED = torch.linspace(0, 1, 5 * 26 * 4, dtype=torch.float64).reshape(5, 26, 4)  # states


def recorded_pairs(seeds: Sequence[int]) -> Iterator[tuple[Tensor, Tensor]]:
    for _ in seeds:
        yield RECORDED, torch.zeros(5, 25, 2, dtype=torch.float64)


@pytest.fixture(autouse=True)
def no_teacher(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """To plan the teacher takes long."""
    monkeypatch.setattr(robustness, "record_pairs", recorded_pairs)
    ten_demonstrations.cache_clear()
    yield
    ten_demonstrations.cache_clear()


@pytest.mark.parametrize(
    ("experiment", "std"),
    [
        (with_start_std(0.05), (0.05, 0.1) * 2),
        (with_start_std(0.2), (0.2, 0.4) * 2),
        (with_noise(0.0), (0.05, 0.1) * 2),
        (with_noise(0.05), (math.hypot(0.05, 0.05), math.hypot(0.1, 0.5)) * 2),
    ],
)
def test_start_belief_is_the_distribution_of_what_the_sensors_say_of_starts(
    experiment: Task, std: tuple[float, ...]
) -> None:
    count, initial = 20_000, experiment.initial
    seen = experiment.make_env(num_envs=count, seed=0).reset()["observation"]
    torch.testing.assert_close(initial.std, torch.tensor(std, dtype=torch.float64))
    assert ((seen.mean(0) - initial.mean).abs() / initial.std).max() < 4 / math.sqrt(count)
    assert (seen.std(0) / initial.std - 1).abs().max() < 4 / math.sqrt(2 * count)


def test_demonstrations_are_nested_and_begin_with_those_of_the_package() -> None:
    shipped, every = shipped_demonstrations("double_pendulum"), ten_demonstrations().positions
    assert torch.equal(every[:5], shipped.positions)
    assert torch.equal(every[5:], link_positions(RECORDED))
    for count in (2, 3, 10):
        experiment = with_demonstrations(count)
        assert torch.equal(experiment.demonstrations.positions, every[:count])
        assert len(experiment.demonstrated_states) == 26 * count
        assert torch.linalg.cholesky_ex(experiment.demonstrated.cov).info.max() == 0


def test_plain_level_is_the_plain_experiment_and_all_others_differ_in_name() -> None:
    names = {
        factor.name: [
            experiment.name.removeprefix("double_pendulum") for experiment in factor.experiments()
        ]
        for factor in FACTORS
    }
    counts = [f"_demonstrations_{count}" for count in (2, 3, 10)]
    assert names == {
        "start": ["", "_start_0.1rad", "_start_0.2rad"],
        "noise": ["", "_noise_0.01rad", "_noise_0.02rad", "_noise_0.05rad"],
        "demonstrations": [*counts[:2], "", counts[2]],
    }


def test_every_experiment_is_learned_once_with_every_seed_in_another_process(
    tmp_path: Path,
) -> None:
    runs = needed_runs(tmp_path, False)
    seeds = [tmp_path / name / f"seed_{seed}" for name in varied_experiments() for seed in SEEDS]
    assert [run.out for run in runs] == seeds
    assert len(needed_runs(tmp_path, True)) == len(varied_experiments()) == 9
    for run in runs:
        sent, meant = (
            one.learn.keywords["experiment"].make_env(seed=3).reset()
            for one in (pickle.loads(pickle.dumps(run)), run)
        )
        assert (sent == meant).all()


def test_every_number_is_at_its_level(monkeypatch: pytest.MonkeyPatch) -> None:
    names = list(varied_experiments())

    def remeasured(folder: Path, experiment: Task, starts: int, seed: int) -> dict[str, object]:
        assert folder.parent.name == experiment.name
        rate = names.index(experiment.name) / 10 + int(folder.name[-1]) / 100
        return {"experiment": experiment.name, "success_rate": rate}

    monkeypatch.setattr(robustness, "remeasured", remeasured)
    made = results([Path(name, f"seed_{seed}") for name in names for seed in (0, 1)], quick=True)
    plain = load_experiment("double_pendulum").name
    for factor in FACTORS:
        for name, experiment in zip(factor.names(), factor.experiments(), strict=True):
            expected = names.index(experiment.name) / 10 + 0.005
            assert made.headline[f"success_{name}"] == pytest.approx(expected)
    plain_levels = "start_0.05rad", "noise_0rad", "demonstrations_5"
    assert len({made.headline[f"success_{level}"] for level in plain_levels}) == 1
    assert sum(run["experiment"] == plain for run in made.details["measured"]) == 2
    labels = [panel.get_xlabel() for panel in made.figures["robustness"].axes]
    assert labels == [factor.label for factor in FACTORS]
