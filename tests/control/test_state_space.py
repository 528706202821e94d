"""What models and policies see of a state, and where trajectories are matched."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.state_space import MatchSpace, StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian

NAMES, UNITS = ("q1", "q2", "dq1", "dq2"), ("rad", "rad", "rad/s", "rad/s")


@pytest.fixture
def space() -> StateSpace:
    return StateSpace(NAMES, UNITS, (0, 1), joint_match(NAMES, UNITS))


@pytest.fixture
def links() -> MatchSpace:
    """Positions of the ends of two links of 0.5 m that hang down, of relative joint angles."""
    angles = torch.tensor([[1.0, 0, 0, 0], [1.0, 1.0, 0, 0]], dtype=torch.float64)
    weights = torch.zeros(4, 8, dtype=torch.float64)
    weights[0, 4], weights[1, 6] = 0.5, -0.5
    weights[2, [4, 5]], weights[3, [6, 7]] = 0.5, -0.5
    return MatchSpace(("x1", "y1", "x2", "y2"), ("m",) * 4, angles, weights)


def point(x: Tensor) -> Gaussian:
    return Gaussian(x, torch.zeros(*x.shape, x.shape[-1], dtype=torch.float64))


def test_features_are_the_other_entries_then_sines_then_cosines(
    space: StateSpace, draws: Draws
) -> None:
    x = draws.normal(5, 4)
    expected = torch.cat([x[:, 2:], x[:, :2].sin(), x[:, :2].cos()], -1)
    assert torch.equal(space.features(x), expected)
    assert space.feature_names == ("dq1", "dq2", "sin q1", "sin q2", "cos q1", "cos q2")


def test_features_do_not_change_by_a_full_turn(space: StateSpace, draws: Draws) -> None:
    x = draws.normal(4)
    turned = x + 2 * torch.pi * torch.tensor([1.0, -3.0, 0.0, 0.0], dtype=torch.float64)
    assert_close(space.features(turned), space.features(x))


def test_belief_at_zero_covariance_holds_the_features_and_their_gradient(
    space: StateSpace, draws: Draws
) -> None:
    x = draws.normal(3, 4)
    features, slope = space.feature_moments(point(x))
    assert_close(features.mean, space.features(x))
    assert_close(features.cov, torch.zeros(3, 6, 6, dtype=torch.float64))
    for i in range(3):
        assert_close(slope[i], torch.autograd.functional.jacobian(space.features, x[i]).mT)


def test_angles_in_any_position_keep_their_names(draws: Draws) -> None:
    names, units = ("a", "b", "c"), ("m", "rad", "m")
    space, x = StateSpace(names, units, (1,), joint_match(names, units)), draws.normal(3)
    assert space.feature_names == ("a", "c", "sin b", "cos b")
    assert torch.equal(space.features(x), torch.stack([x[0], x[2], x[1].sin(), x[1].cos()]))
    assert_close(space.feature_moments(point(x))[0].mean, space.features(x))


def test_state_without_angles_is_its_own_features(draws: Draws) -> None:
    space, x = StateSpace(NAMES, UNITS, (), joint_match(NAMES, UNITS)), draws.normal(2, 4)
    assert torch.equal(space.features(x), x)
    assert space.feature_names == NAMES


def test_slopes_are_those_of_autograd(links: MatchSpace, draws: Draws) -> None:
    states = draws.normal(3, 4)
    expected = torch.stack([torch.autograd.functional.jacobian(links, each) for each in states])
    assert_close(links.slopes(states), expected, atol=1e-15, rtol=1e-14)


def test_link_positions_are_those_of_geometry(links: MatchSpace) -> None:
    right_angle = torch.tensor([torch.pi / 2, -torch.pi / 2, 3.0, -3.0], dtype=torch.float64)
    expected = torch.tensor([0.5, 0.0, 0.5, -0.5], dtype=torch.float64)
    assert_close(links(right_angle), expected)


def test_match_belief_at_zero_covariance_is_the_observation(
    links: MatchSpace, draws: Draws
) -> None:
    x = draws.normal(3, 4)
    observed = links.moments(point(x))
    assert_close(observed.mean, links(x))
    assert_close(observed.cov, torch.zeros(3, 4, 4, dtype=torch.float64))


def test_match_belief_has_the_moments_of_observed_samples(links: MatchSpace, draws: Draws) -> None:
    state, count = draws.belief(4), 50_000
    samples = links(state.sample(count, draws.generator))
    observed = links.moments(state)
    deviation = samples - observed.mean
    products = deviation[:, :, None] * deviation[:, None, :]
    assert (deviation.mean(0).abs() <= 4 * samples.std(0) / count**0.5).all()
    assert ((products.mean(0) - observed.cov).abs() <= 4 * products.std(0) / count**0.5).all()


def test_joint_match_is_the_identity_in_single_and_double_precision(draws: Draws) -> None:
    match, belief = joint_match(NAMES, UNITS), draws.belief(2, 4)
    assert torch.equal(match(belief.mean.float()), belief.mean.float())
    observed = match.moments(belief)
    assert_close(observed.mean, belief.mean)
    assert_close(observed.cov, belief.cov)


def test_units_that_do_not_fit_are_an_error() -> None:
    with pytest.raises(ValueError, match="got 1 units and a match space of 4"):
        StateSpace(NAMES, ("rad",), (0,), joint_match(NAMES, UNITS))


def test_match_space_of_numbers_that_are_none_is_an_error() -> None:
    with pytest.raises(ValueError, match="weights must be finite, got nan"):
        MatchSpace(("x",), ("m",), torch.zeros(0, 1), torch.full((1, 1), torch.nan))
    with pytest.raises(ValueError, match=r"angles must have shape \(K, D\), got \(1,\)"):
        MatchSpace(("x",), ("m",), torch.zeros(1), torch.ones(1, 3))
