"""The front door: a robot and its recordings in, a policy and a report out."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partialmethod
from pathlib import Path

import pytest
import torch

from tests.helpers.attended import AttendedPendulum, Operator
from tests.helpers.virtual_time import VirtualTime, virtual_time
from torch_pmil import (
    PMIL,
    Demonstrations,
    GPDynamics,
    SearchSettings,
    load_policy,
    shipped_demonstrations,
)
from torch_pmil.envs import DoublePendulumEnv, PhysicalRobotEnv
from torch_pmil.envs.operator import RunStopped
from torch_pmil.runs.run_folder import FinishedRunError
from torch_pmil.tasks.double_pendulum import double_pendulum_space

SPACE = double_pendulum_space()
SHORT = SearchSettings(mean_iterations=1, stage_iterations=1, final_iterations=1, first_horizon=1.0)


@pytest.fixture
def learner(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> PMIL:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(GPDynamics, "fit", partialmethod(GPDynamics.fit, max_iterations=3))
    return learner_of(DoublePendulumEnv())


def learner_of(robot: DoublePendulumEnv) -> PMIL:
    known = {"state": SPACE.names, "angles": ("q1", "q2"), "match": SPACE.match_space}
    return PMIL(robot, shipped_demonstrations("double_pendulum"), 0.1, **known, search=SHORT)


def test_a_run_is_told_and_leaves_all_that_the_command_leaves(
    learner: PMIL, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    assert learner.learn(trials=1, seed=3) is learner
    printed, complained = capsys.readouterr()
    line = r"^trial  1:   2\.5 s of experience, KL .* nats"
    assert re.search(line, printed, re.MULTILINE)
    assert "success rate" in printed and "likely reason: " in printed
    assert "see runs/DoublePendulumEnv/seed_3/report.html" in printed
    assert "INFO" not in printed + complained and not caplog.records
    assert "incomplete" not in complained
    out = Path("runs/DoublePendulumEnv/seed_3")
    left = {path.name for path in out.iterdir()}
    assert {"report.html", "summary.json", "policy.pt", "dynamics.pt", "run.json"} <= left
    assert (out / "figures" / "trajectories.png").exists()
    assert learner.report() == out / "report.html"


def test_the_policy_is_a_function_is_saved_and_is_measured_once_it_is_learned(
    learner: PMIL,
) -> None:
    for ask in (lambda: learner.policy, lambda: learner.save("a.pt"), learner.evaluate):
        with pytest.raises(RuntimeError, match="there is no policy yet: call learn"):
            ask()
    weights = learner.learn(trials=1, out="run").policy.policy.weights.clone()
    torque = learner.policy([3.14, 0, 0, 0])
    assert torque.shape == (2,)
    learner.save("mine.pt")
    assert (load_policy("mine.pt")([3.14, 0, 0, 0]) == torque).all()
    rate = learner.evaluate(starts=4, seed=1)
    assert rate in (0, 0.25, 0.5, 0.75, 1) and learner.evaluate(starts=4, seed=1) == rate
    # the run stays, and resumes to the same end
    with pytest.raises(FinishedRunError):
        learner.learn(trials=1, out="run")
    learner.learn(trials=1, out="run", resume=True)
    torch.testing.assert_close(learner.policy.policy.weights, weights, atol=0, rtol=0)


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ({"resume": "maybe"}, "resume must be True, False or the folder of a run, got 'maybe'"),
        ({"overwrite": 1}, "overwrite must be True or False, got 1"),
        ({"seed": -1}, "seed must be a whole number from 0 to"),
        ({"trials": "3"}, "trials must be a whole number of at least 1, got '3'"),
        ({"out": 3}, "out must be the path of a folder, or None, got 3"),
    ],
)
def test_wrong_arguments_of_a_run_leave_no_folder(
    learner: PMIL, argument: dict[str, object], message: str
) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        learner.learn(**argument)
    assert not Path("runs").exists()


def test_a_physical_robot_moves_no_more_than_it_is_asked_to(
    learner: PMIL, capsys: pytest.CaptureFixture[str]
) -> None:
    operator = Operator()
    robot = AttendedPendulum(operator, failing={5: 2}, seed=0)
    alone = learner_of(robot).learn(trials=2, seed=3)
    assert operator.asked == robot.rollouts == 1 + 2
    printed = capsys.readouterr().out
    assert "judged by the robot's own rollouts alone" in printed and "success rate" not in printed
    alone.task = replace(alone.task, tolerance=1e9)
    assert alone.evaluate(starts=3) == pytest.approx(2 / 3)  # the fifth rollout is cut short
    assert operator.asked == 3 + 3


class Cart:
    """A cart that moves as fast as it is told, at once."""

    def __init__(self, clock: VirtualTime) -> None:
        self.x, self.sent, self._clock = 0.0, [], clock

    def read_state(self) -> tuple[list[float], float]:
        return [self.x], self._clock.monotonic()

    def send(self, action: torch.Tensor) -> None:
        self.x += 0.02 * action.item()
        self.sent.append(action.item())

    def stop(self) -> None:
        pass


def test_a_robot_that_keeps_time_learns_stops_goes_on_and_is_measured(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(GPDynamics, "fit", partialmethod(GPDynamics.fit, max_iterations=3))
    cart, asked = Cart(virtual_time(monkeypatch)), Operator(("", "", "q", "d"))

    def operator() -> None:
        cart.x = 0.0
        asked()

    env = PhysicalRobotEnv(
        cart, dim=1, low=[-1.0], high=[2.0], control_period=0.02, operator=operator
    )
    ways = torch.stack([torch.linspace(0, end, 11).double() for end in (0.1, 0.11)])[..., None]
    shown = Demonstrations(ways, 0.02, ("x",))
    settings = {"search": replace(SHORT, first_horizon=1.0), "num_centres": 5, "confirmations": 9}
    learner = PMIL(env, shown, 0.02, **settings)
    assert cart.sent == [] and asked.asked == 0
    with pytest.raises(RunStopped):
        learner.learn(trials=2, out="run")
    learner.learn(trials=2, out="run", resume=True)
    assert [trial.steps for trial in learner.result.trials] == [10, 10]
    assert learner.result.summary["experience_s"] == pytest.approx(3 * 10 * 0.02)
    assert learner.evaluate(starts=2) in (0, 0.5, 1)
    assert len(cart.sent) == 10 * asked.asked - 10 * 2  # all but those of q and d
    env.close()
