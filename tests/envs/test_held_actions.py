"""Actions that are held: the motion is that of the robot, seen less often."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Unbounded
from torchrl.envs.utils import check_env_specs

from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.held_actions import HeldActionsEnv
from torch_pmil.envs.history import History, HistoryEnv
from torch_pmil.envs.rollouts import as_executed, states_of

HELD, STEPS = 3, 4
TORQUES = torch.tensor([[0.5, -0.2], [-1.0, 0.3], [0.2, 0.1], [1.0, 0.0]], dtype=torch.float64)


class Following:
    """Torques that change after so many steps."""

    def __init__(self, periods: int) -> None:
        self.periods, self.step = periods, 0

    def __call__(self, state: Tensor, *_: Tensor) -> Tensor:
        torque = TORQUES[self.step // self.periods]
        self.step += 1
        return torque.expand(*state.shape[:-1], -1)


def states(env: HeldActionsEnv | DoublePendulumEnv, steps: int, periods: int) -> Tensor:
    return states_of(as_executed(env.rollout(steps, Following(periods))))


@pytest.mark.parametrize("num_envs", [None, 2])
def test_motion_is_that_of_the_robot_under_held_actions(num_envs: int | None) -> None:
    held = HeldActionsEnv(DoublePendulumEnv, HELD, num_envs=num_envs, seed=1)
    robot = DoublePendulumEnv(num_envs=num_envs, seed=1)
    assert held.control_period == pytest.approx(HELD * robot.control_period)
    shown = states(held, STEPS, 1)
    assert torch.equal(shown, states(robot, HELD * STEPS, HELD)[..., ::HELD, :])


def test_it_is_an_environment_of_torchrl() -> None:
    check_env_specs(HeldActionsEnv(DoublePendulumEnv, HELD, seed=0))


@pytest.mark.parametrize("within", [0, 1, 2])
def test_guard_sees_every_reading_and_a_step_that_it_cut_short_is_left_out(within: int) -> None:
    held = HeldActionsEnv(DoublePendulumEnv, HELD, seed=1)
    seen: list[Tensor] = []

    def guard(state: Tensor) -> str:
        seen.append(state)
        return "too far" if len(seen) == HELD + within + 1 else ""

    held.guard = guard
    rollout = as_executed(held.rollout(STEPS, Following(1)))
    assert held.cut_short == "too far" and len(seen) == HELD + within + 1
    assert len(rollout) == (2 if within == HELD - 1 else 1)
    held.guard = None
    assert len(as_executed(held.rollout(STEPS, Following(1)))) == STEPS


def test_guard_of_a_state_with_a_history_sees_every_reading_too() -> None:
    history = History(("q1", "dq1", "q2", "dq2"), ("tau1", "tau2"), 0.3, past_actions=1)

    def robot(**settings: object) -> HeldActionsEnv:
        return HeldActionsEnv(DoublePendulumEnv, HELD, **settings)

    env = HistoryEnv(robot, history, lambda states: 0 * states[..., :2], seed=1)
    seen: list[Tensor] = []
    env.guard = lambda state: seen.append(state) or ""
    env.rollout(STEPS, Following(1))
    assert len(seen) == HELD * STEPS and all(len(state) == history.dim for state in seen)


class Limited(DoublePendulumEnv):
    """A robot that sends half of each action, and then all of it."""

    sent = 0

    def _set_specs(self, dim: int, low: Tensor, high: Tensor, more: dict) -> None:
        super()._set_specs(dim, low, high, {**more, "sent": Unbounded(2, dtype=torch.float64)})

    def _reset(self, tensordict: TensorDict, **given: object) -> TensorDict:
        return super()._reset(tensordict, **given).set("sent", torch.zeros(2).double())

    def _step(self, tensordict: TensorDict) -> TensorDict:
        self.sent += 1
        share = 0.5 if self.sent % HELD == 1 else 1.0
        result = super()._step(tensordict)
        result["sent"] = share * tensordict["action"]
        return result


def test_action_as_sent_is_the_mean_over_the_periods() -> None:
    rollout = HeldActionsEnv(Limited, HELD, seed=0).rollout(STEPS, Following(1))
    torch.testing.assert_close(as_executed(rollout)["action"], TORQUES * 2.5 / 3)


def test_periods_must_be_a_whole_number() -> None:
    with pytest.raises(ValueError, match="periods must be a whole number of at least 1, got 0"):
        HeldActionsEnv(DoublePendulumEnv, 0)
