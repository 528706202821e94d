"""CPU time and likelihood of fitting the double pendulum's model, beside plain GPyTorch.

One thread.

Ours starts cold (from PILCO's starts) or warm (from the optimum of the data without their last
rollout). Plain GPyTorch is a batch of exact GPs on the same data, from the first of PILCO's starts,
by at most 100 iterations of L-BFGS on ``ExactMarginalLogLikelihood``, without PILCO's penalties,
which cost ours up to 16 nats. Evaluations are of one output's likelihood; nats are the total
negative log likelihood, without penalties.

Example:
    python -m benchmarks.gp_fit --sizes 100 200 300
"""

from __future__ import annotations

import argparse
import copy
import statistics
import time
from collections.abc import Callable

import gpytorch
import torch
from torch import Tensor

from benchmarks.command_line import add_json, source_of, write_summary
from torch_pmil.gp.hyperparameters import pilco_starts
from torch_pmil.gp.marginal_likelihood import negative_log_likelihood
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.experience import Experience
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.trainer.collector import RobotActor

ROLLOUT = 25  # transitions
ITERATIONS = 100
SEED, REPEATS = 0, 7  # of the rollouts, and fits of each kind

# returns the fitted batch and the number of evaluations
Fit = Callable[[], tuple[gpytorch.models.ExactGP, int]]


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--sizes",
        type=int,
        nargs="+",
        default=[300],
        help=f"numbers of transitions, more than {ROLLOUT + 1} each",
    )
    add_json(parser, "gp_fit")
    arguments = parser.parse_args()
    if min(arguments.sizes) < ROLLOUT + 2:
        parser.error(f"sizes must be more than {ROLLOUT + 1}, got {arguments.sizes}")
    torch.set_num_threads(1)
    source = source_of("gp_fit")
    rows = [row for n in arguments.sizes for row in measure(*experience(n, SEED))]
    settings = {"seed": SEED, "repeats": REPEATS}
    write_summary(arguments.json, {**source, **settings, "headline": headline(rows), "rows": rows})
    print(table(rows))


def experience(n: int, seed: int) -> tuple[Tensor, Tensor]:
    """GP inputs (n, 8) and targets (n, 4) of exploration, as the trainer has them.

    They are random rollouts with the moderate torques of the first trial.
    """
    task = load_experiment("double_pendulum")
    rollouts = -(-n // ROLLOUT)
    env = task.make_env(num_envs=rollouts, seed=seed)
    generator = torch.Generator().manual_seed(seed)
    actor = RobotActor(task.make_policy(generator), task.space, task.exploration.motion(generator))
    past = Experience(capacity=rollouts * ROLLOUT)
    past.extend(env.rollout(ROLLOUT, actor))
    inputs, targets = past.training_data(task.space, "difference")
    return inputs[:n], targets[:n]


def measure(inputs: Tensor, targets: Tensor) -> list[dict[str, object]]:
    """A row for each kind of fit.

    The kinds take turns, so that what else the machine does meets all of them.
    """
    earlier = GPDynamics(inputs.shape[-1], targets.shape[-1])
    earlier.fit(inputs[:-ROLLOUT], targets[:-ROLLOUT])
    fits: dict[str, Callable[[], Fit]] = {
        "cold": lambda: ours(GPDynamics(inputs.shape[-1], targets.shape[-1]), inputs, targets),
        "warm": lambda: ours(copy.deepcopy(earlier), inputs, targets),
        "gpytorch": lambda: plain_gpytorch(inputs, targets),
    }
    seconds: dict[str, list[float]] = {name: [] for name in fits}
    rows: dict[str, dict[str, object]] = {}
    for repeat in range(REPEATS + 1):  # the first is not counted
        for name, prepare in fits.items():
            fit = prepare()
            start = time.process_time()
            model, evaluations = fit()
            if repeat:
                seconds[name].append(time.process_time() - start)
            rows[name] = {
                "evaluations": evaluations,
                "nats": total_negative_log_likelihood(model, inputs, targets),
            }
    return [
        {
            "fit": name,
            "n": len(inputs),
            "cpu_s_min": min(times),
            "cpu_s_median": statistics.median(times),
            **rows[name],
        }
        for name, times in seconds.items()
    ]


def ours(model: GPDynamics, inputs: Tensor, targets: Tensor) -> Fit:
    """``GPDynamics.fit``."""

    def fit() -> tuple[gpytorch.models.ExactGP, int]:
        evaluations = model.fit(inputs, targets, ITERATIONS).evaluations
        return model.gp, evaluations

    return fit


def plain_gpytorch(inputs: Tensor, targets: Tensor) -> Fit:
    """GPyTorch's model, likelihood and loss, and ``torch.optim.LBFGS`` on all outputs together."""
    model = PlainGP(inputs, targets)
    optimizer = torch.optim.LBFGS(
        model.parameters(), max_iter=ITERATIONS, line_search_fn="strong_wolfe"
    )
    objective = gpytorch.mlls.ExactMarginalLogLikelihood(model.likelihood, model)
    evaluations = 0

    def closure() -> Tensor:
        nonlocal evaluations
        evaluations += targets.shape[-1]
        optimizer.zero_grad()
        loss = -objective(model(*model.train_inputs), model.train_targets).sum()
        loss.backward()
        return loss

    def fit() -> tuple[gpytorch.models.ExactGP, int]:
        optimizer.step(closure)
        return model, evaluations

    return fit


class PlainGP(gpytorch.models.ExactGP):
    """A batch of outputs at PILCO's start, with GPyTorch's own constraints.

    The exception is GPyTorch's least noise, which is more than the robot's.
    """

    def __init__(self, inputs: Tensor, targets: Tensor) -> None:
        batch = torch.Size([targets.shape[-1]])
        likelihood = gpytorch.likelihoods.GaussianLikelihood(
            batch_shape=batch, noise_constraint=gpytorch.constraints.Positive()
        )
        super().__init__(inputs.expand(*batch, -1, -1), targets.mT.contiguous(), likelihood)
        self.mean_module = gpytorch.means.ZeroMean(batch_shape=batch)
        rbf = gpytorch.kernels.RBFKernel(ard_num_dims=inputs.shape[-1], batch_shape=batch)
        self.covar_module = gpytorch.kernels.ScaleKernel(rbf, batch_shape=batch)
        self.double()
        start = torch.stack([pilco_starts(inputs, target)[0] for target in targets.mT]).exp()
        rbf.lengthscale = start[:, None, :-2]
        self.covar_module.outputscale = start[:, -2]
        likelihood.noise = start[:, -1:]

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


@torch.no_grad()
def total_negative_log_likelihood(
    model: gpytorch.models.ExactGP, inputs: Tensor, targets: Tensor
) -> float:
    """Negative log likelihood summed over the outputs, nats, without penalties."""
    kernel = model.covar_module
    parts = (
        kernel.base_kernel.lengthscale[:, 0],
        kernel.outputscale[:, None],
        model.likelihood.noise,
    )
    log_parameters = torch.cat(parts, -1).log()
    outputs = zip(targets.mT, log_parameters, strict=True)
    return sum(negative_log_likelihood(inputs, *output)[0] for output in outputs)


def headline(rows: list[dict[str, object]]) -> dict[str, object]:
    """All numbers, each under one name."""
    values = ("cpu_s_min", "cpu_s_median", "nats", "evaluations")
    return {f"{row['fit']}_{row['n']}_{value}": row[value] for row in rows for value in values}


def table(rows: list[dict[str, object]]) -> str:
    """The printed table."""
    lines = [
        f"{'n':>4}  {'fit':<9} {'CPU s min':>9} {'median':>7} {'-log likelihood, nats':>22} "
        f"{'evaluations':>12}"
    ]
    for row in rows:
        times = f"{row['cpu_s_min']:>9.3f} {row['cpu_s_median']:>7.3f}"
        lines.append(
            f"{row['n']:>4}  {row['fit']:<9} {times} {row['nats']:>22.4f} {row['evaluations']:>12}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
