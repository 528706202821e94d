"""The imitation objective, against the KL of its prediction and as a TorchRL loss."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import LossModule

from tests.draws import Draws
from torch_pmil.dynamics import GPDynamics
from torch_pmil.gaussian import Gaussian
from torch_pmil.kl import gaussian_kl, trajectory_kl
from torch_pmil.objective import TrajectoryKLLoss
from torch_pmil.policy import RBFPolicy
from torch_pmil.rollout import PredictionError, predict_mean_trajectory, predict_trajectory
from torch_pmil.state_space import MatchSpace, StateSpace

HORIZON, NOISE_STD = 4, 0.1
TIP = MatchSpace(("x", "y"), ("m", "m"), torch.tensor([[1.0, 0.0]]), torch.tensor([[0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.0, 0.5]]))
SPACE = StateSpace(("q", "dq"), ("rad", "rad/s"), (0,), TIP)


def make_loss(seed: int) -> TrajectoryKLLoss:
    """A pendulum that shows its tip, a random policy and a random expert."""
    draws = Draws(seed)
    inputs = torch.cat([SPACE.features(draws.uniform(-1.5, 1.5, 25, 2)), draws.uniform(-2, 2, 25, 1)], -1)
    dynamics = GPDynamics(4, 2)
    dynamics.set_data(inputs, 0.1 * torch.stack([inputs[:, 0], inputs[:, 3] - 2 * inputs[:, 1]], -1))
    dynamics.gp.covar_module.base_kernel.lengthscale = torch.tensor([[3.0, 1.5, 1.5, 4.0]])
    dynamics.gp.likelihood.noise = torch.full((2, 1), 1e-3)
    policy = RBFPolicy(draws.normal(5, 3), torch.tensor([2.0]), torch.ones(3))
    policy.weights.data.copy_(0.5 * draws.normal(5, 1))
    expert = draws.belief(HORIZON, 2, scale=0.05)
    return TrajectoryKLLoss(policy, dynamics, SPACE, expert, NOISE_STD)


@pytest.fixture
def loss() -> TrajectoryKLLoss:
    return make_loss(seed=0)


@pytest.fixture
def initial(draws: Draws) -> Gaussian:
    return Gaussian(0.5 * draws.normal(2), draws.cov(2, scale=0.02))


def expert_of(loss: TrajectoryKLLoss) -> Gaussian:
    return Gaussian(loss.expert_mean, loss.expert_cov)


def start(initial: Gaussian) -> TensorDict:
    return TensorDict({"observation": {"mean": initial.mean, "var": initial.cov}})


def test_loss_is_the_kl_of_the_predicted_trajectory(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    expected = trajectory_kl(expert_of(loss), loss.predict(initial))
    torch.testing.assert_close(loss(start(initial))["loss_kl"], expected, rtol=1e-12, atol=0)
    torch.testing.assert_close(loss.per_step(initial).sum(), expected, rtol=1e-12, atol=0)


def test_steps_are_the_kls_of_the_marginals(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    predicted, steps = loss.predict(initial), loss.per_step(initial)
    assert steps.shape == (HORIZON,)
    for t in range(HORIZON):
        torch.testing.assert_close(steps[t], gaussian_kl(expert_of(loss)[t], predicted[t]), rtol=1e-12, atol=0)


def test_prediction_is_that_of_the_state_seen_in_the_match_space_with_noise(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    states = predict_trajectory(initial, loss.actor_network, loss.dynamics, SPACE, HORIZON)
    seen, predicted = TIP.belief(states), loss.predict(initial)
    torch.testing.assert_close(predicted.mean, seen.mean, rtol=0, atol=0)
    torch.testing.assert_close(predicted.cov - seen.cov, (NOISE_STD**2 * torch.eye(2, dtype=torch.float64)).expand(HORIZON, 2, 2))


def test_noise_floors_the_predicted_variance(loss: TrajectoryKLLoss) -> None:
    """A tip lies on a circle: without the noise, its covariance is singular at a certain state."""
    certain = Gaussian(torch.zeros(2, dtype=torch.float64), torch.zeros(2, 2, dtype=torch.float64))
    assert torch.linalg.eigvalsh(loss.predict(certain).cov).min() >= NOISE_STD**2 * (1 - 1e-9)


@pytest.mark.parametrize("horizon", [1, 3, HORIZON])
def test_shorter_horizon_is_the_beginning_of_the_whole(loss: TrajectoryKLLoss, initial: Gaussian, horizon: int) -> None:
    for per_step in (loss.per_step, loss.mean_per_step):
        torch.testing.assert_close(per_step(initial, horizon), per_step(initial)[:horizon], rtol=1e-12, atol=0)


def test_mean_objective_is_the_kl_of_a_prediction_as_wide_as_the_expert(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    states = predict_mean_trajectory(initial.mean, loss.actor_network, loss.dynamics, SPACE, HORIZON)
    as_wide = Gaussian(TIP(states), loss.expert_cov)
    torch.testing.assert_close(loss.mean_per_step(initial), gaussian_kl(expert_of(loss), as_wide))


def test_batch_of_starts_is_averaged(loss: TrajectoryKLLoss, draws: Draws) -> None:
    initial = draws.belief(3, 2, scale=0.02)
    alone = torch.stack([loss(start(initial[i]))["loss_kl"] for i in range(3)])
    torch.testing.assert_close(loss(start(initial))["loss_kl"], alone.mean())


def test_expert_that_is_the_prediction_costs_nothing(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    predicted = loss.predict(initial).detach()
    perfect = TrajectoryKLLoss(loss.actor_network, loss.dynamics, SPACE, predicted, NOISE_STD)
    torch.testing.assert_close(perfect(start(initial))["loss_kl"], torch.zeros((), dtype=torch.float64), rtol=0, atol=1e-9)


@pytest.mark.parametrize("objective", ["per_step", "mean_per_step"])
@pytest.mark.parametrize("name", ["centres", "weights", "log_widths"])
def test_gradient_is_the_difference_quotient(loss: TrajectoryKLLoss, initial: Gaussian, draws: Draws, objective: str, name: str) -> None:
    parameter, per_step = loss.actor_network.get_parameter(name), getattr(loss, objective)
    (gradient,) = torch.autograd.grad(per_step(initial).sum(), parameter)
    direction, step, values = draws.normal(*parameter.shape), 1e-4, []
    for move in (step, -2 * step):
        parameter.data.add_(direction, alpha=move)
        values.append(per_step(initial).sum().item())
    assert (gradient * direction).sum().item() == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-5)


def test_gradient_reaches_the_policy_and_leaves_the_model_alone(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    loss(start(initial))["loss_kl"].backward()
    assert all((parameter.grad != 0).all() for parameter in loss.actor_network.parameters())
    assert all(parameter.grad is None for parameter in loss.dynamics.parameters())


def test_loss_follows_the_conventions_of_torchrl(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    assert isinstance(loss, LossModule)
    assert loss.in_keys == [("observation", "mean"), ("observation", "var")]
    assert loss.out_keys == ["loss_kl"]
    result = loss(start(initial))
    assert list(result.keys()) == loss.out_keys
    assert result["loss_kl"].shape == ()


def test_loss_takes_tensors_in_place_of_a_tensordict(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    expected = loss(start(initial))["loss_kl"]
    assert torch.equal(loss(observation_mean=initial.mean, observation_var=initial.cov), expected)
    assert torch.equal(loss(initial.mean, initial.cov), expected)


def test_other_keys_can_be_set_for_one_loss(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    expected, other = loss(start(initial))["loss_kl"], make_loss(seed=0)
    loss.set_keys(mean="mu", var=("start", "Sigma"))
    assert loss.in_keys == ["mu", ("start", "Sigma")]
    renamed = TensorDict({"mu": initial.mean, "start": {"Sigma": initial.cov}})
    assert torch.equal(loss(renamed)["loss_kl"], expected)
    assert torch.equal(loss(mu=initial.mean, start_Sigma=initial.cov), expected)
    assert torch.equal(other(start(initial))["loss_kl"], expected)


def test_unknown_key_is_an_error(loss: TrajectoryKLLoss) -> None:
    with pytest.raises(ValueError, match="reward is not an accepted tensordict key"):
        loss.set_keys(reward="r")


def test_fresh_loss_with_the_state_of_another_is_the_same(loss: TrajectoryKLLoss, initial: Gaussian, tmp_path: Path) -> None:
    """Policy, model with its data, and expert: all are in the state."""
    other = make_loss(seed=1)
    expected = loss(start(initial))["loss_kl"]
    assert not torch.allclose(other(start(initial))["loss_kl"], expected)
    torch.save(loss.state_dict(), tmp_path / "loss.pt")
    other.load_state_dict(torch.load(tmp_path / "loss.pt", weights_only=True))
    assert torch.equal(other(start(initial))["loss_kl"], expected)
    assert {name.split(".")[0] for name in loss.state_dict()} == {"actor_network", "dynamics", "expert_mean", "expert_cov"}


def test_expert_of_another_dimension_is_an_error(loss: TrajectoryKLLoss, draws: Draws) -> None:
    with pytest.raises(ValueError, match=r"expert must have the 2 entries \('x', 'y'\), got 3"):
        TrajectoryKLLoss(loss.actor_network, loss.dynamics, SPACE, draws.belief(HORIZON, 3), NOISE_STD)


def test_failed_prediction_is_an_error_that_names_its_step(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    negative = Gaussian(initial.mean, -100 * torch.eye(2, dtype=torch.float64))
    with pytest.raises(PredictionError, match=rf"prediction of step 1 of {HORIZON} failed") as error:
        loss(start(negative))
    assert error.value.step == 1
