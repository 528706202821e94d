"""How far a run has come: its trials, and the policies that ran."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tensordict import TensorDictBase

from torch_pmil.trainer.collector import RobotActor
from torch_pmil.trainer.trials import Candidate, Trial


class RunState:
    """The trainer's own state, with the state methods that a checkpoint needs.

    Args:
        actor: of the robot; it explores until the first search.
        robots: number of robots that move at once.

    Attributes:
        rollouts: number of rollouts so far.
        explored: transitions of the exploration so far.
        trials: completed trials.
        pending: the trial whose policy runs next, or None.
        candidates: the policies that ran.
        begun, begun_cpu: wall and CPU time at which the run began, without interruptions.
    """

    def __init__(self, actor: RobotActor, robots: int) -> None:
        self.actor, self.robots = actor, robots
        self.rollouts, self.explored = 0, 0
        self.trials: list[Trial] = []
        self.pending: Trial | None = None
        self.candidates: list[Candidate] = []
        self.begun, self.begun_cpu = time.perf_counter(), time.process_time()

    @property
    def seconds(self) -> float:
        """Wall time since the run began, without interruptions, s."""
        return time.perf_counter() - self.begun

    @property
    def cpu_seconds(self) -> float:
        """CPU time of this process since the run began, without interruptions, s."""
        return time.process_time() - self.begun_cpu

    def state_dict(self) -> dict[str, object]:
        """What a checkpoint holds of it."""
        return {
            "exploring": self.actor.exploring,
            "rollouts": self.rollouts,
            "explored": self.explored,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "trials": [asdict(trial) for trial in self.trials],
            "pending": None if self.pending is None else asdict(self.pending),
            "candidates": [vars(candidate) for candidate in self.candidates],
        }

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restore the state that :meth:`state_dict` returned."""
        self.actor.exploring, pending = state_dict["exploring"], state_dict["pending"]
        self.rollouts, self.explored = state_dict["rollouts"], state_dict["explored"]
        self.begun = time.perf_counter() - state_dict["seconds"]
        self.begun_cpu = time.process_time() - state_dict["cpu_seconds"]
        self.trials = [Trial(**trial) for trial in state_dict["trials"]]
        self.pending = None if pending is None else Trial(**pending)
        self.candidates = [Candidate(**candidate) for candidate in state_dict["candidates"]]

    def rollout_of(self, candidate: Candidate, transitions: TensorDictBase) -> TensorDictBase:
        """The rollout (robots, steps) of a policy, out of all transitions of the run."""
        steps = [trial.steps for trial in self.trials[: candidate.trial]]
        begin = self.explored + self.robots * sum(steps[:-1])
        own = transitions[begin : begin + self.robots * steps[-1]]
        return own.reshape(self.robots, steps[-1])
