"""Handwriting: strokes of people, where they are placed, and what robots make of them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.short_run import shortened
from torch_pmil.demonstrations import DemonstrationError, Demonstrations
from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.envs.double_pendulum import link_positions
from torch_pmil.runs.training import train
from torch_pmil.tasks.handwriting import handwriting_biorob
from torch_pmil.tasks.registry import demonstrations_from, load_experiment
from torch_pmil.tasks.strokes import (
    distance_from_mean,
    distance_spread,
    lasa_strokes,
    placed,
    preprocessed,
)
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.writers import biorob_writer, pendulum_writer, states_of_strokes

# those that it was developed on: the others are for evaluation alone
SHAPES = ("Angle", "Sshape", "GShape", "Sine")
WRITERS = {"handwriting": pendulum_writer, "handwriting_biorob": biorob_writer}
each_robot = pytest.mark.parametrize("name", WRITERS)


def wave(count: int = 5, steps: int = 30, spread: float = 0.01) -> Demonstrations:
    """Strokes of somebody whose hand is off by as much all the time."""
    time = torch.linspace(0, 1, steps + 1, dtype=torch.float64)
    mean = torch.stack([time, 0.3 * (1 - (2 * math.pi * time).cos())], -1)
    return strokes_of(mean + spread * Draws(0).normal(count, 1, 2))


def strokes_of(positions: Tensor) -> Demonstrations:
    return Demonstrations(positions, 0.1, ("x", "y"))


@pytest.mark.parametrize("shape", SHAPES)
def test_placed_strokes_fill_their_box(shape: str) -> None:
    strokes = placed(preprocessed(lasa_strokes(shape), duration=3.0), extent=0.3)
    lowest, highest = strokes.positions.amin((0, 1)), strokes.positions.amax((0, 1))
    assert_close((highest - lowest).max().item(), 0.3)
    assert_close((highest + lowest) / 2, torch.zeros(2, dtype=torch.float64))


def test_placing_keeps_the_proportions() -> None:
    strokes = wave()
    there = placed(strokes, extent=0.3).positions.flatten(0, 1)
    here = strokes.positions.flatten(0, 1)
    ratio = torch.pdist(there) / torch.pdist(here)
    assert_close(ratio, ratio[:1].expand_as(ratio))


def test_strokes_are_in_metres_and_end_at_the_origin() -> None:
    recordings = lasa_strokes("Angle")
    assert len(recordings.values) == 7
    for values in recordings.values:
        assert_close(values[-1], torch.zeros(2, dtype=torch.float64))
        assert 0.01 < (values.amax(0) - values.amin(0)).max() < 0.1


def test_conditioned_strokes_begin_and_end_as_the_recorded_ones_and_last_as_long_as_said() -> None:
    recordings = lasa_strokes("Sine")
    strokes = preprocessed(recordings, duration=2.0)
    assert (strokes.duration, strokes.time_step, len(strokes.positions)) == (2.0, 0.1, 7)
    recorded_ends = torch.stack([values[[0, -1]] for values in recordings.values])
    assert_close(strokes.positions[:, [0, -1]], recorded_ends, atol=1e-3, rtol=0)


def test_alignment_leaves_less_spread_than_the_same_share_of_each_stroke() -> None:
    recordings = lasa_strokes("GShape")
    shares = [values[torch.linspace(0, len(values) - 1, 31).long()] for values in recordings.values]
    aligned = distance_spread(preprocessed(recordings, duration=3.0))
    assert aligned < 0.8 * distance_spread(strokes_of(torch.stack(shares)))


def test_a_held_out_stroke_is_as_far_from_the_mean_as_the_spread_says(draws: Draws) -> None:
    """E[1/s^2] of 4 x 60 degrees of freedom is 240 / 238."""
    white, ratios = draws.normal(400, 6, 31, 2), []
    for strokes in white:
        shown = strokes_of(strokes[:5])
        ratios.append((distance_from_mean(strokes[5], shown) / distance_spread(shown)).square())
    ratio, error = torch.stack(ratios).mean(), torch.stack(ratios).std() / 400**0.5
    assert abs(ratio - (1 + 1 / 5) * 120 / 118) < 4 * error


@pytest.mark.parametrize("shape", SHAPES)
@each_robot
def test_tip_of_the_demonstrated_states_is_on_the_strokes(name: str, shape: str) -> None:
    experiment = load_experiment(name, lasa_strokes(shape))
    positions = experiment.demonstrations.positions
    assert_close(experiment.space.observe(experiment.demonstrated_states), positions.flatten(0, 1))


@pytest.mark.parametrize("shape", SHAPES)
@each_robot
def test_poses_are_smooth_along_a_stroke(name: str, shape: str) -> None:
    writer = WRITERS[name]()
    strokes = writer.on_board(preprocessed(lasa_strokes(shape), writer.duration))
    assert writer.pose(strokes.positions).diff(dim=1).abs().max() < 0.4


def test_racket_is_where_mujoco_says(draws: Draws) -> None:
    env, match_space = BioRobEnv(), biorob_writer().space.match_space
    data = mujoco.MjData(env.model)
    for q in draws.uniform(-0.7, 1.3, 20, 3):
        for joint, angle in zip(("yaw", "shoulder", "elbow"), q, strict=True):
            data.joint(joint).qpos[0] = angle
        mujoco.mj_kinematics(env.model, data)
        expected = torch.from_numpy(data.site("racket").xpos.copy())
        assert_close(match_space(torch.cat([q, torch.zeros(3)])), expected, atol=1e-9, rtol=0)


def test_wrist_gives_way_by_less_than_a_millimetre() -> None:
    experiment = handwriting_biorob(wave())
    env = experiment.robot(seed=0)
    data = mujoco.MjData(env.model)
    for state in experiment.demonstrated_states[::5]:
        at_rest = torch.cat([state[:3], torch.zeros(3, dtype=torch.float64)])
        physics = env.replay(at_rest, torch.zeros(0, 3), 1)[0]
        mujoco.mj_setState(env.model, data, physics.numpy(), mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_kinematics(env.model, data)
        racket = torch.from_numpy(data.site("racket").xpos)
        assert (experiment.space.observe(at_rest) - racket).norm() < 1e-3


def test_pendulum_tip_is_where_the_environment_says(draws: Draws) -> None:
    states = draws.normal(20, 4)
    assert_close(pendulum_writer().space.observe(states), link_positions(states)[:, 2:])


@each_robot
def test_holding_torques_hold_the_robot(name: str) -> None:
    experiment, writer = load_experiment(name, wave()), WRITERS[name]()
    start = experiment.initial.mean
    after = experiment.robot(seed=0).simulate(start[None], writer.holding_torques(start[None]))[0]
    assert (after - start).abs().max() < 1e-3


@each_robot
def test_first_motion_stays_near_the_strokes(name: str, generator: torch.Generator) -> None:
    experiment, writer = load_experiment(name, wave()), WRITERS[name]()
    env, motion = experiment.robot(seed=0), experiment.exploration.motion(generator)
    state, places = env.reset(), []
    for _ in range(experiment.exploration.steps):
        state["action"] = motion(state["observation"])
        state = env.step(state)["next"]
        places.append(writer.space.observe(state["observation"]))
    centre = experiment.demonstrations.positions.mean((0, 1))
    assert (torch.stack(places) - centre).norm(dim=-1).max() < 0.35


def test_robot_starts_at_rest_where_the_strokes_begin() -> None:
    experiment = handwriting_biorob(wave())
    begin = experiment.demonstrations.positions[:, 0].mean(0)
    assert_close(experiment.space.observe(experiment.initial.mean), begin, atol=1e-3, rtol=0)
    assert (experiment.initial.mean[3:] == 0).all()


@each_robot
def test_mean_stroke_itself_has_no_error_and_others_have_theirs(name: str) -> None:
    experiment = load_experiment(name, wave())
    shown, strokes = experiment.demonstrations, experiment.demonstrations.positions
    mean = distance_from_mean(strokes.mean(0, keepdim=True), shown)
    assert_close(mean, torch.zeros(1, dtype=torch.float64))
    spread = math.sqrt(5 / 4 * distance_from_mean(strokes, shown).square().mean())
    assert experiment.tolerance == pytest.approx(1.25 * spread)


@pytest.mark.parametrize(
    ("stroke", "complaint"),
    [
        (
            [[0.0, -0.5], [0.9, -0.9], [0.0, -0.5]],
            r"^strokes must stay in the robot's reach: .* got \[0.9, -0.9\]$",
        ),
        (
            [[0.95, 0.0]] * 4,
            r"^stroke 0 needs 4\.\d+ N·m of motor 0 at 0\.0 s, which has 3.5 N·m$",
        ),
    ],
)
def test_stroke_out_of_reach_or_of_too_much_torque_is_refused_in_one_line(
    stroke: list[list[float]], complaint: str
) -> None:
    strokes = strokes_of(torch.tensor(stroke, dtype=torch.float64).expand(2, -1, -1))
    with pytest.raises(DemonstrationError, match=complaint):
        states_of_strokes(pendulum_writer(), strokes)


@each_robot
@pytest.mark.parametrize(
    ("shown", "complaint"),
    [
        (
            None,
            r"^handwriting.* needs strokes \(demonstrations=lasa:Angle, or a file of pmil draw\), ",
        ),
        (
            replace(wave(), names=("u", "v")),
            r"^demonstrations must be of x, y, got u, v; pmil align .* --names x y renames them$",
        ),
        (replace(wave(), time_step=0.05), r"^strokes must have a time step of 0.1 s, got 0.05 s$"),
    ],
)
def test_strokes_of_something_else_are_refused_in_one_line(
    name: str, shown: Demonstrations | None, complaint: str
) -> None:
    with pytest.raises(DemonstrationError, match=complaint):
        load_experiment(name, shown)


@pytest.mark.parametrize("shape", ["angle", "../secret"])
def test_unknown_shape_is_refused_in_one_line(shape: str) -> None:
    with pytest.raises(ValueError, match=rf"^a shape must be one of Angle, .*, got '{shape}'$"):
        demonstrations_from(f"lasa:{shape}")


@pytest.mark.usefixtures("quick")
@each_robot
def test_a_short_run_ends_with_a_policy_and_its_ratio(name: str, tmp_path: Path) -> None:
    task = shortened(load_experiment(name, wave(steps=4)), 4)
    result = train(task, seed=0, trials=1, out=tmp_path, command="test", progress_bar=False)
    assert result.summary["experiment"] == name
    assert result.summary["rms_error"].keys() == set(task.space.match_space.names)
    assert result.summary["experience_s"] == pytest.approx((3 + 1) * 0.4)


@each_robot
def test_torques_stay_within_the_limits(name: str, generator: torch.Generator) -> None:
    experiment: Task = load_experiment(name, wave())
    features = experiment.space.features(experiment.demonstrated_states)
    torques = experiment.make_policy(generator)(features)
    assert (torques.abs() <= experiment.actions.high).all()
