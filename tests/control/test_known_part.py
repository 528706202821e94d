"""The known linear part of the dynamics: what follows from velocities, and what is refused."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.known_part import KnownPart
from torch_pmil.envs.history import History

NAMES = ("x", "q", "dx", "dq")
CART = KnownPart.of_velocities(NAMES, {"x": "dx", "q": "dq"}, num_actions=2, time_step=0.04)


@pytest.mark.parametrize(
    "known",
    [KnownPart.of_differences(4), KnownPart.of_successors(4), CART],
    ids=["differences", "successors", "velocities"],
)
def test_targets_and_successors_are_inverse(known: KnownPart, draws: Draws) -> None:
    x, u, outputs = draws.normal(7, 4), draws.normal(7, 2), draws.normal(7, known.num_outputs)
    after = known.successors(x, u, outputs)
    assert_close(known.targets(x, u, after), outputs)


def test_differences_and_successors_are_what_they_are_called(draws: Draws) -> None:
    x, u, after = draws.normal(3, 4), draws.normal(3, 2), draws.normal(3, 4)
    assert torch.equal(KnownPart.of_differences(4).targets(x, u, after), after - x)
    assert torch.equal(KnownPart.of_successors(4).targets(x, u, after), after)


def test_constant_acceleration_is_integrated_exactly(draws: Draws) -> None:
    """The trapezoidal rule is exact for a velocity that changes linearly."""
    start, velocity, acceleration = draws.normal(5, 2), draws.normal(5, 2), draws.normal(5, 2)
    dt = 0.04
    x = torch.cat([start, velocity], -1)
    after = CART.successors(x, draws.normal(5, 2), dt * acceleration)
    assert_close(after[:, :2], start + dt * velocity + dt**2 * acceleration / 2, rtol=0, atol=1e-15)
    assert_close(after[:, 2:], velocity + dt * acceleration, rtol=0, atol=1e-15)


def test_error_of_the_rule_falls_with_the_cube_of_the_time_step() -> None:
    """q = sin t, with the right change of the velocity: the error is dt^3 / 12 in the limit."""
    errors = []
    for dt in (0.02, 0.01):
        t = torch.tensor([0.0, dt], dtype=torch.float64) + 0.3
        known = KnownPart.of_velocities(("q", "dq"), {"q": "dq"}, 1, dt)
        x = torch.stack([t.sin(), t.cos()], -1)
        after = known.successors(x[0], torch.zeros(1).double(), x[1, 1:] - x[0, 1:])
        errors.append((after[0] - x[1, 0]).item() / dt**3)
    assert errors[0] == pytest.approx(errors[1], rel=0.05)
    # the change of the acceleration in a second is -cos t
    assert abs(errors[1]) == pytest.approx(torch.tensor(0.3).cos().item() / 12, rel=0.05)


def test_actions_have_their_known_effect(draws: Draws) -> None:
    matrix, gain = draws.normal(2, 5), torch.eye(2, dtype=torch.float64)
    known = KnownPart(matrix, gain, (0, 1))
    x, u = draws.normal(4, 2), draws.normal(4, 3)
    expected = x @ matrix[:, :2].mT + u @ matrix[:, 2:].mT
    assert_close(known.successors(x, u, torch.zeros(4, 2).double()), expected)


@pytest.mark.parametrize(
    ("velocities", "got"),
    [({"x": "y"}, "{'x': 'y'}"), ({"x": "dx", "dx": "dq"}, "{'x': 'dx', 'dx': 'dq'}")],
)
def test_velocities_must_be_learned_entries(velocities: dict[str, str], got: str) -> None:
    with pytest.raises(ValueError, match="velocities must be entries of x, q, dx, dq") as error:
        KnownPart.of_velocities(NAMES, velocities, 1, 0.1)
    assert str(error.value).endswith(f"got {got}")


@pytest.mark.parametrize(
    ("matrix", "gain", "learned", "line"),
    [
        (torch.zeros(2, 1), torch.eye(2), (0, 1), "a column for each of the 2 entries"),
        (torch.zeros(3, 4), torch.eye(2), (0, 1), r"matrix must have shape \(2, 'D \+ F'\)"),
        (torch.zeros(2, 3), 2 * torch.eye(2), (0, 1), "rows of gain are the identity"),
        (torch.zeros(2, 3), torch.eye(2), (0, 2), r"2 entries of the state .* got \(0, 2\)"),
        (torch.full((2, 3), torch.nan), torch.eye(2), (0, 1), "matrix must be finite"),
    ],
)
def test_parts_that_do_not_fit_are_refused(
    matrix: torch.Tensor, gain: torch.Tensor, learned: tuple[int, ...], line: str
) -> None:
    with pytest.raises(ValueError, match=line.replace("'", "")):
        KnownPart(matrix, gain, learned)


def servo(draws: Draws, dt: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """States, held targets and successors of two joints with linear servos of their own."""
    x, u = draws.normal(30, 4), draws.normal(30, 2)
    after = torch.empty_like(x)
    for joint, (stiffness, damping) in enumerate(((90.0, 20.0), (400.0, 25.0))):
        motion = torch.tensor([[0.0, 1.0, 0.0], [-stiffness, -damping, stiffness], [0.0] * 3])
        step = torch.linalg.matrix_exp(dt * motion.double())
        of_joint = torch.stack([x[:, joint], x[:, joint + 2], u[:, joint]], -1) @ step.mT
        after[:, joint], after[:, joint + 2] = of_joint[:, 0], of_joint[:, 1]
    return x, u, after


def test_learned_rule_is_exact_for_linear_servos(draws: Draws) -> None:
    x, u, after = servo(draws, 0.04)
    known = CART.with_rule(CART.fitted_rule(x, after))
    outputs = known.targets(x, u, after)
    assert_close(outputs, CART.targets(x, u, after))
    assert_close(known.successors(x, u, outputs), after, rtol=0, atol=1e-5)
    assert (CART.successors(x, u, outputs) - after).abs().max() > 0.02


def test_rule_stays_the_trapezoidal_one_where_it_is_exact_or_nothing_moves(draws: Draws) -> None:
    x, u, outputs = draws.normal(20, 4), draws.normal(20, 2), draws.normal(20, 2)
    half = torch.full((2, 2), 0.02, dtype=torch.float64)
    assert_close(CART.rule, half)
    assert_close(CART.fitted_rule(x, CART.successors(x, u, outputs)), half)
    still = torch.zeros(5, 4, dtype=torch.float64)
    assert_close(CART.fitted_rule(still, still), half)


@pytest.mark.parametrize("still", [0, 180], ids=["it moves", "it mostly rests"])
@pytest.mark.parametrize("turned", [0, 1], ids=["smooth", "turned back"])
def test_rule_is_found_in_readings_with_errors(draws: Draws, still: int, turned: int) -> None:
    """Whether a joint rests for most readings, or is read at 20 m/s twice in the same place."""
    x, after, error = readings(draws)
    rest = 1e-9 * draws.normal(still, 4)
    back = torch.tensor([[0.0, 0.0, 20.0, 0.0]], dtype=torch.float64)[:turned]
    found = CART.fitted_rule(torch.cat([x, rest, back]), torch.cat([after, rest, back]))
    assert ((found - RULE).abs() < 4 * error).all()


def test_one_hasty_motion_does_not_outweigh_all_others(draws: Draws) -> None:
    """It stops from 20 m/s, and goes a little further than the trapezoidal rule says."""
    x, after, _ = readings(draws)
    fast, stopped = torch.zeros(2, 1, 4, dtype=torch.float64)
    fast[0, 2], stopped[0, 0] = 20.0, 20 * 0.0217
    x, after = torch.cat([x, fast]), torch.cat([after, stopped])
    speeds, moved = torch.stack([x[:, 2], after[:, 2]], -1), (after - x)[:, 0]
    plain = torch.linalg.lstsq(speeds, moved).solution
    assert (CART.fitted_rule(x, after)[0] - RULE[0]).norm() < (plain - RULE[0]).norm() / 4


RULE = torch.tensor([[0.0203, 0.0202], [0.0199, 0.0202]], dtype=torch.float64)


def readings(draws: Draws) -> tuple[Tensor, Tensor, Tensor]:
    """Transitions by :data:`RULE` with normal errors, and the standard errors of its numbers."""
    x, outputs = draws.normal(60, 4), draws.normal(60, 2)
    after = CART.with_rule(RULE).successors(x, torch.zeros(60, 2), outputs)
    after[:, :2] += 1e-4 * draws.normal(60, 2)
    speeds = torch.stack([x[:, 2:], after[:, 2:]], -1).transpose(0, 1)
    return x, after, 1e-4 * torch.linalg.inv(speeds.mT @ speeds).diagonal(dim1=-2, dim2=-1).sqrt()


def test_rule_is_taken_as_it_is_given() -> None:
    rule = torch.tensor([[0.01, 0.03], [0.015, 0.02]], dtype=torch.float64)
    assert_close(CART.with_rule(rule).rule, rule)
    with pytest.raises(ValueError, match=r"rule must have shape \(2, 2\), got \(2,\)"):
        CART.with_rule(rule[0])


def test_past_of_a_state_is_certain() -> None:
    past = History(("q", "dq"), ("u",), 0.1, hidden=("dq",), past_actions=1)
    known = KnownPart.of_readings(past.shift, past.gain, past.measured)
    assert known.uncertain.tolist() == [True, True, False]
    assert CART.uncertain.all()
