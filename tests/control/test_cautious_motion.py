"""The first motion within a box: its amplitude follows the margins that are left."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.exploration import (
    FIRST_AMPLITUDE,
    GROWTH,
    CautiousMotion,
    Exploration,
    PDMovements,
    RandomActions,
)
from torch_pmil.control.state_box import StateBox
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.tasks.registry import load_experiment

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (), joint_match(NAMES, UNITS))
BOX = StateBox(SPACE, {"q": (-1.0, 3.0)})
MOTORS = ActionSpace(("tau",), ("N·m",), torch.tensor([-2.0]), torch.tensor([4.0]))
RANDOM = RandomActions(MOTORS, 0.5, steps=10)
STILL, GAIN = torch.zeros(2, dtype=torch.float64), torch.tensor([[5.0, 1.0]])
MOVEMENTS = PDMovements(
    STILL, torch.tensor([0.4, 0.0]), GAIN, torch.tensor([9.0]), 1, 2, 10, lambda x: 0 * x[..., :1]
)


def at(q: float) -> Tensor:
    return torch.tensor([q, 0.0], dtype=torch.float64)


def cautious(exploration: Exploration = RANDOM, seed: int = 0) -> CautiousMotion:
    return CautiousMotion(exploration.motion(torch.Generator().manual_seed(seed)), BOX)


def amplitudes(motion: CautiousMotion, *positions: float) -> list[float]:
    found = []
    for q in positions:
        motion(at(q))
        found.append(motion.amplitude)
    return found


def test_amplitude_grows_while_the_margins_of_the_start_are_left_and_is_halved_otherwise() -> None:
    """Margins of 1 below and 3 above: 3/4 of them are left from -0.25 to 0.75."""
    a = FIRST_AMPLITUDE
    found = amplitudes(cautious(), 0.0, 0.74, 0.76, -0.24, -0.26, -2.0)
    wanted = [a, a * GROWTH, a * GROWTH / 2, a * GROWTH**2 / 2, a * GROWTH**2 / 4]
    assert found == pytest.approx([*wanted, a * GROWTH**2 / 8])


def test_amplitude_ends_its_growth_at_the_whole_motion() -> None:
    assert amplitudes(cautious(), *[0.0] * 40)[-1] == 1.0


def test_each_rollout_begins_small_and_with_the_margins_of_its_own_start() -> None:
    motion = cautious()
    amplitudes(motion, *[0.0] * 10)
    motion.begin()
    assert amplitudes(motion, 1.0, 0.0) == [FIRST_AMPLITUDE, FIRST_AMPLITUDE / 2]


def test_amplitude_does_not_grow_from_a_start_outside() -> None:
    found = amplitudes(cautious(), 5.0, 5.0, 4.0)
    assert found == [FIRST_AMPLITUDE, FIRST_AMPLITUDE / 2, FIRST_AMPLITUDE / 4]


def test_of_several_robots_the_nearest_to_a_limit_counts() -> None:
    motion = cautious()
    motion(torch.stack([at(0.0), at(0.0)]))
    motion(torch.stack([at(0.0), at(0.9)]))
    assert motion.amplitude == FIRST_AMPLITUDE / 2


def test_random_actions_shrink_towards_the_middle_of_the_range() -> None:
    whole = RANDOM.motion(torch.Generator().manual_seed(0))(at(0.0))
    small = cautious()(at(0.0))
    assert_close(small - 1, FIRST_AMPLITUDE * (whole - 1))


def test_targets_of_movements_shrink_towards_the_pose() -> None:
    whole = MOVEMENTS.motion(torch.Generator().manual_seed(0))(at(0.0))
    small = cautious(MOVEMENTS)(at(0.0))
    assert_close(small, FIRST_AMPLITUDE * whole)


def test_first_motions_of_the_double_pendulum_stay_where_the_whole_ones_leave() -> None:
    """Within 1.3 times the largest demonstrated speeds."""
    experiment = load_experiment("double_pendulum")
    speeds = 1.3 * experiment.demonstrated_states.abs().amax(0)
    limits = {name: (-speeds[i].item(), speeds[i].item()) for i, name in ((1, "dq1"), (3, "dq2"))}
    box, left = StateBox(experiment.space, limits), {"whole": 0, "cautious": 0}
    for seed in range(100, 110):
        generators = [torch.Generator().manual_seed(seed) for _ in range(2)]
        whole, inner = map(experiment.exploration.motion, generators)
        for name, motion in (("whole", whole), ("cautious", CautiousMotion(inner, box))):
            rollout = DoublePendulumEnv(seed=seed).rollout(25, motion)
            left[name] += bool(box.guard(states_of(rollout)))
    assert left == {"whole": 10, "cautious": 0}
