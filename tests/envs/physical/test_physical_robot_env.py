"""Physical robots keep time, say what went wrong, and stop on every way out."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import check_env_specs

from tests.helpers.fake_robot import PERIOD, FakeRobot, fake_env
from tests.helpers.run_script import ROOT
from tests.helpers.virtual_time import VirtualTime, virtual_time, wait_until
from torch_pmil.envs.operator import RobotError, RolloutDiscarded, RunStopped
from torch_pmil.envs.physical.physical_robot_env import PhysicalRobotEnv
from torch_pmil.envs.physical.watched_robot import SIGNALS

Policy = Callable[[TensorDictBase], TensorDictBase]
Make = Callable[..., PhysicalRobotEnv]


def constant(*action: float) -> Policy:
    """A policy of one action."""
    return lambda tensordict: tensordict.set("action", torch.tensor(action, dtype=torch.float64))


@pytest.fixture(autouse=True)
def ordinary_signals() -> Iterator[None]:
    """A shell's background jobs ignore these two, and what is ignored stays so."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGQUIT)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


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
STAMP = "a time stamp must be a finite number of seconds"


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
        (lambda: (["a", 0], 1.0), "a reading must be 2 finite numbers, got ['a', 0]"),
        (lambda: ([1j, 0], 1.0), "a reading must be 2 finite numbers, got [1j, 0]"),
        (lambda: 7.0, "read_state must return a state and its time, got 7.0"),
        *[
            (lambda stamp=stamp: ([0.0, 0.0], stamp), f"{STAMP}, got {stamp}")
            for stamp in (NAN[0], float("inf"), None)
        ],
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


@pytest.mark.parametrize("speed", [0.0, 1e-6])
def test_time_stamp_that_jumps_ahead_and_then_stands_still_ends_the_rollout(
    make_env: Make, clock: VirtualTime, speed: float
) -> None:
    def jumped() -> tuple[list[float], float]:
        return [0.0, 0.0], 5000.0 + speed * clock.monotonic()

    env = make_env(FakeRobot(dict.fromkeys(range(4, 20), jumped)))
    rollout = env.rollout(20, STILL)
    assert rollout["next", "late"].flatten().tolist() == [False, False, True, True, True]
    assert env.cut_short.startswith("3 steps in a row were late; the last one: ")


def test_clock_that_is_set_ahead_makes_one_step_late(make_env: Make, clock: VirtualTime) -> None:
    faults = {k: lambda: ([0.0, 0.0], clock.monotonic() + 3600.0) for k in range(4, 20)}
    rollout = make_env(FakeRobot(faults)).rollout(6, STILL)
    assert rollout["next", "late"].flatten().tolist() == [False, False, True, False, False, False]


@pytest.mark.parametrize("sent", [[1.0], [0.0, 0.0, 0.0], NAN, "ok", object()])
def test_answer_that_is_no_action_ends_the_rollout(make_env: Make, sent: object) -> None:
    robot = FakeRobot()
    robot.send = lambda action: sent
    env = make_env(robot)
    rollout = env.rollout(10, STILL)
    assert len(rollout) == 1 and rollout["next", "sent"].tolist() == [[0.0, 0.0]]
    assert env.cut_short.startswith("what send returns must be 2 finite numbers, got ")
    assert robot.calls[-1] == "stop"


def test_robot_that_writes_into_its_action_changes_no_record(make_env: Make) -> None:
    robot = FakeRobot()
    robot.send = lambda action: fail(OSError) if action.zero_().any() else None
    assert make_env(robot).rollout(1, constant(0.5, 1.0))["next", "sent"].tolist() == [[0.5, 1.0]]


def test_robot_that_cannot_be_stopped_is_not_started(make_env: Make) -> None:
    robot = FakeRobot()
    robot.stop = lambda: fail(OSError("no bus"))
    asked = []
    env = make_env(robot, operator=lambda: asked.append(1))
    with pytest.raises(RobotError, match="the robot could not be stopped: OSError: no bus"):
        env.reset()
    robot.stop = lambda: None
    env.reset()
    env.close()
    with pytest.raises(RobotError, match="closed: make a new one"):
        env.reset()
    assert asked == [1]


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
        (lambda: ([0.0, 0.0], time.time_ns()), "time stamps must be in seconds, got"),
        (lambda: ([0.0, 0.0], 1e3 * time.monotonic()), "time stamps must be in seconds, got"),
        (lambda: ([0.0, 0.0], time.monotonic() / 60), "time stamps must be in seconds, got"),
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
import os, signal, sys, threading, time
sys.path.insert(0, {root!r})
from tests.helpers.fake_robot import FakeRobot, fake_env
class Told(FakeRobot):
    def stop(self):
        print("stop", flush=True)
robot = Told()
env = fake_env(robot, control_period={period}, operator=lambda: None)
env._robot.stop()
env._robot.start()
env._robot.send(env.action_spec.zero())
print("moves", flush=True)
{end}
"""
BLOCKED = """
locked = threading.Lock()
locked.acquire()
robot.stop = lambda: print("stop", flush=True) or locked.acquire()
print(time.monotonic(), flush=True)
"""
KILL = "os.kill(os.getpid(), signal.SIG{}); time.sleep(3)"
FORKED = """
child = os.fork()
if not child:
    {}
os.waitpid(child, 0)
"""
ENDS = {
    "exit": "sys.exit(3)",
    "error": "raise RuntimeError",
    "interrupt": KILL.format("INT"),
    "terminate": KILL.format("TERM"),
    "terminal": KILL.format("HUP"),
    "quit": KILL.format("QUIT"),
    "child exits": FORKED.format("sys.exit()") + "print('parent', flush=True)",
    "child is terminated": FORKED.format(KILL.format("TERM")) + "print('parent', flush=True)",
}


def ended(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )


def moving(end: str, period: float = 20.0) -> str:
    """A program whose robot moves, and how it ends."""
    return PROGRAM.format(root=str(ROOT), period=period, end=end)


def without_robot(end: str) -> str:
    """A program that ends so; TorchRL's imports change the code of one that is interrupted."""
    return f"import os, signal, sys, time\nimport torchrl.envs\n{end}"


@pytest.mark.slow
@pytest.mark.parametrize("end", ENDS)
def test_robot_stops_when_its_program_ends(end: str) -> None:
    """And the program ends as it would without a robot."""
    found = ended(moving(ENDS[end]))
    plain = ended(without_robot(ENDS[end]))
    assert found.stdout.split() == ["stop", "moves", *plain.stdout.split(), "stop"]
    assert found.returncode == plain.returncode
    assert found.stderr.splitlines()[-1:] == plain.stderr.splitlines()[-1:]  # the same error


@pytest.mark.slow
def test_robot_of_a_program_that_hangs_stops() -> None:
    found = ended(moving("time.sleep(2); os._exit(9)", period=0.5))
    assert found.stdout.split() == ["stop", "moves", "stop"] and found.returncode == 9


@pytest.mark.slow
@pytest.mark.parametrize("number", ["INT", "TERM"])
def test_stop_that_blocks_delays_a_signal_by_a_second(number: str) -> None:
    found = ended(moving(BLOCKED + KILL.format(number) + "\nprint('survived')"))
    words = found.stdout.split()
    assert words[:2] == ["stop", "moves"] and words[3:] == ["stop"]
    assert found.returncode == ended(without_robot(KILL.format(number))).returncode
    assert "its stop did not return" in found.stderr
    assert found.stderr.endswith("KeyboardInterrupt\n") is (number == "INT")
    assert 0.9 < time.monotonic() - float(words[2]) < 8


@pytest.mark.slow
def test_suspended_program_has_stopped_its_robot_and_goes_on() -> None:
    program = moving(KILL.format("TSTP")) + "print(env._robot._stopped)"
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, process_group=0
    ) as child:
        assert [child.stdout.readline() for _ in range(3)] == ["stop\n", "moves\n", "stop\n"]
        time.sleep(0.2)
        os.kill(child.pid, signal.SIGCONT)
        assert child.stdout.read() == "at SIGTSTP\n"
    assert child.returncode == 0


def test_signal_stops_the_robot_at_once_and_a_second_one_ends_a_stop_that_hangs(
    make_env: Make,
) -> None:
    robot = FakeRobot()
    make_env(robot).reset()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert robot.calls.count("stop") == 2 and robot.stopped_at - begun < 0.2
    robot.stop = lambda: signal.raise_signal(signal.SIGINT) or time.sleep(9)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert time.monotonic() - begun < 5


def test_environment_made_outside_the_main_thread_warns(make_env: Make) -> None:
    with ThreadPoolExecutor() as threads, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        threads.submit(make_env, FakeRobot()).result()
    assert len(caught) == 1 and "must be made in the main thread" in str(caught[0].message)


def test_no_garbage_is_collected_while_the_robot_moves(make_env: Make) -> None:
    env = make_env(FakeRobot())
    tensordict = env.reset()
    for _ in range(2):
        assert not gc.isenabled()
        env.step(STILL(tensordict))
    wait_until(gc.isenabled)


def test_handlers_of_signals_come_back() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    env = fake_env(FakeRobot())
    assert signal.getsignal(signal.SIGQUIT) != before[SIGNALS.index(signal.SIGQUIT)]
    env.close()
    assert [signal.getsignal(number) for number in SIGNALS] == before


WRONG = [
    ({"low": [0.0], "high": [1.0, 2.0]}, "low must be below high"),
    ({"low": [0.0, 3.0]}, r"low must be below high, got \[0.0, 3.0\] and \[1.0, 3.0\]"),
    ({"high": [1.0, float("inf")]}, "high must be a list of finite numbers"),
    ({"action_names": ["one"]}, "action_names must be 2 words, got one"),
    *[({"control_period": value}, "control_period must be a positive") for value in (0.0, "1")],
    *[({"tolerance": value}, "tolerance must be a pos") for value in (NAN[0], 0.0, float("inf"))],
    *[({"most_late": value}, "most_late must be a whole number") for value in (0, 1.5, None)],
    *[({"dim": value}, "dim must be a whole number") for value in (0, -1, 2.0)],
    *[({"low": value}, "low must be a list of finite numbers") for value in ([], None, -1.0, "a")],
    ({"action_names": "ab"}, "action_names must be 2 words, got ab"),
    ({"largest_change": [1.0, 1.0]}, "largest_change needs holding_action"),
    ({"largest_change": [1.0, -1.0]}, "largest_change must be 2 positive numbers"),
]


@pytest.mark.parametrize(("settings", "line"), WRONG)
def test_wrong_settings_are_refused(settings: dict, line: str) -> None:
    with pytest.raises(ValueError, match=line):
        fake_env(FakeRobot(), **settings)


class Waiting(FakeRobot):
    async def stop(self) -> None:
        pass


@pytest.mark.parametrize("robot", [None, FakeRobot, Waiting(), object()])
def test_what_is_no_robot_is_refused(robot: object) -> None:
    with pytest.raises(TypeError, match="robot needs the methods read_state, send, stop, got"):
        fake_env(robot)


def test_holding_action_of_another_length_is_refused(make_env: Make) -> None:
    env = make_env(FakeRobot(), holding_action=lambda state: state[:1])
    with pytest.raises(ValueError, match="holding_action must be 2 finite numbers, got"):
        env.reset()


def test_actions_have_names_and_units(make_env: Make) -> None:
    env = make_env(FakeRobot(), action_names=["hip", "knee"], action_units=["rad", "N·m"])
    assert (env.action_names, env.action_units) == (("hip", "knee"), ("rad", "N·m"))
    plain = make_env(FakeRobot())
    assert (plain.action_names, plain.action_units) == (("0", "1"), ("", ""))
