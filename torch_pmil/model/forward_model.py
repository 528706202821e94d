"""What a forward model is: data of transitions, what is known of them, and a fit to the rest."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from torch_pmil.checks import check_finite_entries, check_real, check_whole
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.state_space import StateSpace

Targets = KnownPart | Literal["difference", "successor"]
Functions = Callable[[Tensor], Tensor]  # of inputs (N, *batch, D' + F), to (N, *batch, E)


@dataclass(frozen=True, eq=False)
class FitResult:
    """Outcome of a fit of the hyper-parameters.

    Args:
        negative_log_likelihood: nats of each output, (E,), without penalties; NaN if unknown.
        evaluations: of one output's likelihood, over all outputs and starts.
        seconds: wall time.
        stop_reason: why the best search of each output ended, as in ``MinimiseResult``.
    """

    negative_log_likelihood: Tensor
    evaluations: int
    seconds: float
    stop_reason: tuple[str, ...]


class ForwardModel(nn.Module):
    r"""Base class of models of :math:`x_{t+1}` given features of the state and the action.

    A subclass fits itself to data, predicts mean and variance, and draws functions.

    Args:
        num_inputs: number D' + F of features and actions.
        num_outputs: number E of outputs: that of the known part.
        targets: what is known of x_{t+1}, so that the rest is learned. "difference" is short for
            :meth:`KnownPart.of_differences` (the prior mean is then that the state stays where it
            is), "successor" for :meth:`KnownPart.of_successors` (Eq. 2).

    Raises:
        ValueError: a number is out of range, or is not that of the known part.
    """

    train_inputs: Tensor
    train_targets: Tensor
    position_rule: Tensor

    def __init__(self, num_inputs: int, num_outputs: int, targets: Targets = "difference") -> None:
        super().__init__()
        check_whole("num_inputs", num_inputs, 1)
        check_whole("num_outputs", num_outputs, 1)
        known = known_part(targets, num_outputs)
        if known.num_outputs != num_outputs:
            raise ValueError(
                f"num_outputs must be the {known.num_outputs} of the known part, got {num_outputs}"
            )
        self.num_inputs, self.num_outputs = num_inputs, num_outputs
        self.targets = self._first_targets = known
        self.register_buffer("train_inputs", torch.zeros(0, num_inputs, dtype=torch.float64))
        self.register_buffer("train_targets", torch.zeros(0, num_outputs, dtype=torch.float64))
        if known.followed:
            self.register_buffer("position_rule", known.rule)

    @abstractmethod
    def fit(self, inputs: Tensor, targets: Tensor) -> FitResult:
        """Fit to features and actions (n, D' + F), and to what is learned, (n, E)."""

    @abstractmethod
    def predict(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and variance (*batch, E) at inputs (*batch, D' + F), without :attr:`noise`."""

    def mean(self, inputs: Tensor) -> Tensor:
        """The mean of :meth:`predict` alone."""
        return self.predict(inputs)[0]

    @abstractmethod
    def functions(self, count: int, generator: torch.Generator) -> Functions:
        """Draw ``count`` functions that are consistent with the data, each for its own inputs."""

    def fault_at(self, inputs: Tensor) -> str:
        """Why no finite state follows inputs (N, *batch, D' + F); "" if the model is not why."""
        return ""

    @property
    @abstractmethod
    def noise(self) -> Tensor:
        """Variances (E,) of what no function explains."""

    @property
    def prior_variance(self) -> Tensor:
        """Variances (E,) of the outputs where nothing is known: those of the data."""
        return self.train_targets.var(0)

    @property
    def lengthscales(self) -> Tensor:
        """Distances (E, D' + F) at which inputs count as far apart; here the spread of the data.

        It is 1 for an input that never changes.
        """
        spread = self.train_inputs.std(0)
        return torch.where(spread > 0, spread, 1.0).expand(self.num_outputs, -1)

    @property
    def sparse(self) -> bool:
        """Whether the data are too many for an exact posterior."""
        return False

    @property
    def dim(self) -> int:
        """Number of entries of the state D."""
        return self.targets.dim

    def known_part(self, space: StateSpace) -> KnownPart:
        """The known part of the dynamics, with as many actions as the model has in this space."""
        return self.targets.for_actions(self.num_inputs - len(space.feature_names))

    def fit_known_part(self, states: Tensor, successors: Tensor) -> None:
        """Learn from transitions (n, D) how positions follow from velocities, if any do."""
        if self.targets.followed:
            self._take_rule(self._first_targets.fitted_rule(states, successors))

    def set_data(self, inputs: Tensor, targets: Tensor) -> None:
        """Take finite data (n, D' + F) and (n, E)."""
        self._check_data(inputs, targets)
        self.train_inputs, self.train_targets = (
            data.detach().to(torch.float64, copy=True) for data in (inputs, targets)
        )

    def check_has_data(self) -> None:
        """Raise RuntimeError before there are data."""
        if len(self.train_inputs) == 0:
            raise RuntimeError(
                "the dynamics model has no data yet: call fit(inputs, targets) first"
            )

    def _check_data(self, inputs: Tensor, targets: Tensor) -> None:
        check_real("inputs", inputs)
        check_real("targets", targets)
        n = inputs.shape[0] if inputs.ndim else 0
        if inputs.shape != (n, self.num_inputs) or targets.shape != (n, self.num_outputs) or n < 2:
            raise ValueError(
                f"expected inputs (n, {self.num_inputs}) and targets (n, {self.num_outputs}) with "
                f"n >= 2, got {tuple(inputs.shape)} and {tuple(targets.shape)}"
            )
        check_finite_entries("inputs", inputs)
        check_finite_entries("targets", targets)

    def _take_rule(self, rule: Tensor) -> None:
        self.targets = self.targets.with_rule(rule)
        self.position_rule = rule.to(self.position_rule)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        inputs = state_dict.get(prefix + "train_inputs")
        targets = state_dict.get(prefix + "train_targets")
        if inputs is not None and targets is not None and len(inputs):
            self.set_data(inputs, targets)
        super()._load_from_state_dict(state_dict, prefix, *args)
        if prefix + "position_rule" in state_dict and hasattr(self, "position_rule"):
            self._take_rule(self.position_rule.clone())


def known_part(targets: Targets, dim: int) -> KnownPart:
    """The known part that ``targets`` stands for, in a state of D entries.

    Raises ValueError if ``targets`` is neither a :class:`KnownPart` nor one of the two words.
    """
    if isinstance(targets, KnownPart):
        return targets
    words = {"difference": KnownPart.of_differences, "successor": KnownPart.of_successors}
    if targets not in tuple(words):
        raise ValueError(
            f'targets must be "difference" or "successor", got {targets!r}, which is not a '
            "KnownPart either"
        )
    return words[targets](dim)
