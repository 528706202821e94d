"""Time of the loss of several targets, with its policy gradient, beside that of one.

The robot is the BioRob: D = 6 states, F = 3 motors, 9 GP inputs, T = 18 steps, and a policy of 250
basis functions.

The compiled kernels predict one target after the other, or several at once in as many threads as
PyTorch may use. The numbers of targets take turns in one process, with one target by the formulas
in PyTorch; CPU and wall seconds are the least of the repeats; the ratio is that of CPU seconds for
one thread, of wall seconds for more. The data are transitions of exploration, the hyper-parameters
those of ``workloads.make_dynamics``.

Example:
    python -m benchmarks.targets --sizes 60 120 240 --threads 1 2
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from benchmarks.command_line import add_json, source_of, write_summary
from benchmarks.policy_step import timed
from benchmarks.workloads import Evaluate, by_formulas, make_dynamics
from torch_pmil.envs.rollouts import states_of
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.multi_target_loss import MultiTargetKLLoss
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.targets import TargetTask

SEED, STEPS = 0, 20  # steps of a rollout of exploration
COUNTS = (1, 3)  # of targets


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--sizes",
        type=int,
        nargs="+",
        default=[60, 120, 240, 480],
        help="transitions that the model knows",
    )
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--repeats", type=int, default=20)
    add_json(parser, "targets")
    arguments = parser.parse_args()
    if min(*arguments.sizes, *arguments.threads, arguments.repeats) < 1:
        parser.error("sizes, threads and repeats must be at least 1")
    source = source_of("targets")
    rows = [
        row
        for size in arguments.sizes
        for row in measure(size, arguments.threads, arguments.repeats)
    ]
    headline = {f"three_over_one_{row['n']}_threads_{row['threads']}": row["ratio"] for row in rows}
    summary = {**source, "repeats": arguments.repeats, "headline": headline, "rows": rows}
    write_summary(arguments.json, summary)
    for row in rows:
        one, ratio = row["cpu_s"][0], row["ratio"]
        print(
            f"n = {row['n']:4d}, {row['threads']} threads: {one:.4f} CPU s for one target, three "
            f"take {ratio:.2f} times as long; the formulas {row['formulas_cpu_s']:.3f} for one"
        )


def measure(n: int, threads: list[int], repeats: int) -> list[dict[str, object]]:
    """A row for each number of threads."""
    experiment = load_experiment("biorob_targets")
    dynamics, rows = explored(experiment, n), []
    policy = experiment.make_policy(torch.Generator().manual_seed(SEED))
    demonstrated, targets = experiment.demonstrated, experiment.targets
    losses = [
        MultiTargetKLLoss(
            policy, dynamics, experiment.space, demonstrated[:S], targets[:S], experiment.noise_std
        )
        for S in COUNTS
    ]
    for count in threads:
        torch.set_num_threads(count)
        evaluations = [evaluation(loss, experiment) for loss in losses]
        evaluations.append(by_formulas(evaluations[0]))
        times = [[timed(evaluate) for evaluate in evaluations] for _ in range(repeats + 1)][1:]
        cpu, wall = torch.tensor(times, dtype=torch.float64).amin(0).T.tolist()
        ratio = cpu[1] / cpu[0] if count == 1 else wall[1] / wall[0]
        numbers = {"n": n, "threads": count, "targets": COUNTS, "ratio": ratio}
        of_formulas = {"formulas_cpu_s": cpu.pop(), "formulas_wall_s": wall.pop()}
        rows.append({**numbers, "cpu_s": cpu, "wall_s": wall, **of_formulas})
    return rows


def evaluation(loss: MultiTargetKLLoss, experiment: TargetTask) -> Evaluate:
    """A function that computes value and gradient of a loss."""
    parameters = list(loss.parameters())

    def evaluate() -> list[Tensor]:
        value = loss.per_step(experiment.initial).sum()
        return [value, *torch.autograd.grad(value, parameters)]

    return evaluate


def explored(experiment: TargetTask, n: int) -> GPDynamics:
    """The model of n transitions of exploration."""
    env = experiment.robots_at(experiment.targets[:1].expand(-(-n // STEPS), -1), SEED)
    motion = replace(experiment.exploration, rollouts=1).motion(torch.Generator().manual_seed(SEED))
    actor = TensorDictModule(motion, in_keys=["observation"], out_keys=["action"])
    rollout = env.rollout(STEPS, actor)
    states = states_of(rollout)
    inputs = torch.cat([experiment.space.features(states[:, :-1]), rollout["action"]], -1)
    inputs = inputs.flatten(0, 1)[:n]
    changes = states.diff(dim=1).flatten(0, 1)[:n]
    return make_dynamics(inputs, changes)


if __name__ == "__main__":
    main()
