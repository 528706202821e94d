"""What the networks of the peers share: their seeds, their inputs' scale, and how they are fitted.

Networks are in single precision; states and actions are in double precision.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from torch_pmil.control.action_space import ActionSpace

LEAST_STD = 1e-3  # of an entry of the data, below which it is not scaled up
LARGEST_SEED = 2**62


@contextmanager
def seeded(generator: torch.Generator) -> Iterator[None]:
    """Let a generator seed what draws from torch's own: initial weights, and TorchRL's losses.

    Torch's own generator is afterwards as it was before.

    Example:
        >>> with seeded(torch.Generator().manual_seed(0)):
        ...     first = nn.Linear(2, 2)
        >>> with seeded(torch.Generator().manual_seed(0)):
        ...     second = nn.Linear(2, 2)
        >>> torch.equal(first.weight, second.weight)
        True
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(LARGEST_SEED, (), generator=generator)))
        yield


class Scaled(nn.Module):
    """A network whose inputs (*batch, I) are brought to mean 0 and standard deviation 1.

    Args:
        network: of the scaled inputs.
        inputs: I.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, network: nn.Module, inputs: int) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("std", torch.ones(inputs))

    def set_scale(self, data: Tensor) -> None:
        """Take means and standard deviations from data (n, I)."""
        self.mean.copy_(data.mean(0))
        self.std.copy_(data.std(0).clamp_min(LEAST_STD))

    def forward(self, inputs: Tensor) -> Tensor:
        """Outputs of the network at inputs (*batch, I)."""
        return self.network((inputs.float() - self.mean) / self.std)


def descend(
    loss: Callable[[Tensor], Tensor],
    optimizer: torch.optim.Optimizer,
    rows: int,
    batch: int,
    steps: int,
    generator: torch.Generator,
) -> None:
    """Steps of an optimizer on the mean loss of random rows.

    Args:
        loss: of the rows with given indices, (batch,) to a scalar.
        optimizer: of the parameters.
        rows: number of data.
        batch: rows of each step, drawn with replacement; all of them if they are no more than that.
        steps: number of steps.
        generator: of the rows.
    """
    everything = torch.arange(rows)
    for _ in range(steps):
        chosen = everything
        if rows > batch:
            chosen = torch.randint(rows, (batch,), generator=generator)
        optimizer.zero_grad()
        loss(chosen).backward()
        optimizer.step()


def to_unit(actions: Tensor, space: ActionSpace) -> Tensor:
    """Actions (*batch, F) as fractions of half their ranges, from -1 to 1, in single precision."""
    return ((actions - space.middle) / space.half_range).float()


def from_unit(fractions: Tensor, space: ActionSpace) -> Tensor:
    """Actions (*batch, F) of fractions of half their ranges, clipped to their limits."""
    actions = space.middle + space.half_range * fractions.double().clamp(-1, 1)
    return actions.clamp(space.low, space.high)
