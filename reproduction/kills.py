"""``kill -9`` of the robot's process or of the learning one, in the midst of rollouts."""

from __future__ import annotations

import multiprocessing
import random
import time
from collections.abc import Iterator
from contextlib import closing
from multiprocessing.process import BaseProcess
from pathlib import Path

from examples.robot_server.client import RemoteRobot
from examples.robot_server.launch import ServerProcess
from examples.robot_server.messages import State, Status
from reproduction.served_robot import DISTURBANCE, learn_hastily
from torch_pmil.tasks.registry import load_experiment

PERIOD = load_experiment("double_pendulum").demonstrations.time_step
PATIENCE = 60.0  # s until the robot moves
TRIALS = 200  # more than there are kills


def killed(out: Path, kills: int) -> list[dict[str, object]]:
    """Kill the server and the learning process in turn, at a random time of a rollout.

    Each learning process makes a whole rollout, and is in the midst of another one when it or its
    robot is killed; the next one goes on from its folder.

    Returns:
        For each kill the victim, seconds until the other side stopped, whether the metrics of all
        rollouts before are still there beside new ones, and whether all is as it must be.
    """
    out.mkdir(parents=True, exist_ok=True)
    times = random.Random(0)
    results: list[dict[str, object]] = []
    before = ""
    with ServerProcess(*DISTURBANCE) as server:
        for number in range(kills):
            victim = ("server", "trainer")[number % 2]
            delay = _kill_once(victim, out, server, times.uniform(0.3, 2.0))
            metrics = (out / "metrics.csv").read_text()
            whole = metrics.startswith(before) and len(metrics) > len(before)
            survived = whole and delay is not None and delay <= 2 * PERIOD
            results.append(
                {
                    "killed": victim,
                    "stopped_after_s": delay,
                    "nothing_lost": whole,
                    "survived": survived,
                }
            )
            before = metrics
    return results


def _kill_once(victim: str, out: Path, server: ServerProcess, moment: float) -> float | None:
    """Kill one side after a second rollout moved for ``moment`` s.

    Returns:
        Seconds until the other side stopped; None if it did not.
    """
    stops, addresses = out / "stops.txt", (server.states, server.commands)
    stops.unlink(missing_ok=True)
    trainer = multiprocessing.get_context("spawn").Process(
        target=learn_hastily, args=(out, addresses, stops, TRIALS)
    )
    trainer.start()
    try:
        with closing(RemoteRobot(4, PERIOD / 2, *addresses)) as watcher:
            _wait_for_second_rollout(watcher)
            time.sleep(moment)
            if victim == "trainer":
                return _kill_trainer(trainer, watcher)
        return _kill_server(server, trainer, stops)
    finally:
        trainer.join(PATIENCE)
        trainer.kill()


def _kill_trainer(trainer: BaseProcess, watcher: RemoteRobot) -> float | None:
    """Kill it; return seconds until the robot stopped by itself."""
    trainer.kill()
    killed_at = time.monotonic()
    for state in _states(watcher, 1.0):
        if state.status == Status.STOPPED:
            return state.stamp - killed_at
    return None


def _kill_server(server: ServerProcess, trainer: BaseProcess, stops: Path) -> float | None:
    """Kill it, and start another one; return seconds until the learning process stopped."""
    server.kill()
    killed_at = time.monotonic()
    trainer.join(PATIENCE)  # no robot answers any more
    server.start()
    after = [float(line) for line in stops.read_text().split() if float(line) > killed_at]
    return after[0] - killed_at if after else None


def _wait_for_second_rollout(watcher: RemoteRobot) -> None:
    rollouts = set[int]()
    for state in _states(watcher, PATIENCE):
        if state.status == Status.MOVING:
            rollouts.add(state.rollout)
        if len(rollouts) == 2:
            return
    raise RuntimeError(f"the robot must move within {PATIENCE} s")


def _states(watcher: RemoteRobot, seconds: float) -> Iterator[State]:
    """States that come in so many seconds."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        state = watcher.next_state(100)
        if state is not None:
            yield state
