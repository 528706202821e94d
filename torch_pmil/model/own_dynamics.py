"""A forward model of one's own: any object that fits data, and samples functions or has moments."""

from __future__ import annotations

import copy
import math
import time
from typing import Any

import torch
from torch import Tensor

from torch_pmil.checks import check_tensor, check_whole
from torch_pmil.gp.gaussian import normal
from torch_pmil.model.forward_model import FitResult, ForwardModel, Functions, Targets

FIT_SEED = 0  # of PyTorch's global generator while a model is fitted
PREDICTED_BY = 200  # functions, of a model that has no moments


class OwnDynamics(ForwardModel):
    r"""Forward model by an object of a user's own, predicted by samples.

    The object has ``fit(inputs, targets)`` and one of these:

    - ``sample(count, generator)`` returns functions that are consistent with the data. They map
      inputs (count, \*batch, D' + F) to outputs (count, \*batch, E), and are differentiable in the
      inputs.
    - ``moments(inputs)`` returns mean and variance of the outputs, (\*batch, E) each, without
      noise. Function i is then :math:`\mu(x) + z_i \sigma(x)`: a particle that is one standard
      deviation off stays so along its trajectory.

    Its attribute ``noise``, (E,), holds the noise variances once the object is fitted. Without this
    attribute the noise is zero.

    Inputs are features of the state and actions. Targets are what the known part leaves to learn:
    by default the changes of the state in one step. Each fit begins with the object as it was
    given, under one seed of PyTorch's generator. So a resumed run learns the same.

    Args:
        model: the object, which is copied and stays as it is.
        num_inputs, num_outputs, targets: as in :class:`ForwardModel`.

    Raises:
        TypeError: the object has no such methods, or cannot be copied.

    Example: see ``docs/how_to/own_model.md``.
    """

    def __init__(
        self, model: Any, num_inputs: int, num_outputs: int, targets: Targets = "difference"
    ) -> None:
        super().__init__(num_inputs, num_outputs, targets)
        check_own_model(model)
        # in a tuple, lest a module's parameters become those of the loss
        self._given, self._fitted = (model,), tuple[Any, ...]()

    @property
    def own(self) -> Any:
        """The object fitted to the present data.

        Raises:
            RuntimeError: there are no data yet.
            ValueError: its ``fit`` failed.
        """
        if not self._fitted:
            self.check_has_data()
            own, data = copy.deepcopy(self._given[0]), (self.train_inputs, self.train_targets)
            with torch.random.fork_rng(devices=[]), torch.enable_grad():
                torch.manual_seed(FIT_SEED)
                try:
                    own.fit(*(each.clone() for each in data))
                except (RuntimeError, ValueError) as error:
                    inputs, targets = (tuple(each.shape) for each in data)
                    raise ValueError(
                        f"fit() of the model must learn from inputs {inputs} and targets "
                        f"{targets}, got {type(error).__name__}: {error}"
                    ) from error
            self._fitted = (own,)
        return self._fitted[0]

    def set_data(self, inputs: Tensor, targets: Tensor) -> None:
        """Take finite data (n, D' + F) and (n, E); the object is fitted to them on first use."""
        super().set_data(inputs, targets)
        self._fitted = ()

    def fit(self, inputs: Tensor, targets: Tensor) -> FitResult:
        """Fit the object to data (n, D' + F) and (n, E)."""
        begun = time.perf_counter()
        self.set_data(inputs, targets)
        assert self.own is not None
        unknown = torch.full((self.num_outputs,), math.nan, dtype=torch.float64)
        seconds, reason = time.perf_counter() - begun, ("fitted by its own method",)
        return FitResult(unknown, 0, seconds, reason * self.num_outputs)

    def predict(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and variance (*batch, E), of sampled functions or of ``moments``."""
        if not _has(self.own, "sample"):
            return self._moments(inputs)
        functions = self.functions(PREDICTED_BY, torch.Generator().manual_seed(FIT_SEED))
        outputs = functions(inputs.expand(PREDICTED_BY, *inputs.shape))
        return outputs.mean(0), outputs.var(0)

    def functions(self, count: int, generator: torch.Generator) -> Functions:
        """Draw ``count`` functions from the object."""
        check_whole("count", count, 1)
        if not _has(self.own, "sample"):
            return self._by_moments(count, generator)
        functions = self.own.sample(count, generator)

        def checked(inputs: Tensor) -> Tensor:
            outputs = self._as_wanted("functions of sample()", functions(inputs), inputs)
            _check_slope("functions of sample()", outputs, inputs)
            return outputs

        return checked

    @torch.no_grad()
    def fault_at(self, inputs: Tensor) -> str:
        """Which method of the object returns NaN at finite inputs; "" if none does."""
        outputs = self.functions(len(inputs), torch.Generator().manual_seed(FIT_SEED))(inputs)
        if not inputs.isfinite().all() or not outputs.isnan().any():
            return ""
        return f"{'sample' if _has(self.own, 'sample') else 'moments'}() of the model returned nan"

    @property
    def noise(self) -> Tensor:
        """Variances (E,) of what no function explains; ValueError where they have another shape."""
        found = getattr(self.own, "noise", None)
        if found is None:
            return torch.zeros(self.num_outputs, dtype=torch.float64)
        check_tensor("noise of the model", found, (self.num_outputs,))
        return found.double()

    def _by_moments(self, count: int, generator: torch.Generator) -> Functions:
        """Functions that keep their distance from the mean, in standard deviations."""
        white = normal((count, self.num_outputs), self.train_targets, generator)

        def of_moments(inputs: Tensor) -> Tensor:
            mean, variance = self._moments(inputs)
            apart = white.reshape(count, *[1] * (inputs.ndim - 2), -1)
            return mean + variance.sqrt() * apart

        return of_moments

    def _moments(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        found = self.own.moments(inputs)
        if not (isinstance(found, tuple) and len(found) == 2):
            raise TypeError(
                f"moments() of the model must return mean and variance, got {type(found).__name__}"
            )
        mean, variance = (self._as_wanted("moments()", part, inputs) for part in found)
        _check_slope("the mean of moments()", mean, inputs)
        if (variance < 0).any():
            least = variance.min().item()
            raise ValueError(f"moments() of the model must give variances, got {least:g}")
        # a slope of the root that is finite where nothing is uncertain
        return mean, variance.clamp(min=torch.finfo(variance.dtype).tiny)

    def _as_wanted(self, what: str, outputs: object, inputs: Tensor) -> Tensor:
        """Outputs (*batch, E) at inputs (*batch, D' + F), in float64."""
        wanted = (*inputs.shape[:-1], self.num_outputs)
        if not isinstance(outputs, Tensor) or outputs.shape != wanted:
            found = tuple(outputs.shape) if isinstance(outputs, Tensor) else type(outputs).__name__
            raise ValueError(
                f"{what} of the model must give a tensor {wanted} at inputs "
                f"{tuple(inputs.shape)}, got {found}"
            )
        return outputs.double()


def _check_slope(what: str, outputs: Tensor, inputs: Tensor) -> None:
    """Raise ValueError if a search would find no slope in a model."""
    if inputs.requires_grad and torch.is_grad_enabled() and not outputs.requires_grad:
        raise ValueError(
            f"{what} of the model must be differentiable in the inputs, got numbers without a "
            "gradient"
        )


def check_own_model(model: object) -> None:
    """Raise TypeError unless an object has the methods of a model, and can be copied."""
    if isinstance(model, type):
        raise TypeError(f"model must be an object, got the class {model.__name__}: call it first")
    known = [name for name in ("fit", "sample", "moments") if _has(model, name)]
    if "fit" not in known or len(known) < 2:
        raise TypeError(
            "model must have the methods fit(inputs, targets), and sample(count, generator) or "
            f"moments(inputs), got {type(model).__name__} with {', '.join(known) or 'none of them'}"
        )
    try:
        copy.deepcopy(model)
    except (TypeError, RuntimeError, NotImplementedError) as error:
        raise TypeError(f"model must be one that copy.deepcopy can copy, got {error}") from error


def _has(model: object, method: str) -> bool:
    return callable(getattr(model, method, None))
