"""The robot's forward model: one exact GP for each entry of the state (Eqs. 2-7), learned with GPyTorch."""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import dataclass
from typing import Literal

import gpytorch
import torch
from gpytorch.constraints import Positive
from linear_operator.utils.errors import NanError, NotPSDError
from linear_operator.utils.warnings import NumericalWarning
from torch import Tensor, nn

from torch_pmil.kernel_expansion import KernelExpansion

Targets = Literal["difference", "successor"]

MAX_SIGNAL_TO_NOISE = 500.0  # PILCO's penalties: beyond this ratio of standard deviations, and
MAX_LENGTHSCALE_RATIO = 100.0  # beyond this factor from the inputs' spread, the likelihood is bent down
PENALTY_POWER = 30


class _BatchGP(gpytorch.models.ExactGP):
    """E independent GPs on the same inputs; raw parameters are logarithms, as in PILCO."""

    def __init__(self, inputs: Tensor, targets: Tensor) -> None:
        batch = targets.shape[:-1]
        log = {"transform": torch.exp, "inv_transform": torch.log}
        likelihood = gpytorch.likelihoods.GaussianLikelihood(batch_shape=batch, noise_constraint=Positive(**log))
        super().__init__(inputs, targets, likelihood)
        self.mean_module = gpytorch.means.ZeroMean(batch_shape=batch)
        rbf = gpytorch.kernels.RBFKernel(ard_num_dims=inputs.shape[-1], batch_shape=batch, lengthscale_constraint=Positive(**log))
        self.covar_module = gpytorch.kernels.ScaleKernel(rbf, batch_shape=batch, outputscale_constraint=Positive(**log))

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


@dataclass(frozen=True)
class FitResult:
    """How the hyper-parameters were found: negative log marginal likelihood per output (nats, (E,)), work done, why it ended."""

    negative_log_likelihood: Tensor
    evaluations: int
    seconds: float
    stop_reason: str


class GPDynamics(nn.Module):
    r"""GP model of :math:`x_{t+1}` given features of the state and the action (Eqs. 2-7).

    Hyper-parameters are in physical units: lengthscales in those of the inputs, signal and noise variance in the squared
    units of the targets. They are the ``lengthscale``, ``outputscale`` and ``noise`` of the GPyTorch model :attr:`gp`.

    Args:
        num_inputs: D' + F, features and actions.
        num_outputs: D, entries of the state.
        targets: "difference" learns x_{t+1} - x_t (the prior then means "stays where it is"), "successor" x_{t+1} (Eq. 2).

    Example:
        >>> X = torch.linspace(-2, 2, 20, dtype=torch.float64)[:, None]
        >>> model = GPDynamics(num_inputs=1, num_outputs=1)
        >>> result = model.fit(X, X.sin())
        >>> mean, variance = model.expansion.predict(torch.zeros(1, dtype=torch.float64))
        >>> bool(mean.abs() < 1e-2)
        True
    """

    def __init__(self, num_inputs: int, num_outputs: int, targets: Targets = "difference") -> None:
        super().__init__()
        if targets not in ("difference", "successor"):
            raise ValueError(f'targets must be "difference" or "successor", got {targets!r}')
        self.num_inputs, self.num_outputs, self.targets = num_inputs, num_outputs, targets
        self.gp = _BatchGP(torch.zeros(num_outputs, 1, num_inputs), torch.zeros(num_outputs, 1)).double()
        self.register_buffer("train_inputs", torch.zeros(0, num_inputs, dtype=torch.float64))
        self.register_buffer("train_targets", torch.zeros(0, num_outputs, dtype=torch.float64))
        self._expansion: KernelExpansion | None = None

    @property
    def expansion(self) -> KernelExpansion:
        """The posterior with its cached K^-1 and beta; constant, without a graph. Raises RuntimeError before any data."""
        if self._expansion is None:
            if len(self.train_inputs) == 0:
                raise RuntimeError("the dynamics model has no data yet: call fit(inputs, targets) first")
            with torch.no_grad():
                self._expansion = KernelExpansion.from_exact_gp(self.gp)
        return self._expansion

    def set_data(self, inputs: Tensor, targets: Tensor) -> None:
        """Take data (n, D' + F) and (n, D) and keep the hyper-parameters.

        Raises:
            ValueError: shapes do not fit, or an entry is not finite.
        """
        self._check_data(inputs, targets)
        self.train_inputs, self.train_targets = inputs.detach().double(), targets.detach().double()
        self.gp.set_train_data(self.train_inputs.expand(self.num_outputs, -1, -1), self.train_targets.mT.contiguous(), strict=False)
        self._expansion = None

    def fit(self, inputs: Tensor, targets: Tensor, max_iterations: int = 100) -> FitResult:
        """Maximise the marginal likelihood of the data with L-BFGS, from PILCO's start and from the last optimum.

        PILCO's start: lengthscales std(input), signal std(target), noise a tenth of it. Its penalties keep the
        signal-to-noise ratio below about 500 and the lengthscales within a factor 100 of std(input). Each output keeps
        the better of its starts.

        Args:
            inputs: features and actions (n, D' + F).
            targets: differences or successors (n, D), as the class was told.
            max_iterations: of L-BFGS, for each start.

        Raises:
            ValueError: shapes do not fit, or an entry is not finite, or fewer than two data.
        """
        start_time = time.perf_counter()
        warm = len(self.train_inputs) > 0
        previous = self._log_parameters()
        self.set_data(inputs, targets)
        starts = [_pilco_start(self.train_inputs, self.train_targets, noise_ratio) for noise_ratio in (0.1, 0.01)]
        runs = [self._fit_from(start, max_iterations) for start in ([previous] if warm else []) + starts]
        losses = torch.stack([loss for _, loss, _ in runs])
        best = losses.argmin(0)
        chosen = [torch.stack(options)[best, range(self.num_outputs)] for options in zip(*(p for p, _, _ in runs), strict=True)]
        self._set_log_parameters(chosen)
        evaluations = sum(count for _, _, count in runs)
        return FitResult(losses.amin(0), evaluations, time.perf_counter() - start_time, f"best of {len(runs)} starts")

    def _fit_from(self, start: list[Tensor], max_iterations: int) -> tuple[list[Tensor], Tensor, int]:
        self._set_log_parameters(start)
        spread = self.train_inputs.std(0).clamp(min=1e-6).log()
        optimizer = torch.optim.LBFGS(
            self._raw_parameters(), max_iter=max_iterations, max_eval=2 * max_iterations, line_search_fn="strong_wolfe"
        )
        best: list = [math.inf, start, torch.full((self.num_outputs,), math.inf, dtype=torch.float64)]
        evaluations = 0

        def closure() -> Tensor:
            nonlocal evaluations
            evaluations += 1
            optimizer.zero_grad()
            try:
                losses = self._negative_log_likelihood() + self._penalty(spread)
                total = losses.sum()
                total.backward()
            except (NumericalWarning, NotPSDError, NanError):
                return _reject(self._raw_parameters())
            if not total.isfinite():
                return _reject(self._raw_parameters())
            if total.item() < best[0]:
                best[:] = [total.item(), self._log_parameters(), losses.detach()]
            return total

        optimizer.step(closure)
        return best[1], best[2], evaluations

    def _negative_log_likelihood(self) -> Tensor:
        """-log p(y | X) of each output, (E,), nats."""
        self.gp.train()
        exact = gpytorch.settings.fast_computations(covar_root_decomposition=False, log_prob=False, solves=False)
        with exact, warnings.catch_warnings():
            warnings.simplefilter("error", NumericalWarning)  # a jittered likelihood is another likelihood
            prior = self.gp(*self.gp.train_inputs)
            return -self.gp.likelihood(prior).log_prob(self.gp.train_targets)

    def _penalty(self, log_spread: Tensor) -> Tensor:
        log_lengthscale, log_signal, log_noise = self._raw_parameters()
        ratio = (log_signal - log_noise.squeeze(-1)) / 2 / math.log(MAX_SIGNAL_TO_NOISE)
        length = (log_lengthscale.squeeze(-2) - log_spread) / math.log(MAX_LENGTHSCALE_RATIO)
        return ratio**PENALTY_POWER + (length**PENALTY_POWER).sum(-1)

    def _raw_parameters(self) -> list[Tensor]:
        kernel = self.gp.covar_module
        return [kernel.base_kernel.raw_lengthscale, kernel.raw_outputscale, self.gp.likelihood.noise_covar.raw_noise]

    def _log_parameters(self) -> list[Tensor]:
        return [parameter.detach().clone() for parameter in self._raw_parameters()]

    def _set_log_parameters(self, values: list[Tensor]) -> None:
        with torch.no_grad():
            for parameter, value in zip(self._raw_parameters(), values, strict=True):
                parameter.copy_(value)
        self._expansion = None

    def _check_data(self, inputs: Tensor, targets: Tensor) -> None:
        n = len(inputs)
        if inputs.shape != (n, self.num_inputs) or targets.shape != (n, self.num_outputs) or n < 2:
            raise ValueError(
                f"expected inputs (n, {self.num_inputs}) and targets (n, {self.num_outputs}) with n >= 2, "
                f"got {tuple(inputs.shape)} and {tuple(targets.shape)}"
            )
        for name, values in (("inputs", inputs), ("targets", targets)):
            if not values.isfinite().all():
                row, column = (~values.isfinite()).nonzero()[0].tolist()
                raise ValueError(f"{name} must be finite, got {values[row, column]} in row {row}, column {column}")

    def _load_from_state_dict(self, state_dict, prefix, *args) -> None:
        inputs, targets = state_dict.get(prefix + "train_inputs"), state_dict.get(prefix + "train_targets")
        if inputs is not None and targets is not None and len(inputs):
            self.set_data(inputs, targets)
        super()._load_from_state_dict(state_dict, prefix, *args)
        self._expansion = None


def _pilco_start(inputs: Tensor, targets: Tensor, noise_ratio: float) -> list[Tensor]:
    """Log lengthscales (E, 1, D), log signal variance (E,), log noise variance (E, 1)."""
    outputs = targets.shape[-1]
    length = inputs.std(0).clamp(min=1e-6).log().expand(outputs, 1, -1)
    signal = 2 * targets.std(0).clamp(min=1e-12).log()
    return [length.clone(), signal, (signal + 2 * math.log(noise_ratio))[:, None]]


def _reject(parameters: list[Tensor]) -> Tensor:
    """A large loss with zero gradient, at which a strong-Wolfe line search steps back."""
    for parameter in parameters:
        parameter.grad = torch.zeros_like(parameter)
    return torch.tensor(1e10, dtype=torch.float64)
