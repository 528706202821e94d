"""The training script on tasks of gymnasium, shortened: what it leaves with pictures and without,
and without gymnasium.
"""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium
import imageio_ffmpeg
import pytest
import torch
from torch.nn.utils import parameters_to_vector

from tests.helpers.run_script import run_command
from tests.helpers.short_run import quick_fits as shorten_fits, replace_task, short_experiment
from torch_pmil.envs import gym_tasks
from torch_pmil.runs.training import make_trainer
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.trainer import PMILTrainer

COMMAND = "train"
HORIZON = 8
NAMES = ("gym_pendulum", "inverted_pendulum")


@pytest.fixture(autouse=True)
def quick_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten_fits(monkeypatch)


def short(name: str) -> Task:
    """The experiment's first steps, with short searches; every rollout is a failure."""
    failure = lambda rollout: torch.ones(rollout.shape[:-1])  # noqa: E731
    return short_experiment(HORIZON, name, error=failure, tolerance=0.5)


def trained(name: str, seed: int, trials: int) -> PMILTrainer:
    trainer = make_trainer(short(name), seed, trials, False, lambda trial: None)
    trainer.train()
    return trainer


def run(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """One trial of the shortened experiment into ``run``."""
    monkeypatch.chdir(tmp_path)
    replace_task(monkeypatch, short(name), name)
    run_command(monkeypatch, COMMAND, f"experiment={name}", "trials=1", "out=run")


@pytest.mark.parametrize("name", NAMES)
def test_robot_of_gymnasium_moves_until_it_has_fallen(name: str) -> None:
    trainer = trained(name, seed=0, trials=2)
    steps, falls = zip(*((each.steps, each.cut_short) for each in trainer.trials), strict=True)
    assert [count < HORIZON for count in steps] == [bool(fall) for fall in falls]
    assert any(falls) == (name == "inverted_pendulum")
    explored = len(trainer.experience) - sum(steps)
    rollouts = trainer.experience.transitions.split([explored, *steps])
    assert all(
        torch.equal(rollout["next", "observation"][:-1], rollout["observation"][1:])
        for rollout in rollouts
    )
    assert len(torch.stack([rollout["observation"][0] for rollout in rollouts]).unique(dim=0)) == 3
    assert all(trial.n_eval == 20 for trial in trainer.trials)


@pytest.mark.parametrize("name", NAMES)
def test_same_seed_learns_the_same_policy_bit_for_bit(name: str) -> None:
    results = []
    for seed in (3, 3, 4):
        policy = trained(name, seed, trials=1).loss_module.actor_network
        results.append(parameters_to_vector(policy.parameters()))
    assert torch.equal(results[0], results[1]) and not torch.equal(results[0], results[2])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_run_leaves_a_video_of_the_environments_own_pictures(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(name, monkeypatch, tmp_path)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(tmp_path / "run" / "video.mp4")
    assert frames == HORIZON + 1
    assert seconds == pytest.approx(
        (HORIZON + 1) * load_experiment(name).demonstrations.time_step, abs=0.02
    )
    figures = {"trajectories", "learning_curve", "kl_per_step", "calibration", "model", "policy"}
    assert {path.stem for path in (tmp_path / "run" / "figures").iterdir()} == figures
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["experiment"] == name
    assert (
        "see run/report.html, run/figures, run/video.mp4, run/summary.json"
        in capsys.readouterr().out
    )


@pytest.mark.slow
def test_run_without_pictures_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*args: object, **kwargs: object) -> None:
        raise gymnasium.error.DependencyNotInstalled("pygame is not installed\nor broken")

    monkeypatch.setattr(gymnasium.envs.classic_control.PendulumEnv, "render", broken)
    run("gym_pendulum", monkeypatch, tmp_path)
    assert not (tmp_path / "run" / "video.mp4").exists()
    printed, complained = capsys.readouterr()
    assert (
        "the report is incomplete: video: pygame is not installed or broken; pmil resume run makes "
        "the rest later, pmil report the page alone\n"
    ) in complained
    assert "see run/report.html, run/figures, run/summary.json" in printed.splitlines()


@pytest.mark.parametrize("name", NAMES)
def test_without_gymnasium_the_script_ends_in_one_line(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(gym_tasks, "gymnasium", None)
    with pytest.raises(SystemExit) as stop:
        run_command(monkeypatch, COMMAND, f"experiment={name}", "out=run")
    assert (
        stop.value.code
        == "error: this task needs gymnasium, which is not installed: pip install 'torch_pmil[gym]'"
    )
    assert list(tmp_path.iterdir()) == []
