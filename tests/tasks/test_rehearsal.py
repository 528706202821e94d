"""Simulated robots are tried first: wrong names, wrappers and steps are found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torchrl.envs import RewardSum, TransformedEnv, VecNormV2
from torchrl.envs.libs.gym import GymWrapper

from torch_pmil import Demonstrations, Task
from torch_pmil.tasks.own_robot import own_robot
from torch_pmil.tasks.rehearsal import rehearse

gymnasium = pytest.importorskip("gymnasium")
wrappers = gymnasium.wrappers

STATE = ("q1", "q2", "dq1", "dq2")


class TwoJoints(gymnasium.Env):
    """Two joints in gravity, at 20 Hz: angles (rad) and velocities (rad/s)."""

    metadata = {"render_modes": []}

    def __init__(
        self,
        scale: tuple[float, ...] = (1, 1, 1, 1),
        noise: float = 0.01,
        random: str = "",
        dt=0.05,
    ) -> None:
        self.scale, self.noise, self.random = np.array(scale), noise, random
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (4,), np.float64)
        self.action_space = gymnasium.spaces.Box(-6, 6, (2,), np.float64)
        if dt is not None:
            self.dt = dt

    def _shown(self) -> np.ndarray:
        source = np.random if self.random == "unseeded" else self.np_random
        return self.scale * self.state + self.noise * source.standard_normal(4)

    def reset(self, *, seed: int | None = None, options: object = None) -> tuple:
        super().reset(seed=seed)
        if self.random != "kept" or not hasattr(self, "state"):
            self.state = 0.05 * self.np_random.standard_normal(4)
        return self._shown(), {}

    def step(self, action: np.ndarray) -> tuple:
        q, dq = np.split(self.state, 2)
        for _ in range(10):
            dq = dq + 0.005 * (action - 4 * np.sin(q) - 0.5 * dq)
            q = q + 0.005 * dq
        self.state = np.concatenate([q, dq])
        return self._shown(), 0.0, bool(abs(q).max() > 0.5), False, {}


class ResetsItself(gymnasium.Wrapper):
    def step(self, action: np.ndarray) -> tuple:
        shown, reward, terminated, *others = self.env.step(action)
        return (self.env.reset()[0] if terminated else shown), reward, terminated, *others


class MeanRemoved(gymnasium.ObservationWrapper):
    seen, total = 0, 0.0

    def observation(self, shown: np.ndarray) -> np.ndarray:
        self.seen, self.total = self.seen + 1, self.total + shown
        return shown - self.total / self.seen


class FourTimes(gymnasium.Wrapper):
    def step(self, action: np.ndarray) -> tuple:
        return [self.env.step(action) for _ in range(4)][-1]


def normed(env: gymnasium.Env) -> TransformedEnv:
    keys = {"in_keys": ["observation"], "out_keys": ["observation"]}
    return TransformedEnv(GymWrapper(env), VecNormV2(**keys))


def made(env: Any, state: tuple[str, ...] = STATE, period: float = 0.05, **said: Any) -> Task:
    time = torch.linspace(0, 1, 21, dtype=torch.float64)
    shown = torch.stack([(1 + 0.05 * k) * time for k in range(3)])[..., None].expand(-1, -1, 2)
    shown = Demonstrations(shown, period, ("q1", "q2"))
    task = own_robot(env, shown, period, state=state, **said)
    rehearse(task)
    return task


@pytest.mark.parametrize(
    "robot",
    [
        TwoJoints,
        lambda: TwoJoints(noise=0.05),
        lambda: wrappers.NormalizeReward(TwoJoints()),
        lambda: wrappers.RescaleAction(TwoJoints(), -1.0, 1.0),
        lambda: wrappers.TimeLimit(TwoJoints(), 5),
        lambda: wrappers.StickyAction(TwoJoints(), 0.25),
        lambda: TransformedEnv(GymWrapper(TwoJoints()), RewardSum()),
    ],
)
def test_a_robot_that_repeats_itself_is_taken(robot: Callable[[], Any]) -> None:
    made(robot())
    made(robot(), angles=("q1", "q2"))


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (lambda: wrappers.NormalizeObservation(TwoJoints()), "NormalizeObservation remembers"),
        (lambda: MeanRemoved(TwoJoints()), "MeanRemoved remembers"),
        (lambda: wrappers.TimeLimit(MeanRemoved(TwoJoints()), 9), "MeanRemoved remembers"),
        (lambda: normed(TwoJoints()), "VecNormV2 remembers"),
        (lambda: TwoJoints(random="kept"), "TwoJoints remembers"),
        (
            lambda: wrappers.Autoreset(TwoJoints()),
            "within a motion, got one with Autoreset",
        ),
        (lambda: ResetsItself(TwoJoints()), "which was reset [0-9]+ times in 50 actions"),
        (lambda: FourTimes(TwoJoints()), r"last control_period = 0\.05 s, got 4 steps of 0\.05 s"),
        (lambda: TwoJoints(dt=None), "steps_per_action must be given, since TwoJoints has no dt"),
    ],
)
def test_a_robot_that_changes_between_motions_or_within_is_refused(
    robot: Callable[[], Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        made(robot())


def test_unseeded_noise_is_warned_of() -> None:
    with pytest.warns(RuntimeWarning, match="TwoJoints draws random numbers that no seed"):
        made(TwoJoints(random="unseeded"))


@pytest.mark.parametrize(
    ("state", "scale", "message"),
    [
        (("dq1", "dq2", "q1", "q2"), (1, 1, 1, 1), "dq1 must be .* of q1, got the reverse: swap"),
        (("q1", "q2", "dq2", "dq1"), (1, 1, 1, 1), "q2 moves at the rate of dq1; state must"),
        (("q1", "dq1", "q2", "dq2"), (1, 1, 1, 1), "q1 moves at the rate of q2; state must name"),
        (STATE, (1, 1, 57.3, 57.3), r"dq1 must be the velocity of q1, got 57\.\d times that"),
        (
            STATE,
            (1, 1, 1, -1),
            r"dq2 must be .* of q2, got -(1|1\.0\d|0\.9\d+) times that",
        ),
        (STATE, (1, 1, 0.05, 0.05), r"got 0\.0[45]\d* times that: .* control_period \(0\.05 s\)"),
    ],
)
def test_names_that_do_not_fit_the_motion_are_refused(
    state: tuple[str, ...], scale: tuple[float, ...], message: str
) -> None:
    for angles in ((), ("q1", "q2")):
        with pytest.raises(ValueError, match=message):
            made(TwoJoints(scale, noise=0.001), state, angles=angles)


@pytest.mark.parametrize(
    ("dt", "period", "said"),
    [(np.float32(0.05), 0.1, {}), (None, 0.1, {"steps_per_action": 2}), (0.05, 0.05, {})],
)
def test_an_action_lasts_a_control_period(dt: object, period: float, said: dict) -> None:
    robot = TwoJoints(dt=dt, noise=0.0)
    env = made(robot, period=period, **said).robot(0)
    env.reset()
    calls, step = [], robot.step
    robot.step = lambda action: (calls.append(1), step(action))[1]
    for _ in range(8):
        env.step(env.rand_action())
    assert len(calls) == round(8 * period / 0.05)


@pytest.mark.parametrize("past", [{}, {"past_actions": 1}])
def test_robot_is_tried_within_its_first_motion_and_its_box(past: dict) -> None:
    """Making the task moves nothing; the try is no larger than the first motion, and ends."""
    sent, robot = [], TwoJoints(noise=0.0)
    step = robot.step
    robot.step = lambda action: (sent.append(float(np.abs(action).max())), step(action))[1]
    shown = Demonstrations(torch.linspace(0, 1, 21).expand(3, 2, -1).mT, 0.05, ("q1", "q2"))
    said = {"random_action": 0.1, "box": {"q1": (-10.0, 10.0)}, **past}
    task = own_robot(robot, shown, 0.05, state=STATE, **said)
    assert sent == []
    rehearse(task)
    assert len(sent) == 150 and max(sent) <= 0.1 * float(robot.action_space.high.max())
    sent.clear()
    rehearse(own_robot(robot, shown, 0.05, state=STATE, box={"q1": (-0.3, 0.3)}, **past))
    assert len(sent) < 150


@pytest.mark.parametrize("past", [{}, {"past_actions": 1}])
def test_robot_that_no_action_moves_is_named(past: dict) -> None:
    robot = TwoJoints(noise=0.0)
    step = robot.step
    robot.step = lambda action: step(0 * action)
    with pytest.warns(RuntimeWarning, match="actions of 40% of their range do not change how"):
        made(robot, **past)


def test_hidden_velocities_are_not_compared() -> None:
    with pytest.raises(ValueError, match=r"got -0\.998 times"):
        made(TwoJoints((1, 1, 1, -1), noise=0.001))
    made(TwoJoints((1, 1, 1, -1), noise=0.001), positions_only=True, past_actions=1)
