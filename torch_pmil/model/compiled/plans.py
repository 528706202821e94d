"""What the kernels are asked for."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.rbf_policy import Controller
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.trigonometry import Augmentation


@dataclass(frozen=True, eq=False)
class Plan:
    """What a trajectory is predicted with.

    Args:
        model: the forward model's posterior.
        known: what is known of the next state besides.
        space: the robot's state space.
        controller: the policy's controller.
        horizon: T.
        observation_noise: whether the states' variances hold the model's noise.
    """

    model: KernelExpansion
    known: KnownPart
    space: StateSpace
    controller: Controller
    horizon: int
    observation_noise: bool = True


@dataclass(frozen=True, eq=False)
class Comparison:
    r"""What predicted states are compared with: :math:`r = A\,[x, \sin(\cdot), \cos(\cdot)] + a`.

    Args:
        augmentation: sines and cosines of the state.
        matrix: A, (M, R).
        offset: a, (\*batch, T, M).
        noise: covariance added to that of r, (M, M).
        demonstrated: covariances of the demonstrated marginals, (\*batch, T, M, M), for their KL to
            N(r, cov); None for the saturating cost of r.
    """

    augmentation: Augmentation
    matrix: Tensor
    offset: Tensor
    noise: Tensor
    demonstrated: Tensor | None

    @property
    def tensors(self) -> list[Tensor]:
        """What kernels have no gradient in."""
        parts = self.matrix, self.offset, self.noise, self.demonstrated
        return [part for part in parts if part is not None]
