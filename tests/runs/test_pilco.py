"""PILCO on robots of gymnasium: a cost alone is enough."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from torch_pmil import PILCO, CostTask, SaturatingCost, load_policy, own_cost
from torch_pmil.runs import learner
from torch_pmil.runs.learner import Learner
from torch_pmil.runs.training import RunResult, train


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_pole_is_brought_to_rest_in_the_middle(seed: int, tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    learner = PILCO(
        "InvertedPendulum-v5",
        cost=SaturatingCost(target={"x": 0.0, "q": 0.0}, width=0.1),
        horizon=50,
        control_period=0.04,
        state=("x", "q", "dx", "dq"),
    )
    learner.learn(seed=seed, out=tmp_path / "run")
    assert learner.evaluate() >= 0.95
    assert learner.result.summary["experience_s"] <= 20
    learner.save(tmp_path / "policy.pt")
    assert load_policy(tmp_path / "policy.pt").control_period == 0.04
    learner.export(tmp_path / "policy.pt2")
    assert (tmp_path / "policy.pt2").stat().st_size > 0
    names = {path.name for path in (tmp_path / "run" / "figures").iterdir()}
    assert "trajectories.png" in names and "kl_per_step.png" not in names
    assert (tmp_path / "run" / "report.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_pendulum_is_brought_up_from_any_angle(seed: int, tmp_path: Path) -> None:
    """The one of the page, which no Gaussian start describes."""
    pytest.importorskip("gymnasium")
    learner = PILCO(
        "Pendulum-v1",
        cost=SaturatingCost(target={"cos q": 1.0, "sin q": 0.0}, width=0.5),
        horizon=100,
        control_period=0.1,
        state=("cos q", "sin q", "dq"),
    )
    assert learner.task.initial.std.max() > 1
    learner.learn(seed=seed, out=tmp_path / "run")
    assert learner.evaluate() >= 0.95


def short(control_period: float = 0.04, **settings: object) -> CostTask:
    """A task whose searches take a moment."""
    pytest.importorskip("gymnasium")
    quick = {"mean_iterations": 1, "stage_iterations": 2, "final_iterations": 2, "restarts": 0}
    return own_cost(
        "InvertedPendulum-v5",
        SaturatingCost(target={"q": 0.0}, width=0.1),
        horizon=12,
        control_period=control_period,
        state=("x", "q", "dx", "dq"),
        num_centres=5,
        **{f"search.{name}": value for name, value in quick.items()},
        **settings,
    )


def learned(task: CostTask, out: Path, trials: int, resume: bool = False) -> RunResult:
    return train(task, 1, trials, out, "", progress_bar=False, resume=resume)


def test_stopped_run_goes_on_to_the_same_policy(tmp_path: Path) -> None:
    """Its first motion, which says where the policy's centres are, is that of the run."""
    whole = learned(short(), tmp_path / "whole", 2)
    learned(short(), tmp_path / "stopped", 1)
    resumed = learned(short(), tmp_path / "stopped", 2, resume=True)
    for name, tensor in whole.policy.policy.state_dict().items():
        assert torch.equal(tensor, resumed.policy.policy.state_dict()[name]), name
    assert torch.equal(whole.task.centre_std, resumed.task.centre_std)


def test_run_of_another_seed_begins_with_the_experience_of_a_run(tmp_path: Path) -> None:
    """The policy's centres are where those of that run are."""
    first = learned(short(), tmp_path / "first", 1)
    out, seed = tmp_path / "second", 2
    second = train(short(), seed, 1, out, "", False, resume=tmp_path / "first")
    resumed = train(short(), seed, 2, out, "", False, resume=True)
    for later in (second, resumed):
        assert torch.equal(later.task.centre_std, first.task.centre_std)
        assert len(later.dynamics.train_inputs) == 4 * 12  # two motions and two trials


def test_experience_at_another_rate_is_refused(tmp_path: Path) -> None:
    learned(short(), tmp_path / "first", 1)
    with pytest.raises(ValueError, match=r"has control_period = 0\.04, got 0\.08: it cannot go on"):
        train(short(0.08), 1, 1, tmp_path / "second", "", False, resume=tmp_path / "first")


def test_a_learner_learns_each_seed_as_if_it_were_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learner, "tell_all", lambda *_: [])
    twice, alone = Learner(short()), Learner(short())
    for seed in (1, 2):
        twice.learn(trials=1, seed=seed, out=tmp_path / f"twice_{seed}")
    alone.learn(trials=1, seed=2, out=tmp_path / "alone")
    assert torch.equal(twice.task.centre_std, alone.task.centre_std)


def test_run_with_another_cost_is_another_run(tmp_path: Path) -> None:
    learned(short(), tmp_path / "run", 1)
    other = short().with_settings(**{"cost.width": 0.2})
    with pytest.raises(ValueError, match=r"has cost = .*it cannot go on so"):
        learned(other, tmp_path / "run", 2, resume=True)


def test_another_optimiser_searches_too(tmp_path: Path) -> None:
    result = learned(short(optimizer=torch.optim.Adam), tmp_path / "run", 1)
    assert result.trials[0].evaluations > 0
    assert result.summary["settings"]["optimizer"] == "Adam"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_cost_that_is_a_function_is_learned(seed: int, tmp_path: Path) -> None:
    """The one of the page, by samples."""
    pytest.importorskip("gymnasium")

    def cost(states: Tensor, actions: Tensor) -> Tensor:
        return (states[..., :2] / 0.1).square().sum(-1) + 0.01 * actions.square().sum(-1)

    def in_the_middle(states: Tensor) -> Tensor:
        return states[:, -10:, :2].abs().amax((-2, -1)) < 0.1

    learner = PILCO(
        "InvertedPendulum-v5",
        cost=cost,
        success=in_the_middle,
        horizon=50,
        control_period=0.04,
        state=("x", "q", "dx", "dq"),
    )
    learner.learn(seed=seed, out=tmp_path / "run")
    assert learner.evaluate() >= 0.95
