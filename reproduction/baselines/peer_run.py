"""A run of a peer of our method, with the experience, starts and measure of our runs."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor

from reproduction.baselines.peer import Peer
from reproduction.reproduction import Run
from torch_pmil.checks import check_whole
from torch_pmil.control.exploration import Motion
from torch_pmil.envs.robot import RobotEnv
from torch_pmil.envs.rollouts import as_executed
from torch_pmil.files import write_json
from torch_pmil.runs.own_files import own
from torch_pmil.runs.run_folder import clear_folder, provenance, write_metrics
from torch_pmil.seeds import Stream, generator_of
from torch_pmil.tasks.task import MEASURED_STARTS, Task
from torch_pmil.trainer.ending import LIMIT
from torch_pmil.trainer.trials import Measurement, own_error, success_rate

# actions (*batch, F) at a step in states (*batch, D)
Controller = Callable[[int, Tensor], Tensor]


def peer_run(
    root: Path,
    experiment: Task,
    peer_class: type[Peer],
    seed: int,
    trials: int,
    factor: int = 1,
    settings: Mapping[str, object] | None = None,
) -> Run:
    """A run of a peer, in its folder below ``root``.

    A run that was stopped begins anew.

    Args:
        root: folder of runs.
        experiment: what to learn.
        peer_class: the peer.
        seed: of the robot's starts, the exploration and the peer.
        trials: number of trials.
        factor: rollouts in place of each one of ours, for as many times our experience.
        settings: other arguments of the peer than its own.

    Example:
        >>> from reproduction.baselines.bco import BCO
        >>> from torch_pmil.tasks.registry import load_experiment
        >>> experiment = load_experiment("double_pendulum")
        >>> str(peer_run(Path("runs"), experiment, BCO, seed=3, trials=20).out)
        'runs/double_pendulum_bco/seed_3'
    """
    check_whole("seed", seed, least=0)
    check_whole("trials", trials, least=1)
    check_whole("factor", factor, least=1)
    name = f"{experiment.name}_{peer_class.name}" + (f"_{factor}x" if factor > 1 else "")
    learn = partial(
        _learn,
        experiment=experiment,
        peer_class=peer_class,
        seed=seed,
        trials=trials,
        factor=factor,
        settings=settings or {},
    )
    return Run(root / name / f"seed_{seed}", learn)


def _learn(
    out: Path,
    command: str,
    experiment: Task,
    peer_class: type[Peer],
    seed: int,
    trials: int,
    factor: int,
    settings: Mapping[str, object],
) -> None:
    begun, source = (time.perf_counter(), time.process_time()), provenance(command)
    out.mkdir(parents=True, exist_ok=True)
    clear_folder(out, overwrite=True)
    practice = Practice(experiment, peer_class(experiment, seed, **settings), seed, factor)
    rows, confirmations = list[Measurement](), peer_class.confirmations
    write_metrics(own(out, "metrics.csv"), Measurement, rows)
    while len(rows) < trials and not _confirmed(rows, confirmations):
        rows.append(practice.trial(len(rows) + 1))
        write_metrics(own(out, "metrics.csv"), Measurement, rows)
    confirmed = _confirmed(rows, confirmations)
    if not confirmed:
        practice.peer.fit()
    summary = {
        "experiment": out.parent.name,
        "seed": seed,
        **source,
        "settings": {
            "trials": trials,
            "factor": factor,
            "confirmations": confirmations,
            **settings,
        },
        "wall_seconds": round(time.perf_counter() - begun[0], 2),
        "cpu_seconds": round(time.process_time() - begun[1], 2),
        "stop_reason": "the own rollouts succeeded" if confirmed else LIMIT,
        "experience_s": practice.experience_s,
        "saved_trial": len(rows),
        "saved_success_rate": practice.measured(),
        "saved_n_eval": MEASURED_STARTS,
        "trials": [_plain(row) for row in rows],
    }
    write_json(own(out, "summary.json"), summary)


def _confirmed(rows: Sequence[Measurement], confirmations: int | None) -> bool:
    """Whether so many of the last own rollouts have succeeded, one after the other."""
    if confirmations is None or len(rows) < confirmations:
        return False
    return all(row.own_success for row in rows[-confirmations:])


class Practice:
    """A peer at its robot: it explores, learns, is measured, and moves by what it learned.

    The first experience is the very exploration that our learner gets with that seed, and the
    starts are the same too, of the robot and of those on which policies are measured.

    Args:
        experiment: what to learn.
        peer: the learner.
        seed: of the robot's starts and the exploration.
        factor: rollouts in place of each one of ours.
    """

    def __init__(self, experiment: Task, peer: Peer, seed: int, factor: int) -> None:
        self.experiment, self.peer, self.factor = experiment, peer, factor
        self.robot = experiment.robot(seed)
        self.fresh = experiment.robots(MEASURED_STARTS, seed + Stream.MEASURED_STARTS)
        generator = generator_of(Stream.MOTION, seed)
        motion, exploration = experiment.exploration.motion(generator), experiment.exploration
        # our learner's collector, too, tries out robot and motion when it is made
        motion(self.robot.reset()["observation"])
        for _ in range(exploration.rollouts * factor):
            motion.begin()
            peer.add(rollout(self.robot, _without_step(motion), exploration.steps))

    @property
    def experience_s(self) -> float:
        """Seconds of the robot's motion so far."""
        steps = sum(len(rollout) for rollout in self.peer.rollouts)
        return round(steps * self.experiment.demonstrations.time_step, 6)

    def trial(self, number: int) -> Measurement:
        """Learn from all experience, measure from fresh starts, and gain experience on the robot.

        The error of several own rollouts is the largest one.
        """
        experience_s = self.experience_s
        self.peer.fit()
        rate = self.measured()
        error = max(self._own_rollout() for _ in range(self.factor))
        success = error <= self.experiment.tolerance
        return Measurement(number, experience_s, rate, MEASURED_STARTS, error, success)

    def measured(self) -> float:
        """Success rate from fresh starts, which are no experience."""
        rollouts = rollout(self.fresh, self.peer.act, self.experiment.horizon)
        return success_rate(self.experiment.error(rollouts), self.experiment.tolerance)

    def _own_rollout(self) -> float:
        """Add an own rollout to the experience, and return its error, infinite if cut short."""
        horizon = self.experiment.horizon
        own = rollout(self.robot, self.peer.explore, horizon)
        self.peer.add(own)
        return own_error(own, self.robot.cut_short, horizon, self.experiment.error)


@torch.no_grad()
def rollout(env: RobotEnv, controller: Controller, steps: int) -> TensorDictBase:
    """Rollouts (*robots, up to ``steps``) of a controller from fresh starts, as executed."""
    time = itertools.count()

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("action", controller(next(time), tensordict["observation"]))

    return as_executed(env.rollout(steps, act))


def _without_step(motion: Motion) -> Controller:
    return lambda step, states: motion(states)


def _plain(row: Measurement) -> dict[str, object]:
    """A row as JSON has it: the error of a rollout that was cut short is null."""
    values = asdict(row)
    return values if row.own_error < float("inf") else values | {"own_error": None}
