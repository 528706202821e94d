"""Gaussian beliefs, which predictions, demonstrations and policies exchange, and their moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torch_pmil.checks import check_finite_entries, check_whole

# part of its largest entry by which a covariance may be asymmetric, or an eigenvalue negative
NEGLIGIBLE = 1e-5


class NotPositiveDefiniteError(ValueError):
    """A matrix that must be positive definite is not; ``element`` is its index in the batch."""

    def __init__(self, message: str, element: tuple[int, ...] = ()) -> None:
        super().__init__(message)
        self.element = element


def symmetric(matrix: Tensor) -> Tensor:
    """Symmetric part of a matrix (*batch, D, D)."""
    return (matrix + matrix.mT) / 2


def cholesky(matrix: Tensor, name: str) -> Tensor:
    """Lower Cholesky factor of a matrix (*batch, D, D), without jitter.

    Raises:
        NotPositiveDefiniteError: gives ``name``, batch element and extreme eigenvalues.
    """
    try:
        return torch.linalg.cholesky(matrix)
    except torch.linalg.LinAlgError:
        element = tuple(torch.linalg.cholesky_ex(matrix).info.nonzero()[0].tolist())
        raise NotPositiveDefiniteError(
            _describe_failure(matrix.detach()[element], element, name), element
        ) from None


def _describe_failure(failed: Tensor, element: tuple[int, ...], name: str) -> str:
    where = f" at batch element {element}" if element else ""
    if not failed.isfinite().all():
        return f"{name} must be positive definite, got a matrix that is not finite{where}"
    eigenvalues = torch.linalg.eigvalsh(failed)
    return (
        f"{name} must be positive definite, got eigenvalues from {eigenvalues[0]:.3g} to "
        f"{eigenvalues[-1]:.3g}{where}"
    )


def check_belief(
    belief: Gaussian, name: str, like: Tensor | None = None, floor: Tensor | float = 0.0
) -> None:
    """Raise if this is not a valid belief.

    Args:
        belief: any batch shape. Its covariance may be singular, and valid but for rounding.
        name: of the belief, for the error.
        like: a tensor with the dtype that mean and covariance must have; any float if None.
        floor: a variance that does not count.

    Raises:
        TypeError: it is not a Gaussian.
        ValueError: the mean is not finite, or a dtype is wrong.
        NotPositiveDefiniteError: the covariance is not finite, not symmetric, or has a clearly
            negative eigenvalue.
    """
    check_moments(belief, name, like, floor)
    cov = belief.cov.detach()
    if cov.numel():
        values = torch.linalg.eigvalsh(cov)[..., 0]
        if (negative := values < -_negligible(cov, floor)).any():
            element = tuple(negative.nonzero()[0].tolist())
            raise NotPositiveDefiniteError(
                _describe_failure(cov[element], element, f"covariance of {name}"), element
            )


def check_moments(
    belief: Gaussian, name: str, like: Tensor | None = None, floor: Tensor | float = 0.0
) -> None:
    """:func:`check_belief` without the eigenvalues, for what a Cholesky factor checks anyway."""
    if not isinstance(belief, Gaussian):
        raise TypeError(f"{name} must be a Gaussian, got {type(belief).__name__}")
    mean, cov = belief.mean.detach(), belief.cov.detach()
    dtype = mean.dtype if like is None else like.dtype
    if not mean.dtype == cov.dtype == dtype:
        raise ValueError(
            f"{name} must have mean and covariance of {dtype}, got {mean.dtype} and {cov.dtype}"
        )
    if not mean.is_floating_point():
        raise ValueError(f"{name} must have mean and covariance of floats, got {mean.dtype}")
    check_finite_entries(f"mean of {name}", mean)
    check_finite_entries(
        f"covariance of {name}",
        cov,
        lambda message, entry: NotPositiveDefiniteError(message, entry[:-2]),
    )
    if cov.numel():
        difference = (cov - cov.mT).abs().amax((-2, -1))
        if (asymmetric := difference > _negligible(cov, floor)).any():
            raise NotPositiveDefiniteError(
                f"covariance of {name} must be symmetric, got entries that differ by "
                f"{difference.max():.3g} from their mirror images",
                tuple(asymmetric.nonzero()[0].tolist()),
            )


def _negligible(cov: Tensor, floor: Tensor | float) -> Tensor:
    """How far rounding may change each of the covariances (*batch, D, D), (*batch)."""
    return NEGLIGIBLE * cov.abs().amax((-2, -1)) + floor


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A Gaussian N(mean, cov), or a batch of them.

    Args:
        mean: (*batch, D), in the units of the variable.
        cov: (*batch, D, D), symmetric and positive semi-definite (it may be zero).

    Raises:
        TypeError: one of the two is not a tensor.
        ValueError: shapes do not fit each other.

    Example:
        >>> belief = Gaussian(torch.zeros(3, 2), torch.eye(2).expand(3, 2, 2))
        >>> belief.dim, belief.batch_shape
        (2, torch.Size([3]))
    """

    mean: Tensor  # (*batch, D)
    cov: Tensor  # (*batch, D, D)

    def __post_init__(self) -> None:
        if not (isinstance(self.mean, Tensor) and isinstance(self.cov, Tensor)):
            raise TypeError(
                f"mean and cov must be tensors, got {type(self.mean).__name__} and "
                f"{type(self.cov).__name__}"
            )
        expected = (*self.mean.shape, self.mean.shape[-1]) if self.mean.ndim else ()
        if self.mean.ndim == 0 or self.cov.shape != expected:
            raise ValueError(
                f"cov must have shape (*batch, D, D) = {expected} for a mean of shape "
                f"{tuple(self.mean.shape)}, got {tuple(self.cov.shape)}"
            )

    @property
    def dim(self) -> int:
        """Number of entries D of the variable."""
        return self.mean.shape[-1]

    @property
    def batch_shape(self) -> torch.Size:
        """Leading shape, without the variable's own axis."""
        return self.mean.shape[:-1]

    @property
    def std(self) -> Tensor:
        """Standard deviations of the entries, (*batch, D)."""
        return self.cov.diagonal(dim1=-2, dim2=-1).clamp(min=0).sqrt()

    @property
    def flattened(self) -> Gaussian:
        """These beliefs with a single batch dimension."""
        if self.mean.ndim == 2:
            return self
        return Gaussian(self.mean.reshape(-1, self.dim), self.cov.reshape(-1, self.dim, self.dim))

    def __getitem__(self, index: Any) -> Gaussian:
        """Part of the batch."""
        return Gaussian(self.mean[index], self.cov[index])

    def detach(self) -> Gaussian:
        """This belief without its graph."""
        return Gaussian(self.mean.detach(), self.cov.detach())

    def marginal(self, index: Tensor) -> Gaussian:
        """Belief over the entries ``index`` (K,), in that order."""
        return Gaussian(self.mean[..., index], self.cov[..., index, :][..., index])

    def affine(self, matrix: Tensor, offset: Tensor | float = 0.0) -> Gaussian:
        """Belief over ``matrix @ x + offset``, with matrix (M, D) and offset (M,)."""
        return Gaussian(self.mean @ matrix.mT + offset, matrix @ self.cov @ matrix.mT)

    def add_noise(self, variance: Tensor | float) -> Gaussian:
        """Belief over x plus independent noise of the given variance, a number or (*batch, D).

        Raises ValueError unless variances are finite and not negative, and fit the entries.
        """
        noise = torch.as_tensor(variance, dtype=self.mean.dtype, device=self.mean.device)
        fits = noise.shape in ((), self.mean.shape[-1:], self.mean.shape)
        if not (fits and ((noise >= 0) & (noise < torch.inf)).all()):
            raise ValueError(
                f"variance must be finite, not negative, and one number or {self.dim} for the "
                f"entries, got {noise.flatten()[:8].tolist()}"
            )
        return Gaussian(self.mean, self.cov + torch.diag_embed(noise.expand(self.mean.shape)))

    def sample(self, count: int, generator: torch.Generator | None = None) -> Tensor:
        """Draws, (count, *batch, D), also from a singular covariance, through its eigenvectors."""
        check_whole("count", count, 0)
        # eigenvectors have no sign of their own: those of the CPU give the same draws everywhere
        values, vectors = torch.linalg.eigh(self.cov.cpu())
        root = (vectors * values.clamp(min=0).sqrt()[..., None, :]).to(self.cov)
        white = normal((count, *self.mean.shape), self.mean, generator)
        return self.mean + (root @ white[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of f(x) when x is Gaussian and f an expansion of E outputs.

    Args:
        mean: (*batch, E), in the units of the outputs.
        cov: (*batch, E, E).
        inv_cov_cross_cov: Sigma_x^-1 cov(x, f), (*batch, D, E), finite where Sigma_x is singular;
            :meth:`cross_cov` is the covariance itself.
    """

    mean: Tensor  # (*batch, E)
    cov: Tensor  # (*batch, E, E)
    inv_cov_cross_cov: Tensor  # (*batch, D, E)

    @property
    def gaussian(self) -> Gaussian:
        """The Gaussian with this mean and covariance."""
        return Gaussian(self.mean, self.cov)

    def unflatten(self, batch_shape: torch.Size) -> Moments:
        """These moments with a batch shape in place of one batch dimension."""
        if len(batch_shape) == 1:
            return self
        flat = self.mean, self.cov, self.inv_cov_cross_cov
        return Moments(*(t.reshape(*batch_shape, *t.shape[1:]) for t in flat))

    def cross_cov(self, belief: Gaussian) -> Tensor:
        """Input-output covariance cov(x, f), (*batch, D, E), at the belief of these moments."""
        return belief.cov @ self.inv_cov_cross_cov


def normal(shape: Sequence[int], like: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Standard normal draws, like a tensor in dtype and device, drawn on the generator's device."""
    device = like.device if generator is None else generator.device
    return torch.randn(*shape, dtype=like.dtype, device=device, generator=generator).to(like.device)


def joint(x: Gaussian, y: Gaussian, cross_cov: Tensor) -> Gaussian:
    """Belief over [x, y] from its two marginals and cov(x, y), (*batch, D_x, D_y)."""
    rows = torch.cat([x.cov, cross_cov], -1), torch.cat([cross_cov.mT, y.cov], -1)
    return Gaussian(torch.cat([x.mean, y.mean], -1), torch.cat(rows, -2))


def apply(
    function: type[torch.autograd.Function], *arguments: object
) -> Tensor | tuple[Tensor, ...]:
    """``function.apply``, or only its ``forward`` (without context) where no graph is recorded."""
    return (function.apply if torch.is_grad_enabled() else function.forward)(*arguments)
