"""A simulated robot in a process of its own, which moves in real time.

It sends its state at each time step of the simulation, and stops by itself when no action came
within two control periods, less a tenth for the way. Example:

    python -m examples.robot_server.server --delay 0.005 --jitter 0.002
"""

from __future__ import annotations

import argparse
import pydoc
import signal
import sys
import time

import numpy as np
import zmq

from examples.robot_server.connection import Connection, Disturbance
from examples.robot_server.messages import (
    ACTION,
    COMMANDS,
    PUT_BACK,
    STATES,
    STOP,
    Command,
    State,
    Status,
    pack_state,
    unpack_command,
)
from examples.robot_server.simulated_robot import SimulatedRobot
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.envs.physical.readings import ControlClock

MOST_HEARD = 50  # messages in a time step, so that a flood of them does not hold up the watchdog
COMPLAINTS = 1.0  # s between two lines about wrong messages
PATIENCE = 1.8  # control periods without an action after which the robot stops


class RobotServer:
    """Moves a robot as it is commanded.

    Args:
        env: of the robot.
        disturbance: of the connection, in both directions.
        noise: standard deviations of the sensors, one or D.
        seed: of delays, losses and noise.
    """

    def __init__(
        self, env: MujocoRobotEnv, disturbance: Disturbance, noise: list[float], seed: int
    ) -> None:
        self._generator = np.random.default_rng(seed)
        self._robot, self._noise = SimulatedRobot(env), noise
        self._patience = PATIENCE * env.control_period
        self._actions = Connection[Command](disturbance, self._generator)
        self._states = Connection[bytes](disturbance, self._generator)
        self._status, self._rollout, self._last_action = Status.HELD, 0, 0.0
        self._complained = -COMPLAINTS

    def hear(self, message: bytes, now: float) -> None:
        """Take a message; one that is not a command is reported and dropped."""
        try:
            command = unpack_command(message, self._robot.env.model.nu)
        except ValueError as error:
            if now - self._complained >= COMPLAINTS:
                self._complained = now
                print(error, file=sys.stderr, flush=True)
            return
        if command.kind == ACTION:
            self._actions.put(command, now)
        elif command.kind == STOP and command.rollout == self._rollout:
            self.stop()
        elif command.kind == PUT_BACK and command.rollout != self._rollout:
            self._robot.put_back()
            self._status, self._rollout = Status.HELD, command.rollout

    def step(self, now: float) -> list[bytes]:
        """Move for a time step; return the messages that arrive at the client."""
        for command in self._actions.arrived(now):
            if command.rollout == self._rollout and self._status != Status.STOPPED:
                self._robot.act(command.action)
                self._status, self._last_action = Status.MOVING, now
        if self._status == Status.MOVING and now - self._last_action > self._patience:
            self.stop()
        if self._status != Status.HELD:
            self._robot.advance()
        state = self._robot.state()
        measured = state + np.multiply(self._noise, self._generator.standard_normal(len(state)))
        state = State(self._status, self._rollout, now, measured.tolist())
        self._states.put(pack_state(state), now)
        return [*self._states.arrived(now)]

    def stop(self) -> None:
        """Bring the robot to rest until it is put back."""
        self._robot.stop()
        self._status = Status.STOPPED


def serve(server: RobotServer, timestep: float, states: str, commands: str) -> None:
    """Serve at these addresses, until the process ends."""
    context = zmq.Context()
    sent, heard = context.socket(zmq.PUB), context.socket(zmq.PULL)
    sent.bind(states)
    heard.bind(commands)
    print(f"a robot sends its state at {states} and takes actions at {commands}", flush=True)
    clock = ControlClock(timestep)
    try:
        while True:
            clock.wait()
            for _ in range(MOST_HEARD):
                if not heard.poll(0):
                    break
                server.hear(heard.recv(), time.monotonic())
            for message in server.step(time.monotonic()):
                sent.send(message)
    finally:
        server.stop()
        context.destroy(linger=0)


def main() -> None:
    """Read the command line and serve."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robot", default="torch_pmil.envs.DoublePendulumEnv")
    parser.add_argument("--control-period", type=float, default=0.1, metavar="S")
    parser.add_argument("--delay", type=float, default=0.0, metavar="S", help="of each message")
    parser.add_argument("--jitter", type=float, default=0.0, metavar="S", help="of the delay")
    parser.add_argument("--loss", type=float, default=0.0, help="share of lost messages")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0], help="of the sensors")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--states", default=STATES, metavar="ADDRESS")
    parser.add_argument("--commands", default=COMMANDS, metavar="ADDRESS")
    given = parser.parse_args()
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, lambda number, _: sys.exit(128 + number))  # stops the robot
    robot = pydoc.locate(given.robot)
    if not callable(robot):
        parser.error(f"--robot must name a class of MuJoCo robots, got {given.robot}")
    env = robot(control_period=given.control_period, seed=given.seed)
    disturbance = Disturbance(given.delay, given.jitter, given.loss)
    server = RobotServer(env, disturbance, given.noise, given.seed)
    serve(server, env.model.opt.timestep, given.states, given.commands)


if __name__ == "__main__":
    main()
