"""How a robot moves before anything is learned."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.exploration import Exploration, Motion, PDMovements, RandomActions

POSE = torch.tensor([0.3, -0.2, 0.0, 0.0], dtype=torch.float64)
REACH = torch.tensor([0.4, 0.2, 0.0, 0.0], dtype=torch.float64)
STIFFNESS, DAMPING = torch.tensor([[5.0, 3.0], [1.0, 0.5]], dtype=torch.float64)
GAIN = torch.cat([STIFFNESS.diag(), DAMPING.diag()], 1)
U_MAX = torch.tensor([100.0, 100.0], dtype=torch.float64)
HOLD = 5
LOW, HIGH = torch.tensor([[-4.0, 0.0], [4.0, 2.0]], dtype=torch.float64)
TARGETS = ActionSpace(("q1", "q2"), ("rad", "rad"), LOW, HIGH)


def gravity(state: Tensor) -> Tensor:
    return 2 * state[..., :2].cos()


MOVEMENTS = PDMovements(POSE, REACH, GAIN, U_MAX, HOLD, 3, 20, gravity)


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def targets_of(motion: Motion, steps: int, robots: int) -> Tensor:
    """Positions (steps, robots, 2) to which the torques at the pose pull."""
    state = POSE.expand(robots, -1)
    pulls = [(motion(state) - gravity(state)) / STIFFNESS for _ in range(steps)]
    return POSE[:2] + torch.stack(pulls)


def test_targets_are_uniform_around_the_pose() -> None:
    """Mean and variance of a uniform distribution, to four standard errors."""
    fractions = (targets_of(MOVEMENTS.motion(generator()), 1, 4000)[0] - POSE[:2]) / REACH[:2]
    assert (fractions.abs() <= 1 + 1e-12).all()
    assert (fractions.mean(0).abs() < 4 * (1 / 3 / 4000) ** 0.5).all()
    assert ((fractions.square().mean(0) - 1 / 3).abs() < 4 * (4 / 45 / 4000) ** 0.5).all()


def test_target_stays_for_its_time_and_is_then_another_one() -> None:
    targets = targets_of(MOVEMENTS.motion(generator()), 4 * HOLD, robots=1)[:, 0]
    assert len(targets.round(decimals=9).unique(dim=0)) == 4
    for held in targets.split(HOLD):
        assert_close(held, held[:1].expand(HOLD, -1), rtol=0, atol=1e-12)


def test_rollout_begins_with_a_new_target_whenever_the_last_one_ended() -> None:
    motion = MOVEMENTS.motion(generator())
    first = targets_of(motion, 2, robots=1)
    motion.begin()
    second = targets_of(motion, HOLD, robots=1)
    assert not torch.allclose(first[-1], second[0])
    assert_close(second, second[:1].expand(HOLD, -1, -1), rtol=0, atol=1e-12)


def test_torque_is_weight_stiffness_and_damping() -> None:
    still = replace(MOVEMENTS, reach=torch.zeros_like(REACH)).motion(generator())
    state = torch.tensor([0.5, 0.1, 0.7, -0.4], dtype=torch.float64)
    expected = gravity(state) - STIFFNESS * (state - POSE)[:2] - DAMPING * state[2:]
    assert_close(still(state), expected, rtol=1e-12, atol=0)


def test_torques_end_at_the_limits() -> None:
    limits = torch.tensor([0.5, 100.0], dtype=torch.float64)
    state = torch.tensor([-9.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    free, limited = (
        replace(MOVEMENTS, u_max=u_max).motion(generator())(state) for u_max in (U_MAX, limits)
    )
    assert limited.tolist() == [0.5, free[1].item()]


def test_random_actions_are_uniform_around_the_given_one_and_clipped_to_the_range() -> None:
    """A quarter of half the range: (-1, 1) around 0, and (1.75, 2.25) around 2 of (0, 2)."""
    around = torch.tensor([0.0, 2.0], dtype=torch.float64)
    motion = RandomActions(TARGETS, 0.25, 20, around=around).motion(generator())
    first, second = motion(torch.zeros(4000, 4)).unbind(-1)
    assert first.abs().max() <= 1 and first.abs().max() > 0.99
    assert first.mean().abs() < 4 * (1 / 3 / 4000) ** 0.5
    assert second.min() >= 1.75 and second.min() < 1.76 and second.max() == 2
    assert ((second == 2).double().mean() - 0.5).abs() < 4 * (0.25 / 4000) ** 0.5


def test_random_actions_are_around_the_middle_unless_it_is_said() -> None:
    motion = RandomActions(TARGETS, 1.0, 20).motion(generator())
    drawn = motion(torch.zeros(4000, 4))
    assert (drawn >= LOW).all() and (drawn <= HIGH).all()
    assert_close(drawn.amin(0), LOW, rtol=0, atol=0.01)
    assert_close(drawn.amax(0), HIGH, rtol=0, atol=0.01)


@pytest.mark.parametrize("exploration", [MOVEMENTS, RandomActions(TARGETS, 0.4, 20)])
def test_same_generator_gives_the_same_actions(exploration: Exploration) -> None:
    motions = [exploration.motion(generator()) for _ in range(2)]
    first, second = ([motion(POSE) for _ in range(2 * HOLD)] for motion in motions)
    assert torch.equal(torch.stack(first), torch.stack(second))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"reach": torch.zeros(3)}, r"reach must have shape \(4,\), got \(3,\)"),
        ({"reach": -REACH}, r"exploration.reach must be .*, at least 0, got \[-0.4"),
        ({"u_max": torch.zeros(2)}, r"u_max must be positive, got \[0.0, 0.0\]"),
        ({"hold": 0}, "hold must be a whole number of at least 1, got 0"),
    ],
)
def test_movements_that_make_no_sense_are_an_error(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(MOVEMENTS, **wrong)


def test_random_actions_go_along_a_path_and_begin_it_anew_with_each_rollout() -> None:
    path = torch.stack([torch.linspace(-2, 2, 5), torch.linspace(0, 1, 5)], -1).double()
    motion = RandomActions(TARGETS, 1e-6, 5, rollouts=2, around=path).motion(generator())
    for _ in range(2):
        motion.begin()
        drawn = torch.stack([motion(torch.zeros(2)) for _ in range(5)])
        assert_close(drawn, path, atol=1e-5, rtol=0)


def test_path_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match=r"around must have shape \(5, 2\), got \(4, 2\)"):
        RandomActions(TARGETS, 0.1, 5, around=torch.zeros(4, 2))
