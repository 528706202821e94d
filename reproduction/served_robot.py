"""The double pendulum of the robot server, and learning on it without another simulator."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from examples.robot_server.client import RemoteRobot, served_env
from torch_pmil.envs import DoublePendulumEnv, PhysicalRobotEnv
from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.robot import RobotEnv
from torch_pmil.runs.training import train
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

DISTURBANCE = ("--delay", "0.005", "--jitter", "0.002")  # s
Addresses = tuple[str, str]  # of states and commands


class TimedRobot(RemoteRobot):
    """A client that appends to a file when its robot was asked to stop, in s of the system.

    Args:
        stops: the file.
        settings: of the client.
    """

    def __init__(self, stops: Path, *settings: Any) -> None:
        super().__init__(*settings)
        self._stops = stops

    def stop(self) -> None:
        """Stop the robot."""
        super().stop()
        with self._stops.open("a") as file:
            file.write(f"{time.monotonic()}\n")


def connected(
    addresses: Addresses, like: RobotEnv, client: Callable[..., RemoteRobot] = RemoteRobot
) -> PhysicalRobotEnv:
    """The environment of a served robot like that one."""
    dim = like.observation_spec["observation"].shape[-1]
    return served_env(client(dim, like.control_period / 2, *addresses), like)


def served_experiment(addresses: Addresses, stops: Path | None = None) -> Task:
    """The double pendulum on the server; the operator is the server, and nothing else measures."""
    return replace(
        load_experiment("double_pendulum"),
        name="robot_server",
        make_env=partial(_env, addresses, stops),
        evaluated=False,
        draws=False,
    )


def _env(addresses: Addresses, stops: Path | None, seed: int) -> PhysicalRobotEnv:
    """The starts are the server's: it has the seed."""
    client = RemoteRobot if stops is None else partial(TimedRobot, stops)
    return connected(addresses, DoublePendulumEnv(), client)


def learn_hastily(out: Path, addresses: Addresses, stops: Path, trials: int) -> None:
    """Learn with a search that takes no time, until the robot cannot be reached.

    No number of successes ends it.
    """
    few = {f"search.{kind}_iterations": 1 for kind in ("mean", "stage", "final")}
    few |= {"search.sample_steps": 0, "confirmations": trials}
    hasty = served_experiment(addresses, stops).with_settings(**few)
    with suppress(RobotError):
        train(hasty, 0, trials, out, "kills", progress_bar=False, resume=True)
