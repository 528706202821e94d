"""All peers of our method, and the experiments that they learn, by their names."""

from __future__ import annotations

from reproduction.baselines.bco import BCO
from reproduction.baselines.bco_with_velocities import BCOWithVelocities
from reproduction.baselines.ensemble_cem import EnsembleCEM
from reproduction.baselines.gaifo import GAIfO
from reproduction.baselines.gp_tracker import GPTracker
from reproduction.baselines.mc_pilco import MCPilco
from reproduction.baselines.peer import Peer
from reproduction.handwriting import written
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

PEERS: dict[str, type[Peer]] = {
    peer.name: peer for peer in (GPTracker, EnsembleCEM, BCO, BCOWithVelocities, GAIfO, MCPilco)
}


def named(name: str) -> Task:
    """The experiment of a name: one of the package, or a shape that the double pendulum writes.

    Example:
        >>> named("double_pendulum").name
        'double_pendulum'
    """
    return written(name) if name[0].isupper() else load_experiment(name)


def trials_until(end: float, experiment: Task) -> int:
    """Trials of which the last one learns from ``end`` seconds of experience, or a little less.

    Example:
        >>> trials_until(50.0, load_experiment("double_pendulum"))
        20
    """
    period, exploration = experiment.demonstrations.time_step, experiment.exploration
    steps = round(end / period) - exploration.rollouts * exploration.steps
    return 1 + max(0, steps // experiment.horizon)
