"""Declared angles are on one turn: in recordings, at the start and in the robot's rollouts."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict

from tests.tasks.test_own_robot import START, Arm, at_rest
from torch_pmil import Demonstrations, MatchSpace, Task
from torch_pmil.demonstrations import DemonstrationError, Recordings
from torch_pmil.envs.turning import Continued, Turning
from torch_pmil.tasks.own_robot import own_robot

TIMES = torch.arange(201, dtype=torch.float64) / 100
STATE = ("q", "dq")


class WithinATurn(Arm):
    """Hangs at pi, and shows its angle in (-pi, pi]."""

    def _shown(self) -> torch.Tensor:
        q, dq = self.state
        return torch.stack([torch.atan2(q.sin(), q.cos()), dq])

    def _reset(self, tensordict: object) -> object:
        super()._reset(tensordict)
        self.state = self.state + torch.tensor([math.pi, 0.0])
        return TensorDict({"joint": self._shown()})


def reaches() -> torch.Tensor:
    """From pi on by 2 rad, (5, T)."""
    sizes = 2 + 0.1 * torch.arange(5.0)[:, None]
    return math.pi + sizes * (TIMES / 2) ** 2 * (3 - TIMES)


def within_a_turn(q: torch.Tensor) -> torch.Tensor:
    return torch.atan2(q.sin(), q.cos())[..., None]


def recorded(values: torch.Tensor) -> Recordings:
    return Recordings(tuple("01234"), 5 * (TIMES,), tuple(values), ("q",))


def task(shown: object, robot: Arm | None = None, **given: object) -> Task:
    said = {"state": STATE, "angles": ("q",)} | given
    return own_robot(robot or WithinATurn(), shown, 0.1, **said)


@pytest.mark.parametrize("whole_turns", [0, 1, -2])
@pytest.mark.parametrize("evaluated", [True, False])
def test_wrapped_recordings_mean_what_continuous_ones_mean(
    whole_turns: int, evaluated: bool
) -> None:
    values = within_a_turn(reaches())
    values[2] += 2 * math.pi * whole_turns
    made_of = {
        recorded(values): recorded(reaches()[..., None]),
        Demonstrations(values[:, ::10], 0.1, ("q",)): Demonstrations(
            reaches()[:, ::10, None], 0.1, ("q",)
        ),
    }
    for wrapped, continuous in made_of.items():
        expected = task(continuous, evaluated=evaluated)
        made = task(wrapped, evaluated=evaluated)
        apart = made.demonstrations.positions - expected.demonstrations.positions
        turns = (apart / (2 * math.pi)).round()
        assert (turns == turns[0, 0, 0]).all()  # of all at all times
        assert (apart - 2 * math.pi * turns).abs().max() < 1e-9
        turns_of_start = (made.initial.mean[0] - made.demonstrations.positions[:, 0].mean()).abs()
        assert turns_of_start < START and made.initial.std[0] < 0.3


def test_robot_that_shows_its_angle_within_a_turn_is_continued_near_the_demonstrations() -> None:
    made = task(recorded(within_a_turn(reaches())))
    start = made.demonstrations.positions[:, 0].mean()
    assert abs(made.initial.mean[0] - start) < START
    push = torch.tensor([1.5], dtype=torch.float64)
    for seed in range(5):
        rollout = made.robot(seed).rollout(20, lambda td: td.set("action", push))
        q = torch.cat([rollout["observation"][:1, 0], rollout["next", "observation"][:, 0]])
        assert abs(q[0] - start) < START
        torch.testing.assert_close(q.diff(), torch.full_like(q.diff(), 0.15), rtol=0, atol=1e-5)


def test_match_of_a_declared_angle_is_continued_in_its_own_unit() -> None:
    match = MatchSpace(
        ("half",),
        ("",),
        torch.zeros(0, 2).double(),
        torch.tensor([[0.5, 0.0]], dtype=torch.float64),
    )
    halves = 0.5 * within_a_turn(reaches())
    shown = Recordings(tuple("01234"), 5 * (TIMES,), tuple(halves), ("half",))
    found = task(shown, match=match).demonstrations.positions[..., 0]
    shown = Recordings(tuple("01234"), 5 * (TIMES,), tuple(0.5 * reaches()[..., None]), ("half",))
    apart = (found - task(shown, match=match).demonstrations.positions[..., 0]) / math.pi
    assert (apart - apart[0, 0].round()).abs().max() < 1e-9


def test_undeclared_jump_and_hole_are_named() -> None:
    values = within_a_turn(reaches())
    with pytest.warns(UserWarning, match=r"q of demonstration \d jumps by a turn \(6.283\) at "):
        task(recorded(values), angles=())
    kept = (TIMES < 0.5) | (TIMES > 1.1)
    times = (TIMES[kept], *4 * (TIMES,))
    shown = Recordings(tuple("01234"), times, (values[0, kept], *values[1:]), ("q",))
    message = "demonstration 0 has no samples from 0.49 to 1.11 s: this hole of 0.62 s"
    with pytest.warns(UserWarning, match=message):
        task(shown)


def test_declared_angles_that_look_like_degrees_are_doubted() -> None:
    degrees = recorded(torch.rad2deg(reaches() - math.pi)[..., None])
    with pytest.warns(UserWarning, match=r"q looks like degrees: it is recorded over 1\d\d\.?"):
        task(degrees, initial=at_rest(0.0))
    with pytest.warns(UserWarning, match="q looks like degrees: the robot starts at 179.1, wh"):
        task(recorded(reaches()[..., None]), initial=at_rest(180.0), evaluated=False)
    task(degrees, initial=at_rest(180.0), units=("rad", "rad/s"))  # and nothing is said


@pytest.mark.parametrize("units", [(), ("rad", "rad/s")])
def test_declared_angles_that_jump_by_a_turn_in_degrees_are_refused(
    units: tuple[str, ...],
) -> None:
    degrees = recorded(torch.rad2deg(within_a_turn(reaches() - 0.5)))
    message = "q looks like degrees: its recordings jump by 360, where a turn is 6.283; convert it"
    with pytest.raises(DemonstrationError, match=message):
        task(degrees, units=units)


@pytest.mark.parametrize("rate", [1, None])
def test_fast_motion_of_a_continuous_angle_is_left_as_it_is(rate: int | None) -> None:
    speeds = [31.0, 35.0, 40.0]
    for speed in speeds:
        q = 4.0 + 0.1 * speed * torch.arange(5.0)
        shown = Continued([Turning(0, rate, 4.0)])
        found = [shown(torch.stack([at, torch.tensor(speed)]))[0] for at in q]
        assert torch.equal(torch.stack(found), q)
