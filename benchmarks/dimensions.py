"""CPU time of one KL with its policy gradient over the number D of entries of the state.

One thread, 100 basis functions. The state is the angles and velocities of D/2 joints, each with an
actuator. Data, hyper-parameters and policy are drawn at random: the time does not depend on what
was learned. Three models take turns: one with a GP for each entry of the state, one that learns the
velocities alone, from which the positions follow, and one whose velocities have the same
lengthscales too. The fastest of several evaluations of each counts.

Example:
    python -m benchmarks.dimensions
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import torch

from benchmarks.command_line import add_json, cpu_seconds, source_of, write_summary
from benchmarks.workloads import lengthscale_factors
from torch_pmil import Gaussian, GPDynamics, RBFPolicy, TrajectoryKLLoss
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.model.forward_model import Targets

SEED = 0
DIMENSIONS = (4, 6, 8, 12, 14)  # D, even
N, HORIZON = 400, 25  # transitions that the model knows, and T
REPEATS = 7  # evaluations of each model
TIME_STEP = 0.05  # s
CENTRES = 100
LENGTHSCALE, NOISE = 4.0, 0.1  # in spreads of the inputs; noise over signal, standard deviations
WIDTH = 2.0  # of the basis functions, in spreads of the state
START_STD, DEMONSTRATED_STD, NOISE_STD = 0.05, 0.3, 0.1
MODELS = ("all entries", "velocities alone", "velocities alone, tied")


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_json(parser, "dimensions")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    source = source_of("dimensions")
    rows = []
    for dim in DIMENSIONS:
        rows.append({"dim": dim, "actions": dim // 2, **measure(dim)})
        print(f"D = {dim:<3}", *(f"{name}: {rows[-1][name]:.4f} s " for name in MODELS), flush=True)
    headline = {f"cpu_seconds_D{row['dim']}": row["velocities alone"] for row in rows}
    headline |= {f"cpu_seconds_all_entries_D{row['dim']}": row["all entries"] for row in rows}
    headline |= {f"cpu_seconds_tied_D{row['dim']}": row["velocities alone, tied"] for row in rows}
    size = {"n": N, "horizon": HORIZON, "repeats": REPEATS, "centres": CENTRES}
    summary = {"experiment": "dimensions", **source, "headline": headline, **size, "rows": rows}
    write_summary(arguments.json, summary)


def measure(dim: int) -> dict[str, float]:
    """Least CPU seconds of a value and its gradient with each of the models."""
    names = tuple(f"{kind}{joint}" for kind in ("q", "dq") for joint in range(dim // 2))
    velocities = {f"q{joint}": f"dq{joint}" for joint in range(dim // 2)}
    known = KnownPart.of_velocities(names, velocities, dim // 2, TIME_STEP)
    models: tuple[tuple[Targets, bool], ...] = (
        ("difference", False),
        (known, False),
        (known, True),
    )
    evaluations = [evaluation(names, *model) for model in models]
    times = [[cpu_seconds(evaluate) for evaluate in evaluations] for _ in range(REPEATS + 1)]
    least = [min(column) for column in zip(*times[1:], strict=True)]
    return dict(zip(MODELS, least, strict=True))


def evaluation(names: tuple[str, ...], targets: Targets, tied: bool) -> Callable[[], object]:
    """The KL of a random policy with its gradient, by a model of random data with these targets."""
    generator, D, F = torch.Generator().manual_seed(SEED), len(names), len(names) // 2
    outputs = D if targets == "difference" else D // 2

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=generator, dtype=torch.float64)

    space = StateSpace(names, ("",) * D, (), joint_match(names, ("",) * D))
    dynamics = GPDynamics(D + F, outputs, targets)
    factors = lengthscale_factors(outputs, D + F)
    if tied:
        factors = factors[:1].repeat(outputs, 1)
    dynamics.gp.covar_module.base_kernel.lengthscale = LENGTHSCALE * factors[:, None]
    dynamics.gp.covar_module.outputscale = torch.full((outputs,), TIME_STEP**2)
    dynamics.gp.likelihood.noise = torch.full((outputs, 1), (NOISE * TIME_STEP) ** 2)
    dynamics.set_data(normal(N, D + F), TIME_STEP * normal(N, outputs))
    one = torch.ones(D, dtype=torch.float64)
    policy = RBFPolicy(normal(CENTRES, D), torch.ones(F, dtype=torch.float64), WIDTH * one)
    policy.weights.data.copy_(0.1 * normal(CENTRES, F))
    covariance = DEMONSTRATED_STD**2 * torch.diag(one)
    demonstrated = Gaussian(0 * one.expand(HORIZON, D), covariance.expand(HORIZON, D, D))
    loss = TrajectoryKLLoss(policy, dynamics, space, demonstrated, NOISE_STD)
    start, parameters = Gaussian(0 * one, START_STD**2 * torch.diag(one)), list(policy.parameters())
    return lambda: torch.autograd.grad(loss.per_step(start).sum(), parameters)


if __name__ == "__main__":
    main()
