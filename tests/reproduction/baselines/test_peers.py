"""What all peers have in common: robots, seeds, and the settings that were tried."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from reproduction.baselines import tune_peers
from reproduction.baselines.known_peers import PEERS, named
from reproduction.baselines.peer_run import Practice, peer_run
from reproduction.baselines.tune_peers import CONFIGURATIONS, needed_runs, success
from tests.helpers.short_run import short_experiment
from torch_pmil.files import read_json
from torch_pmil.tasks.task import Task

SEED = 104
QUICK = {
    "gp_tracker": {},
    "ensemble_cem": {"steps": 3, "candidates": 9},
    "mc_pilco": {"most_steps": 2, "particles": 5, "centres": 10},
    "bco": {"steps": 3},
    "bco_with_velocities": {},
    "gaifo": {"steps": 2},
}


def short_imitation() -> Task:
    """The first steps of the double pendulum, with the states of these steps alone."""
    short, count = short_experiment(), len(named("double_pendulum").demonstrations.positions)
    states = short.demonstrated_states.unflatten(0, (count, -1))[:, : short.horizon + 1]
    return replace(short, demonstrated_states=states.flatten(0, 1))


@pytest.mark.parametrize("name", [name for name in PEERS if name != "bco_with_velocities"])
@pytest.mark.parametrize("task", ["double_pendulum_servo", "biorob", "Sshape"])
def test_peer_moves_any_robot_within_its_limits(task: str, name: str) -> None:
    experiment = named(task)
    peer = PEERS[name](experiment, SEED, **QUICK[name])
    practice = Practice(experiment, peer, SEED, factor=1)
    peer.fit()
    assert 0 <= practice.measured() <= 1
    practice._own_rollout()
    actions = peer.rollouts[-1]["action"]
    assert len(actions) == experiment.horizon
    assert (actions >= experiment.actions.low).all() and (actions <= experiment.actions.high).all()


@pytest.mark.parametrize("name", PEERS)
def test_same_seed_is_the_same_run(tmp_path: Path, name: str) -> None:
    outcomes = []
    for folder in ("a", "b"):
        torch.rand(1)  # torch's own generator does not matter
        task, root = short_imitation(), tmp_path / folder
        run = peer_run(root, task, PEERS[name], SEED, 2, settings=QUICK[name])
        run.learn(run.out, "")
        outcomes.append([row["own_error"] for row in read_json(run.out / "summary.json")["trials"]])
    assert outcomes[0] == pytest.approx(outcomes[1], rel=1e-4)


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_peers_have_the_settings_that_are_tried(name: str) -> None:
    experiment = named("double_pendulum")
    for settings in CONFIGURATIONS[name]:
        assert PEERS[name](experiment, SEED, **settings).name == name


def test_configurations_have_runs_of_their_own_on_development_seeds(tmp_path: Path) -> None:
    folders = [run.out for runs in needed_runs(tmp_path, "bco", "Sshape") for run in runs]
    assert len(set(folders)) == len(folders) == len(CONFIGURATIONS["bco"]) * len(tune_peers.SEEDS)
    assert all(100 <= seed < 200 for seed in tune_peers.SEEDS)


def test_score_is_the_mean_success_over_experience(tmp_path: Path) -> None:
    run = peer_run(tmp_path, short_imitation(), PEERS["bco"], SEED, 1, settings=QUICK["bco"])
    run.learn(run.out, "")
    measured = success([run])
    last = read_json(run.out / "summary.json")["saved_success_rate"]
    assert measured["success_at_s"] == {"12.5": last, "25": last, "50": last}
    assert measured["score"] == pytest.approx(last)
