"""What past states reveal about robots that act at once and robots that act late.

Each robot learns; the evidence in its own rollouts is computed as in the diagnosis of a run
(:mod:`torch_pmil.model.past_evidence`). The threshold of the diagnosis was chosen with
these seeds, so no reported result uses them.

Example:
    python -m benchmarks.past_evidence
"""

from __future__ import annotations

import argparse

import joblib
import torch

from benchmarks.command_line import add_json, source_of, write_summary
from reproduction.delay_calibration import with_delay
from torch_pmil.runs.diagnosis.after_a_run import evidence_in
from torch_pmil.runs.training import make_trainer
from torch_pmil.tasks.registry import load_experiment

SEEDS, TRIALS = (100, 101), 12
AT_ONCE = ("double_pendulum", "double_pendulum_servo", "biorob")
LATE = {"50_ms_late": 0.05, "100_ms_late": 0.1}  # s


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_json(parser, "past_evidence")
    arguments = parser.parse_args()
    source = source_of("past_evidence")
    measured = joblib.Parallel(n_jobs=joblib.cpu_count())(
        joblib.delayed(measure)(robot, seed) for robot in (*AT_ONCE, *LATE) for seed in SEEDS
    )
    at_once = [row for row in measured if row["robot"] not in LATE]
    headline = {
        "most_nats_at_once": max(max(row["of_action"], row["of_state"]) for row in at_once),
        **{
            f"least_nats_{name}": min(row["of_action"] for row in measured if row["robot"] == name)
            for name in LATE
        },
    }
    write_summary(arguments.json, {**source, "headline": headline, "rows": measured})
    for row in measured:
        print(
            f"{row['robot']:24} {row['transitions']:4} transitions, nats of an action before "
            f"{row['of_action']:6.1f}, of the change before {row['of_state']:6.1f}"
        )


def measure(robot: str, seed: int) -> dict[str, object]:
    """Evidence of a robot's own rollouts, of one seed."""
    torch.set_num_threads(1)
    experiment = with_delay(LATE[robot]) if robot in LATE else load_experiment(robot)
    trainer = make_trainer(experiment, seed, TRIALS, False, lambda trial: None)
    trainer.train()
    targets = trainer.loss_module.dynamics.targets
    evidence = evidence_in(experiment, targets, trainer.own_rollouts())
    return {
        "robot": robot,
        "seed": seed,
        "transitions": evidence.transitions,
        "success_rate": trainer.trials[-1].success_rate,
        "periods": evidence.periods,
        "of_action": evidence.of_action,
        "of_state": evidence.of_state,
    }


if __name__ == "__main__":
    main()
