r"""Differences of TorchRL's ``GPWorldModel`` from its own Gaussian process, where ours has none.

Both models are fitted, each by its own ``fit``, to the same transitions of the double pendulum
under random torques, and see the four states themselves. The noise that is said beside each is its
own estimate in physical units.

* Zero covariance: moment matching of a certain input must give the GP's posterior mean and
  variance. Each model is held against its own GP (botorch's, GPyTorch's) at states and torques
  drawn like the data. Mean errors are in posterior standard deviations; variances are ratios,
  observation noise included on both sides.
* Units: botorch standardises the targets, and its GP's noise is in units of their variance. That
  number is compared with what moment matching takes it for: squared units of the state.
* Saved states, and gradients of the prediction from a certain state.

``torchrl_our_posterior`` is TorchRL's moment matching with the data, hyper-parameters and units of
our fit.

Example:
    python -m benchmarks.torchrl_model --n 100
"""

from __future__ import annotations

import argparse
import textwrap
from dataclasses import dataclass
from importlib.metadata import version

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.modules import GPWorldModel as TorchRLModel

from benchmarks.command_line import add_json, source_of, write_summary
from benchmarks.workloads import random_transitions, world_model
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.torchrl_interop import GPWorldModel

SEED = 0  # of the transitions
POINTS = 20  # at which posterior and moments are compared


@dataclass(frozen=True)
class Posterior:
    """A model's own GP at some points, in physical units.

    Mean (N, D) and noisy variance (N, D) are of the next state; the noise is (D,).
    """

    mean: Tensor
    variance: Tensor
    noise_variance: Tensor


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--n", type=int, default=100, help="transitions that the models are fitted to"
    )
    add_json(parser, "torchrl_model")
    arguments = parser.parse_args()
    if arguments.n < 2:
        parser.error(f"--n must be at least 2, got {arguments.n}")
    torch.set_num_threads(1)
    source = source_of("torchrl_model")
    rows = measure(arguments.n)
    botorch = version("botorch")
    settings = {"botorch": botorch, "n": arguments.n, "seed": SEED, "points": POINTS}
    write_summary(arguments.json, {**source, **settings, "rows": rows})
    print(table(rows))


def measure(n: int) -> list[dict[str, object]]:
    """A row for each model; n transitions to learn from and ``POINTS`` others to predict at."""
    states, torques, successors = random_transitions(
        load_experiment("double_pendulum"), n + POINTS, torch.Generator().manual_seed(SEED)
    )
    order = torch.randperm(n + POINTS, generator=torch.Generator().manual_seed(SEED))
    data = TensorDict(
        {"observation": states, "action": torques, "next": {"observation": successors}},
        [n + POINTS],
    )[order]
    known, points = data[:n], data[n:]
    ours, theirs = (cls(obs_dim=4, action_dim=2) for cls in (GPWorldModel, TorchRLModel))
    for model in (ours, theirs):
        model.fit(known)
    mixed = world_model(ours.dynamics)
    return [
        {
            "model": "torch_pmil",
            **limit(ours, own_posterior(ours, points), points),
            **habits(ours, points),
        },
        {
            "model": "torchrl",
            **limit(theirs, torchrl_posterior(theirs, points), points),
            **habits(theirs, points),
        },
        {"model": "torchrl_our_posterior", **limit(mixed, own_posterior(ours, points), points)},
    ]


@torch.no_grad()
def own_posterior(model: GPWorldModel, points: TensorDictBase) -> Posterior:
    """The posterior of our model's GP, as GPyTorch computes it."""
    gp = model.dynamics.gp.eval()
    x = torch.cat([points["observation"], points["action"]], -1)
    prediction = gp.likelihood(gp(x.expand(model.obs_dim, *x.shape)))
    return Posterior(
        points["observation"] + prediction.mean.mT,
        prediction.variance.mT,
        gp.likelihood.noise[:, 0],
    )


@torch.no_grad()
def torchrl_posterior(model: TorchRLModel, points: TensorDictBase) -> Posterior:
    """The posterior of TorchRL's model, as botorch computes it, back in physical units."""
    x = torch.cat([points["observation"], points["action"]], -1)
    models = model.model_list.models
    noisy = [gp.posterior(x, observation_noise=True) for gp in models]
    noiseless = [gp.posterior(x, observation_noise=False) for gp in models]
    mean = torch.cat([p.mean for p in noisy], -1)
    variance = torch.cat([p.variance for p in noisy], -1)
    noise = variance - torch.cat([p.variance for p in noiseless], -1)
    return Posterior(points["observation"] + mean, variance, noise.mean(0))


@torch.no_grad()
def limit(model: nn.Module, posterior: Posterior, points: TensorDictBase) -> dict[str, float]:
    """The model's moment matching of certain inputs, held against its own posterior."""
    match = model.uncertain_forward if isinstance(model, TorchRLModel) else model
    moments = match(beliefs(points["observation"], points["action"]))["next", "observation"]
    ratio = moments["var"].diagonal(dim1=-2, dim2=-1) / posterior.variance
    noise = taken_noise(model) / posterior.noise_variance
    error = (moments["mean"] - posterior.mean).abs() / posterior.variance.sqrt()
    return {
        "variance_ratio_min": ratio.min().item(),
        "variance_ratio_max": ratio.max().item(),
        "mean_error_std": error.max().item(),
        "noise_ratio_min": noise.min().item(),
        "noise_ratio_max": noise.max().item(),
    }


def taken_noise(model: nn.Module) -> Tensor:
    """The noise that moment matching adds, (D,)."""
    if isinstance(model, TorchRLModel):
        return model.sigma_sq_eps
    return model.dynamics.expansion.noise_variance


def beliefs(states: Tensor, actions: Tensor) -> TensorDictBase:
    """Beliefs without uncertainty, with all of TorchRL's keys."""
    (n, D), F = states.shape, actions.shape[-1]
    action = {
        "mean": actions,
        "var": states.new_zeros(n, F, F),
        "cross_covariance": states.new_zeros(n, D, F),
    }
    return TensorDict(
        {"observation": {"mean": states, "var": states.new_zeros(n, D, D)}, "action": action}, [n]
    )


def habits(model: nn.Module, points: TensorDictBase) -> dict[str, object]:
    """Whether a saved state loads into a new model, and whether there are gradients.

    If it does not load, the first words of the error are returned.
    """
    try:
        type(model)(obs_dim=4, action_dim=2).load_state_dict(model.state_dict())
        loading = "loads"
    except RuntimeError as error:
        loading = textwrap.shorten(str(error).splitlines()[1], 60, placeholder=" ...")
    states = points["observation"].clone().requires_grad_()
    mean = model(beliefs(states, points["action"]))["next", "observation", "mean"]
    (gradient,) = torch.autograd.grad(
        (mean - states).sum(), states, allow_unused=True, materialize_grads=True
    )
    return {"state_dict": loading, "gradients": bool(gradient.abs().max() > 0)}


def table(rows: list[dict[str, object]]) -> str:
    """The printed table."""
    lines = [
        f"{'model':<22} {'variance / GP variance':>24} {'mean error, std':>16} "
        f"{'noise / GP noise':>22}  gradients  state_dict"
    ]
    for row in rows:
        variance, noise = (
            f"{row[f'{name}_ratio_min']:.6g} to {row[f'{name}_ratio_max']:.6g}"
            for name in ("variance", "noise")
        )
        habits = f"{row['gradients']!s:<9}  {row['state_dict']}" if "gradients" in row else ""
        lines.append(
            f"{row['model']:<22} {variance:>24} {row['mean_error_std']:>16.2g} {noise:>22}  "
            f"{habits}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
