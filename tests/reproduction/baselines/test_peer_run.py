"""A run of a peer: what it starts from, when it learns, and what it leaves."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from reproduction.baselines.peer import Peer
from reproduction.baselines.peer_run import Practice, peer_run
from tests.helpers.short_run import short_experiment
from torch_pmil.envs.rollouts import states_of
from torch_pmil.runs.summaries import read_summary, success_over_experience
from torch_pmil.runs.training import make_trainer
from torch_pmil.tasks.registry import load_experiment

SEED = 103


class Still(Peer):
    """Learns nothing, and acts not."""

    label, name = "still", "still"

    def fit(self) -> None:
        self.seen = len(self.transitions[0])

    def act(self, step: int, states: Tensor) -> Tensor:
        return torch.zeros(*states.shape[:-1], 2, dtype=torch.float64)


@pytest.mark.parametrize("name", ["double_pendulum", "double_pendulum_servo", "biorob"])
def test_first_experience_and_later_starts_are_those_of_our_learner(name: str) -> None:
    experiment = load_experiment(name)
    trainer = make_trainer(experiment, SEED, 2, False, lambda trial: None)
    batches = iter(trainer.collector)
    trainer.collector.steps = experiment.exploration.steps
    ours = [next(batches) for _ in range(experiment.exploration.rollouts + 1)]
    peer = Still(experiment, SEED)
    practice = Practice(experiment, peer, SEED, factor=1)
    for own, other in zip(peer.rollouts, ours[:-1], strict=True):
        torch.testing.assert_close(own["action"], other["action"])
        torch.testing.assert_close(states_of(own), states_of(other))
    start = practice.robot.reset()["observation"]
    torch.testing.assert_close(start, ours[-1]["observation"][0])


def test_demonstrated_transitions_do_not_go_from_one_demonstration_to_the_next() -> None:
    experiment = load_experiment("double_pendulum")
    states, following = Still(experiment, SEED).demonstrated_transitions
    assert len(states) == experiment.demonstrations.positions.shape[0] * experiment.horizon
    shown = experiment.demonstrations.positions
    torch.testing.assert_close(experiment.space.observe(states), shown[:, :-1].flatten(0, 1))
    torch.testing.assert_close(experiment.space.observe(following), shown[:, 1:].flatten(0, 1))


@pytest.mark.parametrize("factor", [1, 3])
def test_run_leaves_what_our_runs_leave(tmp_path: Path, factor: int) -> None:
    run = peer_run(tmp_path, short_experiment(), Still, SEED, trials=2, factor=factor)
    run.learn(run.out, "a command")
    name = "double_pendulum_still" + ("_3x" if factor == 3 else "")
    assert run.out == tmp_path / name / "seed_103"
    summary = read_summary(run.out)
    assert (summary["experiment"], summary["seed"], summary["command"]) == (name, 103, "a command")
    assert summary["saved_n_eval"] == 20
    curve = success_over_experience([summary])
    assert curve.experience_s.tolist() == pytest.approx([0.4 * factor * n for n in (1, 2, 3)])


def test_rollout_that_is_cut_short_is_a_failure(tmp_path: Path) -> None:
    experiment = replace(short_experiment(), box={"dq1": (-1e-9, 1e-9)})
    run = peer_run(tmp_path, experiment, Still, SEED, trials=1)
    run.learn(run.out, "")
    [trial] = json.loads((run.out / "summary.json").read_text())["trials"]
    assert trial["own_error"] is None and not trial["own_success"]
    assert "inf" in (run.out / "metrics.csv").read_text()
    assert trial["experience_s"] < 0.4 and math.isfinite(trial["experience_s"])


@pytest.mark.parametrize(
    ("tolerance", "confirmations", "trials", "fits"),
    [(1e3, 2, 2, 2), (1e3, None, 3, 4), (0, 2, 3, 4)],
)
def test_run_ends_when_its_rollouts_succeed_and_keeps_the_policy_that_did(
    tmp_path: Path, tolerance: float, confirmations: int | None, trials: int, fits: int
) -> None:
    counted: list[int] = []

    class Counting(Still):
        def fit(self) -> None:
            counted.append(len(self.rollouts))

    Counting.confirmations = confirmations
    experiment = replace(short_experiment(), tolerance=tolerance)
    run = peer_run(tmp_path, experiment, Counting, SEED, 3)
    run.learn(run.out, "")
    summary = read_summary(run.out)
    assert (len(summary["trials"]), summary["saved_trial"], len(counted)) == (trials, trials, fits)
    assert (summary["stop_reason"] == "limit of trials") == (trials == 3)
