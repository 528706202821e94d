"""What it would lose if all outputs had the same lengthscales, with signal and noise of their own.

One exponential for each pair of data would then serve all pairs of outputs. Data and robots are
those of ``benchmarks.sparse``. Both models are searched by maximum marginal likelihood with the
same penalties, the tied one from the geometric mean of the other's lengthscales. Told are the nats
of evidence that are lost, the rms error of predictions of other transitions over that of the
untied model, and the coverage of both. One thread.

Example:
    make arms
    python -m benchmarks.tied
"""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.sparse import NOISES, ROBOTS, SOME, TESTED, Problem, covered
from torch_pmil import GPDynamics
from torch_pmil.experiments.runs.run_folder import provenance
from torch_pmil.files import write_json
from torch_pmil.gp.gaussian import NotPositiveDefiniteError
from torch_pmil.gp.hyperparameters import (
    MOST_SIGNAL_TO_NOISE,
    SMALL_CHANGE,
    SMALL_GRADIENT,
    penalty,
)
from torch_pmil.gp.lbfgs import minimise_function
from torch_pmil.gp.marginal_likelihood import negative_log_likelihood

SIZES = (100, 400)  # transitions
ITERATIONS = 200


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument(
        "--json",
        type=Path,
        default=Path("results/benchmarks/tied/summary.json"),
        help="file to write",
    )
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    source = provenance(shlex.join(["python", "-m", "benchmarks.tied", *sys.argv[1:]]))
    rows = []
    for robot in arguments.robots:
        for noise in NOISES:
            for n in SIZES:
                row = {"robot": robot, "noise": noise, "n": n}
                rows.append(row | measure(ROBOTS[robot](), n, noise))
                print(rows[-1], flush=True)
    headline = {
        "least_evidence_lost_nats": min(row["evidence_lost_nats"] for row in rows),
        "largest_error_ratio": max(row["error_ratio"] for row in rows),
    }
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    summary = {"experiment": "tied", **source, "headline": headline, "rows": rows}
    write_json(arguments.json, summary)


def measure(problem: Problem, n: int, noise: float) -> dict[str, float]:
    """Evidence, errors and coverage of both models of n transitions."""
    inputs, targets = problem.data(n, 1, noise)
    tested = problem.data(TESTED, 2, noise)
    untied, tied = (problem.model(most_exact=SOME) for _ in range(2))
    result = untied.fit(inputs, targets)
    tied.load_state_dict(untied.state_dict())
    tied_evidence = tie(tied)
    errors = [
        (tested[1] - model.expansion.mean(tested[0])).square().mean(0).sqrt()
        for model in (untied, tied)
    ]
    return {
        "evidence_lost_nats": tied_evidence - result.negative_log_likelihood.sum().item(),
        "error_ratio": (errors[1] / errors[0]).mean().item(),
        "coverage": covered(untied, *tested),
        "coverage_tied": covered(tied, *tested),
    }


def tie(dynamics: GPDynamics) -> float:
    """Search common lengthscales, signals and noises of a fitted model; return the nats."""
    inputs, targets = dynamics.train_inputs, dynamics.train_targets
    D, E = dynamics.num_inputs, dynamics.num_outputs
    log_spread, kernel = inputs.std(0).log(), dynamics.gp.covar_module

    def of_output(joint: Tensor, output: int) -> Tensor:
        return torch.cat([joint[:D], joint[[D + output, D + E + output]]])

    def objective(joint: Tensor) -> tuple[float, Tensor]:
        total, slope = 0.0, torch.zeros_like(joint)
        for output in range(E):
            own = of_output(joint, output)
            value, of_own = negative_log_likelihood(inputs, targets[:, output], own)
            penalised, of_penalty = penalty(own, log_spread, MOST_SIGNAL_TO_NOISE)
            total, of_own = total + value + penalised, of_own + of_penalty
            slope[:D] += of_own[:D]
            slope[[D + output, D + E + output]] += of_own[D:]
        return total, slope

    found = (kernel.base_kernel.lengthscale, kernel.outputscale, dynamics.gp.likelihood.noise)
    lengthscales, signal, noise = (value.detach().log().squeeze() for value in found)
    start = torch.cat([lengthscales.mean(0), signal, noise])
    best, _ = minimise_function(
        start, objective, ITERATIONS, (NotPositiveDefiniteError,), SMALL_GRADIENT, SMALL_CHANGE
    )
    parameters = torch.stack([of_output(best, output) for output in range(E)])
    kernel.base_kernel.lengthscale = parameters[:, None, :D].exp()
    kernel.outputscale = parameters[:, D].exp()
    dynamics.gp.likelihood.noise = parameters[:, D + 1 :].exp()
    dynamics.set_data(inputs, targets)
    nats = [
        negative_log_likelihood(inputs, target, own)[0]
        for target, own in zip(targets.mT, parameters, strict=True)
    ]
    return sum(nats)


if __name__ == "__main__":
    main()
