"""Hyper-parameters of a Gaussian process by maximum marginal likelihood and L-BFGS.

Starting points and penalties are PILCO's, with narrower bounds. Parameters are logarithms in one
vector (D + 2 E,): of the D lengthscales, the E signal variances and the E noise variances, of E
outputs that share their lengthscales.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import NotPositiveDefiniteError
from torch_pmil.gp.lbfgs import MinimiseResult, NotFiniteError, minimise_function
from torch_pmil.gp.marginal_likelihood import negative_log_likelihood

# Penalties lower the likelihood beyond this signal-to-noise ratio of standard deviations, and
# beyond this ratio of a lengthscale to the spread of its input. With PILCO's 500 and 100, rounding
# errors of variances end a search, and the model extrapolates from a small first motion to large
# actions
MOST_SIGNAL_TO_NOISE = 100.0
MAX_LENGTHSCALE_RATIO = 30.0
PENALTY_POWER = 30
# noise std over signal std at PILCO's start, and at a second one
NOISE_RATIOS = (0.1, 0.01)
# fewer data than this have several optima, so that twice the lengthscales are tried too
FEW_DATA = 100
# a column whose std is less than this part of its size changes by rounding only
CONSTANT = 1e-9
# of L-BFGS, in nats for a factor e and nats an iteration: searches of some hundred data end within
# 1e-5 nats of an optimum
SMALL_GRADIENT = 1e-3
SMALL_CHANGE = 1e-6


@dataclass(frozen=True, eq=False)
class Optimum:
    """Hyper-parameters, and how they were found.

    Args:
        log_parameters: (D + 2 E,).
        negative_log_likelihood: nats of each output, without the penalties, (E,).
        evaluations: number of evaluations of the objective, over all starts.
        stop_reason: why the best search ended, as in ``MinimiseResult``.
    """

    log_parameters: Tensor
    negative_log_likelihood: Tensor
    evaluations: int
    stop_reason: str


def find_hyperparameters(
    inputs: Tensor,
    targets: Tensor,
    starts: Sequence[Tensor],
    max_iterations: int,
    most_signal_to_noise: float = MOST_SIGNAL_TO_NOISE,
) -> Optimum:
    """Minimise the penalised negative log marginal likelihood from several starts; keep the best.

    A start at which the likelihood has no value is passed over.

    Args:
        inputs: (n, D).
        targets: one output (n,), or E that share their lengthscales, (n, E).
        starts: log parameters, (D + 2 E,) each.
        max_iterations: limit of L-BFGS for each start.
        most_signal_to_noise: ratio of standard deviations beyond which it is penalised.

    Raises:
        NotPositiveDefiniteError, NotFiniteError: of the first start, if no start has a value.

    Example:
        >>> x = torch.linspace(-2, 2, 20, dtype=torch.float64)[:, None]
        >>> y = x[:, 0].sin()
        >>> found = find_hyperparameters(x, y, pilco_starts(x, y), max_iterations=100)
        >>> found.negative_log_likelihood < -50
        tensor([True])
    """
    log_spread, D = _log_spread(inputs), inputs.shape[1]
    outputs = targets.reshape(len(targets), -1).mT

    def objective(log_parameters: Tensor) -> tuple[float, Tensor]:
        total, slopes = 0.0, []
        for target, own in zip(outputs, of_outputs(log_parameters, D), strict=True):
            likelihood, slope = negative_log_likelihood(inputs, target, own)
            penalised, penalty_slope = penalty(own, log_spread, most_signal_to_noise)
            total += likelihood + penalised
            slopes.append(slope + penalty_slope)
        return total, joined(torch.stack(slopes))

    limits = max_iterations, (NotPositiveDefiniteError,), SMALL_GRADIENT, SMALL_CHANGE
    runs: list[tuple[Tensor, MinimiseResult]] = []
    failures: list[ValueError] = []
    for start in starts:
        try:
            runs.append(minimise_function(start, objective, *limits))
        except (NotPositiveDefiniteError, NotFiniteError) as error:
            failures.append(error)
    if not runs:
        raise failures[0]
    best, result = min(runs, key=lambda run: run[1].loss)
    own = zip(outputs, of_outputs(best, D), strict=True)
    nats = [negative_log_likelihood(inputs, target, parameters)[0] for target, parameters in own]
    likelihood = torch.tensor(nats, dtype=torch.float64)
    return Optimum(best, likelihood, sum(run.evaluations for _, run in runs), result.stop_reason)


def of_outputs(log_parameters: Tensor, num_inputs: int) -> Tensor:
    """Log parameters of each output, (E, D + 2), from one vector (D + 2 E,)."""
    lengthscales, variances = log_parameters[:num_inputs], log_parameters[num_inputs:]
    own = variances.view(2, -1).mT
    return torch.cat([lengthscales.expand(len(own), -1), own], -1)


def joined(of_output: Tensor) -> Tensor:
    """Derivatives by the parameters of all outputs, (D + 2 E,), from those of each, (E, D + 2)."""
    return torch.cat([of_output[:, :-2].sum(0), of_output[:, -2], of_output[:, -1]])


def pilco_starts(inputs: Tensor, targets: Tensor) -> list[Tensor]:
    """Starting points (D + 2 E,) as in PILCO, for arguments of :func:`find_hyperparameters`.

    Lengthscales are std(input), signals std(target), noises ``NOISE_RATIOS`` times these. Few data
    also have starts with twice the lengthscales.
    """
    log_signal, log_spread = 2 * _log_spread(targets).reshape(-1), _log_spread(inputs)
    factors = (1.0, 2.0) if len(inputs) < FEW_DATA else (1.0,)
    return [
        torch.cat([log_spread + math.log(factor), log_signal, log_signal + 2 * math.log(ratio)])
        for factor in factors
        for ratio in NOISE_RATIOS
    ]


def penalty(
    log_parameters: Tensor, log_spread: Tensor, most_signal_to_noise: float = MOST_SIGNAL_TO_NOISE
) -> tuple[float, Tensor]:
    """Nats by which PILCO's penalties lower the likelihood, and their gradient (D + 2,).

    Inside the bounds they are next to nothing.
    """
    signal_scale, length_scale = 2 * math.log(most_signal_to_noise), math.log(MAX_LENGTHSCALE_RATIO)
    ratio = (log_parameters[-2:-1] - log_parameters[-1:]) / signal_scale
    length = (log_parameters[:-2] - log_spread) / length_scale
    slopes = [
        PENALTY_POWER * distance ** (PENALTY_POWER - 1) / scale
        for distance, scale in ((length, length_scale), (ratio, signal_scale))
    ]
    value = (ratio**PENALTY_POWER + (length**PENALTY_POWER).sum()).item()
    return value, torch.cat([*slopes, -slopes[1]])


def _log_spread(values: Tensor) -> Tensor:
    """Log standard deviations of columns (n, ...), or of the size of a constant one, or 0."""
    std, size = values.std(0), values.square().mean(0).sqrt()
    return torch.where(std > CONSTANT * size, std, torch.where(size > 0, size, 1.0)).log()
