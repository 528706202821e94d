"""How well rollouts agree with what was predicted and with what was demonstrated."""

from __future__ import annotations

from torch import Tensor

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.gaussian import Gaussian


def two_sigma_coverage(predicted: Gaussian, executed: Tensor) -> float:
    """Fraction of executed entries inside the predicted mean plus or minus two standard deviations.

    Args:
        predicted: marginals at t = 1..T, mean (T, D).
        executed: rollouts x_0..x_T, (N, T + 1, D).

    Example:
        >>> import torch
        >>> still = Gaussian(torch.zeros(2, 1), torch.ones(2, 1, 1))
        >>> two_sigma_coverage(still, torch.tensor([[[0.0], [1.0], [3.0]]]))
        0.5
    """
    return within_two_sigma(predicted, executed).mean().item()


def two_sigma_coverage_by_entry(predicted: Gaussian, executed: Tensor) -> Tensor:
    """The same for each entry of the state, (D,).

    Example:
        >>> import torch
        >>> still = Gaussian(torch.zeros(1, 2), torch.eye(2)[None])
        >>> two_sigma_coverage_by_entry(still, torch.tensor([[[0.0, 0.0], [1.0, 3.0]]]))
        tensor([1., 0.], dtype=torch.float64)
    """
    return within_two_sigma(predicted, executed).mean((0, 1))


def within_two_sigma(predicted: Gaussian, executed: Tensor) -> Tensor:
    """Which executed entries at t = 1..T are inside, 1 or 0, (N, T, D); see :func:`two_sigma_coverage`."""
    return ((executed[:, 1:] - predicted.mean).abs() <= 2 * predicted.std).double()


def rms_error(demonstrations: Demonstrations, executed: Tensor) -> Tensor:
    r"""Root mean square distance of rollouts from the demonstrated mean (Eq. 10), over rollouts and t = 1..T, for each observed entry.

    .. math:: \sqrt{\frac{1}{N T} \sum_{n, t} (z_{nt} - \hat\mu_t^{\exp})^2}

    Args:
        demonstrations: of M entries.
        executed: rollouts in the match space, z_0..z_T, (N, T + 1, M).

    Returns:
        (M,), in the units of the match space.

    Example:
        >>> import torch
        >>> shown = Demonstrations(torch.tensor([[[0.0], [1.0]], [[0.0], [3.0]]]), 0.1, ("q",))
        >>> rms_error(shown, torch.tensor([[[0.0], [5.0]]]))
        tensor([3.], dtype=torch.float64)
    """
    return (executed[:, 1:] - demonstrations.positions[:, 1:].mean(0)).square().mean((0, 1)).sqrt()


def demonstration_spread(demonstrations: Demonstrations) -> Tensor:
    r"""What :func:`rms_error` may be compared with: the demonstrations' own standard deviation (Eq. 11) over t = 1..T, for each entry.

    .. math:: \sqrt{\frac{1}{T} \sum_t \hat\Sigma_{t, jj}^{\exp}}

    Unbiased, without observation noise. A further demonstration would have an rms error of :math:`\sqrt{1 + 1/N}` times this.

    Returns:
        (M,), in the units of the match space.

    Example:
        >>> import torch
        >>> shown = Demonstrations(torch.tensor([[[0.0], [1.0]], [[0.0], [3.0]]]), 0.1, ("q",))
        >>> demonstration_spread(shown).square()
        tensor([2.0000], dtype=torch.float64)
    """
    return demonstrations.positions[:, 1:].var(0).mean(0).sqrt()
