"""The robot of the server as a ``PhysicalRobot``."""

from __future__ import annotations

import math
import secrets
import time
from typing import Any

import zmq

from examples.robot_server.messages import (
    ACTION,
    COMMANDS,
    PUT_BACK,
    STATES,
    STOP,
    Command,
    State,
    Status,
    pack_command,
    unpack_state,
)
from torch_pmil.checks import check_positive
from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.physical_robot import Numbers
from torch_pmil.envs.physical.physical_robot_env import PhysicalRobotEnv
from torch_pmil.envs.robot import RobotEnv

COPIES = 2  # of each action, as one may be lost
ANSWER = 5.0  # s that the robot may take to be put back
AGAIN = 50  # ms between two requests
LINGER = 200  # ms that a stop may take to leave


class RemoteRobot:
    """A robot in another process or on another machine.

    Args:
        dim: entries of the state.
        timeout: age in s beyond which a state is too old, and the robot counts as failed. With half
            a control period, the end of the server is noticed within two control periods.
        states, commands: addresses of the server.
    """

    def __init__(
        self, dim: int, timeout: float, states: str = STATES, commands: str = COMMANDS
    ) -> None:
        check_positive("timeout", timeout)
        self._dim, self._timeout, self._address = dim, timeout, commands
        self._context = zmq.Context()
        self._context.linger = 0
        self._commands = self._context.socket(zmq.PUSH)
        self._commands.immediate = True  # a message waits for no server
        self._commands.connect(commands)
        self._states = self._context.socket(zmq.SUB)
        self._states.conflate = True  # only the newest one
        self._states.subscribe(b"")
        self._states.connect(states)
        self._rollout, self._stamp, self._offset = 0, 0.0, math.inf

    def put_back(self) -> None:
        """Let the server put its robot back at a start; the operator of such a robot.

        Raises:
            RobotError: no robot answers.
        """
        self._rollout, self._offset = secrets.randbits(32), math.inf
        end = time.monotonic() + ANSWER
        while time.monotonic() < end:
            self._request()
            state = self.next_state(AGAIN)
            if state is not None and state.rollout == self._rollout:
                return
        raise RobotError(f"no robot answers at {self._address}")

    def read_state(self) -> tuple[Numbers, float]:
        """Newest state and its time stamp.

        Raises:
            RobotError: none has come for a time, or the robot has stopped.
        """
        state = self._newest()
        if state.rollout != self._rollout:
            raise RobotError("the robot was put back in the midst of a rollout")
        if state.status == Status.STOPPED:
            raise RobotError("the robot stopped by itself, as no action reached it in time")
        return state.entries, state.stamp

    def send(self, action: Numbers) -> None:
        """Send an action. Raises RobotError where the server is gone."""
        command = Command(ACTION, self._rollout, [float(entry) for entry in action])
        try:
            for _ in range(COPIES):
                self._commands.send(pack_command(command), zmq.NOBLOCK)
        except zmq.Again:
            raise RobotError(f"no robot takes actions at {self._address}") from None

    def stop(self) -> None:
        """Stop the robot.

        It uses a connection of its own, since any thread may call it. Its message may overtake
        others, so a stop applies only to its own rollout.
        """
        with self._context.socket(zmq.PUSH) as commands:
            commands.linger = LINGER
            commands.connect(self._address)
            commands.send(pack_command(Command(STOP, self._rollout)))

    def close(self) -> None:
        """Close the connections."""
        self._states.close()
        self._commands.close()
        self._context.term()

    def next_state(self, patience: int) -> State | None:
        """The next state that comes within ``patience`` ms, of whatever rollout."""
        return self._received() if self._states.poll(patience) else None

    def _newest(self) -> State:
        age = self._age(self._stamp)
        while (state := self.next_state(self._left(age))) is not None:
            age = self._age(state.stamp)
            if age <= self._timeout:
                return state
        raise RobotError(f"no state has come from the robot within {self._timeout:g} s")

    def _left(self, age: float) -> int:
        """Milliseconds to wait for a state where the newest one is that old, in s."""
        return math.ceil(1000 * min(max(0.0, self._timeout - age), self._timeout))

    def _received(self) -> State:
        """The message that is there. The fastest message so far gives the offset of the clocks."""
        state = unpack_state(self._states.recv(), self._dim)
        self._stamp = state.stamp
        self._offset = min(self._offset, time.monotonic() - state.stamp)
        return state

    def _age(self, stamp: float) -> float:
        return time.monotonic() - stamp - self._offset

    def _request(self) -> None:
        try:
            self._commands.send(pack_command(Command(PUT_BACK, self._rollout)), zmq.NOBLOCK)
        except zmq.Again:
            time.sleep(AGAIN / 1000)  # it may still come


def served_env(robot: RemoteRobot, like: RobotEnv, **settings: Any) -> PhysicalRobotEnv:
    """The environment of a served robot.

    Args:
        robot: the client.
        like: an environment with the states, actions and control period of the robot. It does not
            move.
        settings: of the environment, besides these.
    """
    limits = like.action_spec.space
    return PhysicalRobotEnv(
        robot,
        dim=like.observation_spec["observation"].shape[-1],
        low=limits.low,
        high=limits.high,
        control_period=like.control_period,
        action_names=like.action_names,
        action_units=like.action_units,
        operator=robot.put_back,
        **settings,
    )
