"""Environments of others as robots: the laws hold whatever the environment is."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from functools import partial

import gymnasium
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Bounded, Composite, OneHot, TensorSpec, Unbounded
from torchrl.envs import EnvBase, GymEnv
from torchrl.envs.utils import check_env_specs

from torch_pmil.envs import AdaptedEnv, CosSin
from torch_pmil.envs.adapter import SEEDS

CART = partial(GymEnv, "InvertedPendulum-v5", reset_noise_scale=0.1)
BOX = Bounded(-1.0, 3.0, (1,))


class Wheel(EnvBase):
    """A wheel that turns by its action; shows [cos, speed, sin] under ``"seen"`` and says after one
    step that all is over.
    """

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
        return TensorDict(
            {
                "seen": self._seen(tensordict["motor"]),
                "reward": torch.ones(1),
                "done": torch.ones(1, dtype=torch.bool),
            }
        )

    def _seen(self, speed: Tensor) -> Tensor:
        return torch.cat([self.angle.cos(), speed, self.angle.sin()]).float()


def adapted_wheel(make_env: Callable[..., EnvBase] = Wheel, **settings: object) -> AdaptedEnv:
    return AdaptedEnv(
        make_env, 0.1, **{"observation": "seen", "action": "motor", "seed": 0, **settings}
    )


def drive(env: AdaptedEnv, actions: Tensor) -> Tensor:
    """Observations (T + 1, D) under actions (T, F)."""
    observations = [env.reset()["observation"]]
    for action in actions:
        observations.append(
            env.step(TensorDict({"action": action}, env.batch_size))["next", "observation"]
        )
    return torch.stack(observations)


@pytest.mark.parametrize("num_envs", [None, 3])
@pytest.mark.parametrize(
    ("make_env", "settings"),
    [
        (Wheel, {"observation": "seen", "action": "motor"}),
        (Wheel, {"observation": "seen", "action": "motor", "angles": (CosSin(cos=0, sin=2),)}),
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
    assert {rollout[key].dtype for key in ("observation", "action", ("next", "reward"))} == {
        torch.float64
    }


def test_observations_are_those_of_gymnasium_itself() -> None:
    actions = 0.3 * torch.rand(
        20, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64
    )
    ours = drive(AdaptedEnv(CART, 0.04, seed=5), actions)
    robot = gymnasium.make("InvertedPendulum-v5", reset_noise_scale=0.1)
    robot.reset(seed=int(torch.randint(SEEDS, (), generator=torch.Generator().manual_seed(5))))
    theirs = [robot.reset()[0]] + [robot.step(action.float().numpy())[0] for action in actions]
    assert torch.equal(ours, torch.stack([torch.from_numpy(observation) for observation in theirs]))


def test_rollout_goes_on_when_the_task_says_that_it_is_over() -> None:
    assert adapted_wheel().rollout(10).batch_size == (10,)
    rollout = AdaptedEnv(CART, 0.04, seed=0).rollout(60)
    assert rollout.batch_size == (60,)
    assert rollout["next", "observation"][-1, 1].abs() > 1, (
        "the pole fell far beyond the 0.2 rad at which the task ends"
    )


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
    torch.testing.assert_close(
        seen[0, 0].cos(), (wheel.angle - speeds.sum()).cos()[0], rtol=0, atol=1e-6
    )
    torch.testing.assert_close(seen[1:, 0] - seen[0, 0], speeds.cumsum(0)[:, 0], rtol=0, atol=1e-6)
    assert torch.equal(seen[1:, 1], speeds[:, 0]), (
        "the entry that is no angle stays, and the sine is gone"
    )


def test_same_seed_gives_the_same_rollouts_bit_for_bit_and_another_does_not() -> None:
    actions = torch.full((10, 1), 0.1, dtype=torch.float64)
    first, again, other = (drive(AdaptedEnv(CART, 0.04, seed=seed), actions) for seed in (7, 7, 8))
    assert torch.equal(first, again)
    assert not torch.equal(first[0], other[0])


def test_robots_of_a_batch_start_apart_and_each_start_differs() -> None:
    env = AdaptedEnv(CART, 0.04, num_envs=4, seed=0)
    starts = torch.cat([env.reset()["observation"] for _ in range(3)])
    assert len(starts.unique(dim=0)) == 12


def test_global_seed_neither_moves_the_starts_nor_is_moved() -> None:
    starts = []
    for seed in (0, 1):
        torch.manual_seed(seed)
        before = torch.get_rng_state()
        starts.append(AdaptedEnv(CART, 0.04, seed=3).reset()["observation"])
        assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(*starts)


@pytest.mark.parametrize("num_envs", [None, 2])
def test_checkpoint_resumes_the_coming_episodes_bit_for_bit(num_envs: int | None) -> None:
    env, actions = (
        AdaptedEnv(CART, 0.04, num_envs=num_envs, seed=0),
        torch.zeros(5, *([] if num_envs is None else [num_envs]), 1),
    )
    drive(env, actions.double())
    file = io.BytesIO()
    torch.save(env.state_dict(), file)
    expected = [drive(env, actions.double()) for _ in range(2)]
    file.seek(0)
    resumed = AdaptedEnv(CART, 0.04, num_envs=num_envs, seed=1)
    resumed.load_state_dict(torch.load(file, weights_only=True))
    assert all(torch.equal(drive(resumed, actions.double()), rollout) for rollout in expected)


@pytest.mark.parametrize(
    ("make_env", "settings", "message"),
    [
        (Wheel, {"action": "action"}, r"must have action under 'action', got motor"),
        (
            partial(Wheel, Bounded(0, 255, (8, 8, 3), dtype=torch.uint8)),
            {},
            r"observation 'seen' must be a vector of real numbers, got Bounded\w* of torch.uint8 "
            r"with shape \(8, 8, 3\)",
        ),
        (
            partial(Wheel, Unbounded((2, 3))),
            {},
            r"must be a vector of real numbers, got Unbounded\w* of torch.float32 with shape "
            r"\(2, 3\)",
        ),
        (
            partial(Wheel, action=OneHot(4)),
            {},
            r"action 'motor' must be a vector of real numbers, got OneHot of torch.bool with "
            r"shape \(4,\)",
        ),
        (
            partial(Wheel, action=Unbounded((1,))),
            {},
            "action 'motor' must have finite limits, got Unbounded",
        ),
        (
            partial(GymEnv, "CartPole-v1"),
            {"observation": "observation", "action": "action"},
            "action 'action' must be a vector of real",
        ),
        (Wheel, {"num_envs": 0}, "num_envs must be None or at least 1, got 0"),
        (Wheel, {"angles": (CosSin(0, 3),)}, "angles must be of different entries of the 3 "),
    ],
)
@pytest.mark.parametrize("num_envs", [None, 2])
def test_unsuitable_environment_is_refused_in_one_line(
    make_env: Callable[..., EnvBase], settings: dict, message: str, num_envs: int | None
) -> None:
    with pytest.raises(ValueError, match=message) as error:
        adapted_wheel(make_env, **{"num_envs": num_envs, **settings})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_action_that_is_not_finite_is_refused(bad: float) -> None:
    env = adapted_wheel()
    env.reset()
    with pytest.raises(ValueError, match="action must be finite, got"):
        env.step(TensorDict({"action": torch.tensor([bad], dtype=torch.float64)}))


def test_observation_that_is_not_finite_ends_the_rollout() -> None:
    wheel = Wheel()
    env = adapted_wheel(lambda: wheel)
    env.reset()
    wheel.angle = torch.tensor([math.nan])
    with pytest.raises(RuntimeError, match="the environment's observation must be finite, got"):
        env.step(TensorDict({"action": torch.zeros(1, dtype=torch.float64)}))


def test_robots_are_reset_together() -> None:
    env = AdaptedEnv(CART, 0.04, num_envs=2, seed=0)
    env.reset()
    with pytest.raises(
        ValueError, match="all robots must be reset together, got a mask with 1 of 2"
    ):
        env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, [2]))


def test_pictures_come_beside_the_observation() -> None:
    env = AdaptedEnv(
        partial(GymEnv, "Pendulum-v1", pixels_only=False), 0.05, from_pixels=True, seed=0
    )
    check_env_specs(env)
    rollout = env.rollout(2)
    assert (
        rollout["next", "pixels"].shape == (2, 500, 500, 3)
        and rollout["pixels"].dtype == torch.uint8
    )
    assert rollout["observation"].shape == (2, 3)
