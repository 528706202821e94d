"""Tasks with targets: the robots see theirs, the policy is one, the outcome is of each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from reproduction.learned import load_learned
from tests.helpers.short_run import COMMAND, SEED, quick_fits, short_experiment
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.demonstrations import DemonstrationError
from torch_pmil.demonstrations.distribution import expert_distribution, rms_error
from torch_pmil.envs import BioRobEnv
from torch_pmil.envs.biorob import START, holding_torques
from torch_pmil.envs.rollouts import states_of
from torch_pmil.model.calibration import two_sigma_coverage
from torch_pmil.runs.training import RunResult, make_trainer, train
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.targets import TargetTask
from torch_pmil.tasks.task import MEASURED_STARTS

STEPS, TRIALS, S = 4, 2, 3
NAMES = ("biorob_targets", "double_pendulum_targets")
SEARCH = SearchSettings(0, 1, 1, first_horizon=1.0)


@pytest.fixture(scope="module", params=NAMES)
def experiment(request: pytest.FixtureRequest) -> TargetTask:
    return load_experiment(request.param)


def short(name: str = "double_pendulum_targets") -> TargetTask:
    return short_experiment(STEPS, name, search=SEARCH)


def new_policy(experiment: TargetTask) -> RBFPolicy:
    return experiment.make_policy(torch.Generator().manual_seed(0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs") / "run"


@pytest.fixture(scope="module")
def result(folder: Path) -> RunResult:
    with pytest.MonkeyPatch.context() as patch:
        quick_fits(patch)
        return train(short(), SEED, TRIALS, folder, COMMAND, progress_bar=False)


def test_policies_have_the_parameters_of_their_basis_functions() -> None:
    policies = {name: new_policy(load_experiment(name)) for name in NAMES}
    counts = {name: sum(p.numel() for p in policies[name].parameters()) for name in NAMES}
    assert counts == {"biorob_targets": 2774, "double_pendulum_targets": 100 * (8 + 2) + 2 * 8}


def test_every_target_has_its_own_demonstrations(experiment: TargetTask) -> None:
    targets, sets = experiment.demonstrations.by_target()
    assert torch.equal(experiment.targets, targets) and len(targets) == S
    assert experiment.demonstrated.batch_shape == (S, experiment.horizon)
    for cov, demonstrations in zip(experiment.demonstrated.cov, sets, strict=True):
        assert torch.equal(cov, expert_distribution(demonstrations, experiment.noise_std).cov)


def test_policy_is_centred_at_demonstrated_states_of_the_same_target(
    experiment: TargetTask,
) -> None:
    inputs, D = experiment.demonstrated_inputs, len(experiment.space.feature_names)
    _, sets = experiment.demonstrations.by_target()
    for target, demonstrations in zip(experiment.targets, sets, strict=True):
        of_target = inputs[(inputs[:, D:] == target).all(-1), :D]
        assert len(of_target) == demonstrations.positions[..., 0].numel()
    assert len(inputs) == len(experiment.demonstrated_states)


def test_new_policy_holds_the_arm_for_every_target() -> None:
    experiment = load_experiment("biorob_targets")
    policy, start = new_policy(experiment), torch.tensor(START, dtype=torch.float64)
    for target in experiment.targets:
        assert (policy(torch.cat([start, target])) - holding_torques(start[:3])).abs().max() < 0.3


def test_robots_see_their_targets_one_after_the_other(experiment: TargetTask) -> None:
    targets = experiment.targets
    for robots, seen in (
        (experiment.robot(0), targets),
        (experiment.robots(2, 0), targets.repeat_interleave(2, 0)),
        (experiment.first_robot(0), targets[0]),
        (experiment.robots_at(targets[1:], 0), targets[1:]),
    ):
        assert torch.equal(robots.reset()["target"], seen)


def test_balls_hang_where_the_targets_say() -> None:
    experiment = load_experiment("biorob_targets")
    env: BioRobEnv = experiment.make_env(targets=experiment.targets[1], seed=0)
    moved = env.model.body("ball").pos - BioRobEnv().model.body("ball").pos
    assert moved == pytest.approx([0.0, *experiment.targets[1].tolist()])


@pytest.mark.usefixtures("quick")
def test_robot_that_learns_moves_once_for_each_target() -> None:
    trainer = make_trainer(short("biorob_targets"), 0, 1, False, lambda trial: None)
    trainer.train()
    assert trainer.trials[0].experience_s == pytest.approx(6.0)
    assert len(trainer.experience) == 60 + S * STEPS
    assert trainer.trials[0].n_eval == S * MEASURED_STARTS


def test_trial_is_a_success_if_every_target_is(result: RunResult) -> None:
    assert len(result.trials) == TRIALS
    assert result.trials[0].own_error >= 0.1  # in 0.4 s no tip comes to all its places
    assert not result.trials[0].own_success


def test_outcomes_are_those_of_each_target(result: RunResult) -> None:
    experiment = short()
    labels = ["x = 0.1, y = -0.6", "x = 0.5, y = -0.6", "x = 0.3, y = -0.4"]
    assert [outcome.label for outcome in result.outcomes] == labels
    for i, outcome in enumerate(result.outcomes):
        assert outcome.executed.shape == (MEASURED_STARTS, STEPS + 1, 4)
        assert (outcome.rollouts["target"] == experiment.targets[i]).all()
        assert torch.equal(outcome.demonstrated.mean, experiment.demonstrated.mean[i])


def test_summary_is_the_mean_over_the_targets_and_names_each(result: RunResult) -> None:
    summary, outcomes, match_space = result.summary, result.outcomes, short().space.match_space
    assert summary["settings"]["targets"] == short().targets.tolist()
    assert summary["saved_n_eval"] == S * MEASURED_STARTS
    assert list(summary["saved_success_rate_by_target"]) == [outcome.label for outcome in outcomes]
    coverage = [two_sigma_coverage(outcome.predicted, outcome.executed) for outcome in outcomes]
    assert summary["two_sigma_coverage"] == pytest.approx(sum(coverage) / S)
    errors = [rms_error(one.demonstrations, match_space(one.executed)) for one in outcomes]
    expected = torch.stack(errors).square().mean(0).sqrt().tolist()
    assert list(summary["rms_error"].values()) == pytest.approx(expected)


def test_saved_policy_runs_again_as_it_did(result: RunResult, folder: Path) -> None:
    experiment = short()
    learned = load_learned(folder, experiment)
    assert learned.policy.target_names == ("x", "y")
    rollouts = learned.rollouts(experiment, 2, seed=0)
    before = rollouts["observation"][:, 0], rollouts["target"][:, 0]
    assert torch.equal(rollouts["action"][:, 0], learned.policy(*before))
    assert states_of(rollouts).shape == (2 * S, STEPS + 1, 4)
    assert torch.equal(learned.predicted(experiment).mean[1], result.outcomes[1].predicted.mean)


@pytest.mark.usefixtures("quick")
def test_stopped_run_goes_on_to_the_same_end(result: RunResult, tmp_path: Path) -> None:
    rest = {"out": tmp_path / "run", "command": COMMAND, "progress_bar": False}
    train(short(), SEED, 1, **rest)
    resumed = train(short(), SEED, TRIALS, **rest, resume=True)
    for name, value in result.policy.state_dict().items():
        assert torch.equal(resumed.policy.state_dict()[name], value)


def test_demonstrations_without_targets_or_with_others_are_refused(experiment: TargetTask) -> None:
    shown, names = experiment.demonstrations, ", ".join(experiment.demonstrations.target_names)
    name = experiment.name
    without = replace(shown, targets=None, target_names=())
    for task, other, said in (
        (name, without, f"{names}, got none"),
        (name, replace(shown, target_names=("a", "b")), f"{names}, got a, b"),
        (name.removesuffix("_targets"), shown, f"none, got {names}"),
    ):
        with pytest.raises(DemonstrationError, match=f"of the demonstrations must be {said}"):
            load_experiment(task, other)


def test_basis_functions_are_wide_in_the_target_beside_the_distances_of_the_targets(
    experiment: TargetTask,
) -> None:
    policy, D = new_policy(experiment), len(experiment.space.feature_names)
    largest = max((a - b).norm().item() for a in experiment.targets for b in experiment.targets)
    assert policy.scale[D:].tolist() == pytest.approx([experiment.target_scale * largest] * 2)
    assert (policy.scale[:D] > 0).all()


def test_one_target_is_not_enough(experiment: TargetTask) -> None:
    _, (first, *_) = experiment.demonstrations.by_target()
    targets = experiment.targets[:1].expand(len(first.positions), -1)
    alone = replace(first, targets=targets, target_names=("y", "z"))
    with pytest.raises(DemonstrationError, match="must be of two targets at least, got"):
        replace(experiment, demonstrations=alone)
