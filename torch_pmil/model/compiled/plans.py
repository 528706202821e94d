"""What the kernels are asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.rbf_policy import Controller
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.trigonometry import Augmentation


@dataclass(frozen=True, eq=False)
class Plan:
    """What a trajectory is predicted with."""

    model: KernelExpansion  # posterior of the forward model
    known: KnownPart
    space: StateSpace
    controller: Controller
    horizon: int  # T
    observation_noise: bool = True  # whether the states' variances hold the model's noise


class Drawn(Protocol):
    """Functions drawn from a posterior, as :class:`FunctionSamples` holds them."""

    @property
    def expansion(self) -> KernelExpansion:
        """The posterior."""

    @property
    def frequencies(self) -> Tensor:
        """(E, J, D' + F)."""

    @property
    def weights(self) -> Tensor:
        """Of cosines and sines, (N, E, 2 J)."""

    @property
    def updates(self) -> Tensor:
        """Weights of the data, (N, E, n)."""


@dataclass(frozen=True, eq=False)
class Comparison:
    r"""What states are compared with: :math:`r = A\,[x, \sin(\cdot), \cos(\cdot)] + a`."""

    augmentation: Augmentation  # sines and cosines of the state
    matrix: Tensor  # A, (M, R)
    offset: Tensor  # a, (*batch, T, M)
    noise: Tensor  # covariance added to that of r, (M, M)
    # covariances of the demonstrated marginals, (*batch, T, M, M), for their KL to N(r, cov); None
    # for the saturating cost of r
    demonstrated: Tensor | None
    cross_entropy: bool = False  # of N(r, cov) relative to these marginals, in place of their KL

    @property
    def tensors(self) -> list[Tensor]:
        """What kernels have no gradient in."""
        parts = self.matrix, self.offset, self.noise, self.demonstrated
        return [part for part in parts if part is not None]


# centres (m, D'), weights (m, F) and log widths (F, D') of a policy, or gradients in these
Parameters = tuple[Tensor, Tensor, Tensor]
# a sum of costs and its gradients; None where the formulas must say what is wrong
Objective = Callable[[Parameters], tuple[float, Parameters] | None]
