"""Gaussian integrals of kernels as the paper writes them, and Gauss-Hermite quadrature."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.kernel_expansion import KernelExpansion


def hermite_grid(belief: Gaussian, order: int = 80) -> tuple[Tensor, Tensor]:
    """Points (order^D, D) and weights of Gauss-Hermite quadrature over one belief."""
    D = belief.dim
    nodes, weights = (torch.as_tensor(a) for a in np.polynomial.hermite_e.hermegauss(order))
    white, w = (torch.cartesian_prod(*[t] * D).reshape(-1, D) for t in (nodes, weights))
    points = belief.mean + white @ torch.linalg.cholesky(belief.cov).mT
    return points, w.prod(-1) / (2 * torch.pi) ** (D / 2)


def textbook_q(f: KernelExpansion, a: int, mu: np.ndarray, Sigma: np.ndarray) -> np.ndarray:
    """Eq. 15, (n,)."""
    Lambda, x = np.diag(f.lengthscales[a].numpy() ** 2), f.inputs.numpy()
    det = np.linalg.det(Sigma @ np.linalg.inv(Lambda) + np.eye(len(mu)))
    forms = np.array([nu @ np.linalg.solve(Sigma + Lambda, nu) for nu in x - mu])
    return f.signal_variance[a].item() / np.sqrt(det) * np.exp(-forms / 2)


def textbook_Q(f: KernelExpansion, a: int, b: int, mu: np.ndarray, Sigma: np.ndarray) -> np.ndarray:
    """Eq. 17 for two outputs with their own alpha and Lambda, (n, n)."""
    inverse_a, inverse_b = (np.diag(f.lengthscales[o].numpy() ** -2) for o in (a, b))
    nu, R = f.inputs.numpy() - mu, Sigma @ (inverse_a + inverse_b) + np.eye(len(mu))

    def element(i: int, j: int) -> float:
        z = inverse_a @ nu[i] + inverse_b @ nu[j]
        kernels = -(nu[i] @ inverse_a @ nu[i] + nu[j] @ inverse_b @ nu[j]) / 2
        return np.exp(kernels + z @ np.linalg.solve(R, Sigma @ z) / 2) / np.sqrt(np.linalg.det(R))

    factor = (f.signal_variance[a] * f.signal_variance[b]).item()
    return factor * np.array([[element(i, j) for j in range(len(nu))] for i in range(len(nu))])
