"""Limits of a motion, and the closed-form probability of leaving them."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.state_box import StateBox
from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.gp.gaussian import Gaussian

NAMES, UNITS, INF = ("q1", "dq1", "q2", "dq2"), ("rad", "rad/s", "rad", "rad/s"), math.inf
SPACE = StateSpace(NAMES, UNITS, (0, 2), MatchSpace.of_links(("q1", "q2"), (0.5, 0.5), NAMES))
SPEEDS = StateBox(SPACE, {"dq1": (-1.0, 1.5), "dq2": (-2.0, INF)})
TIP = StateBox(SPACE, {"q1": (-INF, 1.0), "y2": (-0.2, INF)})


@pytest.fixture
def states(draws: Draws) -> Gaussian:
    """Marginals at 3 steps, about as wide as the boxes."""
    return draws.belief(3, 4, scale=0.5)


@pytest.mark.parametrize("box", [SPEEDS, TIP], ids=["speeds", "tip"])
def test_states_are_outside_where_a_margin_is_negative(box: StateBox, draws: Draws) -> None:
    x = 2 * draws.normal(200, 4)
    values = dict(zip(NAMES, x.T, strict=True)) | {"y2": SPACE.observe(x)[:, 3]}
    outside = torch.zeros(200, dtype=torch.bool)
    for name, (low, high) in box.limits.items():
        outside |= (values[name] < low) | (values[name] > high)
    assert 20 < outside.sum() < 180
    assert torch.equal((box.margins(x) < 0).any(-1), outside)
    assert all(bool(box.guard(state)) == out for state, out in zip(x, outside, strict=True))


def test_guard_names_the_first_entry_that_left() -> None:
    inside, outside = torch.zeros(4), torch.tensor([0.0, 1.0, 0.0, -12.34])
    assert SPEEDS.guard(inside) == ""
    line = "dq2 = -12.3 rad/s left its limits of -2 to inf rad/s"
    assert SPEEDS.guard(outside) == SPEEDS.guard(torch.stack([inside, outside])) == line
    hanging = torch.tensor([torch.pi, 0.0, 0.0, 0.0])
    lowered = StateBox(SPACE, {"y2": (-0.2, INF)})
    assert lowered.guard(hanging) == "y2 = -1 m left its limits of -0.2 to inf m"


def left_by_samples(box: StateBox, states: Gaussian, draws: Draws) -> Tensor:
    """Which of 1e6 samples leave which limits, drawn in pieces that fit a processor's cache."""
    pieces = (states.sample(10_000, draws.generator) for _ in range(100))
    return torch.cat([box.margins(samples) < 0 for samples in pieces])


def test_probability_of_leaving_is_that_of_samples(states: Gaussian, draws: Draws) -> None:
    """Of one entry with two limits it is exact, up to five standard errors of 1e6 samples."""
    box = StateBox(SPACE, {"dq1": (-1.0, 1.5)})
    left = left_by_samples(box, states, draws)
    sampled = left.any(-1).double().mean(0)
    error = (sampled * (1 - sampled) / len(left)).sqrt()
    assert (sampled > 0.01).all()
    assert ((box.leaving_by_step(states) - sampled).abs() < 5 * error).all()


def test_bound_of_several_entries_and_steps_is_above_the_probability_of_samples(
    states: Gaussian, draws: Draws
) -> None:
    """By at most the sum over pairs of events (Bonferroni), here of independent steps."""
    left = left_by_samples(SPEEDS, states, draws)
    left_at, left_ever = left.any(-1).double().mean(0), left.any(-1).any(-1).double().mean()
    assert (SPEEDS.leaving_by_step(states) > left_at - 5e-4 * 5).all()
    pairs = (left.double().mean((0, 1)).sum() * 3) ** 2 / 2
    bound = SPEEDS.leaving_by_step(states).sum(-1)
    assert left_ever - 5 * 5e-4 < bound < left_ever + pairs


def test_tip_leaves_as_the_gaussian_of_its_moments_does(states: Gaussian) -> None:
    box, observed = StateBox(SPACE, {"y2": (-0.2, 0.9)}), SPACE.match_space.moments(states)
    tip = torch.distributions.Normal(observed.mean[:, 3], observed.std[:, 3])
    bounds = torch.tensor([[-0.2], [0.9]], dtype=torch.float64)
    below, above = tip.cdf(bounds)
    assert_close(box.leaving_by_step(states), below + 1 - above)


def test_certain_states_leave_surely_or_never() -> None:
    x = torch.tensor([[0.0, 1.4, 0.0, 0.0], [0.0, 1.6, 0.0, 0.0]], dtype=torch.float64)
    certain = Gaussian(x, torch.zeros(2, 4, 4, dtype=torch.float64))
    assert SPEEDS.leaving_by_step(certain).tolist() == [0.0, 1.0]
    assert SPEEDS.penalty(certain)[0] == 0.0


def test_wide_marginals_leave_with_probability_of_all_limits(states: Gaussian) -> None:
    """Each of three limits is beyond half of a Gaussian that is far wider than the box."""
    wide = Gaussian(states.mean, 1e12 * states.cov)
    box = StateBox(SPACE, {"dq1": (-1.0, 1.5)})
    one = torch.ones(3, dtype=torch.float64)
    assert_close(box.leaving_by_step(wide), one, rtol=0, atol=1e-5)
    assert (SPEEDS.leaving_by_step(wide) == 1).all()  # no more than a probability


def penalised(box: StateBox) -> Callable[[Tensor, Tensor], Tensor]:
    return lambda mean, root: box.penalty(Gaussian(mean, root @ root.mT))


@pytest.mark.parametrize("box", [SPEEDS, TIP], ids=["speeds", "tip"])
@pytest.mark.parametrize("spread", [1.0, 0.1])
def test_gradients_of_the_penalty_are_right(box: StateBox, spread: float, draws: Draws) -> None:
    mean, root = draws.normal(3, 4), spread * torch.linalg.cholesky(draws.cov(3, 4))
    assert torch.autograd.gradcheck(penalised(box), (mean.requires_grad_(), root.requires_grad_()))


def test_penalty_pulls_back_from_far_outside_and_hardly_far_inside() -> None:
    speed = torch.tensor([1e3, 10.0, 0.0], dtype=torch.float64, requires_grad=True)
    mean = torch.outer(speed, torch.eye(4, dtype=torch.float64)[1])
    cov = 0.01 * torch.eye(4, dtype=torch.float64).expand(3, 4, 4)
    penalty = SPEEDS.penalty(Gaussian(mean, cov))
    (gradient,) = torch.autograd.grad(penalty.sum(), speed)
    assert penalty.isfinite().all()
    assert_close(gradient[:2], (speed.detach()[:2] - 1.5) / 0.01, rtol=0.01, atol=0)
    assert 0 <= penalty[2] < 1e-20
    assert gradient[2].abs() < 1e-20


def test_penalty_is_minus_the_log_of_what_stays(states: Gaussian) -> None:
    box = StateBox(SPACE, {"dq2": (-INF, 1.0)})
    staying = 1 - box.leaving_by_step(states)
    assert_close(box.penalty(states), -staying.log())


@pytest.mark.parametrize(
    "limits, threshold, line",
    [
        ({"dq3": (0.0, 1.0)}, 0.05, "limits must be of q1, dq1, q2, dq2, x1, y1, x2, y2, got dq3"),
        ({"q1": (1.0, 1.0)}, 0.05, "limits of q1 must be two numbers, low < high, got (1.0, 1.0)"),
        (
            {"q1": (math.nan, 1.0)},
            0.05,
            "limits of q1 must be two numbers, low < high, got (nan, 1.0)",
        ),
        ({"q1": 1}, 0.05, "limits of q1 must be two numbers, low < high, got 1"),
        ({"q1": ("0", "1")}, 0.05, "limits of q1 must be two numbers, low < high, got ('0', '1')"),
        ({"q1": (-INF, INF)}, 0.05, "limits must hold a finite number, got {'q1': (-inf, inf)}"),
        ({}, 0.05, "limits must hold a finite number, got {}"),
        ({"q1": (0.0, 1.0)}, 1.0, "threshold must be below 1, got 1.0"),
        ({"q1": (0.0, 1.0)}, 0.0, "threshold must be a positive finite number, got 0.0"),
    ],
)
def test_wrong_limits_are_refused(
    limits: dict[str, tuple[float, float]], threshold: float, line: str
) -> None:
    with pytest.raises(ValueError) as refused:
        StateBox(SPACE, limits, threshold)
    assert str(refused.value) == line


def test_settings_are_what_json_has() -> None:
    limits = {"dq1": [-1.0, 1.5], "dq2": [-2.0, None]}
    assert SPEEDS.settings == {"limits": limits, "threshold": 0.05}
