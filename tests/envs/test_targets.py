"""Every observation shows the robot's target, and each robot has the ball that it is to hit."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from torchrl.envs.utils import check_env_specs

from tests.envs.driving import drawn, resumed, run, step
from tests.helpers.draws import Draws
from torch_pmil.envs import BioRobEnv, DoublePendulumEnv, MujocoRobotEnv
from torch_pmil.envs.biorob import BALL, biorob_model

TARGETS = torch.tensor([[0.1, -0.2], [0.0, 0.0], [-0.3, 0.1]], dtype=torch.float64)
BALLS = torch.tensor([BALL, (0.757, -0.1, 1.2), BALL], dtype=torch.float64)
UNDER_THE_BALL = torch.tensor([0.1, 0.55, 1.35, 0.0, 0.0, 0.0], dtype=torch.float64)
STRIKE = torch.tensor([0.0, 20.0, 10.0], dtype=torch.float64)
each_robot = pytest.mark.parametrize("robot", [BioRobEnv, DoublePendulumEnv])


def torques(env: MujocoRobotEnv, steps: int) -> Tensor:
    return env.action_spec.space.high * Draws(0).uniform(-0.5, 0.5, steps, *env.action_spec.shape)


@each_robot
@pytest.mark.parametrize("num_envs", [None, 3])
def test_torchrl_accepts_an_environment_with_targets(
    robot: type[MujocoRobotEnv], num_envs: int | None
) -> None:
    targets = TARGETS if num_envs else TARGETS[0]
    env = robot(targets=targets, num_envs=num_envs, seed=0)
    check_env_specs(env)
    rollout = env.rollout(3)
    expected = targets[..., None, :].expand(*env.batch_size, 3, 2)
    for shown in (rollout["target"], rollout["next", "target"]):
        assert torch.equal(shown, expected)
    assert rollout["target"].dtype == torch.float64


@each_robot
def test_targets_change_neither_the_motion_nor_what_is_saved(robot: type[MujocoRobotEnv]) -> None:
    plain, aimed = robot(num_envs=3, seed=0), robot(num_envs=3, seed=0, targets=TARGETS)
    starts, actions = plain.reset()["observation"], torques(plain, 5)
    assert torch.equal(starts, aimed.reset()["observation"])
    assert "target" not in plain.observation_spec
    without, shown = run(plain, starts, actions), run(aimed, starts, actions)
    assert torch.equal(without["observation"], shown["observation"]) and "target" not in without
    assert plain.state_dict().keys() == aimed.state_dict().keys()


def test_target_of_an_observation_is_a_copy_and_stays_at_a_partial_reset() -> None:
    given = TARGETS.clone()
    env = DoublePendulumEnv(num_envs=3, targets=given, seed=0)
    given.zero_()
    env.reset()["target"].zero_()
    after = env.reset()
    assert torch.equal(after["target"], TARGETS)
    mask = torch.tensor([[True], [False], [False]])
    assert torch.equal(env.reset(after.set("_reset", mask))["target"], TARGETS)


@each_robot
@pytest.mark.parametrize(
    ("num_envs", "targets", "message"),
    [
        (3, TARGETS[0], r"targets must have shape \(3, entries\), got \(2,\)"),
        (2, TARGETS, r"targets must have shape \(2, entries\), got \(3, 2\)"),
        (3, TARGETS[:, :0], r"targets must have shape \(3, entries\), got \(3, 0\)"),
        (None, TARGETS, r"targets must have shape \(entries,\), got \(3, 2\)"),
        (None, TARGETS[0] / 0, "targets must be finite, got"),
    ],
)
def test_malformed_targets_are_refused(
    robot: type[MujocoRobotEnv], num_envs: int | None, targets: Tensor, message: str
) -> None:
    with pytest.raises(ValueError, match=message) as error:
        robot(num_envs=num_envs, targets=targets)
    assert "\n" not in str(error.value)


def test_robots_with_balls_of_their_own_are_single_robots_side_by_side() -> None:
    env = BioRobEnv(BALLS, num_envs=3, seed=0)
    actions = torch.cat([STRIKE.expand(4, 3, 3), torques(env, 4)])
    together = run(env, UNDER_THE_BALL.expand(3, 6), actions)
    for robot, ball in enumerate(BALLS):
        alone = run(BioRobEnv(ball, seed=0), UNDER_THE_BALL, actions[:, robot])
        assert (together[:, robot] == alone).all()
    assert together["info", "hit"][-1].flatten().tolist() == [True, False, True]


def test_ball_of_each_robot_hangs_at_rest_where_it_is_said_to() -> None:
    env = BioRobEnv(BALLS, num_envs=3, seed=0)
    run(env, env.initial_mean.expand(3, 6), torch.zeros(5, 3, 3, dtype=torch.float64))
    ball = slice(1 + env.model.nq - 7, 1 + env.model.nq - 4)
    np.testing.assert_allclose(env.state_dict()["_physics"][:, ball], BALLS, atol=1e-5)


def test_checkpoint_resumes_robots_with_balls_of_their_own() -> None:
    env = BioRobEnv(BALLS, num_envs=3, targets=TARGETS, seed=0)
    run(env, UNDER_THE_BALL.expand(3, 6), STRIKE.expand(2, 3, 3))
    again, strike = BioRobEnv(BALLS, num_envs=3, targets=TARGETS, seed=1), STRIKE.expand(3, 3)
    resumed(env, again)
    for _ in range(3):
        assert (step(env, strike) == step(again, strike)).all()


def test_replay_and_simulation_know_whose_ball_it_is() -> None:
    env = BioRobEnv(BALLS, num_envs=3, seed=0)
    actions = STRIKE.expand(5, 3)
    run(env, UNDER_THE_BALL.expand(3, 6), actions[:, None].expand(5, 3, 3))
    for robot, ball in enumerate(BALLS):
        replayed = env.replay(UNDER_THE_BALL, actions, 1, robot)[-1]
        assert torch.equal(replayed, env.state_dict()["_physics"][robot])
        alone, within = BioRobEnv(ball, seed=0), (UNDER_THE_BALL, STRIKE, 4)
        assert torch.equal(env.substates(*within, robot), alone.substates(*within))
        one = UNDER_THE_BALL[None], STRIKE[None]
        assert torch.equal(env.simulate(*one, robot), alone.simulate(*one))


def test_bad_balls_and_models_are_refused_in_one_line() -> None:
    for num_envs, message in [
        (2, r"ball must have shape \(3,\) or \(2, 3\), got \(3, 3\)"),
        (None, r"ball must have shape \(3,\), got \(3, 3\)"),
    ]:
        with pytest.raises(ValueError, match=message):
            BioRobEnv(BALLS, num_envs=num_envs)
    start = {"initial_mean": [0.0] * 2, "initial_std": [0.0] * 2}
    with pytest.raises(ValueError, match="one or 3 models, one for each robot, got 2"):
        MujocoRobotEnv([biorob_model()] * 2, ("yaw",), num_envs=3, **start)


PICTURES = """
import torch
from torch_pmil.envs import BioRobEnv
from torch_pmil.envs.biorob import BALL
balls = torch.tensor([BALL, (0.757, -0.2, 1.3)])
env = BioRobEnv(balls, num_envs=2, from_pixels=True, seed=0)
start = env.initial_mean.expand(2, 6)
shown = env.reset(env.reset().set("observation", start))["pixels"].int()
assert (shown[0] - shown[1]).abs().max() > 100
for robot, ball in enumerate(balls):
    alone = torch.from_numpy(BioRobEnv(ball).render(env.initial_mean)).int()
    again = torch.from_numpy(env.render(env.initial_mean, robot)).int()
    assert (shown[robot] - alone).abs().max() <= 2 and torch.equal(shown[robot], again)
"""


@pytest.mark.slow
def test_picture_of_each_robot_shows_its_own_ball() -> None:
    result = drawn(PICTURES, MUJOCO_GL="egl")
    assert result.returncode == 0, result.stderr
