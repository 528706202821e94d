"""Ours learned anew beside its peers as they were recorded, on the same seeds.

The peers take most of the hours of :mod:`reproduction.peers`, and change less often than ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from reproduction.figure7 import GOAL, OURS, SEEDS, success_figure, success_numbers
from reproduction.peers import (
    ALONE,
    PEERS_STUDY,
    QUICK_END,
    QUICK_SEEDS,
    TASKS,
    Method,
    ahead,
)
from reproduction.reproduction import PaperExperiment, Results, Run
from torch_pmil.files import read_json
from torch_pmil.runs.summaries import SuccessCurve, read_summary, success_over_experience

RECORDED = Path("results/paper", PEERS_STUDY.name, "summary.json")
# a run of the pendubot takes several minutes
ANEW = {name: methods for name, methods in TASKS.items() if name != "pendubot"}
TIMES = (10.0, 12.5, 25.0)  # s of experience
END = 50.0
DRAWN, OTHERS = "double_pendulum", 5  # the task of the figure, and its curves beside ours


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ours on each task with each seed."""
    seeds, end = (QUICK_SEEDS, QUICK_END) if quick else (SEEDS, END)
    return [ALONE.run(root, task, seed, end) for task in ANEW for seed in seeds]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Experience to 95 % of ours and of the quickest peer, and by how much ours is ahead."""
    recorded, seeds = read_json(RECORDED), len(QUICK_SEEDS if quick else SEEDS)
    headline: dict[str, float | None] = {"seeds": seeds}
    figures: dict[str, Figure] = {}
    details: dict[str, object] = {"peers_recorded": recorded["date"]}
    for number, (task, methods) in enumerate(ANEW.items()):
        own = folders[number * seeds : (number + 1) * seeds]
        ours = success_over_experience([read_summary(folder) for folder in own])
        peers = recorded_curves(recorded[task]["curves"], methods)
        headline |= _numbers(task, ours, peers)
        if task == DRAWN:
            figures[task] = success_figure({OURS: ours, **dict(list(peers.items())[:OTHERS])})
        details[task] = {
            "curves": success_numbers({OURS: ours}),
            "ahead": {label: ahead(ours, peer, TIMES) for label, peer in peers.items()},
        }
    return Results(headline, figures, details)


def recorded_curves(
    curves: Mapping[str, Mapping[str, list]], methods: Sequence[Method]
) -> dict[str, SuccessCurve]:
    """The recorded curves of the peers of a task that had no more experience than ours."""
    labels = [method.label for method in methods if method.peer and method.factor == 1]
    return {
        label: SuccessCurve(**{key: np.array(values) for key, values in curves[label].items()})
        for label in labels
    }


def _numbers(
    task: str, ours: SuccessCurve, peers: Mapping[str, SuccessCurve]
) -> dict[str, float | None]:
    reached = [peer.experience_to(GOAL) for peer in peers.values()]
    quickest = min((seconds for seconds in reached if seconds is not None), default=None)
    return {
        f"experience_to_95_{task}_ours": ours.experience_to(GOAL),
        f"experience_to_95_{task}_quickest_peer": quickest,
        **{f"success_{time:g}s_{task}_ours": ours.at(time) for time in TIMES},
    }


RECORDED_PEERS = PaperExperiment(
    "recorded_peers", "ours anew beside its peers as they were recorded", needed_runs, results
)
