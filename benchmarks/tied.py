"""What is lost if all outputs share their lengthscales, but have their own signal and noise.

Data and robots are those of ``benchmarks.sparse``. It reports the evidence that is lost (nats), the
rms error on other transitions relative to the untied model, and the coverage of both. One thread.

Example:
    make arms
    python -m benchmarks.tied
"""

from __future__ import annotations

import argparse

import torch

from benchmarks.command_line import add_json, source_of, write_summary
from benchmarks.sparse import NOISES, ROBOTS, SOME, TESTED, Problem, covered

SIZES = (100, 400)  # transitions


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_json(parser, "tied")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    source = source_of("tied")
    rows = []
    for robot, make in ROBOTS.items():
        for noise in NOISES:
            for n in SIZES:
                row = {"robot": robot, "noise": noise, "n": n}
                rows.append(row | measure(make(), n, noise))
                print(rows[-1], flush=True)
    headline = {
        "least_evidence_lost_nats": min(row["evidence_lost_nats"] for row in rows),
        "largest_error_ratio": max(row["error_ratio"] for row in rows),
    }
    summary = {"experiment": "tied", **source, "headline": headline, "rows": rows}
    write_summary(arguments.json, summary)


def measure(problem: Problem, n: int, noise: float) -> dict[str, float]:
    """Evidence, errors and coverage of both models of n transitions."""
    models = untied, tied = problem.model(SOME), problem.model(SOME, tied=True)
    data, tested = problem.data(n, 1, noise), problem.data(TESTED, 2, noise)
    nats = [model.fit(*data).negative_log_likelihood.sum().item() for model in models]
    errors = [
        (tested[1] - model.expansion.mean(tested[0])).square().mean(0).sqrt() for model in models
    ]
    return {
        "evidence_lost_nats": nats[1] - nats[0],
        "error_ratio": (errors[1] / errors[0]).mean().item(),
        "coverage": covered(untied, *tested),
        "coverage_tied": covered(tied, *tested),
    }


if __name__ == "__main__":
    main()
