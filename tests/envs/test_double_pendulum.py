"""The simulated double pendulum against its equations of motion, and the laws of an environment."""

import math

import mujoco
import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from tensordict import TensorDict
from torchrl.envs import StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.envs.driving import drawn, resumed, run, start_at, step
from tests.helpers.draws import Draws
from torch_pmil.envs import DoublePendulumEnv, MujocoRobotEnv
from torch_pmil.envs.double_pendulum import double_pendulum_model, link_positions

GRAVITY, LENGTH = 9.81, 0.5
NOISE = (0.02, 0.3, 0.0, 0.1)  # rad, rad/s


def lagrange_equations(_, x, masses, torques, lengths=(LENGTH, LENGTH)):
    """Derivative of [q1, dq1, q2, dq2] of two uniform rods; angles a1 = q1, a2 = q1 + q2."""
    (m1, m2), (tau1, tau2), (l1, l2) = masses, torques, lengths
    a1, v1, a2, v2 = x[0], x[1], x[0] + x[2], x[1] + x[3]
    coupling = m2 * l1 * l2 / 2
    cosine, sine = coupling * np.cos(a1 - a2), coupling * np.sin(a1 - a2)
    mass_matrix = [[m1 * l1**2 / 3 + m2 * l1**2, cosine], [cosine, m2 * l2**2 / 3]]
    weights = GRAVITY * (m1 * l1 / 2 + m2 * l1), GRAVITY * m2 * l2 / 2
    force1 = tau1 - tau2 - sine * v2**2 + weights[0] * np.sin(a1)
    force2 = tau2 + sine * v1**2 + weights[1] * np.sin(a2)
    acceleration1, acceleration2 = np.linalg.solve(mass_matrix, [force1, force2])
    return [v1, acceleration1, v2 - v1, acceleration2 - acceleration1]


def exact_motion(start, times, *args):
    """States of the equations of motion at times, (T, 4)."""
    span, tight = (0, times[-1]), {"rtol": 1e-12, "atol": 1e-12}
    return solve_ivp(lagrange_equations, span, start, "DOP853", times, args=args, **tight).y.T


def random_torques(seed, *shape):
    return Draws(seed).uniform(-3.5, 3.5, *shape)


@pytest.mark.parametrize("num_envs", [None, 3])
@pytest.mark.parametrize("noise", [None, NOISE])
def test_torchrl_accepts_the_environment(num_envs, noise):
    check_env_specs(DoublePendulumEnv(num_envs=num_envs, observation_std=noise, seed=0))


@pytest.mark.parametrize(
    ("masses", "lengths"),
    [
        ((0.5, 0.5), (0.5, 0.5)),
        ((0.5, 0.15), (0.5, 0.5)),
        ((0.5, 1.0), (0.5, 0.5)),
        ((0.5, 0.5), (0.4, 0.6)),
        ((0.4, 0.6), (0.55, 0.3)),
    ],
)
@pytest.mark.parametrize("torque", [(0.0, 0.0), (0.5, -0.1)])
def test_motion_agrees_with_lagrange_equations(masses, lengths, torque):
    start = [math.pi - 0.6, 0.3, 0.4, -0.2]
    env = DoublePendulumEnv(masses, seed=0)
    if lengths != (LENGTH, LENGTH):
        model = double_pendulum_model(masses, lengths)
        env = MujocoRobotEnv(
            model, ("q1", "q2"), initial_mean=start, initial_std=(0.0,) * 4, torque_limit=3.5
        )
    simulated = run(env, start, torch.tensor([torque] * 25, dtype=torch.float64))
    times = np.linspace(0, 2.5, 26)
    exact = exact_motion(start, times, masses, torque, lengths)
    np.testing.assert_allclose(simulated["observation"], exact, rtol=0, atol=1e-6)


def test_sites_are_where_the_formulas_say_and_those_of_other_links_at_their_ends():
    data = mujoco.MjData(double_pendulum_model())
    state = torch.tensor([0.4, 0.0, 1.1, 0.0], dtype=torch.float64)
    data.qpos[:] = state[[0, 2]]
    mujoco.mj_forward(data.model, data)
    sites = np.concatenate([data.site(name).xpos[[0, 2]] for name in ("elbow", "tip")])
    np.testing.assert_allclose(sites, link_positions(state), atol=1e-12)
    assert link_positions(state)[0] == LENGTH * math.sin(0.4)
    data = mujoco.MjData(double_pendulum_model(link_lengths=(0.4, 0.6)))
    data.qpos[:] = math.pi / 2, -math.pi / 2  # the first to the right, the second up
    mujoco.mj_forward(data.model, data)
    assert np.allclose(data.site("elbow").xpos, [0.4, 0, 0], atol=1e-12)
    assert np.allclose(data.site("tip").xpos[[0, 2]], [0.4, 0.6], atol=1e-12)
    assert np.allclose(data.geom("rod2").xpos[[0, 2]], [0.4, 0.3], atol=1e-12)


def test_same_seed_gives_the_same_rollout_bit_for_bit_whatever_the_global_one():
    rollouts = []
    for seed in range(2):
        env = DoublePendulumEnv(seed=seed)
        env.set_seed(7)
        torch.manual_seed(seed)
        start = env.reset()["observation"]
        rollouts.append(run(env, start, random_torques(1, 25, 2))["observation"])
    assert torch.equal(*rollouts)


def test_starts_follow_the_start_distribution():
    starts = DoublePendulumEnv(num_envs=20_000, seed=0).reset()["observation"]
    std = torch.tensor([0.05, 0.1, 0.05, 0.1])
    mean_error = (starts.mean(0) - torch.tensor([math.pi, 0, 0, 0], dtype=torch.float64)) / std
    assert mean_error.abs().max() < 4 / math.sqrt(20_000)
    assert (starts.std(0) / std - 1).abs().max() < 4 / math.sqrt(40_000)


def test_sensors_say_the_true_state_and_independent_noise_of_their_standard_deviations():
    count, std = 2_000, torch.tensor(NOISE, dtype=torch.float64)
    env = DoublePendulumEnv(num_envs=count, observation_std=NOISE, seed=0)
    measured = [env.reset(), step(env, torch.zeros(count, 2, dtype=torch.float64))]
    noise = torch.cat([each["observation"] - each["state"] for each in measured], -1)
    std = std.repeat(2)
    assert (noise.mean(0).abs() <= 4 * std / math.sqrt(count)).all()
    assert ((noise.std(0) - std).abs() <= 4 * std / math.sqrt(2 * count)).all()
    correlations = noise[:, std > 0].T.corrcoef()
    off_diagonal = correlations - torch.eye(len(correlations), dtype=torch.float64)
    assert off_diagonal.abs().max() < 5 / math.sqrt(count)


def test_noise_does_not_move_the_robot():
    start = torch.tensor([2.0, 0.5, 0.7, -1.0], dtype=torch.float64).repeat(3, 1)
    noisy = DoublePendulumEnv(num_envs=3, observation_std=NOISE, seed=0)
    exact = DoublePendulumEnv(num_envs=3, seed=1)
    assert torch.equal(start_at(noisy, start)["state"], start)
    start_at(exact, start)
    for torque in random_torques(6, 5, 3, 2):
        measured = step(noisy, torque)
        assert torch.equal(measured["state"], step(exact, torque)["observation"])
        assert not torch.equal(measured["state"], measured["observation"])


def test_first_starts_do_not_depend_on_the_noise():
    exact, noisy = (
        DoublePendulumEnv(num_envs=3, observation_std=noise, seed=4).reset()
        for noise in (None, NOISE)
    )
    assert torch.equal(noisy["state"], exact["observation"])
    assert "state" not in set(exact.keys())


def test_batch_equals_single_environments():
    batch, torques = DoublePendulumEnv(num_envs=3, seed=0), random_torques(2, 25, 3, 2)
    starts = batch.reset()["observation"]
    together = run(batch, starts, torques)["observation"]
    for index, start in enumerate(starts):
        alone = run(DoublePendulumEnv(seed=0), start, torques[:, index])["observation"]
        torch.testing.assert_close(together[:, index], alone, rtol=0, atol=1e-12)


def test_torques_are_clipped_at_the_limit():
    start, env = [math.pi, 0, 0, 0], DoublePendulumEnv(torque_limit=(3.5, 1.0), seed=0)
    torques = torch.tensor([[100.0, -2.0], [3.5, -1.0]], dtype=torch.float64)
    beyond, at_limit = (run(env, start, torque[None])["observation"] for torque in torques)
    assert torch.equal(beyond, at_limit)


def test_simulate_agrees_with_step_and_leaves_the_environment_alone():
    env = DoublePendulumEnv(seed=0)
    start, torque = env.reset()["observation"], random_torques(3, 1, 2)
    predicted = env.simulate(start[None], torque)
    env.simulate(start[None] + 1, torque)
    assert torch.equal(step(env, torque[0])["observation"], predicted[0])


@pytest.mark.parametrize("count", [1, 5, 50])
def test_substates_end_where_simulate_does_and_lie_on_the_motion(count):
    env = DoublePendulumEnv(seed=0)
    start, torque = env.reset()["observation"], random_torques(5, 2)
    states = env.substates(start, torque, count)
    assert states.shape == (count, 4)
    assert torch.equal(states[-1], env.simulate(start[None], torque[None])[0])
    times = np.linspace(0, 0.1, count + 1)[1:]
    exact = exact_motion(start, times, (0.5, 0.5), torque.numpy())
    np.testing.assert_allclose(states.numpy(), exact, rtol=0, atol=1e-6)


@pytest.mark.parametrize("count", [0, 3, 100])
def test_period_splits_into_whole_time_steps_only(count):
    env = DoublePendulumEnv(seed=0)
    line = f"count must divide the 50 time steps of a control period, got {count}"
    with pytest.raises(ValueError, match=line):
        env.substates(env.initial_mean, torch.zeros(2, dtype=torch.float64), count)


@pytest.mark.parametrize("noise", [None, NOISE])
def test_checkpoint_resumes_motion_starts_and_noise(noise):
    env, torque = DoublePendulumEnv(observation_std=noise, seed=0), random_torques(4, 2)
    env.reset()
    step(env, torque)
    again = resumed(env, DoublePendulumEnv(observation_std=noise, seed=1))
    after, expected = (step(each, torque)["observation"] for each in (again, env))
    assert torch.equal(after, expected)
    assert torch.equal(again.reset()["observation"], env.reset()["observation"])


def test_partial_reset_moves_only_the_masked_robots():
    env = DoublePendulumEnv(num_envs=2, seed=0)
    before = env.reset()["observation"]
    mask = torch.tensor([[True], [False]])
    masked = TensorDict({"_reset": mask, "observation": before}, [2])
    after = env.reset(masked, select_reset_only=True)["observation"]
    assert not torch.equal(after[0], before[0])
    assert torch.equal(after[1], before[1])


def test_step_counter_restarts_a_batch():
    env = TransformedEnv(DoublePendulumEnv(num_envs=2, seed=0), StepCounter(max_steps=3))
    counts = env.rollout(7, break_when_any_done=False)["step_count"][0].flatten()
    assert counts.tolist() == [step % 3 for step in range(7)]


POSITIVE_MASSES = "link_masses must be two positive finite numbers in kg, got"
REFUSED = [
    ({"link_masses": (0.5, 0.0)}, POSITIVE_MASSES),
    ({"link_masses": (0.5,)}, POSITIVE_MASSES),
    ({"torque_limit": -1.0}, "torque_limit must be one or 2 positive finite numbers"),
    ({"initial_mean": (0.0, 0.0)}, "initial_mean must be 4 finite numbers, got"),
    ({"initial_std": (0.1, -0.1, 0.1, 0.1)}, "initial_std must not be negative, got"),
    ({"observation_std": (0.1, -0.1, 0.1, 0.1)}, "observation_std must not be negative, got"),
    ({"observation_std": (0.1,)}, "observation_std must be 4 finite numbers, got"),
    ({"num_envs": 0}, "num_envs must be None or at least 1, got 0"),
    ({"control_period": 0.101}, "must be a whole number of 0.002 s time steps, got 0.101 s"),
]


@pytest.mark.parametrize(("settings", "message"), REFUSED)
def test_bad_setting_is_refused_in_one_line(settings, message):
    with pytest.raises(ValueError, match=message) as error:
        DoublePendulumEnv(**settings)
    assert "\n" not in str(error.value)


def test_bad_lengths_and_starts_are_refused():
    with pytest.raises(ValueError, match=r"^link_lengths must be two positive finite numbers in m"):
        double_pendulum_model(link_lengths=(0.5, 0.0))
    with pytest.raises(ValueError, match=r"start observation must have shape \(4,\), got \(3,\)"):
        start_at(DoublePendulumEnv(seed=0), torch.zeros(3))


def test_diverged_simulation_names_environment_and_step(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves a log file
    env, still = DoublePendulumEnv(num_envs=2, seed=0), torch.zeros(2, 2, dtype=torch.float64)
    start_at(env, [[0.0, 0, 0, 0], [0.0, 1e9, 0, 0]])
    with pytest.raises(RuntimeError, match="simulation diverged in env 1 at step 1"):
        step(env, still)


PICTURES = """
import torch
from torch_pmil.envs import DoublePendulumEnv  # before torchrl, which fails with a misspelt backend
from torchrl.envs.utils import check_env_specs
for num_envs in (None, 2):
    env = DoublePendulumEnv(num_envs=num_envs, from_pixels=True, seed=0)
    check_env_specs(env)
    pixels = env.reset()["pixels"]
hanging, upright = env.render(torch.tensor([3.14, 0, 0, 0])), env.render(torch.zeros(4))
assert pixels.shape == (2, 480, 480, 3) and hanging.shape == (480, 480, 3)
assert pixels.dtype == torch.uint8
assert (hanging != upright).any()
"""


@pytest.mark.slow
def test_pictures_are_drawn_without_a_display_after_torchrl_imported_mujoco():
    result = drawn("import torchrl.envs\n" + PICTURES)
    assert result.returncode == 0, result.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "fails"), [("egl", False), ("glfw", True), ("elg", True)])
def test_pictures_are_drawn_or_refused_clearly(backend, fails):
    result = drawn(PICTURES, MUJOCO_GL=backend)
    assert (result.returncode != 0) == fails, result.stderr
    line = f"RuntimeError: pictures need OpenGL, which failed with MUJOCO_GL {backend}"
    assert (line in result.stderr) == fails
