"""Jumps: what one motion cannot have passed through is left out, all else stays."""

from __future__ import annotations

import itertools
import re

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.demonstrations.preparation.alignment import AlignmentError
from torch_pmil.demonstrations.preparation.jumps import without_jumps

FASTEST = 4.0


@pytest.fixture
def swing() -> tuple[Tensor, Tensor]:
    """A motion of at most 3 units a second at uneven times."""
    times = (0.005 + 0.01 * Draws(0).uniform(0, 1, 200)).cumsum(0)
    return torch.stack([(3 * times).sin(), (2 * times).cos()], -1), times


@pytest.mark.parametrize(
    "beside", [[], [60], [0, 1, 2], [199], [30, 31, 32, 90, 150, 151], list(range(80, 120))]
)
def test_samples_beside_the_track_are_left_out_and_no_other(
    swing: tuple[Tensor, Tensor], beside: list[int]
) -> None:
    values, times = swing
    jumped = values.clone()
    jumped[beside, 0] += 3.0
    stay = [index for index in range(len(times)) if index not in beside]
    kept, instants = without_jumps(jumped, times, FASTEST)
    assert torch.equal(kept, values[stay]) and torch.equal(instants, times[stay])


def test_speed_is_that_of_each_column(swing: tuple[Tensor, Tensor]) -> None:
    values, times = swing
    values = values.clone()
    values[50] += 1.0
    inf = torch.inf
    for limits, count in (((inf, FASTEST), 199), ((FASTEST, inf), 199), ((inf, inf), 200)):
        assert len(without_jumps(values, times, torch.tensor(limits))[0]) == count


@pytest.mark.parametrize("seed", range(5))
def test_no_larger_set_of_samples_fits_together(seed: int) -> None:
    """Against all subsets of a recording that is mostly jumps."""
    values = Draws(seed).normal(11, 2)
    times = torch.arange(11, dtype=torch.float64)

    def fits(chosen: tuple[int, ...]) -> bool:
        pairs = itertools.combinations(chosen, 2)
        return all(
            ((values[a] - values[b]).abs() <= 1.2 * (times[b] - times[a])).all() for a, b in pairs
        )

    largest = max(
        size for size in range(1, 12) if any(map(fits, itertools.combinations(range(11), size)))
    )
    assert largest >= 6  # of 11, so that none of them is refused
    assert len(without_jumps(values, times, 1.2)[0]) == largest


FAR_APART = 10 * torch.eye(4)[:, :1] + torch.arange(4.0)[:, None] * 100


@pytest.mark.parametrize(
    ("values", "fastest", "message"),
    [
        (torch.rand(3), 1.0, "values must be (T, M) and times (T,) with T >= 1, got (3,) and (3,)"),
        (torch.rand(3, 1), torch.ones(2), "fastest must be a number or (M,)"),
        (torch.rand(3, 1), -1.0, "fastest must be positive, got -1.0"),
        (FAR_APART, 1.0, "at least half of the 4 samples must fit a motion of speed 1.0, got 1"),
    ],
)
def test_what_is_no_motion_is_refused(values: Tensor, fastest: float, message: str) -> None:
    with pytest.raises(AlignmentError, match=re.escape(message)):
        without_jumps(values, torch.arange(float(len(values))), fastest)
