r"""Choice of the sampling frequency at which a model of a robot learns most (Eq. 30, Figure 9).

Frequencies are compared by cross-validated likelihood.

=========================  ==================================================================
paper symbol               name
=========================  ==================================================================
f_s = 1 / Delta T          ``frequency``
k                          ``folds``
y_i, x_i                   targets and inputs of fold i
D                          number of targets of a fold, here of one output
``log p(y_i | X, y_-i)``   ``held_out_log_likelihood``, here for each transition
=========================  ==================================================================
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from scipy import stats
from torch import Tensor

from torch_pmil.checks import check_tensor, check_whole
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import NotPositiveDefiniteError
from torch_pmil.gp.hyperparameters import find_hyperparameters, pilco_starts
from torch_pmil.gp.lbfgs import NotFiniteError
from torch_pmil.gp.marginal_likelihood import negative_log_likelihood

CONFIDENCE = 0.95


class Recording(NamedTuple):
    """Motion of a robot without interruption, sampled at a high rate.

    Args:
        states: (T + 1, D).
        actions: actions between the states, (T, F).
    """

    states: Tensor
    actions: Tensor


class Interval(NamedTuple):
    """A mean and half the width of its t interval (``CONFIDENCE``).

    Example:
        >>> Interval.of(torch.tensor([1.0, 2.0, 3.0])).mean
        2.0
    """

    mean: float
    half_width: float

    @classmethod
    def of(cls, values: Tensor) -> Interval:
        """Interval of the mean of independent values (n,); its width is NaN for a single value."""
        quantile = float(stats.t.ppf((1 + CONFIDENCE) / 2, len(values) - 1))
        return cls(values.mean().item(), quantile * values.std().item() / len(values) ** 0.5)


@dataclass(frozen=True, eq=False)
class FrequencyScore:
    """Score of the prediction of held-out transitions at one frequency.

    Args:
        frequency: f_s, Hz.
        transitions: number n of transitions.
        log_likelihood: nats a transition for each fold and output, (k, D); of a density in the
            units of the state.
        spread: standard deviation of the state's increments, in its units, (D,).
    """

    frequency: float
    transitions: int
    log_likelihood: Tensor
    spread: Tensor

    @property
    def raw(self) -> Interval:
        """Sharpness of the prediction of the next state, in nats a transition and output.

        It is the log density in the units of the state. The shorter the step the less can happen in
        it, so this rises with frequency. The interval is over the folds, which share training data:
        take it as a guide.
        """
        return Interval.of(self.log_likelihood.mean(1))

    @property
    def standardised(self) -> Interval:
        """Predicted share of what changes, in nats a transition and output.

        Increments are in units of their spread, so that frequencies can be compared. A model that
        knows nothing but mean and spread has about -1.42. The interval is over the folds, which
        share training data: take it as a guide.
        """
        return Interval.of((self.log_likelihood + self.spread.log()).mean(1))


def score_frequencies(
    recordings: Sequence[Recording],
    time_step: float,
    frequencies: Sequence[float],
    space: StateSpace,
    folds: int = 5,
    max_iterations: int = 100,
) -> list[FrequencyScore]:
    """Cross-validated log-likelihood of the GP forward model at each sampling frequency (Eq. 30).

    At each frequency the recordings are cut into transitions, the action being the mean over the
    interval; the model is that of ``GPDynamics``, which learns differences. Two questions have two
    answers, ``FrequencyScore.raw`` and ``FrequencyScore.standardised``.

    Args:
        recordings: recordings of one robot; no transition leads from one to another.
        time_step: time between two samples of the recordings, s.
        frequencies: frequencies in Hz; the interval of each is a whole number of time steps.
        space: the robot's state space, which says which entries are angles.
        folds: number k of folds.
        max_iterations: limit of L-BFGS for each fit and start.

    Returns:
        A score for each frequency, in their order.

    Raises:
        ValueError: shapes do not fit, a number is not finite, a frequency does not divide the
            recordings' rate or leaves fewer than two transitions a fold, an entry of the state
            never changes, or a fold cannot be fitted.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> time = 0.05 * torch.arange(121).double()
        >>> recording = Recording(time.sin()[:, None], time.cos()[:-1, None])
        >>> (score,) = score_frequencies([recording], 0.05, [4.0], space)
        >>> score.transitions, score.log_likelihood.shape
        (24, torch.Size([5, 1]))
    """
    _check_recordings(recordings, space, time_step)
    check_whole("folds", folds, 2)
    check_whole("max_iterations", max_iterations, 1)
    if not len(frequencies):
        raise ValueError("frequencies must hold one at least, got none")
    scores = []
    for frequency in frequencies:
        steps = _steps(frequency, time_step)
        transitions = sum(len(one.actions) // steps for one in recordings)
        if transitions < 2 * folds:
            raise ValueError(
                f"{frequency:g} Hz must leave at least {2 * folds} transitions for {folds} folds, "
                f"got {transitions}"
            )
        inputs, targets = _transitions(recordings, steps, space)
        spread = targets.std(0)
        if not (spread > 0).all():
            raise ValueError(
                f"every entry of the state must change, got none at {frequency:g} Hz in "
                f"{space.names[int(spread.argmin())]}"
            )
        try:
            values = held_out_log_likelihood(inputs, targets, folds, max_iterations)
        except (NotPositiveDefiniteError, NotFiniteError) as error:
            raise ValueError(f"no model could be fitted at {frequency:g} Hz: {error}") from error
        scores.append(FrequencyScore(frequency, len(inputs), values, spread))
    return scores


def held_out_log_likelihood(
    inputs: Tensor, targets: Tensor, folds: int = 5, max_iterations: int = 100
) -> Tensor:
    r"""Joint predictive log-density of each fold, from a GP that is fitted to the others (Eq. 30).

    .. math::
        \log p(y_i | X, y_{-i}) = -\tfrac12 \log |\Sigma_i| - \tfrac{D}{2} \log 2 \pi
        - \tfrac12 (y_i - \mu_i)^\top \Sigma_i^{-1} (y_i - \mu_i)
        = \log p(y | X) - \log p(y_{-i} | X)

    The right-hand side, with hyper-parameters of the training folds, has the whole predictive
    covariance :math:`\Sigma_i` in it, noise included: a model whose errors are correlated is not
    rewarded for each of them.

    Folds are contiguous. Neighbours in time are nearly equal, the more so the higher the frequency:
    with random folds the model would be tested on what it had seen a moment before and after.

    Args:
        inputs: inputs in the order of their recording, (n, D').
        targets: (n, E).
        folds: number k of folds.
        max_iterations: limit of L-BFGS for each fit and start.

    Returns:
        Nats for each target, (k, E).

    Raises:
        NotPositiveDefiniteError, NotFiniteError: a likelihood has no value.

    Example:
        >>> x = torch.linspace(-3, 3, 40, dtype=torch.float64)[:, None]
        >>> held_out_log_likelihood(x, x.sin()).shape
        torch.Size([5, 1])
    """
    inputs, targets = inputs.double(), targets.double()
    outputs = targets.mT.contiguous()
    values = [
        _held_out(inputs, target, held, max_iterations)
        for held in torch.arange(len(inputs)).tensor_split(folds)
        for target in outputs
    ]
    return torch.tensor(values, dtype=torch.float64).view(folds, len(outputs))


def _held_out(inputs: Tensor, target: Tensor, held: Tensor, max_iterations: int) -> float:
    training = torch.ones(len(inputs), dtype=torch.bool)
    training[held] = False
    known, seen = inputs[training], target[training]
    optimum = find_hyperparameters(known, seen, pilco_starts(known, seen), max_iterations)
    of_all, _ = negative_log_likelihood(inputs, target, optimum.log_parameters)
    of_known, _ = negative_log_likelihood(known, seen, optimum.log_parameters)
    return (of_known - of_all) / len(held)


def _transitions(
    recordings: Sequence[Recording], steps: int, space: StateSpace
) -> tuple[Tensor, Tensor]:
    """Inputs (n, D' + F) and differences (n, D) of recordings at every ``steps``-th sample."""
    inputs, targets = [], []
    for states, actions in recordings:
        if len(actions) < steps:
            continue
        sampled, count = states[::steps].double(), len(actions) // steps
        means = actions[: count * steps].double().reshape(count, steps, -1).mean(1)
        inputs.append(torch.cat([space.features(sampled[:-1]), means], -1))
        targets.append(sampled.diff(dim=0))
    return torch.cat(inputs), torch.cat(targets)


def _steps(frequency: float, time_step: float) -> int:
    if not (math.isfinite(frequency) and frequency > 0):
        raise ValueError(f"frequencies must be positive and finite, in Hz, got {frequency}")
    steps = 1 / (frequency * time_step)
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        raise ValueError(
            f"the interval of {frequency:g} Hz must be a whole number of time steps of "
            f"{time_step:g} s, got {steps:g}"
        )
    return round(steps)


def _check_recordings(recordings: Sequence[Recording], space: StateSpace, time_step: float) -> None:
    if not recordings:
        raise ValueError("recordings must hold one at least, got none")
    if not (math.isfinite(time_step) and time_step > 0):
        raise ValueError(f"time_step must be positive and finite, in s, got {time_step}")
    for number, (states, actions) in enumerate(recordings):
        if not isinstance(recordings[number], Recording):
            raise TypeError(
                f"recording {number} must be a Recording, got {type(recordings[number]).__name__}"
            )
        T, F = len(actions), recordings[0].actions.shape[-1]
        if states.shape != (T + 1, space.dim) or actions.shape != (T, F):
            raise ValueError(
                f"recording {number} must have states (T + 1, {space.dim}) and actions (T, "
                f"{F}), got {tuple(states.shape)} and {tuple(actions.shape)}"
            )
        check_tensor(f"states of recording {number}", states, ("T", space.dim))
        check_tensor(f"actions of recording {number}", actions, ("*batch",))
