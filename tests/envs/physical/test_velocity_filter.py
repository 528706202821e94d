"""Velocities from positions: exact for a constant one, late and noisy as the docstring says."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.fake_robot import FakeRobot
from torch_pmil.envs.physical.velocity_filter import VelocityFilter, WithVelocities

PERIOD = 0.02  # s
each_memory = pytest.mark.parametrize("time_constant", [0.0, 0.01, 0.05, 0.2])


def velocities(positions: Tensor, time_constant: float) -> Tensor:
    """Of positions (T,) at equal intervals."""
    smooth = VelocityFilter(time_constant)
    return torch.cat([smooth.update(q[None], PERIOD * k) for k, q in enumerate(positions)])


@each_memory
def test_velocity_is_exact_if_constant_and_late_by_the_delay_if_not(time_constant: float) -> None:
    times = PERIOD * torch.arange(1000, dtype=torch.float64)
    assert velocities(0.3 - 2 * times, time_constant)[-1] == pytest.approx(-2, abs=1e-9)
    late = 3 * times[-1] - velocities(1.5 * times**2, time_constant)[-1]
    delay = VelocityFilter(time_constant).delay(PERIOD)
    assert late.item() == pytest.approx(3 * delay, abs=1e-8)


@each_memory
def test_noise_grows_by_the_gain(time_constant: float, draws: Draws) -> None:
    count = 40_000
    shown = velocities(draws.normal(count), time_constant)[1000:]
    gain = VelocityFilter(time_constant).noise_gain(PERIOD)
    memory = max(time_constant, PERIOD) / PERIOD
    assert shown.std().item() == pytest.approx(gain, rel=4 * math.sqrt(2 * memory / count))


@pytest.mark.parametrize("theta", [0.3, 0.8])
def test_filter_is_the_discounted_least_squares_line(theta: float, draws: Draws) -> None:
    """Weights theta^k of readings k intervals old, once the first ones are forgotten."""
    positions = draws.normal(400)
    ages = torch.arange(399, -1, -1, dtype=torch.float64)
    roots = theta ** (ages / 2)
    line = torch.stack([torch.ones_like(ages), -PERIOD * ages], dim=-1)
    fit = torch.linalg.lstsq(roots[:, None] * line, roots[:, None] * positions[:, None]).solution
    shown = velocities(positions, -PERIOD / math.log(theta))[-1]
    assert shown.item() == pytest.approx(fit[1].item(), rel=1e-9)


def test_repeated_reading_changes_nothing_and_a_pause_is_forgotten() -> None:
    smooth = VelocityFilter(0.05)
    smooth.update([0.0], 0.0)
    before = smooth.update([0.1], 0.02)
    assert torch.equal(smooth.update([5.0], 0.02), before)
    smooth.update([0.1], 60.0)
    assert smooth.update([0.1], 60.02).abs() < 0.01


@pytest.mark.parametrize("time_constant", [-0.1, math.nan, math.inf])
def test_wrong_time_constants_are_told(time_constant: float) -> None:
    with pytest.raises(ValueError, match="time_constant must be a finite number"):
        VelocityFilter(time_constant)


@pytest.mark.parametrize(
    ("positions", "stamp"), [([math.nan], 0.04), ([0.0, 0.0], 0.04), ([0.2], math.nan)]
)
def test_wrong_reading_is_refused_and_leaves_no_trace(positions: list, stamp: float) -> None:
    smooth, other = VelocityFilter(0.05), VelocityFilter(0.05)
    for one in (smooth, other):
        one.update([0.0], 0.0)
        one.update([0.1], 0.02)
    with pytest.raises(ValueError, match="must be"):
        smooth.update(positions, stamp)
    assert torch.equal(smooth.update([0.3], 0.06), other.update([0.3], 0.06))


def test_clock_that_begins_anew_begins_the_filter_anew() -> None:
    smooth = VelocityFilter(0.0)
    smooth.update([0.0], 900.0)
    assert smooth.update([1.0], 900.5).item() == 2.0
    assert smooth.update([1.0], 0.0).item() == 0.0
    assert smooth.update([0.5], 0.5).item() == -1.0


class Rail(FakeRobot):
    def read_state(self) -> tuple[list[float], float]:
        self.readings += 1
        time = 0.1 * self.readings
        return [2 * time, -time], time


@pytest.mark.parametrize(
    ("positions_first", "expected"), [(False, [0.4, 2.0, -0.2, -1.0]), (True, [0.4, -0.2, 2, -1])]
)
def test_robot_with_velocities_gives_both(positions_first: bool, expected: list[float]) -> None:
    rail = Rail()
    robot = WithVelocities(rail, VelocityFilter(0.0), positions_first)
    robot.read_state()
    state, stamp = robot.read_state()
    assert state.tolist() == pytest.approx(expected) and stamp == 0.2
    robot.send([1.0])
    robot.stop()
    assert rail.calls == ["send", "stop"]
