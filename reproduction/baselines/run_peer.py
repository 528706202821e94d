"""Learn an experiment with a peer of our method.

Example:
    python -m reproduction.baselines.run_peer bco double_pendulum --seed 100

The run lies below runs/SOURCES, as those of the studies.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

import torch

from reproduction.baselines.known_peers import PEERS, named
from reproduction.baselines.peer_run import peer_run
from reproduction.reproduction import root_of_runs
from torch_pmil.runs.summaries import read_summary


def main() -> None:
    """Learn, and print the success rates."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("peer", choices=PEERS)
    parser.add_argument("experiment", help="its name, or a shape of handwriting")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--factor", type=int, default=1, help="times our experience")
    parser.add_argument("--root", type=Path, default=root_of_runs(), help="folder of runs")
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # the matrices are small: more threads wait for each other
    experiment, peer = named(arguments.experiment), PEERS[arguments.peer]
    seed, trials, factor = arguments.seed, arguments.trials, arguments.factor
    run = peer_run(arguments.root, experiment, peer, seed, trials, factor)
    run.learn(
        run.out, shlex.join(["python", "-m", "reproduction.baselines.run_peer", *sys.argv[1:]])
    )
    summary = read_summary(run.out)
    for trial in summary["trials"]:
        print(f"{trial['experience_s']:8.1f} s: {trial['success_rate']:.0%}")
    print(
        f"{summary['experience_s']:8.1f} s: {summary['saved_success_rate']:.0%}\n"
        f"{summary['cpu_seconds']:.0f} s of computing, see {run.out}"
    )


if __name__ == "__main__":
    main()
