"""Forward models of one's own: a Matern kernel, known physics, an ensemble of networks.

Each is fitted to inputs (features of the state, then actions) and targets (by default the changes
of the state in one step). ``PMIL(..., model=Matern())`` then learns on it.

Example:
    >>> import torch
    >>> x = torch.linspace(-2, 2, 30, dtype=torch.float64)[:, None]
    >>> model = Matern()
    >>> model.fit(x, x.sin())
    >>> functions = model.sample(50, torch.Generator().manual_seed(0))
    >>> at_zero = functions(torch.zeros(50, 1, dtype=torch.float64))
    >>> at_zero.shape, bool(at_zero.mean().abs() < 0.05)
    (torch.Size([50, 1]), True)
"""

from __future__ import annotations

from collections.abc import Callable

import gpytorch
import torch
from torch import Tensor, nn

from torch_pmil import GPDynamics

STEPS = 200  # of Adam
WAVES = 100  # random features of the prior
MEMBERS = 5


class _ExactGP(gpytorch.models.ExactGP):
    def __init__(self, x: Tensor, y: Tensor) -> None:
        batch, kernels = y.shape[:1], gpytorch.kernels
        super().__init__(x, y, gpytorch.likelihoods.GaussianLikelihood(batch_shape=batch))
        matern = kernels.MaternKernel(nu=2.5, ard_num_dims=x.shape[-1], batch_shape=batch)
        self.mean_module = gpytorch.means.ZeroMean(batch_shape=batch)
        self.covar_module = kernels.ScaleKernel(matern, batch_shape=batch)

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


class Matern:
    """GPs of GPyTorch with a Matern kernel: what is learned need not be smooth."""

    def fit(self, inputs: Tensor, targets: Tensor) -> None:
        """Maximise the marginal likelihood of inputs (n, D) and targets (n, E), standardised."""
        self.middle, self.size, self.scale = inputs.mean(0), inputs.std(0), targets.std(0)
        self.x, self.y = (inputs - self.middle) / self.size, (targets / self.scale).mT
        gp = _ExactGP(self.x.expand(len(self.y), -1, -1), self.y).double()
        likelihood = gpytorch.mlls.ExactMarginalLogLikelihood(gp.likelihood, gp)
        adam = torch.optim.Adam(gp.parameters(), lr=0.1)
        for _ in range(STEPS):
            adam.zero_grad()
            (-likelihood(gp(*gp.train_inputs), self.y).sum()).backward()
            adam.step()
        kernel, noise = gp.covar_module, gp.likelihood.noise.detach()  # (E, 1)
        self.lengthscales = kernel.base_kernel.lengthscale.detach()  # (E, 1, D)
        self.signal = kernel.outputscale.detach()[:, None]  # (E, 1)
        noisy = self._kernel(self.x) + noise[..., None] * torch.eye(len(self.x))
        self.inverse = torch.linalg.inv(noisy)
        self.noise = noise[:, 0] * self.scale**2

    def sample(self, count: int, generator: torch.Generator) -> Callable[[Tensor], Tensor]:
        """Functions drawn by pathwise conditioning (Wilson et al. 2020)."""
        E, D, n = *self.lengthscales.shape[::2], len(self.x)

        def white(*shape: int) -> Tensor:
            return torch.randn(shape, dtype=torch.float64, generator=generator)

        # the spectrum of a Matern kernel of 5/2 is Student's t with five degrees of freedom
        wide = (white(E, WAVES, 1, 5).square().mean(-1)).rsqrt()
        waves = wide * white(E, WAVES, D) / self.lengthscales
        weights = (self.signal / WAVES).sqrt() * white(count, E, 2 * WAVES)

        def prior(phases: Tensor) -> Tensor:
            return torch.cat([phases.cos(), phases.sin()], -1)

        noise = (self.noise / self.scale**2).sqrt()[:, None]
        at_data = (prior(self.x @ waves.mT) @ weights.permute(1, 2, 0)).permute(2, 0, 1)
        left = self.y - at_data - noise * white(count, E, n)
        updates = (self.inverse @ left[..., None])[..., 0]  # (count, E, n)

        def functions(inputs: Tensor) -> Tensor:
            at = (inputs - self.middle) / self.size
            flat = at.reshape(-1, D)
            of_data = self._kernel(flat).unflatten(1, at.shape[:-1])  # (E, count, *batch, n)
            of_prior = prior(flat @ waves.mT).unflatten(1, at.shape[:-1])
            found = torch.einsum("en...i,nei->n...e", of_data, updates)
            return (found + torch.einsum("en...j,nej->n...e", of_prior, weights)) * self.scale

        return functions

    def _kernel(self, at: Tensor) -> Tensor:
        """Covariances (E, N, n) of inputs (N, D) and the data, with a fifth of GPyTorch's calls."""
        apart = (at / self.lengthscales)[:, :, None] - (self.x / self.lengthscales)[:, None]
        r = (5 * apart.square().sum(-1) + 1e-12).sqrt()  # with a slope at the data
        return self.signal[..., None] * (1 + r + r.square() / 3) * (-r).exp()


class WithPhysics:
    """Known physics, and a GP on what it leaves.

    Args:
        physics: of inputs (*batch, D), the targets (*batch, E) that it expects.
    """

    def __init__(self, physics: Callable[[Tensor], Tensor]) -> None:
        self.physics = physics

    def fit(self, inputs: Tensor, targets: Tensor) -> None:
        """Fit the GP to inputs (n, D) and what is left of targets (n, E)."""
        self.gp = GPDynamics(inputs.shape[1], targets.shape[1])
        self.gp.fit(inputs, targets - self.physics(inputs))
        self.noise = self.gp.noise

    def sample(self, count: int, generator: torch.Generator) -> Callable[[Tensor], Tensor]:
        """Functions of the GP, around the physics."""
        left = self.gp.functions(count, generator)
        return lambda inputs: self.physics(inputs) + left(inputs)


class Ensemble:
    """Networks, each of which learned from a resampled set of the data."""

    def fit(self, inputs: Tensor, targets: Tensor) -> None:
        """Fit each network to inputs (n, D) and targets (n, E), standardised."""
        self.middle, self.size, self.scale = inputs.mean(0), inputs.std(0), targets.std(0)
        x, y = (inputs - self.middle) / self.size, targets / self.scale
        D, E, self.members = x.shape[1], y.shape[1], list[nn.Module]()
        for _ in range(MEMBERS):
            layers = nn.Linear(D, 32), nn.SiLU(), nn.Linear(32, 32), nn.SiLU(), nn.Linear(32, E)
            member, drawn = nn.Sequential(*layers).double(), torch.randint(len(x), (len(x),))
            adam = torch.optim.Adam(member.parameters(), lr=0.01, weight_decay=1e-4)
            for _ in range(STEPS):
                adam.zero_grad()
                (member(x[drawn]) - y[drawn]).square().mean().backward()
                adam.step()
            self.members.append(member.requires_grad_(False))

    def sample(self, count: int, generator: torch.Generator) -> Callable[[Tensor], Tensor]:
        """Functions that are members of the ensemble, in equal parts."""

        def functions(inputs: Tensor) -> Tensor:
            parts = ((inputs - self.middle) / self.size).tensor_split(MEMBERS)
            found = [member(part) for member, part in zip(self.members, parts, strict=True)]
            return torch.cat(found) * self.scale

        return functions
