"""Environments of others as robots: the laws hold whatever the environment is."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Bounded, Composite, OneHot, TensorSpec, Unbounded
from torchrl.envs import EnvBase, GymEnv
from torchrl.envs.utils import check_env_specs

from tests.envs.driving import resumed, step
from tests.helpers.draws import Draws
from torch_pmil.envs import AdaptedEnv, CosSin
from torch_pmil.envs.held_actions import HeldActionsEnv
from torch_pmil.seeds import SEEDS

CART = partial(GymEnv, "InvertedPendulum-v5", reset_noise_scale=0.1)
BOX = Bounded(-1.0, 3.0, (1,))


class Wheel(EnvBase):
    """Turns by its action, shows [cos, speed, sin], and is done after one step."""

    def __init__(self, observation: TensorSpec | None = None, action: TensorSpec = BOX) -> None:
        super().__init__()
        self.observation_spec = Composite(seen=observation or Unbounded((3,)))
        self.full_action_spec = Composite(motor=action)
        self.reward_spec = Unbounded((1,))
        self.generator, self.heard = torch.Generator(), []

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(seed)

    def _reset(self, tensordict: TensorDict | None) -> TensorDict:
        self.angle = torch.rand(1, generator=self.generator).double()
        return TensorDict({"seen": self._seen(torch.zeros(1))})

    def _step(self, tensordict: TensorDict) -> TensorDict:
        self.heard.append(tensordict["motor"])
        self.angle = self.angle + tensordict["motor"]
        done = {"reward": torch.ones(1), "done": torch.ones(1, dtype=torch.bool)}
        return TensorDict({"seen": self._seen(tensordict["motor"]), **done})

    def _seen(self, speed: Tensor) -> Tensor:
        return torch.cat([self.angle.cos(), speed, self.angle.sin()]).float()


NAMES = {"observation": "seen", "action": "motor"}


def adapted_wheel(make_env: Callable[..., EnvBase] = Wheel, **settings: object) -> AdaptedEnv:
    return AdaptedEnv(make_env, 0.1, **{**NAMES, "seed": 0, **settings})


def adapted_cart(**settings: object) -> AdaptedEnv:
    return AdaptedEnv(CART, 0.04, **{"seed": 0, **settings})


def drive(env: AdaptedEnv, actions: Tensor) -> Tensor:
    """Observations (T + 1, D) under actions (T, F)."""
    measured = [env.reset(), *(step(env, action) for action in actions)]
    return torch.stack([each["observation"] for each in measured])


@pytest.mark.parametrize("num_envs", [None, 3])
@pytest.mark.parametrize(
    ("make_env", "settings"),
    [
        (Wheel, NAMES),
        (Wheel, {**NAMES, "angles": (CosSin(cos=0, sin=2),)}),
        (CART, {}),
        (partial(GymEnv, "Pendulum-v1"), {"angles": (CosSin(cos=0, sin=1),)}),
    ],
    ids=["wheel", "wheel's angle", "InvertedPendulum", "Pendulum"],
)
def test_torchrl_accepts_what_becomes_of_an_environment(
    make_env: Callable[..., EnvBase], settings: dict, num_envs: int | None
) -> None:
    env = AdaptedEnv(make_env, 0.1, num_envs=num_envs, seed=0, **settings)
    check_env_specs(env)
    rollout = env.rollout(4)
    assert rollout.batch_size == ((4,) if num_envs is None else (3, 4))
    shown = (rollout[key] for key in ("observation", "action", ("next", "reward")))
    assert {each.dtype for each in shown} == {torch.float64}


def test_observations_are_those_of_gymnasium_itself() -> None:
    actions = Draws(1).uniform(0, 0.3, 20, 1)
    ours = drive(adapted_cart(seed=5), actions)
    robot = gymnasium.make("InvertedPendulum-v5", reset_noise_scale=0.1)
    robot.reset(seed=int(torch.randint(SEEDS[1], (), generator=torch.Generator().manual_seed(5))))
    theirs = [robot.reset()[0]] + [robot.step(action.float().numpy())[0] for action in actions]
    assert torch.equal(ours, torch.stack([torch.from_numpy(observation) for observation in theirs]))


def test_rollout_goes_on_when_the_task_says_that_it_is_over() -> None:
    assert adapted_wheel().rollout(10).batch_size == (10,)
    observations = adapted_cart().rollout(60)["next", "observation"]
    assert len(observations) == 60 and observations[-1, 1].abs() > 1, "the task ends at 0.2 rad"


def test_action_is_the_environments_own_and_is_clipped_to_its_range() -> None:
    wheel = Wheel()
    env = adapted_wheel(lambda: wheel)
    assert (env.action_spec.space.low, env.action_spec.space.high) == (-1, 3)
    drive(env, torch.tensor([[1.0], [2.5], [-1.0], [50.0], [-50.0]], dtype=torch.float64))
    assert torch.equal(torch.cat(wheel.heard), torch.tensor([1.0, 2.5, -1.0, 3.0, -1.0]))


@pytest.mark.parametrize("near", [0.0, math.pi, -20.0])
def test_angle_goes_on_through_whole_turns_from_where_it_is_said_to_be(near: float) -> None:
    wheel = Wheel(action=Bounded(-3.0, 3.0, (1,)))
    env = adapted_wheel(lambda: wheel, angles=(CosSin(cos=0, sin=2, near=near),))
    speeds = torch.tensor([[3.0]] * 10 + [[-2.5]] * 15, dtype=torch.float64)
    seen = drive(env, speeds)
    assert (seen[0, 0] - near).abs() <= math.pi
    first = (wheel.angle - speeds.sum()).cos()[0]
    torch.testing.assert_close(seen[0, 0].cos(), first, rtol=0, atol=1e-6)
    torch.testing.assert_close(seen[1:, 0] - seen[0, 0], speeds.cumsum(0)[:, 0], rtol=0, atol=1e-6)
    assert torch.equal(seen[1:, 1], speeds[:, 0]), "this entry is no angle, and the sine is gone"


def test_rollouts_and_starts_depend_on_their_seed_alone() -> None:
    actions = torch.full((10, 1), 0.1, dtype=torch.float64)
    rollouts = []
    for seed, other in ((7, 0), (7, 1), (8, 0)):
        torch.manual_seed(other)
        before = torch.get_rng_state()
        rollouts.append(drive(adapted_cart(seed=seed), actions))
        assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(*rollouts[:2])
    assert not torch.equal(rollouts[0][0], rollouts[2][0])
    env = adapted_cart(num_envs=4)
    starts = torch.cat([env.reset()["observation"] for _ in range(3)])
    assert len(starts.unique(dim=0)) == 12


@pytest.mark.parametrize("batch", [(), (2,)])
def test_checkpoint_resumes_the_coming_episodes_bit_for_bit(batch: tuple[int, ...]) -> None:
    env, again = (adapted_cart(num_envs=batch[0] if batch else None, seed=seed) for seed in (0, 1))
    actions = torch.zeros(5, *batch, 1, dtype=torch.float64)
    drive(env, actions)
    resumed(env, again)
    for _ in range(2):
        assert torch.equal(drive(env, actions), drive(again, actions))


PICTURES = Bounded(0, 255, (8, 8, 3), dtype=torch.uint8)
REAL = "must be a vector of real numbers, got"
UNSUITABLE = [
    (Wheel, {"action": "action"}, "must have action under 'action', got motor"),
    (
        Wheel,
        {"observation": "x"},
        "must have observation under 'x', got seen; .*FlattenObservation",
    ),
    (
        partial(Wheel, PICTURES),
        {},
        rf"'seen' {REAL} Bounded\w* of torch.uint8 with shape \(8, 8, 3\)",
    ),
    (
        partial(Wheel, Unbounded((2, 3))),
        {},
        rf"{REAL} Unbounded\w* of torch.float32 with shape \(2, 3\); .*FlattenObservation",
    ),
    (
        partial(Wheel, action=OneHot(4)),
        {},
        rf"'motor' {REAL} OneHot of torch.bool with shape \(4,\)",
    ),
    (partial(Wheel, action=Unbounded((1,))), {}, "'motor' must have finite limits, got Unbounded"),
    (
        partial(GymEnv, "CartPole-v1"),
        {"observation": "observation", "action": "action"},
        f"'action' {REAL}",
    ),
    (Wheel, {"num_envs": 0}, "num_envs must be None or at least 1, got 0"),
    (Wheel, {"angles": (CosSin(0, 3),)}, "angles must be of different entries of the 3 "),
]


@pytest.mark.parametrize(("make_env", "settings", "message"), UNSUITABLE)
@pytest.mark.parametrize("num_envs", [None, 2])
def test_unsuitable_environment_is_refused_in_one_line(
    make_env: Callable[..., EnvBase], settings: dict, message: str, num_envs: int | None
) -> None:
    with pytest.raises(ValueError, match=message) as error:
        adapted_wheel(make_env, **{"num_envs": num_envs, **settings})
    assert "\n" not in str(error.value)


def test_actions_that_are_not_finite_are_refused() -> None:
    env = adapted_wheel()
    env.reset()
    for bad in (math.nan, math.inf):
        with pytest.raises(ValueError, match="action must be finite, got"):
            step(env, torch.tensor([bad], dtype=torch.float64))


def test_robots_are_reset_together() -> None:
    env = adapted_cart(num_envs=2)
    env.reset()
    line = "all robots must be reset together, got a mask with 1 of 2"
    with pytest.raises(ValueError, match=line):
        env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, [2]))


def test_seed_of_numpy_is_that_of_python() -> None:
    starts = [adapted_cart(seed=seed).reset()["observation"] for seed in (3, np.int64(3))]
    assert torch.equal(*starts)


def test_pictures_come_beside_the_observation() -> None:
    pendulum = partial(GymEnv, "Pendulum-v1", pixels_only=False)
    env = AdaptedEnv(pendulum, 0.05, from_pixels=True, seed=0)
    check_env_specs(env)
    rollout = env.rollout(2)
    assert rollout["next", "pixels"].shape == (2, 500, 500, 3)
    assert rollout["pixels"].dtype == torch.uint8
    assert rollout["observation"].shape == (2, 3)


class Failing(Wheel):
    """Gives no reading of its second step: it refuses the action, or shows no number.

    Args:
        refuses: whether it refuses.
        done: whether it reports the end of its episode in the first and the second step.
        motion: in which it fails.
    """

    def __init__(self, refuses: bool, done: bool = True, motion: int = 1) -> None:
        super().__init__()
        self.refuses, self.done, self.motion, self.resets, self.steps = refuses, done, motion, 0, 0

    def _reset(self, tensordict: TensorDict | None) -> TensorDict:
        self.resets, self.steps = self.resets + 1, 0
        return super()._reset(tensordict)

    def _step(self, tensordict: TensorDict) -> TensorDict:
        self.steps += 1
        step = super()._step(tensordict).set("done", torch.full((1,), self.done))
        if self.steps == 2 and self.resets == self.motion:
            if self.refuses:
                raise AssertionError("reset me")
            return step.set("seen", step["seen"] * torch.nan)
        return step


@pytest.mark.parametrize(
    ("refuses", "why"),
    [
        (True, "the environment was terminated and takes no more actions (AssertionError('reset m"),
        (False, "the environment ended without a reading"),
    ],
)
def test_rollout_ends_where_the_environment_gives_no_reading(refuses: bool, why: str) -> None:
    robot = adapted_wheel(partial(Failing, refuses))
    robot.base_env.motion = robot.base_env.resets + 1
    assert robot.rollout(3).shape == (1,) and robot.cut_short.startswith(why)
    robot.reset()
    assert robot.cut_short == "" and not robot.unread


def test_step_of_held_actions_that_was_not_read_to_its_end_is_left_out() -> None:
    held = HeldActionsEnv(partial(adapted_wheel, partial(Failing, True)), 2)
    held.robot.base_env.motion = held.robot.base_env.resets + 1
    assert held.rollout(3).shape == (0,) and "takes no more actions" in held.cut_short


def test_rollouts_of_several_starts_stay_where_they_end() -> None:
    robot = adapted_wheel(partial(Failing, True))
    robot.turns, robot.base_env.motion = 2, robot.base_env.resets + 2
    states = robot.rollout(4)["next", "observation"]
    assert states.shape == (2, 4, 3)
    assert (states[1] == states[1, 0]).all() and (states[0] != states[0, 0]).any()
    robot.turns, robot.base_env.motion = 1, robot.base_env.resets + 1
    assert robot.rollout(4).shape == (1, 4)


@pytest.mark.parametrize("refuses", [True, False])
def test_failure_before_the_end_is_the_users_to_mend(refuses: bool) -> None:
    robot = adapted_wheel(partial(Failing, refuses, done=False))
    robot.base_env.motion = robot.base_env.resets + 1
    kind = AssertionError if refuses else RuntimeError
    with pytest.raises(kind, match=r"reset me|finite, got \[nan.*: return the last reading"):
        robot.rollout(3)
