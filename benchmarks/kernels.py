"""How well other kernels with closed moments would predict a step of the double pendulum.

Kernels are the squared exponential (SE), SE plus a linear one, and SE plus the product of another
SE with a linear one, all with a lengthscale or a weight for each input. Exact GPs of GPyTorch are
fitted to n transitions of random motion by 150 steps of Adam; the density is that of
300 transitions of another seed.

Example:
    python -m benchmarks.kernels
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import gpytorch
import torch
from gpytorch.kernels import Kernel, LinearKernel, RBFKernel, ScaleKernel
from torch import Tensor

from benchmarks.command_line import add_json, source_of, write_summary
from benchmarks.gp_fit import experience

ITERATIONS = 150
HELD_OUT = 300
SIZES, SEEDS = (25, 50, 100), (100, 101, 102)
LEAST_NOISE = 1e-6  # variance, of outputs in units of their spread

KERNELS: dict[str, Callable[[int], Kernel]] = {
    "SE": lambda D: scaled_se(D),
    "SE + linear": lambda D: scaled_se(D) + LinearKernel(ard_num_dims=D),
    "SE + SE x linear": lambda D: (
        scaled_se(D) + RBFKernel(ard_num_dims=D) * LinearKernel(ard_num_dims=D)
    ),
}


class Model(gpytorch.models.ExactGP):
    """One output, with a zero mean."""

    def __init__(self, inputs: Tensor, targets: Tensor, kernel: Kernel) -> None:
        noise = gpytorch.constraints.GreaterThan(LEAST_NOISE)
        likelihood = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=noise)
        super().__init__(inputs, targets, likelihood)
        self.mean_module, self.covar_module = gpytorch.means.ZeroMean(), kernel
        self.double()
        likelihood.noise = 0.01

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        """The prior at inputs (n, D)."""
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_json(parser, "kernels")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    source = source_of("kernels")
    rows = [row for n in SIZES for seed in SEEDS for row in measure(n, seed)]
    write_summary(arguments.json, {**source, "headline": headline(rows), "rows": rows})
    for name, nats in headline(rows).items():
        print(f"{name:30s} {nats:7.2f}")


def measure(n: int, seed: int) -> list[dict[str, object]]:
    """A row for each kernel: mean log density of a held-out increment, nats an output."""
    inputs, targets = experience(n, seed)
    new_inputs, new_targets = experience(HELD_OUT, seed + 50)
    mean, std = inputs.mean(0), inputs.std(0)
    inputs, new_inputs = (inputs - mean) / std, (new_inputs - mean) / std
    scale = targets.std(0)
    return [
        {
            "kernel": name,
            "n": n,
            "seed": seed,
            "log_density": sum(
                density(fitted(inputs, known, make(inputs.shape[1])), new_inputs, asked)
                for known, asked in zip((targets / scale).mT, (new_targets / scale).mT, strict=True)
            )
            / len(scale),
        }
        for name, make in KERNELS.items()
    ]


def scaled_se(num_inputs: int) -> Kernel:
    """The kernel of the package's models."""
    kernel = ScaleKernel(RBFKernel(ard_num_dims=num_inputs))
    kernel.base_kernel.lengthscale = 2.0
    return kernel


def fitted(inputs: Tensor, targets: Tensor, kernel: Kernel) -> Model:
    """A model of greatest marginal likelihood, as Adam finds it."""
    model = Model(inputs, targets.contiguous(), kernel)
    objective = gpytorch.mlls.ExactMarginalLogLikelihood(model.likelihood, model)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.05)
    for _ in range(ITERATIONS):
        optimizer.zero_grad()
        loss = -objective(model(inputs), model.train_targets)
        loss.backward()
        optimizer.step()
    return model


@torch.no_grad()
def density(model: Model, inputs: Tensor, targets: Tensor) -> float:
    """Mean log density of targets (n,) at inputs (n, D), each by itself."""
    model.eval(), model.likelihood.eval()
    predicted = model.likelihood(model(inputs))
    marginal = torch.distributions.Normal(predicted.mean, predicted.stddev)
    return marginal.log_prob(targets).mean().item()


def headline(rows: list[dict[str, object]]) -> dict[str, float]:
    """Mean over the seeds for each kernel and n."""
    names = list(dict.fromkeys((row["kernel"], row["n"]) for row in rows))
    return {
        f"{kernel}, n = {n}": float(
            torch.tensor([r["log_density"] for r in rows if (r["kernel"], r["n"]) == (kernel, n)])
            .double()
            .mean()
        )
        for kernel, n in names
    }


if __name__ == "__main__":
    main()
