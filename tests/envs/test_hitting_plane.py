"""The balls of the hitting plane are within a strike's reach and torques; none hits them all."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial import Delaunay
from torch import Tensor

from reproduction.teachers.kinesthetic_teaching import Strike, _racket_path, record_strike
from torch_pmil.envs.biorob import BALL, JOINTS, ROTORS, TORQUE_LIMIT, biorob_model
from torch_pmil.envs.equilibrium import Equilibrium
from torch_pmil.envs.hitting_plane import COLUMNS, GRID, ROWS, TRAINING_TARGETS, ball_at

CORNERS = [0, 6, 28, 34]
TIME_STEP = 0.002  # s, of the torques


@cache
def strike_to(target: tuple[float, float]) -> Strike:
    ball = ball_at(torch.tensor(target, dtype=torch.float64))
    return Strike().towards(ball.numpy(), biorob_model())


def strikes_at(targets: Tensor) -> list[Strike]:
    return [strike_to(tuple(target)) for target in targets.tolist()]


def hits(aims: Tensor, targets: Tensor) -> list[bool]:
    """Whether the strike at each aim, led by hand, hits the ball of the target."""
    return [
        record_strike(biorob_model(ball_at(target)), strike).hit_time is not None
        for strike, target in zip(strikes_at(aims), targets, strict=True)
    ]


def peak_torques(strike: Strike) -> np.ndarray:
    """Largest torques (3,) of motors that move themselves and the arm, the cables stiff."""
    model, path = biorob_model((3.0, 3.0, 1.0)), strike.path()
    times = np.arange(0, strike.duration, TIME_STEP)
    data, ratio = mujoco.MjData(model), Equilibrium(model, JOINTS, ROTORS).ratio
    places, speeds = (
        [getattr(model.joint(name), adr)[0] for name in JOINTS + ROTORS]
        for adr in ("qposadr", "dofadr")
    )
    torques = []
    for motion in zip(path(times), path(times, 1), path(times, 2), strict=True):
        position, velocity, acceleration = (np.concatenate([each, ratio @ each]) for each in motion)
        data.qpos[places], data.qvel[speeds], data.qacc[speeds] = position, velocity, acceleration
        mujoco.mj_inverse(model, data)
        joints, motors = data.qfrc_inverse[speeds].reshape(2, -1)
        torques.append(np.linalg.solve(ratio.T, joints) + motors)  # by virtual work
    return np.abs(torques).max(0)


def table(values: np.ndarray) -> str:
    """Values (35,) as they hang: the highest row first."""
    rows = np.reshape(values, (5, 7))[::-1]
    return "\n".join(" ".join(f"{value:5.1f}" for value in row) for row in rows)


def test_plane_is_perpendicular_to_x_and_begins_at_the_ball_of_the_single_target() -> None:
    assert ball_at(torch.zeros(2)).tolist() == list(BALL)
    shift = ball_at(GRID) - torch.tensor(BALL, dtype=torch.float64)
    torch.testing.assert_close(shift, torch.cat([torch.zeros(35, 1), GRID], 1), rtol=0, atol=1e-15)
    assert ball_at(GRID.reshape(5, 7, 2)).shape == (5, 7, 3)


@pytest.mark.parametrize("targets", [torch.zeros(3), torch.zeros(2, 1), torch.tensor(0.0)])
def test_target_of_another_size_is_refused(targets: Tensor) -> None:
    with pytest.raises(ValueError, match=r"targets must have shape \(\*batch, 2\), got"):
        ball_at(targets)


def test_grid_is_regular_and_reaches_beyond_the_training_targets() -> None:
    assert GRID.shape == (35, 2)
    middle = torch.tensor(COLUMNS, dtype=torch.float64)
    assert torch.equal(GRID.reshape(5, 7, 2)[2, :, 0], middle)
    assert np.diff(COLUMNS) == pytest.approx(0.1) and np.diff(ROWS) == pytest.approx(0.08)
    assert (GRID.amin(0) < TRAINING_TARGETS.amin(0)).all()
    assert (GRID.amax(0) > TRAINING_TARGETS.amax(0)).all()
    inside = (Delaunay(TRAINING_TARGETS * (1 + 1e-9)).find_simplex(GRID) >= 0).sum()
    print(f"{inside} of 35 balls in the training triangle")
    assert inside == 9


def test_racket_meets_each_ball_as_it_meets_the_first() -> None:
    assert strike_to((0.0, 0.0)) == Strike()
    model, strikes = biorob_model(), strikes_at(GRID)
    places = _racket_path(model, np.array([strike.hit for strike in strikes]))
    meeting = _racket_path(model, np.array([Strike().hit]))[0] - BALL
    found = places - ball_at(GRID).numpy()
    np.testing.assert_allclose(found, np.broadcast_to(meeting, (35, 3)), atol=1e-9)
    for strike in strikes:
        assert replace(strike, back=Strike().back, hit=Strike().hit, stop=Strike().stop) == Strike()


def test_strikes_are_a_smooth_function_of_the_target() -> None:
    """Along rows and columns the second differences stay below half of the first."""
    angles = [[*strike.back, *strike.hit, *strike.stop] for strike in strikes_at(GRID)]
    for axis in (0, 1):
        first, second = (
            np.abs(np.diff(np.reshape(angles, (5, 7, 9)), order, axis)).max() for order in (1, 2)
        )
        assert second < first / 2


def test_ball_out_of_reach_is_refused_in_one_line() -> None:
    line = "the arm must reach the ball: no pose within the joints' ranges"
    for ball in ((1.2, 0.0, 1.1), (-0.757, 0.0, 1.1)):
        with pytest.raises(ValueError, match=line) as error:
            Strike().towards(ball, biorob_model())
        assert "\n" not in str(error.value)


def test_motors_can_move_the_arm_along_the_strike_at_every_ball() -> None:
    peaks = np.array([peak_torques(strike) for strike in strikes_at(GRID)])
    for name, limit, peak in zip(JOINTS, TORQUE_LIMIT, peaks.T, strict=True):
        print(f"\npeak torque of the {name}'s motor, limit {limit:.0f} N·m\n{table(peak)}")
    assert (peaks < TORQUE_LIMIT).all()


def test_strike_hits_where_it_is_meant_to_at_the_corners_and_training_targets() -> None:
    targets = torch.cat([GRID[CORNERS], TRAINING_TARGETS])
    assert all(hits(targets, targets))


@pytest.mark.slow
def test_each_ball_is_hit_by_its_own_strike_but_many_by_no_demonstrated_one() -> None:
    nearest = TRAINING_TARGETS[torch.cdist(GRID, TRAINING_TARGETS).argmin(1)]
    own, near, first = (
        np.reshape(hits(aims, GRID), (5, 7)) for aims in (GRID, nearest, torch.zeros_like(GRID))
    )
    print(
        f"\nof 35 balls the strike at each hits {own.sum()}, at the nearest training target "
        f"{near.sum()}, at the first one {first.sum()}; of the 5 balls above and below the first "
        f"one that hits {first[:, 3].sum()}"
    )
    assert own.all() and near.sum() <= 24 and first.sum() <= 12 and first[:, 3].all()
