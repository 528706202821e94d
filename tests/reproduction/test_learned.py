"""Success of a saved policy: measured on the experiment's robot, where it truly is."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from reproduction.learned import load_learned, measured_success, remeasured
from tests.helpers.short_run import quick_fits, run, short_experiment
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.rollouts import of_states
from torch_pmil.runs.summaries import RunError
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task


def hanging_still(**settings: object) -> Task:
    """The double pendulum; a success is that it starts and stays near where it hangs."""
    experiment = load_experiment("double_pendulum")
    return replace(
        experiment,
        make_env=partial(DoublePendulumEnv, **settings),
        error=of_states(lambda states: (states - experiment.initial.mean)[..., 0].abs().amax(-1)),
        tolerance=0.5,
    )


def test_success_is_the_fraction_of_the_starts_by_the_true_states() -> None:
    """However noisy the sensors."""
    experiment = load_experiment("double_pendulum")
    still = RBFPolicy(torch.zeros(1, 6), experiment.actions.half_range, torch.ones(6))
    policy = StatePolicy(still, experiment.space, 0.1)
    noisy = hanging_still(observation_std=(10.0, 10.0, 10.0, 10.0))
    assert measured_success(policy, noisy, starts=20, seed=0) == 1
    wide = hanging_still(initial_std=(0.5, 0.0, 0.0, 0.0))
    starts = wide.make_env(num_envs=200, seed=3).reset()["observation"]
    rate = measured_success(policy, wide, starts=200, seed=3)
    assert 0 < rate <= ((starts - wide.initial.mean)[:, 0].abs() <= 0.5).double().mean()


def test_run_is_measured_anew_and_a_model_that_does_not_fit_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    result = run(tmp_path, trials=1)
    easy = replace(short_experiment(), tolerance=10.0)
    told = remeasured(tmp_path, easy, starts=3, seed=1)
    repeated = {name: result.summary[name] for name in ("seed", "experience_s", "stop_reason")}
    new = {"experiment": "double_pendulum", "success_rate": 1.0, "trials": 1}
    assert told == repeated | new
    path = tmp_path / "dynamics.pt"
    whole = torch.load(path, weights_only=True)
    inputs, noise = whole["train_inputs"], "gp.likelihood.noise_covar.raw_noise"
    for entry, value, complaint in (
        ("train_inputs", inputs * float("nan"), "dynamics.train_inputs must be finite, got nan"),
        ("train_inputs", inputs[:, 1:], "dynamics.train_inputs must be torch.float64 of shape"),
        (noise, torch.full_like(whole[noise], 1e4), f"dynamics.{noise} must be logarithms of"),
    ):
        torch.save(dict(whole) | {entry: value}, path)
        with pytest.raises(RunError, match=complaint):
            load_learned(tmp_path, short_experiment())
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(RunError, match="must be a regular file of at most 64 MiB, got a device"):
        load_learned(tmp_path, short_experiment())
