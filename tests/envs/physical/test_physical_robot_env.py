"""Physical robots keep time, say what went wrong, and stop on every way out."""

from __future__ import annotations

import gc
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import check_env_specs

from tests.helpers.fake_robot import PERIOD, FakeRobot, fake_env
from tests.helpers.run_script import ROOT
from tests.helpers.virtual_time import VirtualTime, virtual_time, wait_until
from torch_pmil.envs.operator import RobotError, RolloutDiscarded, RunStopped
from torch_pmil.envs.physical.physical_robot_env import PhysicalRobotEnv

Policy = Callable[[TensorDictBase], TensorDictBase]
Make = Callable[..., PhysicalRobotEnv]


def constant(*action: float) -> Policy:
    """A policy of one action."""
    return lambda tensordict: tensordict.set("action", torch.tensor(action, dtype=torch.float64))


@pytest.fixture
def make_env() -> Iterator[Make]:
    """Environments that are closed after the test."""
    made = []

    def make(*arguments: object, **settings: object) -> PhysicalRobotEnv:
        made.append(fake_env(*arguments, **settings))
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> VirtualTime:
    return virtual_time(monkeypatch)


STILL, NAN = constant(0.0, 0.0), [float("nan"), 0.0]


def fail(error: BaseException) -> None:
    raise error


def test_torchrl_accepts_the_environment(make_env: Make) -> None:
    torch.manual_seed(0)
    env = make_env(FakeRobot(), most_late=1000)
    check_env_specs(env)


def test_actions_and_readings_take_turns_and_the_robot_stops_at_the_end(make_env: Make) -> None:
    robot = FakeRobot()
    env = make_env(robot)
    rollout = env.rollout(5, constant(0.5, 1.0))
    wait_until(lambda: robot.calls[-1] == "stop")
    assert robot.calls == ["stop", "read", "read", *5 * ["send", "read"], "stop"]
    assert robot.sent == 5 * [[0.5, 1.0]]
    assert rollout["observation"][:, 0].tolist() == [2, 3, 4, 5, 6]
    assert rollout["next", "observation"][:, 0].tolist() == [3, 4, 5, 6, 7]
    assert rollout["next", "measured"].all() and env.cut_short == ""


def test_guard_stops_the_robot_and_then_a_step_moves_nothing(make_env: Make) -> None:
    robot = FakeRobot()
    env = make_env(robot)
    env.guard = lambda states: "too far" if states[0] > 4 else ""
    rollout = env.rollout(10, STILL)
    assert len(rollout) == len(robot.sent) == 3
    assert env.cut_short == "too far" and robot.calls[-1] == "stop"
    assert not env.step(rollout[-1].exclude("next"))["next", "measured"].any()
    assert len(robot.sent) == 3


def test_steps_take_a_period_each_and_deadlines_do_not_drift(
    make_env: Make, clock: VirtualTime
) -> None:
    """However long the policy computes, within the period."""

    def slow(tensordict: TensorDictBase) -> TensorDictBase:
        clock.sleep(PERIOD / 8)
        return STILL(tensordict)

    env = make_env(FakeRobot())
    rollout = env.rollout(20, slow)
    times = torch.cat([rollout["time"][:1], rollout["next", "time"]]).flatten()
    torch.testing.assert_close(times.diff(), torch.full_like(times[1:], PERIOD))
    delays = rollout["next", "delay"]
    torch.testing.assert_close(delays, torch.full_like(delays, PERIOD / 8))
    assert not rollout["next", "late"].any()


def test_robot_is_stopped_two_periods_after_the_last_action(make_env: Make) -> None:
    robot = FakeRobot()
    env = make_env(robot)
    rollout = env.rollout(2, STILL)
    wait_until(lambda: robot.calls[-1] == "stop")
    last_sent = (rollout["time"][-1] + rollout["next", "delay"][-1]).item()
    assert 1.99 * PERIOD < robot.stopped_at - last_sent < 5 * PERIOD  # a loaded machine wakes late


@pytest.mark.parametrize(
    ("fault", "line"),
    [
        (lambda: fail(OSError("cable out")), "the robot failed with OSError: cable out"),
        (lambda: fail(RobotError("it is on fire")), "it is on fire"),
        (lambda: (NAN, time.monotonic()), f"a reading must be 2 finite numbers, got {NAN}"),
        (lambda: ([1.0], time.monotonic()), "a reading must be 2 finite numbers, got [1.0]"),
    ],
)
def test_failed_reading_ends_the_rollout(make_env: Make, fault: Callable, line: str) -> None:
    robot = FakeRobot({4: fault})
    env = make_env(robot)
    rollout = env.rollout(10, STILL)
    assert rollout["next", "measured"].flatten().tolist() == [True, True, False]
    assert rollout["next", "done"].flatten().tolist() == [False, False, True]
    assert rollout["next", "observation"].isfinite().all()
    assert env.cut_short == line and robot.calls[-1] == "stop"
    env.reset()
    assert env.cut_short == ""


def test_action_that_cannot_be_sent_ends_the_rollout(make_env: Make) -> None:
    robot = FakeRobot()
    robot.send = lambda action: fail(ConnectionError("no route to the robot"))
    env = make_env(robot)
    rollout = env.rollout(10, STILL)
    assert len(rollout) == 1 and not rollout["next", "measured"].any()
    assert env.cut_short == "the robot failed with ConnectionError: no route to the robot"
    assert robot.calls[-1] == "stop"


def repeated(*_: VirtualTime) -> tuple[list[float], float]:
    return [0.0, 0.0], 1.0


def old(clock: VirtualTime) -> tuple[list[float], float]:
    return [0.0, 0.0], clock.monotonic() - PERIOD / 2


def slow(clock: VirtualTime) -> None:
    clock.sleep(PERIOD / 2)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (repeated, "the robot repeats the reading of 1.000 s"),
        (old, "its reading was 0.040 s old"),
        (slow, "its reading came 0.040 s after the deadline"),
    ],
)
def test_late_steps_are_told_and_three_in_a_row_end_the_rollout(
    make_env: Make, clock: VirtualTime, fault: Callable, reason: str
) -> None:
    robot = FakeRobot(dict.fromkeys((3, 6, 7, 8), lambda: fault(clock)))
    env = make_env(robot)
    rollout = env.rollout(20, STILL)
    late = rollout["next", "late"].flatten()
    assert late[[1, 4, 5, 6]].all() and len(late) == 7 and not late[[0, 3]].any()
    assert rollout["next", "measured"].all() and robot.calls[-1] == "stop"
    assert env.cut_short == f"3 steps in a row were late; the last one: {reason}"


def test_late_action_is_told_and_held_for_a_whole_period(
    make_env: Make, clock: VirtualTime
) -> None:
    def hesitating(tensordict: TensorDictBase) -> TensorDictBase:
        clock.sleep(0.6 * PERIOD * (tensordict["observation"][0] == 4).item())
        return STILL(tensordict)

    env = make_env(FakeRobot())
    rollout = env.rollout(4, hesitating)
    sent = rollout["time"] + rollout["next", "delay"]
    held = (rollout["next", "time"] - sent).flatten()
    assert rollout["next", "late"].flatten().tolist() == [False, False, True, False]
    torch.testing.assert_close(held, torch.full_like(held, PERIOD))


def test_policy_that_takes_too_long_finds_the_robot_stopped(make_env: Make) -> None:
    def sleeping(tensordict: TensorDictBase) -> TensorDictBase:
        time.sleep(3 * PERIOD * (tensordict["observation"][0] == 4).item())
        return STILL(tensordict)

    robot = FakeRobot()
    env = make_env(robot)
    rollout = env.rollout(10, sleeping)
    assert rollout["next", "measured"].flatten().tolist() == [True, True, False]
    assert env.cut_short == "the robot was stopped, as no action came within 0.16 s"
    assert robot.calls[-1] == "stop" and robot.calls.count("send") == 2


def test_actions_are_limited_and_what_was_sent_is_shown(make_env: Make) -> None:
    robot = FakeRobot()
    env = make_env(
        robot, largest_change=[0.5, 1.0], holding_action=lambda state: torch.tensor([0.0, 1.0])
    )
    rollout = env.rollout(3, constant(-2.0, 9.0))
    assert robot.sent == [[-0.5, 2.0], [-1.0, 3.0], [-1.0, 3.0]]
    assert rollout["next", "sent"].tolist() == robot.sent
    assert rollout["action"].tolist() == 3 * [[-2.0, 9.0]]
    robot.send = lambda action: [0.1, 0.2]  # limits of the robot itself
    assert env.rollout(2, constant(0.5, 0.5))["next", "sent"].tolist() == 2 * [[0.1, 0.2]]


def test_operator_comes_before_each_rollout_and_may_end_it_all(make_env: Make) -> None:
    robot = FakeRobot()
    answers = [lambda: None, lambda: fail(RolloutDiscarded()), lambda: fail(RunStopped())]
    env = make_env(robot, operator=lambda: answers.pop(0)())
    env.rollout(1, STILL)
    with pytest.raises(RolloutDiscarded):
        env.reset()
    with pytest.raises(RunStopped):
        env.reset()
    assert robot.calls[-1] == "stop"


@pytest.mark.parametrize(
    ("fault", "line"),
    [
        (lambda: fail(OSError("no such device")), "OSError: no such device"),
        (repeated, "time stamps must advance, got 1.0 s and 0.08 s later 1.0 s"),
    ],
)
def test_robot_that_cannot_be_read_is_told_at_the_reset(
    make_env: Make, fault: Callable, line: str
) -> None:
    env = make_env(FakeRobot({0: fault, 1: fault}))
    with pytest.raises(RobotError, match=line):
        env.reset()


@pytest.mark.parametrize("end", ["interrupt", "action", "close", "garbage"])
def test_robot_stops_on_every_way_out(end: str) -> None:
    robot = FakeRobot({5: lambda: fail(KeyboardInterrupt()) if end == "interrupt" else None})
    env = fake_env(robot)
    tensordict = STILL(env.reset())
    env.step(tensordict)
    if end == "interrupt":
        with pytest.raises(KeyboardInterrupt):
            env.rollout(9, STILL)
    elif end == "action":
        with pytest.raises(ValueError, match="action must be 2 finite numbers"):
            env.step(constant(float("nan"), 0.0)(tensordict))
    elif end == "close":
        env.close()
    else:
        del env
        gc.collect()
    assert robot.calls[-1] == "stop"


PROGRAM = """
import os, signal, sys, time
sys.path.insert(0, {root!r})
from tests.helpers.fake_robot import FakeRobot, fake_env
class Told(FakeRobot):
    def stop(self):
        print("stop", flush=True)
robot = Told()
env = fake_env(robot, control_period=1.0)
env.reset()
env._robot.send([0.0, 0.0])
print("moves", flush=True)
{end}
"""
ENDS = {
    "exit": ("sys.exit(3)", 3),
    "error": ("raise RuntimeError", 1),
    "interrupt": ("os.kill(os.getpid(), signal.SIGINT); time.sleep(1)", 1),
    "terminate": ("os.kill(os.getpid(), signal.SIGTERM); time.sleep(1)", -signal.SIGTERM),
    "terminal": ("os.kill(os.getpid(), signal.SIGHUP); time.sleep(1)", -signal.SIGHUP),
    "hanging": ("time.sleep(2.5); os._exit(9)", 9),
}


@pytest.mark.slow
@pytest.mark.parametrize("end", ENDS)
def test_robot_stops_when_its_program_ends(end: str) -> None:
    """And the program ends as it would without a robot."""
    command, code = ENDS[end]
    program = PROGRAM.format(root=str(ROOT), end=command)
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert ended.stdout.split() == ["stop", "moves", "stop"]
    assert ended.returncode == code


def test_no_garbage_is_collected_while_the_robot_moves(make_env: Make) -> None:
    env = make_env(FakeRobot())
    tensordict = env.reset()
    for _ in range(2):
        assert not gc.isenabled()
        env.step(STILL(tensordict))
    wait_until(gc.isenabled)


def test_handlers_of_signals_come_back() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    env = fake_env(FakeRobot())
    assert signal.getsignal(signal.SIGTERM) != before[1]
    env.close()
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


WRONG = [
    ({"low": [0.0], "high": [1.0, 2.0]}, "low must be below high"),
    ({"low": [0.0, 3.0]}, r"low must be below high, got \[0.0, 3.0\] and \[1.0, 3.0\]"),
    ({"high": [1.0, float("inf")]}, "high must be a list of finite numbers"),
    ({"action_names": ["one"]}, "action_names must be 2 words, got one"),
    ({"control_period": 0.0}, "control_period must be positive and finite"),
    ({"largest_change": [1.0, 1.0]}, "largest_change needs holding_action"),
    ({"largest_change": [1.0, -1.0]}, "largest_change must be 2 positive numbers"),
]


@pytest.mark.parametrize(("settings", "line"), WRONG)
def test_wrong_settings_are_refused(settings: dict, line: str) -> None:
    with pytest.raises(ValueError, match=line):
        fake_env(FakeRobot(), **settings)


def test_actions_have_names_and_units(make_env: Make) -> None:
    env = make_env(FakeRobot(), action_names=["hip", "knee"], action_units=["rad", "N·m"])
    assert (env.action_names, env.action_units) == (("hip", "knee"), ("rad", "N·m"))
    plain = make_env(FakeRobot())
    assert (plain.action_names, plain.action_units) == (("0", "1"), ("", ""))
