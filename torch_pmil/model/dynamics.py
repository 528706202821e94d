"""The robot's forward model: one GP for each entry of the state (Eqs. 2-7), with GPyTorch."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

import gpytorch
import torch
from gpytorch.constraints import Positive
from torch import Tensor

from torch_pmil.checks import check_whole
from torch_pmil.gp.gaussian import NotPositiveDefiniteError
from torch_pmil.gp.hyperparameters import (
    MOST_SIGNAL_TO_NOISE,
    Optimum,
    find_hyperparameters,
    of_outputs,
    pilco_starts,
)
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.lbfgs import NotFiniteError
from torch_pmil.gp.sparse_posterior import inducing_data, sparse_posterior
from torch_pmil.model.forward_model import FitResult, ForwardModel, Targets
from torch_pmil.model.function_samples import FunctionSamples

RESTART_GROWTH = 1.25  # of the data, after which all starts are searched again
MOST_EXACT = 1000  # data of an exact posterior
INDUCING = 200  # inducing inputs of a sparse one
SEARCHED_DATA = 500  # data from which its hyper-parameters are searched
# variance at the inducing inputs, over that of the noise: far less than the noise of a datum
INDUCING_RIDGE = 1e-4


class _BatchGP(gpytorch.models.ExactGP):
    """E independent GPs on the same inputs; raw parameters are logarithms, as in PILCO."""

    def __init__(self, inputs: Tensor, targets: Tensor) -> None:
        batch = targets.shape[:-1]
        log = {"transform": torch.exp, "inv_transform": torch.log}
        likelihood = gpytorch.likelihoods.GaussianLikelihood(
            batch_shape=batch, noise_constraint=Positive(**log)
        )
        super().__init__(inputs, targets, likelihood)
        self.mean_module = gpytorch.means.ZeroMean(batch_shape=batch)
        rbf = gpytorch.kernels.RBFKernel(
            ard_num_dims=inputs.shape[-1], batch_shape=batch, lengthscale_constraint=Positive(**log)
        )
        self.covar_module = gpytorch.kernels.ScaleKernel(
            rbf, batch_shape=batch, outputscale_constraint=Positive(**log)
        )

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


class GPDynamics(ForwardModel):
    r"""GP model of :math:`x_{t+1}` given features of the state and the action (Eqs. 2-7).

    Hyper-parameters, in the units of inputs and squared targets, are the ``lengthscale``,
    ``outputscale`` and ``noise`` of the GPyTorch model ``gp``.

    Args:
        num_inputs, num_outputs, targets: as in :class:`ForwardModel`.
        most_signal_to_noise: ratio of standard deviations beyond which a fit is penalised, since
            the rounding of moments grows with its square.
        most_exact: number of data up to which the posterior is exact. Beyond, it is sparse
            (:mod:`torch_pmil.gp.sparse_posterior`): inducing inputs come from ``most_exact`` data,
            hyper-parameters from ``SEARCHED_DATA``, evenly chosen.
        num_inducing: number of inducing inputs of the sparse posterior.
        tied_lengthscales: whether all outputs share their lengthscales. The kernels then predict
            several times as fast: one exponential for each pair of data serves all outputs.

    Example:
        >>> X = torch.linspace(-2, 2, 20, dtype=torch.float64)[:, None]
        >>> model = GPDynamics(num_inputs=1, num_outputs=1)
        >>> result = model.fit(X, X.sin())
        >>> mean, variance = model.expansion.predict(torch.zeros(1, dtype=torch.float64))
        >>> bool(mean.abs() < 1e-2)
        True
    """

    searched_size: Tensor

    def __init__(
        self,
        num_inputs: int,
        num_outputs: int,
        targets: Targets = "difference",
        most_signal_to_noise: float = MOST_SIGNAL_TO_NOISE,
        most_exact: int = MOST_EXACT,
        num_inducing: int = INDUCING,
        tied_lengthscales: bool = False,
    ) -> None:
        super().__init__(num_inputs, num_outputs, targets)
        check_whole("num_inducing", num_inducing, 1)
        check_whole("most_exact", most_exact, num_inducing)
        self.most_signal_to_noise = most_signal_to_noise
        self.most_exact, self.num_inducing = most_exact, num_inducing
        self.tied_lengthscales = tied_lengthscales
        self.gp = _BatchGP(
            torch.zeros(num_outputs, 1, num_inputs), torch.zeros(num_outputs, 1)
        ).double()
        # number of data at the last fit from all starts
        self.register_buffer("searched_size", torch.tensor(0))
        self._expansion: KernelExpansion | None = None

    @property
    def expansion(self) -> KernelExpansion:
        """The posterior with its cached K^-1 and beta, without graph; RuntimeError before data."""
        if self._expansion is None:
            self.check_has_data()
            exact = KernelExpansion.from_exact_gp
            with torch.no_grad():
                self._expansion = self._sparse_expansion() if self.sparse else exact(self.gp)
        return self._expansion

    @property
    def sparse(self) -> bool:
        """Whether the data are too many for an exact posterior."""
        return len(self.train_inputs) > self.most_exact

    def _sparse_expansion(self) -> KernelExpansion:
        *kernel, noise = (parameter.exp() for parameter in self._raw_parameters())
        lengthscales, signal, noise = kernel[0], kernel[1][:, 0], noise[:, 0]
        few = self.train_inputs[self._even(self.most_exact)]
        chosen = inducing_data(few, lengthscales, signal, noise, self.num_inducing)
        data = self.train_inputs, self.train_targets.mT, few[chosen]
        return sparse_posterior(*data, lengthscales, signal, noise, INDUCING_RIDGE * noise)

    def _even(self, most: int) -> Tensor:
        """Indices of at most so many data, evenly chosen."""
        n = len(self.train_inputs)
        return torch.linspace(0, n - 1, min(n, most), dtype=torch.float64).round().long()

    def set_data(self, inputs: Tensor, targets: Tensor) -> None:
        """Take finite data (n, D' + F) and (n, E), and keep the hyper-parameters."""
        before = self.train_inputs, self.train_targets
        super().set_data(inputs, targets)
        if not self._continues(*before):
            self.searched_size.zero_()
        self.gp.set_train_data(
            self.train_inputs.expand(self.num_outputs, -1, -1),
            self.train_targets.mT.contiguous(),
            strict=False,
        )
        self._expansion = None

    @property
    def noise(self) -> Tensor:
        """Noise variances (E,)."""
        return self.expansion.noise

    @property
    def prior_variance(self) -> Tensor:
        """Signal variances (E,)."""
        return self.expansion.signal_variance

    @property
    def lengthscales(self) -> Tensor:
        """Lengthscales (E, D' + F)."""
        return self.expansion.lengthscales

    def predict(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """The posterior's mean and variance (*batch, E), without noise (Eqs. 6 and 7)."""
        return self.expansion.predict(inputs)

    def mean(self, inputs: Tensor) -> Tensor:
        """The posterior's mean (*batch, E), which costs O(n)."""
        return self.expansion.mean(inputs)

    def functions(self, count: int, generator: torch.Generator) -> FunctionSamples:
        """Functions drawn from the posterior, see :class:`FunctionSamples`."""
        return FunctionSamples.draw(self.expansion, self.sparse, count, generator)

    def fit(self, inputs: Tensor, targets: Tensor, max_iterations: int = 100) -> FitResult:
        """Maximise the marginal likelihood of each output by L-BFGS; tied outputs share a search.

        The starts are the last optimum and :func:`pilco_starts`; the best result is kept. The
        penalties are those of :mod:`torch_pmil.gp.hyperparameters`.

        Few data have several optima, and one of them may explain all motion as noise. Later fits,
        to data that continue the earlier ones, start from the last optimum alone. All starts are
        searched again once the data have grown by ``RESTART_GROWTH`` since the last full search.

        Args:
            inputs: features and actions (n, D' + F).
            targets: what is learned, (n, E), see the argument ``targets`` of the class.
            max_iterations: limit of L-BFGS for each start.

        Raises:
            ValueError: shapes do not fit, an entry is not finite, or fewer than two data.
            NotPositiveDefiniteError, NotFiniteError: the likelihood has no value at any start.
        """
        check_whole("max_iterations", max_iterations, 1)
        start_time = time.perf_counter()
        fitted = len(self.train_inputs) > 0
        self.set_data(inputs, targets)
        restarted = len(inputs) >= RESTART_GROWTH * self.searched_size.item()
        size = self.num_outputs if self.tied_lengthscales else 1
        optima = [
            self._find(outputs, fitted, restarted, max_iterations)
            for outputs in torch.arange(self.num_outputs).split(size)
        ]
        found = [of_outputs(optimum.log_parameters, self.num_inputs) for optimum in optima]
        self._set_log_parameters(torch.cat(found))
        if restarted:
            self.searched_size.fill_(len(inputs))
        nats = [optimum.negative_log_likelihood for optimum in optima]
        return FitResult(
            negative_log_likelihood=torch.cat(nats),
            evaluations=size * sum(optimum.evaluations for optimum in optima),
            seconds=time.perf_counter() - start_time,
            stop_reason=tuple(optimum.stop_reason for optimum in optima for _ in range(size)),
        )

    def _find(self, outputs: Tensor, fitted: bool, restarted: bool, max_iterations: int) -> Optimum:
        """Hyper-parameters of outputs, from the last ones alone unless ``restarted`` or failed."""
        limits = max_iterations, self.most_signal_to_noise
        known = self._even(SEARCHED_DATA if self.sparse else self.most_exact)
        inputs, targets = self.train_inputs[known], self.train_targets[known][:, outputs]
        before = self._log_parameters()[outputs]
        last = torch.cat([before[:, :-2].mean(0), before[:, -2], before[:, -1]])
        if not restarted:
            # new data may contradict the last model
            with contextlib.suppress(NotPositiveDefiniteError, NotFiniteError):
                return find_hyperparameters(inputs, targets, [last], *limits)
        starts = ([last] if fitted else []) + pilco_starts(inputs, targets)
        return find_hyperparameters(inputs, targets, starts, *limits)

    def _continues(self, inputs: Tensor, targets: Tensor) -> bool:
        """Whether the data begin with these."""
        n = len(inputs)
        same_inputs = torch.equal(self.train_inputs[:n], inputs)
        return same_inputs and torch.equal(self.train_targets[:n], targets)

    def _raw_parameters(self) -> list[Tensor]:
        """Logarithms of lengthscales (E, D), signal and noise variances (E, 1), as views."""
        kernel, noise = self.gp.covar_module, self.gp.likelihood.noise_covar
        raw = kernel.base_kernel.raw_lengthscale, kernel.raw_outputscale, noise.raw_noise
        return [parameter.detach().view(self.num_outputs, -1) for parameter in raw]

    def _log_parameters(self) -> Tensor:
        """Log parameters of every output, (E, D + 2), as in torch_pmil.gp.hyperparameters."""
        return torch.cat(self._raw_parameters(), -1)

    def _set_log_parameters(self, values: Tensor) -> None:
        parts = values.split([self.num_inputs, 1, 1], -1)
        for parameter, value in zip(self._raw_parameters(), parts, strict=True):
            parameter.copy_(value)

    def _apply(self, function: Callable[[Tensor], Tensor], recurse: bool = True) -> GPDynamics:
        self._expansion = None  # on the former device
        return super()._apply(function, recurse)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        super()._load_from_state_dict(state_dict, prefix, *args)
        self._expansion = None
