"""Jumps: what one motion cannot have passed through is left out, all else stays."""

from __future__ import annotations

import itertools

import pytest
import torch
from torch import Tensor

from torch_pmil.demonstrations.preparation.alignment import AlignmentError
from torch_pmil.demonstrations.preparation.jumps import without_jumps

FASTEST = 4.0


@pytest.fixture
def swing() -> tuple[Tensor, Tensor]:
    """A motion of at most 3 units a second at uneven times."""
    times = (
        torch.rand(200, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        .mul(0.01)
        .add(0.005)
        .cumsum(0)
    )
    return torch.stack([(3 * times).sin(), (2 * times).cos()], -1), times


@pytest.mark.parametrize(
    "beside", [[60], [0, 1, 2], [199], [30, 31, 32, 90, 150, 151], list(range(80, 120))]
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


def test_motion_within_the_speed_stays(swing: tuple[Tensor, Tensor]) -> None:
    kept, times = without_jumps(*swing, FASTEST)
    assert torch.equal(kept, swing[0]) and torch.equal(times, swing[1])


def test_speed_is_that_of_each_column(swing: tuple[Tensor, Tensor]) -> None:
    values, times = swing
    values = values.clone()
    values[50] += 1.0
    for limits, count in (
        ((torch.inf, FASTEST), 199),
        ((FASTEST, torch.inf), 199),
        ((torch.inf, torch.inf), 200),
    ):
        assert len(without_jumps(values, times, torch.tensor(limits))[0]) == count


@pytest.mark.parametrize("seed", range(5))
def test_no_larger_set_of_samples_fits_together(seed: int) -> None:
    """Against all subsets of a recording that is mostly jumps."""
    values = torch.randn(11, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
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


@pytest.mark.parametrize(
    ("values", "times", "fastest", "message"),
    [
        (
            torch.rand(3),
            torch.arange(3.0),
            1.0,
            r"values must be \(T, M\) and times \(T,\) with T >= 1, got \(3,\) and \(3,\)",
        ),
        (torch.rand(3, 1), torch.arange(3.0), torch.ones(2), r"fastest must be a number or \(M,\)"),
        (torch.rand(3, 1), torch.arange(3.0), -1.0, "fastest must be positive, got -1.0"),
        (
            10 * torch.eye(4)[:, :1] + torch.arange(4.0)[:, None] * 100,
            torch.arange(4.0),
            1.0,
            "at least half of the 4 samples must fit a motion of speed 1.0, got 1",
        ),
    ],
)
def test_what_tells_no_motion_is_refused(
    values: Tensor, times: Tensor, fastest: float, message: str
) -> None:
    with pytest.raises(AlignmentError, match=message):
        without_jumps(values, times, fastest)
