"""The balls of the hitting plane are within the reach and the torques of a strike, and no strike
hits them all.
"""

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
def strike_at(target: tuple[float, float]) -> Strike:
    return Strike().towards(
        ball_at(torch.tensor(target, dtype=torch.float64)).numpy(), biorob_model()
    )


def hits(strike: Strike, target: Tensor) -> bool:
    """Whether a strike, led by hand, hits the ball of a target."""
    return record_strike(biorob_model(ball_at(target)), strike).hit_time is not None


def peak_torques(strike: Strike) -> np.ndarray:
    """Largest torques (3,) of motors that move the arm along a strike, the cables stiff: their own
    inertia and friction, and the arm.
    """
    model, path, times = (
        biorob_model((3.0, 3.0, 1.0)),
        strike.path(),
        np.arange(0, strike.duration, TIME_STEP),
    )
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
    return "\n".join(
        " ".join(f"{value:5.1f}" for value in row) for row in np.reshape(values, (5, 7))[::-1]
    )


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
    assert GRID.shape == (35, 2) and torch.equal(
        GRID.reshape(5, 7, 2)[2, :, 0], torch.tensor(COLUMNS, dtype=torch.float64)
    )
    assert np.diff(COLUMNS) == pytest.approx(0.1) and np.diff(ROWS) == pytest.approx(0.08)
    assert (GRID.amin(0) < TRAINING_TARGETS.amin(0)).all() and (
        GRID.amax(0) > TRAINING_TARGETS.amax(0)
    ).all()
    inside = (Delaunay(TRAINING_TARGETS * (1 + 1e-9)).find_simplex(GRID) >= 0).sum()
    print(f"{inside} of 35 balls in the training triangle")
    assert inside == 9


def test_strike_at_the_ball_of_the_single_target_is_that_strike() -> None:
    assert strike_at((0.0, 0.0)) == Strike()


def test_racket_meets_each_ball_as_it_meets_the_first() -> None:
    model, strikes = biorob_model(), [strike_at(tuple(target)) for target in GRID.tolist()]
    places = _racket_path(model, np.array([strike.hit for strike in strikes]))
    meeting = _racket_path(model, np.array([Strike().hit]))[0] - BALL
    np.testing.assert_allclose(
        places - ball_at(GRID).numpy(), np.broadcast_to(meeting, (35, 3)), atol=1e-9
    )
    for strike in strikes:
        assert replace(strike, back=Strike().back, hit=Strike().hit, stop=Strike().stop) == Strike()


def test_strikes_are_a_smooth_function_of_the_target() -> None:
    """No pose bends away: along rows and columns the second differences stay below half of the
    first.
    """
    strikes = [strike_at(tuple(target)) for target in GRID.tolist()]
    angles = np.array([[*strike.back, *strike.hit, *strike.stop] for strike in strikes]).reshape(
        5, 7, 9
    )
    for axis in (0, 1):
        first, second = (np.abs(np.diff(angles, order, axis)).max() for order in (1, 2))
        assert second < first / 2


def test_ball_out_of_reach_is_refused_in_one_line() -> None:
    for ball in ((1.2, 0.0, 1.1), (-0.757, 0.0, 1.1)):
        with pytest.raises(
            ValueError, match="the arm must reach the ball: no pose within the joints' ranges"
        ) as error:
            Strike().towards(ball, biorob_model())
        assert "\n" not in str(error.value)


def test_motors_can_move_the_arm_along_the_strike_at_every_ball() -> None:
    peaks = np.array([peak_torques(strike_at(tuple(target))) for target in GRID.tolist()])
    for index, name in enumerate(JOINTS):
        print(
            f"\npeak torque of the {name}'s motor, limit {TORQUE_LIMIT[index]:.0f} "
            f"N·m\n{table(peaks[:, index])}"
        )
    assert (peaks < TORQUE_LIMIT).all()


def test_strike_hits_where_it_is_meant_to_at_the_corners_and_training_targets() -> None:
    assert all(
        hits(strike_at(tuple(target.tolist())), target)
        for target in torch.cat([GRID[CORNERS], TRAINING_TARGETS])
    )


@pytest.mark.slow
def test_each_ball_is_hit_by_its_own_strike_but_many_not_by_the_nearest_that_is_demonstrated() -> (
    None
):
    nearest = TRAINING_TARGETS[torch.cdist(GRID, TRAINING_TARGETS).argmin(1)]
    own, near, first = (
        np.array(
            [
                hits(strike_at(tuple(aim.tolist())), target)
                for aim, target in zip(aims, GRID, strict=True)
            ]
        ).reshape(5, 7)
        for aims in (GRID, nearest, torch.zeros_like(GRID))
    )
    print(
        f"\nof 35 balls the strike at each hits {own.sum()}, at the nearest training target "
        f"{near.sum()}, at the first one {first.sum()}"
    )
    print(
        "of the 5 balls above and below the first one the strike at the first one hits "
        f"{first[:, 3].sum()}"
    )
    assert own.all() and near.sum() <= 24 and first.sum() <= 12 and first[:, 3].all()
