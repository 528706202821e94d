"""The robot of the server moves as its environment does, and each side notices the other's end."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

pytest.importorskip("zmq", reason="needs the extra remote")

import zmq

from examples.robot_server.client import RemoteRobot, served_env
from examples.robot_server.connection import Connection, Disturbance
from examples.robot_server.launch import ServerProcess
from examples.robot_server.messages import (
    ACTION,
    PUT_BACK,
    STOP,
    Command,
    State,
    Status,
    pack_command,
    unpack_command,
    unpack_state,
)
from examples.robot_server.server import RobotServer, serve
from examples.robot_server.simulated_robot import SimulatedRobot
from tests.helpers.run_script import ROOT
from torch_pmil.envs import DoublePendulumEnv, MujocoRobotEnv
from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.physical_robot_env import PhysicalRobotEnv

pytestmark = pytest.mark.robot

PERIOD = 0.1  # s
TIMESTEP = 0.002  # s


class Rig:
    """A server without sockets, in simulated time."""

    def __init__(self, noise: float = 0.0, **disturbance: float) -> None:
        self.env = DoublePendulumEnv(seed=3)
        self.server = RobotServer(self.env, Disturbance(**disturbance), [noise], seed=0)
        self.tick = 0

    @property
    def now(self) -> float:
        return self.tick * TIMESTEP

    def command(self, command: Command) -> None:
        self.server.hear(pack_command(command), self.now)

    def run(self, steps: int) -> list[State]:
        """States that arrive in so many time steps."""
        states = []
        for _ in range(steps):
            states += self.server.step(self.now)
            self.tick += 1
        return [unpack_state(state, 4) for state in states]


def test_robot_moves_as_its_environment_does_to_the_bit() -> None:
    rig, env = Rig(), DoublePendulumEnv(seed=3)
    env.reset()  # the server has taken the first start
    actions = iter(torch.tensor([[0.5, -0.2], [9.0, 0.3], [0.0, -2.0]], dtype=torch.float64))
    expected = env.rollout(3, lambda tensordict: tensordict.set("action", next(actions)))
    rig.command(Command(PUT_BACK, 7))
    start = rig.run(3)[-1]
    seen = [start.entries]
    for action in expected["action"].tolist():
        rig.command(Command(ACTION, 7, action))
        seen.append(rig.run(round(PERIOD / TIMESTEP))[-1].entries)
    assert start.status == Status.HELD and start.rollout == 7
    assert np.array_equal(seen[0], expected["observation"][0])
    assert np.array_equal(seen[1:], expected["next", "observation"])


def test_robot_is_held_until_the_first_action() -> None:
    rig = Rig()
    rig.command(Command(PUT_BACK, 7))
    states = rig.run(100)
    assert len({state.entries for state in states}) == 1
    rig.command(Command(ACTION, 7, (1.0, 0.0)))
    assert rig.run(2)[-1].status == Status.MOVING


def test_robot_stops_by_itself_before_two_periods_are_over() -> None:
    rig = Rig()
    rig.command(Command(PUT_BACK, 7))
    rig.command(Command(ACTION, 7, (1.0, 0.0)))
    stamps = [state.stamp for state in rig.run(200) if state.status == Status.STOPPED]
    assert 1.7 * PERIOD < stamps[0] < 2 * PERIOD
    rig.command(Command(ACTION, 7, (1.0, 0.0)))
    assert rig.run(1)[0].status == Status.STOPPED
    rig.command(Command(PUT_BACK, 8))
    assert rig.run(1)[0].status == Status.HELD


def test_commands_of_another_rollout_and_a_second_request_to_be_put_back_do_nothing() -> None:
    rig = Rig()
    rig.command(Command(PUT_BACK, 7))
    rig.command(Command(ACTION, 6, (1.0, 0.0)))
    before = rig.run(10)[-1]
    assert before.status == Status.HELD
    rig.command(Command(PUT_BACK, 7))
    assert rig.run(1)[0].entries == before.entries
    rig.command(Command(STOP, 6))
    assert rig.run(1)[0].status == Status.HELD
    rig.command(Command(STOP, 7))
    assert rig.run(1)[0].status == Status.STOPPED


def test_actions_take_effect_and_states_arrive_after_the_delay() -> None:
    rig = Rig(delay=0.02, jitter=0.004)
    rig.command(Command(PUT_BACK, 7))
    rig.command(Command(ACTION, 7, (1.0, 0.0)))
    arrivals = [(rig.now, state) for _ in range(60) for state in rig.run(1)]
    moved = next(state.stamp for _, state in arrivals if state.status == Status.MOVING)
    ages = [now - state.stamp for now, state in arrivals]
    assert 0.016 <= moved <= 0.024 + TIMESTEP
    assert min(ages) >= 0.016 and max(ages) <= 0.024 + TIMESTEP + 1e-9


def test_noise_is_of_the_sensors_alone() -> None:
    rig = Rig(noise=0.1)
    rig.command(Command(PUT_BACK, 7))
    shown = np.array([state.entries for state in rig.run(4000)])
    assert np.allclose(shown.std(0), 0.1, rtol=4 / np.sqrt(2 * 4000))


def test_connection_keeps_the_order_and_loses_its_share() -> None:
    way = Connection(Disturbance(0.01, 0.01, 0.25), np.random.default_rng(0))
    for number in range(10_000):
        way.put(number, now=1e-3 * number)
    arrived = [*way.arrived(now=20.0)]
    assert arrived == sorted(arrived)
    assert len(arrived) == pytest.approx(7500, abs=4 * np.sqrt(10_000 * 0.25 * 0.75))


@pytest.mark.parametrize(
    "message", [b"", b"A", b"X" + bytes(4), b"S" + bytes(5), b"A" + bytes(12), bytes(10_000)]
)
def test_message_of_another_size_or_kind_is_told_and_forgotten(
    message: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = Rig()
    before = rig.run(1)[0]
    rig.server.hear(message, rig.now)
    assert "must" in capsys.readouterr().err
    assert rig.run(1)[0].entries == before.entries
    with pytest.raises(ValueError, match="must"):
        unpack_command(message, num_actions=2)
    with pytest.raises(ValueError, match="a message must have 45 bytes"):
        unpack_state(message, dim=4)


@pytest.mark.parametrize("action", [(np.nan, 0.0), (0.0, np.inf)])
def test_action_that_is_not_finite_is_refused(
    action: tuple, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = Rig()
    rig.command(Command(PUT_BACK, 7))
    rig.command(Command(ACTION, 7, action))
    rig.command(Command(ACTION, 7, action))
    assert capsys.readouterr().err.count("an action must be finite numbers") == 1
    assert rig.run(2)[-1].status == Status.HELD


def test_action_beyond_the_range_is_the_largest_one() -> None:
    moved = []
    for torque in (1e300, DoublePendulumEnv().action_spec.space.high[0].item()):
        rig = Rig()
        rig.command(Command(PUT_BACK, 7))
        rig.command(Command(ACTION, 7, (torque, 0.0)))
        moved.append(rig.run(40)[-1].entries)
    assert moved[0] == moved[1]


class Flooded(RobotServer):
    """To which a message comes whenever it looks, until it has made 200 time steps."""

    def step(self, now: float) -> list[bytes]:
        self.now, self.steps = now, getattr(self, "steps", 0) + 1
        if self.steps == 200:
            raise KeyboardInterrupt
        return super().step(now)


def test_robot_stops_by_itself_while_its_socket_is_flooded_and_at_the_end(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(zmq.Socket, "poll", lambda *_: 1)
    messages = iter([pack_command(Command(PUT_BACK, 7)), pack_command(Command(ACTION, 7, (1, 0)))])
    monkeypatch.setattr(zmq.Socket, "recv", lambda *_: next(messages, b"noise"))
    server = Flooded(DoublePendulumEnv(seed=3), Disturbance(), [0.0], seed=0)
    stops, stop = [], server.stop
    monkeypatch.setattr(server, "stop", lambda: stops.append(time.monotonic()) or stop())
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        serve(server, TIMESTEP, f"ipc://{tmp_path}/s", f"ipc://{tmp_path}/c")
    assert len(stops) == 2 and stops[0] - begun > 1.7 * PERIOD


SERVO = """
<mujoco><option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body><joint name="q" axis="0 1 0" damping="1"/>
    <geom size="0.1" mass="1" pos="0.5 0 0"/></body></worldbody>
  <actuator><position joint="q" kp="100" kv="5" ctrlrange="-3 3" ctrllimited="true"/></actuator>
</mujoco>
"""


def test_servo_that_is_stopped_holds_where_it_is() -> None:
    model = mujoco.MjModel.from_xml_string(SERVO)
    env = MujocoRobotEnv(
        model, ["q"], initial_mean=[1.0, 0.0], initial_std=[0.0, 0.0], torque_limit=3.0
    )
    robot = SimulatedRobot(env)
    robot.act([2.0])
    for _ in range(50):
        robot.advance()
    stopped_at = robot.state()[0]
    robot.stop()
    for _ in range(2000):
        robot.advance()
    assert 1.01 < stopped_at < 1.99
    assert robot.state() == pytest.approx([stopped_at, 0.0], abs=1e-6)


@contextmanager
def remote(server: ServerProcess) -> Iterator[PhysicalRobotEnv]:
    """The environment of a served double pendulum."""
    with closing(RemoteRobot(4, PERIOD / 2, server.states, server.commands)) as robot:
        env = served_env(robot, DoublePendulumEnv())
        yield env
        env.close()


def still(tensordict: TensorDictBase) -> TensorDictBase:
    return tensordict.set("action", torch.zeros(2, dtype=torch.float64))


@pytest.mark.slow
def test_rollout_through_the_server_is_that_of_the_environment() -> None:
    """Up to the time by which actions come late."""
    expected = DoublePendulumEnv(seed=0)
    expected.reset()
    with ServerProcess() as server, remote(server) as env:
        seen = env.rollout(10, still)
    states = expected.rollout(10, still)["next", "observation"]
    assert seen["next", "measured"].all()
    assert (seen["next", "observation"] - states).abs().max() < 0.05


@pytest.mark.slow
def test_end_of_the_server_is_noticed_within_two_periods() -> None:
    died = []

    def kill(tensordict: TensorDictBase) -> TensorDictBase:
        if tensordict["time"] - begun > 0.3 and not died:
            server.kill()
            died.append(time.monotonic())
        return still(tensordict)

    with ServerProcess() as server, remote(server) as env:
        begun = time.monotonic() + PERIOD
        rollout = env.rollout(30, kill)
        assert time.monotonic() - died[0] < 2 * PERIOD
        assert not rollout["next", "measured"][-1] and rollout["next", "measured"][:3].all()
        assert "robot" in env.cut_short
        with pytest.raises(RobotError, match="no robot answers at ipc"):
            env.reset()


CLIENT = """
import sys, torch
sys.path.insert(0, {root!r})
from examples.robot_server.client import RemoteRobot, served_env
from torch_pmil.envs import DoublePendulumEnv
env = served_env(RemoteRobot(4, 0.05, *{addresses!r}), DoublePendulumEnv())
def still(tensordict):
    print("moves", flush=True)
    return tensordict.set("action", torch.zeros(2, dtype=torch.float64))
env.rollout(100, still)
"""


@pytest.mark.slow
@pytest.mark.parametrize("end", [subprocess.Popen.kill, subprocess.Popen.terminate])
def test_robot_stops_within_two_periods_when_the_client_ends(
    end: Callable[[subprocess.Popen], None],
) -> None:
    with ServerProcess() as server:
        addresses = [server.states, server.commands]
        program = CLIENT.format(root=str(ROOT), addresses=addresses)
        client = subprocess.Popen(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
        )
        for _ in range(5):
            assert client.stdout.readline() == "moves\n"
        with closing(RemoteRobot(4, PERIOD / 2, *addresses)) as watcher:
            end(client)
            ended = time.monotonic()
            client.communicate()
            while (state := watcher.next_state(1000)).status == Status.MOVING:
                assert state.stamp - ended < 2 * PERIOD
        assert state.status == Status.STOPPED
