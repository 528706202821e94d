"""The BioRob's experiment, with demonstrations recorded here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from reproduction.teachers.kinesthetic_teaching import Strike, Variation, record_strike
from tests.helpers.short_run import shortened
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.biorob import START, biorob_model, holding_torques
from torch_pmil.runs.training import make_trainer, train
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.biorob import biorob_space, distance_from_ball
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

STEPS = 4
SEARCH = SearchSettings(0, 1, 1, first_horizon=1.0)
pytestmark = pytest.mark.usefixtures("quick")


def record() -> Demonstrations:
    """Three strikes, at 10 Hz."""
    generator, model = np.random.default_rng(0), biorob_model()
    variants = [Variation().of(Strike(), model, generator) for _ in range(3)]
    recordings = [record_strike(model, variant) for variant in variants]
    shown = [one.states[:: round(0.1 / one.time_step)] for one in recordings]
    return Demonstrations(torch.from_numpy(np.stack(shown)), 0.1, biorob_space().names)


@pytest.fixture(scope="module")
def experiment() -> Task:
    return load_experiment("biorob", record())


def short(experiment: Task) -> Task:
    return shortened(experiment, STEPS, num_centres=80, search=SEARCH)


def test_policy_has_the_papers_738_parameters_and_the_model_sees_state_and_torques(
    experiment: Task, generator: torch.Generator
) -> None:
    policy, space = experiment.make_policy(generator), experiment.space
    assert sum(parameter.numel() for parameter in policy.parameters()) == 738
    assert experiment.horizon == 18
    assert space.feature_names == space.names == space.match_space.names


def test_new_policy_holds_the_start_pose(experiment: Task, generator: torch.Generator) -> None:
    """Within the friction of the motors, 0.8 N·m at least: the arm stays where it is."""
    policy = experiment.make_policy(generator)
    start = torch.tensor(START, dtype=torch.float64)
    assert (policy(start) - holding_torques(start[:3])).abs().max() < 0.2
    env = experiment.make_env(initial_std=torch.zeros(6), seed=0)
    actor = StatePolicy(policy, experiment.space, env.control_period).as_tensordict_module()
    reached = env.rollout(5, actor)["next", "observation"]
    assert (reached[:, :3] - start[:3]).abs().max() < np.deg2rad(3)


def test_first_motion_is_six_seconds_around_the_start_within_the_limits(experiment: Task) -> None:
    trainer = make_trainer(short(experiment), 0, 1, False, lambda trial: None)
    trainer.train()
    assert trainer.trials[0].experience_s == pytest.approx(6.0)
    assert len(trainer.experience) == 60 + STEPS
    first = trainer.experience.transitions[:60]
    assert (first["action"].abs() <= experiment.actions.high).all()
    starts = first["observation"][::20]
    assert ((starts - experiment.initial.mean).abs() < 5 * experiment.initial.std).all()
    travelled = first["observation"][:, :3].amax(0) - first["observation"][:, :3].amin(0)
    assert (travelled > np.deg2rad(10)).all()


def rollouts(distance: list[list[float]], hit: list[list[bool]]) -> TensorDict:
    info = {"racket_ball_distance": torch.tensor(distance).double(), "hit": torch.tensor(hit)}
    info = {name: value[..., None] for name, value in info.items()}
    return TensorDict({"next": {"info": info}}, (len(distance), len(distance[0])))


def test_error_is_the_least_distance_of_a_rollout_and_zero_after_a_hit() -> None:
    """A hit may lie between two distances that are positive."""
    distances = [[0.5, 0.125, 0.25], [0.5, 0.02, 0.25]]
    missed_and_hit = rollouts(distances, [[False, False, False], [False, True, True]])
    assert distance_from_ball(missed_and_hit).tolist() == [0.125, 0.0]
    assert distance_from_ball(missed_and_hit[0]).shape == ()


def test_run_is_judged_by_what_the_environment_says_of_the_ball(
    experiment: Task, tmp_path: Path
) -> None:
    result = train(short(experiment), 0, 1, tmp_path / "run", "pmil train", progress_bar=False)
    assert result.summary["saved_success_rate"] == 0  # in 0.4 s no robot comes to the ball
    assert 0 < result.trials[0].own_error < 1
    names = experiment.space.names
    for measure in ("two_sigma_coverage_by_entry", "rms_error", "demonstration_spread"):
        assert tuple(result.summary[measure]) == names
    assert result.summary["settings"]["noise_std"] == [0.03] * 3 + [0.3] * 3
