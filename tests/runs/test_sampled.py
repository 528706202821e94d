"""The first motion of a run: kept, continued, and refused if it is another's."""

from __future__ import annotations

import json
import re
from functools import partialmethod
from pathlib import Path
from unittest.mock import Mock

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from tests.helpers.attended import AttendedPendulum, Operator
from torch_pmil import PMIL
from torch_pmil.control.tensor_file import load_tensors
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.operator import RunStopped
from torch_pmil.files import FileError
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.runs import sampled as of_sampled, training
from torch_pmil.runs.own_files import MOTION, SAMPLING, own
from torch_pmil.runs.run_folder import UnfinishedRunError, clear_folder
from torch_pmil.runs.sampled import sampled
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks import sampling_choice
from torch_pmil.tasks.first_motion import explore, ran_away
from torch_pmil.tasks.own_robot import own_robot
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.trainer import PMILTrainer

STATE = ("q1", "dq1", "q2", "dq2")
SHORT = SearchSettings(1, 1, 1, first_horizon=1.0)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(GPDynamics, "fit", partialmethod(GPDynamics.fit, max_iterations=3))


def shown() -> Demonstrations:
    ways = torch.linspace(3.1, 3.4, 51).double()[:, None].expand(51, 2)
    return Demonstrations(torch.stack([ways, 1.02 * ways]), 0.1, ("q1", "q2"))


def said() -> dict[str, object]:
    return {"state": STATE, "angles": ("q1", "q2"), "search": SHORT, "num_centres": 5}


def task() -> Task:
    return own_robot(DoublePendulumEnv(), shown(), 0.1, **said())


def test_motion_and_choice_are_taken_up_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines: list[str] = []
    chosen, motion = sampled(task(), 100, tmp_path, resume=False, report=lines.append)
    assert chosen.samplings == () and lines[-1].startswith("steps of 0.")
    assert set(json.loads((tmp_path / SAMPLING).read_text())["lost"]) >= {"steps of 0.1 s"}
    monkeypatch.setattr(sampling_choice, "held_out_loss", None)  # nothing is compared anew
    again, same = sampled(task(), 100, tmp_path, resume=True, report=lines.append)
    assert again.settings == chosen.settings and lines[-1] == lines[-2]
    assert torch.equal(same["observation"], motion["observation"])


class Falling(gymnasium.Env):
    """A pole that falls from upright within a second, whatever is done."""

    dt = 0.05

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)
    action_space = Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: object = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.state = np.array([0.05, 0.0]) + 0.01 * self.np_random.standard_normal(2)
        return self.state, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        q, dq = self.state
        dq = dq + 0.05 * (40 * np.sin(q) + action[0])
        self.state = np.array([q + 0.05 * dq, dq])
        return self.state, 0.0, False, False, {}


def balancing(size: float) -> Task:
    way = size * torch.linspace(1, 0, 51).double()[:, None]
    recorded = Demonstrations(torch.stack([way, 1.1 * way]), 0.05, ("q",))
    return own_robot(Falling(), recorded, 0.05, state=("q", "dq"), step=0.05)


def test_robot_that_ran_away_is_moved_again_by_half_the_actions(tmp_path: Path) -> None:
    lines: list[str] = []
    task = balancing(0.05)
    fell = explore(task, 100)
    assert ran_away(task, fell)
    motion = load_tensors(_moved(task, tmp_path, lines) / MOTION)
    assert torch.allclose(motion["actions"], fell.actions / 2)
    assert lines[0].startswith("the first motion ran away") and len(lines) == 2


def test_robot_that_stays_is_moved_once(tmp_path: Path) -> None:
    lines: list[str] = []
    task = balancing(10.0)
    motion = load_tensors(_moved(task, tmp_path, lines) / MOTION)
    assert torch.equal(motion["actions"], explore(task, 100).actions) and len(lines) == 1


def _moved(task: Task, out: Path, lines: list[str]) -> Path:
    sampled(task, 100, out, resume=False, report=lines.append)
    return out


def test_task_that_is_sampled_already_makes_no_motion(tmp_path: Path) -> None:
    plain = own_robot(DoublePendulumEnv(), shown(), 0.1, step=0.1, past=None, **said())
    assert sampled(plain, 0, tmp_path, resume=False) == (plain, None)
    assert not list(tmp_path.iterdir())


def test_files_of_another_robot_are_refused(tmp_path: Path) -> None:
    sampled(task(), 100, tmp_path, resume=False)
    kept = (tmp_path / SAMPLING).read_text()
    (tmp_path / SAMPLING).write_text(kept.replace('"held": ', '"held": 9'))
    with pytest.raises(FileError, match="must be a sampling of DoublePendulumEnv"):
        sampled(task(), 100, tmp_path, resume=True)
    (tmp_path / SAMPLING).write_text("[]")
    with pytest.raises(FileError, match="must be a sampling of DoublePendulumEnv"):
        sampled(task(), 100, tmp_path, resume=True)
    torch.save({"states": torch.zeros(3, 2)}, tmp_path / MOTION)
    with pytest.raises(FileError, match="must hold states, actions, resting"):
        sampled(task(), 100, tmp_path, resume=True)


def test_run_that_was_stopped_goes_on_with_its_motion_to_the_same_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = PMIL(DoublePendulumEnv(), shown(), 0.1, **said()).learn(2, seed=100, out="whole")
    fit, fits = PMILTrainer.fit_dynamics, []

    def stopping(trainer: PMILTrainer) -> None:
        fits.append(trainer)
        if len(fits) == 2:
            raise KeyboardInterrupt
        fit(trainer)

    monkeypatch.setattr(PMILTrainer, "fit_dynamics", stopping)
    with pytest.raises(KeyboardInterrupt):
        PMIL(DoublePendulumEnv(), shown(), 0.1, **said()).learn(2, seed=100, out="run")
    learner = PMIL(DoublePendulumEnv(), shown(), 0.1, **said())
    learner.learn(2, seed=100, out="run", resume=True)
    for name, value in whole.policy.policy.state_dict().items():
        assert torch.equal(learner.policy.policy.state_dict()[name], value)
    assert learner.policy.control_period == whole.policy.control_period
    assert learner.result.summary["experience_s"] == pytest.approx(3 * 5.0)


def test_first_motion_of_a_run_that_was_stopped_before_its_first_checkpoint_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learner = PMIL(DoublePendulumEnv(), shown(), 0.1, **said())
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(training, "make_trainer", Mock(side_effect=KeyboardInterrupt))
        learner.learn(1, seed=100, out=tmp_path)
    motion = (tmp_path / MOTION).read_bytes()
    line = re.escape(f"resume=true, choose another out, or remove {tmp_path / MOTION}")
    with pytest.raises(UnfinishedRunError, match=f"{line}$"):
        learner.learn(1, seed=100, out=tmp_path)
    monkeypatch.setattr(of_sampled, "explore", None)  # the robot is not moved again
    learner.learn(1, seed=100, out=tmp_path, resume=True)
    assert (tmp_path / MOTION).read_bytes() == motion
    assert learner.result.summary["experience_s"] == pytest.approx(2 * 5.0)


def test_run_that_begins_with_anothers_experience_is_repeated_until_its_first_checkpoint(
    tmp_path: Path,
) -> None:
    own(tmp_path, MOTION).touch()
    with pytest.raises(UnfinishedRunError):
        clear_folder(tmp_path)
    clear_folder(tmp_path, borrowed=True)
    assert not (tmp_path / MOTION).exists()


def test_first_motion_that_is_discarded_is_made_anew(tmp_path: Path) -> None:
    """Also if the run is stopped at once; nothing of the discarded motion is left."""
    operator = Operator(("", "", "d", "q"))  # the motion, once more since it ran away, and a trial
    learner = PMIL(AttendedPendulum(operator), shown(), 0.1, **said())
    with pytest.raises(RunStopped):
        learner.learn(1, seed=100, out=tmp_path)
    assert not (tmp_path / MOTION).exists() and not (tmp_path / SAMPLING).exists()
    learner.learn(1, seed=100, out=tmp_path, resume=True)
    motion = load_tensors(tmp_path / MOTION)["states"]
    assert operator.asked == 4 + 3
    assert learner.result.summary["experience_s"] == pytest.approx(2 * 5.0)
    again = PMIL(AttendedPendulum(Operator(("", "", "d"))), shown(), 0.1, **said())
    again.learn(1, seed=100, out=tmp_path / "again")
    assert len(load_tensors(tmp_path / "again" / MOTION)["states"]) == len(motion)
