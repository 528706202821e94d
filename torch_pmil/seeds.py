"""Seeds: the streams of random numbers of a run, which never meet for seeds below a million."""

from __future__ import annotations

from enum import IntEnum

import torch

SEEDS = (0, 2**31 - 1)  # of a run
LARGEST_SEED = 2**63 - 1  # of a generator of PyTorch


class Stream(IntEnum):
    """What a stream's numbers decide; its value is added to the seed of the run."""

    POLICIES = 0  # new policies, and the starts of the robot that learns
    MOTION = 1_000_000  # the first motion, and the states at which policies are refitted
    MEASURED_STARTS = 2_000_000  # of the measurement in each trial
    RESETS = 3_000_000  # by which the start of one's own robot is estimated
    EVALUATED_STARTS = 4_000_000  # of the evaluation after a run
    REHEARSAL = 5_000_000  # by which one's own robot is tried before its first motion


def generator_of(stream: Stream, seed: int) -> torch.Generator:
    """A generator of a run's stream.

    Example:
        >>> generator_of(Stream.MOTION, 3).initial_seed()
        1000003
    """
    return torch.Generator().manual_seed(seed + stream)


def draw_seed(generator: torch.Generator) -> int:
    """A seed for something else, such as an environment."""
    return int(torch.randint(SEEDS[1], (), generator=generator))
