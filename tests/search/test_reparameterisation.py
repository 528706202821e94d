"""The variables of the policy search: the same policies, the same loss, and a gradient that leads
further.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.losses import HORIZON, NOISE_STD, SPACE, make_cost, make_kl
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.lbfgs import MinimiseResult, differentiated, in_one_vector, minimise
from torch_pmil.model.rollout import PredictionError, predict_trajectory
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.reparameterisation import NOISE_VARIANCE, ReparameterisedLoss
from torch_pmil.search.trajectory_loss import TrajectoryLoss

START = Gaussian(torch.zeros(2, dtype=torch.float64), 0.01 * torch.eye(2, dtype=torch.float64))


@pytest.fixture
def loss() -> TrajectoryKLLoss:
    return make_kl(seed=0)


def gram(policy: RBFPolicy) -> Tensor:
    """K + sigma^2 I of a network with one output and scale 1, from its definition."""
    centres = policy.centres / policy.log_widths.exp()
    squares = (centres[:, None] - centres).square().sum(-1)
    return (-squares / 2).exp() + NOISE_VARIANCE * torch.eye(len(centres))


def total(loss: TrajectoryKLLoss) -> Tensor:
    return loss.per_step(START).sum()


def test_start_is_the_policy_itself(loss: TrajectoryKLLoss) -> None:
    """Its weights come back as accurately as their system is conditioned; its loss is theirs."""
    weights = loss.actor_network.weights.detach().clone()
    condition = torch.linalg.cond(gram(loss.actor_network)).item()
    reparameterised = ReparameterisedLoss(loss)
    value = reparameterised.total(loss.per_step, START, HORIZON).item()
    reparameterised.write()
    written = loss.actor_network.weights.detach()
    assert (written - weights).norm() <= len(weights) * condition * torch.finfo(
        torch.float64
    ).eps * weights.norm()
    assert total(loss).item() == value


def test_values_are_those_of_the_network_at_its_centres_with_noise(loss: TrajectoryKLLoss) -> None:
    policy = loss.actor_network
    policy.log_widths.data += 0.3
    assert_close(ReparameterisedLoss(loss).values[0], gram(policy) @ policy.weights)


def test_gradient_is_that_of_the_policy_with_the_weights_solved_for(
    loss: TrajectoryKLLoss, draws: Draws
) -> None:
    policy, reparameterised = loss.actor_network, ReparameterisedLoss(loss)
    reparameterised.values.data += 0.3 * draws.normal(*reparameterised.values.shape)
    value = reparameterised.total(loss.per_step, START, HORIZON)
    centres, values, widths = torch.autograd.grad(value, reparameterised.variables)
    reparameterised.write()
    of_centres, of_weights, of_widths = torch.autograd.grad(
        total(loss), [policy.centres, policy.weights, policy.log_widths]
    )
    assert_close(centres, of_centres)
    assert_close(widths, of_widths)
    assert_close(values[0], torch.linalg.solve(gram(policy), of_weights))


@pytest.mark.parametrize(
    ("make", "method"),
    [
        *(
            (make, method)
            for make in (make_kl, make_cost)
            for method in ("per_step", "mean_per_step")
        ),
        (make_kl, "cross_entropy_per_step"),
    ],
)
def test_kernels_without_a_graph_give_the_same_bits(
    make: Callable[[int], TrajectoryLoss], method: str, draws: Draws
) -> None:
    loss = make(0)
    reparameterised, per_step = ReparameterisedLoss(loss), getattr(loss, method)
    arguments = per_step, START, HORIZON - 1
    assert loss.objective(*arguments) is not None
    direct = reparameterised.as_function(*arguments)
    variables = reparameterised.variables
    by_formulas = differentiated(variables, lambda: reparameterised.total(*arguments))
    point = in_one_vector(variables)
    for _ in range(3):  # arrays are used again
        point = point + 0.1 * draws.normal(len(point))
        found, expected = direct(point), by_formulas(point)
        assert found[0] == expected[0]
        assert torch.equal(found[1], expected[1])


def test_where_kernels_have_no_answer_the_formulas_say_why(loss: TrajectoryKLLoss) -> None:
    reparameterised = ReparameterisedLoss(loss)
    direct = reparameterised.as_function(loss.per_step, START, HORIZON)
    point = in_one_vector(reparameterised.variables)
    value = direct(point)[0]
    with pytest.raises(PredictionError, match="step 1 of 4"):
        direct(point * torch.nan)
    assert direct(point)[0] == value


def test_what_kernels_do_not_know_has_a_graph(loss: TrajectoryKLLoss) -> None:
    several = Gaussian(START.mean.expand(3, 2), START.cov.expand(3, 2, 2))
    assert loss.objective(loss.per_step, several, HORIZON) is None
    with loss.penalised(lambda states: states.mean[..., 0]):
        assert loss.objective(loss.per_step, START, HORIZON) is None
    mean, cov = loss.demonstrated_mean, loss.demonstrated_cov
    beliefs = Gaussian(mean.expand(3, *mean.shape), cov.expand(3, *cov.shape))
    of_three = TrajectoryKLLoss(loss.actor_network, loss.dynamics, SPACE, beliefs, NOISE_STD)
    assert of_three.objective(of_three.per_step, START, HORIZON) is None
    own = make_kl(0, prediction=lambda *given: predict_trajectory(*given))
    assert own.objective(own.per_step, START, HORIZON) is None


def found_by_values(loss: TrajectoryKLLoss, iterations: int) -> MinimiseResult:
    reparameterised = ReparameterisedLoss(loss)
    result = minimise(
        reparameterised.variables,
        lambda: reparameterised.total(loss.per_step, START, HORIZON),
        iterations,
    )
    reparameterised.write()
    return result


def test_search_changes_the_policy_itself_and_keeps_its_parameters(loss: TrajectoryKLLoss) -> None:
    before, names = list(loss.actor_network.parameters()), list(loss.actor_network.state_dict())
    found = found_by_values(loss, iterations=5)
    assert found.loss < found.initial_loss
    assert total(loss).item() == pytest.approx(found.loss, rel=1e-9)
    assert all(
        one is other for one, other in zip(before, loss.actor_network.parameters(), strict=True)
    )
    assert list(loss.actor_network.state_dict()) == names


def test_overlapping_functions_are_searched_in_fewer_iterations() -> None:
    """Sixty functions, twice as wide as their centres' spread."""

    def overlapping() -> TrajectoryKLLoss:
        loss, draws = make_kl(seed=0), Draws(seed=1)
        loss.actor_network = RBFPolicy(draws.normal(60, 3), torch.tensor([2.0]), 2 * torch.ones(3))
        loss.actor_network.weights.data.copy_(0.1 * draws.normal(60, 1))
        return loss

    plain = overlapping()
    by_weights = minimise(plain.actor_network.parameters(), lambda: total(plain), max_iterations=15)
    by_values = found_by_values(overlapping(), iterations=15)
    assert by_values.loss < by_weights.loss
