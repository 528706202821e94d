"""Twenty ways in which learning fails, and whether what a run names first is the right reason.

Each failure is made on purpose: a robot, its recordings, and what a person says to
:class:`~torch_pmil.PMIL`. What is said first counts: the error or warning before the run, else the
first reason after it.

Example:
    python -m benchmarks.failures --json failures.json
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from benchmarks.command_line import add_json, row_of_own_process, source_of, write_summary
from benchmarks.stranger_robots import Derivative, Stranger, StrangerEnv, joint, mass
from torch_pmil import PMIL
from torch_pmil.demonstrations import DemonstrationError, Recordings
from torch_pmil.runs.diagnosis.before_a_run import check

JOBS, SEED, TRIALS = 2, 100, 4
Change = Callable[[list[np.ndarray]], list[np.ndarray]]


@dataclass(frozen=True)
class Failure:
    """A robot that does not learn.

    Args:
        robot: its recordings are ``shown``'s, or its own.
        right: pattern of what should be said first.
        shown: the robot that the recordings are of.
        change: of the recorded values, one array (T + 1, M) for each recording.
        seconds: by which the recorded times are multiplied.
        env: of the robot.
        said: arguments of PMIL beside those of the robot.
        trials: of the run, at most.
    """

    robot: Stranger
    right: str
    shown: Stranger | None = None
    change: Change = list
    seconds: float = 1.0
    env: Callable[[Stranger], Any] = StrangerEnv
    said: dict[str, Any] = field(default_factory=dict)
    trials: int = TRIALS

    def recordings(self) -> Recordings:
        """What the person recorded."""
        recorded = (self.shown or self.robot).recordings()
        values = self.change([each.numpy().copy() for each in recorded.values])
        return replace(
            recorded,
            times=tuple(self.seconds * each for each in recorded.times),
            values=tuple(map(torch.from_numpy, values)),
            in_seconds=False,
        )


class ChangingLoad(StrangerEnv):
    """A joint whose inertia is another one in every motion."""

    def reset(self, **options: Any) -> tuple[np.ndarray, dict]:
        shown = super().reset(**options)
        inertia = float(np.exp(self.np_random.uniform(np.log(0.15), np.log(3.0))))
        self.stranger = replace(self.stranger, derivative=joint(inertia, 3, 0.4))
        return shown


class Bounded(StrangerEnv):
    """A joint that says how far it goes, and goes no farther."""

    stop = 0.5

    def __init__(self, stranger: Stranger) -> None:
        super().__init__(stranger)
        far = np.array([self.stop, 20.0])
        self.observation_space = type(self.observation_space)(-far, far, dtype=np.float64)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        super().step(action)
        if abs(self.true[0]) > self.stop:
            self.true = np.array([np.sign(self.true[0]) * self.stop, 0.0])
        return self._reading(), 0.0, False, False, {}


class Wrapped(StrangerEnv):
    """A joint whose encoder shows one turn."""

    def _reading(self) -> np.ndarray:
        reading = super()._reading()
        return np.array([_within_a_turn(reading[0]), reading[1]])


def _within_a_turn(angle: Any) -> Any:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _lagging(x: np.ndarray, u: np.ndarray) -> list[float]:
    dq, acceleration = joint(0.5, 3, 0.4)(x[:2], x[2:])
    return [dq, acceleration, (u[0] - x[2]) / 0.25]


def _two_ways(values: list[np.ndarray]) -> list[np.ndarray]:
    return [-each if number % 2 else each for number, each in enumerate(values)]


def _one_unlike(values: list[np.ndarray]) -> list[np.ndarray]:
    return [*values[:-1], 0.2 * values[-1]]


def _lost_point(values: list[np.ndarray]) -> list[np.ndarray]:
    values[1][40:43] += 0.8
    return values


def _joint_of(derivative: Derivative | None = None, **changes: Any) -> Stranger:
    derivative = derivative or joint(0.5, 3, 0.4)
    usual = {"limits": (6.0,), "start": (0.0, 0.0), "spread": (0.03, 0.03), "goal": {"q": 1.0}}
    return Stranger(("q", "dq"), derivative, 0.05, 3.0, **{**usual, **changes})


JOINT, ALONE = _joint_of(), {"past": None, "step": 0.05}
RAIL = Stranger(("x", "dx"), mass(2, 1), 0.05, 2.0, (8.0,), (0, 0), (0.01,) * 2, {"x": 0.5})
FAILURES = {
    "hidden lag": Failure(
        _joint_of(_lagging, start=(0.0,) * 3, spread=(0.03, 0.03, 0.0)),
        "robot acts late|state does not show all",
        said=ALONE,
    ),
    "late commands": Failure(_joint_of(delay=4), "robot acts late", said=ALONE),
    "no velocity": Failure(
        replace(_joint_of(joint(0.5, 1, 0.1), spread=(0.03, 0.2)), state=("q",)),
        "state does not show all",
        said=ALONE,
    ),
    "times in milliseconds": Failure(JOINT, "time looks like milliseconds", seconds=1000),
    "ten times too fast": Failure(JOINT, "action at its limit", seconds=0.1),
    "weak motor": Failure(_joint_of(limits=(1.5,), goal={"q": 1.3}), "action at its limit"),
    "angle that wraps": Failure(
        _joint_of(start=(2.6, 0.0), limits=(8.0,), goal={"q": 4.0}),
        "wrap|turn",
        change=lambda values: [_within_a_turn(each) for each in values],
        env=Wrapped,
    ),
    "degrees": Failure(
        JOINT, "q looks like degrees", change=lambda values: [57.3 * each for each in values]
    ),
    "beyond a stop": Failure(JOINT, "q is out of reach", env=Bounded),
    "recordings start elsewhere": Failure(
        JOINT, "demonstrations start elsewhere", shown=_joint_of(start=(0.6, 0.0), goal={"q": 1.6})
    ),
    "motor that is off": Failure(
        _joint_of(lambda x, u: (x[1], -20 * x[1])), "actions .* do not change how the robot moves"
    ),
    "noisy readings": Failure(
        _joint_of(noise=(0.3, 1.5)), "starts vary more than demonstrations.*noisy"
    ),
    "two ways": Failure(JOINT, "contradictory demonstrations", change=_two_ways),
    "one recording unlike the others": Failure(
        JOINT, "one demonstration unlike the others", change=_one_unlike
    ),
    "a lost marker": Failure(JOINT, "jumps in demonstrations", change=_lost_point),
    "millimetres": Failure(
        *(RAIL, "x looks like (thousandths|millimetres)"),
        change=lambda values: [1000 * each for each in values],
    ),
    "too few trials": Failure(
        _joint_of(joint(0.05, 3, 0.02), limits=(3.5,), goal={"q": 2.9}),
        "too few trials|too little experience",
        said={"random_action": 0.1},
        trials=1,
    ),
    "changing load": Failure(JOINT, "model not right", env=ChangingLoad),
    "strict tolerance": Failure(
        replace(JOINT, noise=(0.01, 0.05)), "success criterion", said={"tolerance": {"q": 0.002}}
    ),
    "control period of another robot": Failure(
        JOINT, "control_period|steps_per_action", said={"control_period": 0.12}
    ),
}


def main() -> None:
    """Read the command line, let each robot fail, and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--names", default="", help="of the failures, by commas; all by default")
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    add_json(parser, "failures")
    arguments = parser.parse_args()
    names = arguments.names.split(",") if arguments.names else list(FAILURES)
    if arguments.alone:
        torch.set_num_threads(1)
        print(json.dumps(failed(names[0])))
        return
    source = source_of("failures")
    with ThreadPoolExecutor(JOBS) as pool:
        rows = list(pool.map(_in_own_process, names))
    headline = {"failures": len(rows), "named_first": sum(row["right"] for row in rows)}
    found = {"experiment": "failures", **source, "headline": headline, "rows": rows}
    write_summary(arguments.json, found)
    print(f"{headline['named_first']} of {headline['failures']} named first")


def failed(name: str) -> dict[str, Any]:
    """What is said of a failure, in the order in which a person reads it."""
    begun, failure = time.process_time(), FAILURES[name]
    success, said = None, []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            success, said = _learned(failure)
        except (DemonstrationError, TypeError, ValueError) as error:
            said = [str(error)]
    ours = [str(each.message) for each in warned if each.category in (UserWarning, RuntimeWarning)]
    said = [*(line for line in ours if "torch_pmil" not in line), *said]
    first = said[0] if said else ""
    return {
        "failure": name,
        "right": bool(re.search(failure.right, first)),
        "success": success,
        "said": said,
        "cpu_s": round(time.process_time() - begun, 1),
    }


def _learned(failure: Failure) -> tuple[float, list[str]]:
    """Success of a robot, and the reasons why it did not learn; nothing is left of its run."""
    robot = failure.robot
    said = {"control_period": robot.dt, "state": robot.state, **robot.said, **failure.said}
    learner = PMIL(failure.env(robot), failure.recordings(), **said)
    before = [f"{finding.cause}: {finding.message}" for finding in check(learner.task)]
    with TemporaryDirectory() as folder:
        learner.learn(failure.trials, SEED, Path(folder, "run"))
    reasons = learner.result.summary["diagnosis"]
    after = [f"{reason['cause']}: {reason['message']}" for reason in reasons]
    return learner.evaluate(), before + after


def _in_own_process(name: str) -> dict[str, Any]:
    row = row_of_own_process("failures", "--alone", "--names", name)
    first = row["said"][0] if row["said"] else "nothing"
    print(f"{'right' if row['right'] else 'WRONG':>6} {name}: {first:.150}", file=sys.stderr)
    return row


if __name__ == "__main__":
    main()
