"""The BioRob's environment: hidden motors, the hit, and the laws of an environment."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs

from tests.envs.driving import physics, resumed, run, start_at, step
from tests.helpers.draws import Draws
from torch_pmil.envs import BioRobEnv
from torch_pmil.envs.biorob import (
    JOINTS,
    ROTORS,
    START,
    TORQUE_LIMIT,
    biorob_model,
    holding_torques,
)
from torch_pmil.plotting.video import dense_states, render_rollout

NOISE = (0.01, 0.0, 0.02, 0.1, 0.3, 0.1)  # rad, rad/s
UNDER_THE_BALL = (0.1, 0.55, 1.35, 0.0, 0.0, 0.0)
STRIKE = torch.tensor([[0.0, 20.0, 10.0]], dtype=torch.float64)


def random_torques(seed: int, *shape: int) -> Tensor:
    return Draws(seed).uniform(-1, 1, *shape) * torch.tensor([4.0, 10.0, 5.0])


def data_of(env: BioRobEnv) -> mujoco.MjData:
    return physics(env.model, env.state_dict()["_physics"][0])


def state_of(data: mujoco.MjData) -> list[float]:
    joints = [data.joint(name) for name in JOINTS]
    return [joint.qpos[0] for joint in joints] + [joint.qvel[0] for joint in joints]


def step_by_step(
    state: tuple[float, ...], torques: Tensor
) -> tuple[list[float], list[float], Tensor]:
    """Distances (m) and contacts at each of MuJoCo's own time steps, and the last state."""
    env = BioRobEnv(seed=0)
    start_at(env, state)
    data = data_of(env)
    sensed = [data.sensordata.copy()]
    for torque in torques.repeat_interleave(100, 0):
        data.ctrl[:] = torque
        mujoco.mj_step(env.model, data)
        mujoco.mj_forward(env.model, data)
        sensed.append(data.sensordata.copy())
    distances, contacts = (
        [values[env.model.sensor(name).adr[0]] for values in sensed]
        for name in ("racket_ball_distance", "racket_ball_contact")
    )
    return distances, contacts, torch.tensor(state_of(data))


@pytest.mark.parametrize("num_envs", [None, 3])
@pytest.mark.parametrize("noise", [None, NOISE])
def test_torchrl_accepts_the_environment(
    num_envs: int | None, noise: tuple[float, ...] | None
) -> None:
    env = BioRobEnv(num_envs=num_envs, observation_std=noise, seed=0)
    check_env_specs(env)
    batch = () if num_envs is None else (num_envs,)
    info = env.rollout(3)["next", "info"]
    assert info["racket_ball_distance"].shape == (*batch, 3, 1)
    assert info["racket_ball_distance"].dtype == torch.float64 and info["hit"].dtype == torch.bool
    limits = env.action_spec.space.high.expand(*batch, 3).reshape(-1, 3)
    assert limits[0].tolist() == list(TORQUE_LIMIT)


def test_state_has_positions_first_and_motors_move_with_the_joints_at_a_reset() -> None:
    env, state = BioRobEnv(seed=0), [*START[:3], 1.0, 2.0, 3.0]
    assert start_at(env, state)["observation"].tolist() == state
    data = data_of(env)
    assert state_of(data) == state
    assert np.allclose(data.ten_velocity[:6], 0, atol=1e-12), "no cable changes its length"
    assert [data.joint(name).qvel[0] for name in ROTORS] == pytest.approx([1.0, 2.0, 4.0])


@pytest.mark.parametrize("pose", [START[:3], (0.1, 0.72, 1.5), (-0.5, -0.4, 0.3), (0.6, 1.5, 2.0)])
def test_reset_is_in_equilibrium_with_the_torques_that_hold_it(pose: tuple[float, ...]) -> None:
    torque = holding_torques(torch.tensor(pose, dtype=torch.float64))
    states = run(BioRobEnv(seed=0), (*pose, 0.0, 0.0, 0.0), torque.expand(20, 3))["observation"]
    assert (states - states[0]).abs().max() < 1e-6


def test_distance_is_the_least_over_all_time_steps_and_hit_stays() -> None:
    torques = torch.cat([STRIKE.expand(3, 3), torch.zeros(4, 3, dtype=torch.float64)])
    measured = run(BioRobEnv(seed=0), UNDER_THE_BALL, torques)
    distances, contacts, last = step_by_step(UNDER_THE_BALL, torques)
    torch.testing.assert_close(measured["observation"][-1], last, rtol=0, atol=1e-6)
    # both ends of a period belong to it
    least = torch.tensor(distances, dtype=torch.float64).unfold(0, 101, 100).amin(-1)
    measured_distances = measured["info", "racket_ball_distance"][1:, 0]
    torch.testing.assert_close(measured_distances, least, rtol=0, atol=1e-6)
    hits = (torch.tensor(contacts).unfold(0, 101, 100) > 0).any(-1).cummax(0).values
    assert torch.equal(measured["info", "hit"][1:, 0], hits)
    assert not hits[0] and hits[-1] and distances[-1] > 0.1, "it was touched, and is away again"


def test_step_that_only_passes_the_ball_says_how_near_it_came() -> None:
    """The least distance lies within a control period, and both ends of it belong to it."""
    env = BioRobEnv((0.757, 0.25, 1.127), seed=0)
    measured = run(env, UNDER_THE_BALL, STRIKE.expand(4, 3))
    ends = measured["info", "racket_ball_distance"]
    assert not measured["info", "hit"].any() and ends.min() > 0
    states = env.replay(torch.tensor(UNDER_THE_BALL, dtype=torch.float64), STRIKE.expand(4, 3), 1)
    now = torch.tensor(
        [physics(env.model, each).sensor("racket_ball_distance").data[0] for each in states]
    )
    nearer_end = torch.minimum(now[1:], now[:-1])
    assert ends[0, 0] == now[0] and (ends[1:, 0] <= nearer_end + 1e-12).all()
    assert (ends[1:, 0] < nearer_end - 1e-4).any()


def test_hit_ends_nothing_and_is_forgotten_at_a_reset() -> None:
    env = BioRobEnv(seed=0)
    run(env, UNDER_THE_BALL, STRIKE.expand(4, 3))
    after = step(env, STRIKE[0])
    assert after["info", "hit"] and not after["done"]
    assert not env.reset()["info", "hit"]


def test_partial_reset_forgets_the_hits_of_the_masked_robots_only() -> None:
    env = BioRobEnv(num_envs=2, seed=0)
    start = torch.tensor([UNDER_THE_BALL] * 2, dtype=torch.float64)
    assert run(env, start, STRIKE.expand(5, 2, 3))[-1]["info", "hit"].all()
    mask = torch.tensor([[True], [False]])
    env.reset(TensorDict({"_reset": mask, "observation": start}, [2]))
    after = step(env, torch.zeros(2, 3, dtype=torch.float64))
    assert after["info", "hit"].flatten().tolist() == [False, True]


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_holding_torques_keep_the_batch_and_do_the_work_against_gravity(
    batch: tuple[int, ...],
) -> None:
    """Virtual work: motors that turn as the cables demand do what lifts the arm, tau·dr = dV."""
    pose = torch.tensor(START[:3], dtype=torch.float64)
    torques = holding_torques(pose.expand(*batch, 3))
    assert torques.shape == (*batch, 3) and torques.dtype == torch.float64
    assert (torques == torques.reshape(-1, 3)[0]).all()
    ratio = torch.tensor([[1, 0, 0], [0, 1, 0], [0, 0.5, 1.0]], dtype=torch.float64)
    slopes = [
        (_height_energy(pose + e) - _height_energy(pose - e)) / 2e-4
        for e in 1e-4 * torch.eye(3, dtype=torch.float64)
    ]
    # cables and wrist give a little
    work = torques.reshape(-1, 3)[0] @ ratio
    torch.testing.assert_close(work, torch.stack(slopes), rtol=0, atol=0.05)


def _height_energy(pose: Tensor) -> Tensor:
    model = biorob_model()
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    model.tendon_stiffness[:] = 0
    data = mujoco.MjData(model)
    for name, angle in zip(JOINTS, pose.tolist(), strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_forward(model, data)
    return torch.tensor(data.energy[0], dtype=torch.float64)


def test_replay_is_the_rollout_itself_where_the_state_alone_would_not_tell() -> None:
    env, torques = BioRobEnv(seed=0), random_torques(3, 18, 3)
    states = run(env, START, torques)["observation"]
    replayed = env.replay(states[0], torques, 5)
    assert torch.equal(env.state_of(replayed)[::5], states)
    assert torch.equal(replayed[-1], env.state_dict()["_physics"][0])
    assert torch.equal(dense_states(env, states[0], torques)[::5], states)
    from_states = env.simulate(states[:-1], torques)
    assert (from_states - states[1:]).abs().max() > 0.05, "hidden motors matter"


class PhysicsAsPictures(BioRobEnv):
    """Its pictures are the simulation's states themselves, so that no OpenGL is needed."""

    def draw(self, physics: Tensor) -> np.ndarray:
        return physics.numpy()


def test_film_shows_the_motion_of_the_rollout_and_the_flight_of_the_ball() -> None:
    env = PhysicsAsPictures(seed=0)
    torques = torch.cat([STRIKE.expand(4, 3), random_torques(4, 4, 3)])
    run(env, UNDER_THE_BALL, torques)
    pictures = list(render_rollout(env, torch.tensor(UNDER_THE_BALL, dtype=torch.float64), torques))
    assert len(pictures) == 41
    np.testing.assert_array_equal(pictures[-1], env.state_dict()["_physics"][0])
    ball = slice(1 + env.model.nq - 7, 1 + env.model.nq - 4)
    assert np.linalg.norm(pictures[-1][ball] - pictures[0][ball]) > 0.1


@pytest.mark.parametrize("noise", [None, NOISE])
def test_checkpoint_resumes_motion_hit_starts_and_noise(noise: tuple[float, ...] | None) -> None:
    env = BioRobEnv(observation_std=noise, seed=0)
    run(env, UNDER_THE_BALL, STRIKE.expand(5, 3))
    again = resumed(env, BioRobEnv(observation_std=noise, seed=1))
    after, following = step(env, STRIKE[0]), step(again, STRIKE[0])
    assert torch.equal(following["observation"], after["observation"])
    assert following["info", "hit"] and (following["info"] == after["info"]).all()
    assert torch.equal(again.reset()["observation"], env.reset()["observation"])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"ball": (0.0, 1.0)}, r"ball must be 3 finite numbers in m, got \[0.0, 1.0\]"),
        ({"ball": (0.0, 1.0, math.nan)}, "ball must be 3 finite numbers in m, got"),
        ({"initial_mean": (0.0, 0.0)}, "initial_mean must be 6 finite numbers, got"),
    ],
)
def test_bad_setting_is_refused_in_one_line(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        BioRobEnv(**settings)
    assert "\n" not in str(error.value)
