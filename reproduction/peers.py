"""Ours beside its peers: learners from states alone, on the same robots with the same experience.

All see the same exploration, starts and demonstrations, act at the same rate, and are measured from
the same fresh starts. What is compared is the success rate with so many seconds of experience. Each
task is a study of its own, since all of them take hours.

Settings of the peers are those of ``results/paper/peers/tuning_PEER_TASK.json``, where there is
one, and else their own. The tracker plans on our model, so it is tuned anew when that changes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from reproduction.baselines.ensemble_cem import LARGE_PLANNER
from reproduction.baselines.known_peers import PEERS, named, trials_until
from reproduction.baselines.peer import Peer
from reproduction.baselines.peer_run import peer_run
from reproduction.figure7 import GOAL, OURS, SEEDS, success_curves, success_results
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.soak.comparison import paired
from torch_pmil.runs.summaries import SuccessCurve
from torch_pmil.tasks.task import Task

TIMES = (12.5, 25.0, 50.0)  # s of experience
QUICK_SEEDS, QUICK_END = range(2), 5.0


@dataclass(frozen=True)
class Method:
    """A learner of a task.

    Args:
        name: in the numbers; that of ours begins with "ours".
        label: in the figures.
        peer: the learner, None for ours.
        settings: of a peer, other than its own.
        factor: rollouts of a peer in place of each one of ours.
    """

    name: str
    label: str
    peer: type[Peer] | None = None
    settings: Mapping[str, object] = field(default_factory=dict)
    factor: int = 1

    def run(self, root: Path, experiment: Task, seed: int, end: float) -> Run:
        """Its run of an experiment, over ``end`` seconds of our experience at most.

        Example:
            >>> str(ALONE.run(Path("runs"), named("double_pendulum"), 3, 50.0).out)
            'runs/peers/double_pendulum/seed_3'
        """
        trials = trials_until(end, experiment)
        if self.peer is not None:
            return peer_run(root, experiment, self.peer, seed, trials, self.factor, self.settings)
        return learning_run(root / "peers", experiment, seed, trials)


def peer(name: str, factor: int = 1, **settings: object) -> Method:
    """A peer, with settings other than its own, or with so many times our experience.

    Example:
        >>> peer("bco", factor=100).name, peer("bco", factor=100).label
        ('bco_100x', 'BCO, 100 times')
    """
    learner = PEERS[name]
    label = learner.label
    if factor > 1:
        name, label = f"{name}_{factor}x", f"{label}, {factor} times"
    return Method(name, label, learner, settings, factor)


ALONE = Method("ours", OURS)


@dataclass(frozen=True)
class Comparison:
    """Ours beside peers on one task.

    Args:
        task: its name.
        peers: those that learn it.
    """

    task: str
    peers: tuple[Method, ...]

    @property
    def methods(self) -> tuple[Method, ...]:
        """Ours, then the peers."""
        return (ALONE, *self.peers)

    def needed_runs(self, root: Path, quick: bool) -> list[Run]:
        """Those by each method, of each seed."""
        seeds, end = (QUICK_SEEDS, QUICK_END) if quick else (SEEDS, TIMES[-1])
        experiment = named(self.task)
        return [
            method.run(root, experiment, seed, end) for method in self.methods for seed in seeds
        ]

    def results(self, folders: Sequence[Path], quick: bool) -> Results:
        """Success over experience of each method, and by how much ours is ahead."""
        curves = success_curves(folders, [method.label for method in self.methods])
        headline: dict[str, float | None] = {"seeds": len(folders) // len(self.methods)}
        headline |= {
            f"{quantity}_{method.name}": value
            for method in self.methods
            for quantity, value in _numbers(method, curves[method.label]).items()
        }
        leads = {
            other.label: _ahead(curves[OURS], curves[other.label], other.factor)
            for other in self.peers
        }
        found = success_results(curves, headline, "success")
        return replace(found, details={**found.details, "ahead": leads})


PEERS_OF: dict[str, tuple[Method, ...]] = {  # by the task
    "double_pendulum": (
        peer("gp_tracker", action_weight=10.0),
        peer("mc_pilco", scale=30.0),
        peer("ensemble_cem"),
        peer("bco_with_velocities", noise=0.3),
        peer("bco"),
        peer("gaifo"),
    ),
    "double_pendulum_servo": (
        peer("gp_tracker", action_weight=100.0),
        peer("mc_pilco"),
        peer("ensemble_cem", **LARGE_PLANNER),
        peer("bco_with_velocities", noise=0.03),
        peer("bco", noise=0.03),
        peer("gaifo"),
    ),
    "Sshape": (
        peer("gp_tracker", action_weight=1.0),
        peer("mc_pilco", scale=1000.0),
        peer("ensemble_cem", **LARGE_PLANNER),
        peer("bco", noise=0.03),
        peer("gaifo"),
    ),
    "biorob": (
        peer("gp_tracker", action_weight=1.0),
        peer("mc_pilco"),
        peer("ensemble_cem", **LARGE_PLANNER),
        peer("bco", noise=0.03),
        peer("gaifo", penalty=10.0),
    ),
    "pendubot": (
        peer("gp_tracker", action_weight=100.0),
        peer("ensemble_cem"),
        peer("bco", noise=0.03),
        peer("gaifo"),
    ),
    "cart_pole": (
        peer("gp_tracker", action_weight=100.0),
        peer("mc_pilco", most_slope=None),
        peer("bco", noise=0.3),
    ),
}
COMPARISONS = {task: Comparison(task, peers) for task, peers in PEERS_OF.items()} | {
    "100_times": Comparison(
        "double_pendulum",
        (
            peer("bco_with_velocities", factor=100, noise=0.3),
            peer("bco", factor=100),
            peer("gaifo", factor=100),
        ),
    )
}


def _numbers(method: Method, curve: SuccessCurve) -> dict[str, float | None]:
    """Success at ``TIMES`` with its 95 % interval, and the experience to 95 %.

    Of a method with more experience they are at as many times ``TIMES``.
    """
    found: dict[str, float | None] = {"experience_to_95": curve.experience_to(GOAL)}
    for time in TIMES:
        column = curve.column(method.factor * time)
        found[f"success_{time:g}s"] = curve.mean[column].item()
        found[f"lower_{time:g}s"] = curve.lower[column].item()
        found[f"upper_{time:g}s"] = curve.upper[column].item()
    return found


def _ahead(ours: SuccessCurve, other: SuccessCurve, factor: int) -> dict[str, object]:
    """Success of ours at ``TIMES`` less that of another on the same seeds, with its interval.

    The other had so many times our experience.
    """

    def pairs(time: float) -> list[tuple[float, float]]:
        rates = ours.rates[:, ours.column(time)], other.rates[:, other.column(factor * time)]
        return list(zip(*(rate.tolist() for rate in rates), strict=True))

    return {f"{time:g}s": paired(pairs(time)) for time in TIMES}


PEERS_STUDIES = tuple(
    PaperExperiment(
        f"peers_{name}",
        f"ours beside other learners from states alone: {name.replace('_', ' ')}",
        comparison.needed_runs,
        comparison.results,
    )
    for name, comparison in COMPARISONS.items()
)
