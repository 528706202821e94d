"""Every loss of a trajectory as TorchRL's tests ask of a LossModule, and its sums."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict, assert_close
from torch import Tensor
from torch.testing import assert_close as assert_tensors_close
from torchrl.objectives import LossModule
from torchrl.trainers import Trainer

from tests.helpers.draws import Draws
from tests.helpers.losses import (
    HORIZON,
    SPACE,
    assert_gradient_is_the_difference_quotient,
    make_cost,
    make_kl,
    start,
    start_belief,
)
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model import rollout as rollout_module
from torch_pmil.model.rollout import PredictionError, predict_trajectory
from torch_pmil.search import trajectory_loss as loss_module
from torch_pmil.search.trajectory_loss import TrajectoryLoss

MAKERS = {"loss_kl": make_kl, "loss_cost": make_cost}
BATCH = 3


@pytest.fixture(params=MAKERS)
def key(request: pytest.FixtureRequest) -> str:
    """Where the loss is written."""
    return request.param


@pytest.fixture
def loss(key: str) -> TrajectoryLoss:
    return MAKERS[key](seed=0)


@pytest.fixture
def initial(draws: Draws) -> Gaussian:
    return start_belief(draws)


@pytest.fixture
def batch(draws: Draws) -> Gaussian:
    return start_belief(draws, BATCH)


@pytest.fixture
def rollout(loss: TrajectoryLoss, batch: Gaussian) -> TensorDict:
    """Predicted beliefs as an imagined environment's rollout holds them."""
    return rollout_of(predict_trajectory(batch, loss.actor_network, loss.dynamics, SPACE, HORIZON))


def rollout_of(states: Gaussian) -> TensorDict:
    return TensorDict(
        {"next": {"observation": {"mean": states.mean, "var": states.cov}}}, states.batch_shape
    )


def policy_gradients(loss: TrajectoryLoss, value: Tensor) -> tuple[Tensor, ...]:
    return torch.autograd.grad(value, list(loss.actor_network.parameters()))


# Keys


def test_loss_is_a_loss_module(loss: TrajectoryLoss, key: str) -> None:
    assert isinstance(loss, LossModule)
    assert loss.default_keys is loss._AcceptedKeys
    assert loss.in_keys == [("observation", "mean"), ("observation", "var")]
    assert loss.rollout_keys == [("next", "observation", "mean"), ("next", "observation", "var")]
    assert loss.out_keys == [key]
    defaults = {"mean": ("observation", "mean"), "var": ("observation", "var")}
    assert vars(loss.tensor_keys) == defaults


def test_loss_reads_its_in_keys_and_writes_its_out_keys_alone(
    loss: TrajectoryLoss, initial: Gaussian
) -> None:
    read = start(initial)
    more = read.clone().update({"action": torch.zeros(1), "next": {"reward": torch.zeros(1)}})
    untouched = more.clone()
    result = loss(more)
    assert list(result.keys(include_nested=True, leaves_only=True)) == loss.out_keys
    assert_close(more, untouched, rtol=0, atol=0)
    assert torch.equal(loss(more.select(*loss.in_keys))[loss.out_keys[0]], result[loss.out_keys[0]])


@pytest.mark.parametrize("missing", ["mean", "var"])
def test_missing_entry_is_an_error_that_names_it(
    loss: TrajectoryLoss, initial: Gaussian, missing: str
) -> None:
    reads = rf"{type(loss).__name__} reads \('observation', '{missing}'\), got a tensordict with"
    with pytest.raises(KeyError, match=reads):
        loss(start(initial).exclude(("observation", missing)))
    with pytest.raises(KeyError, match=r"reads \('observation', 'mean'\), .* \['observation'\]"):
        loss(TensorDict({"observation": torch.zeros(2)}))


def test_unknown_key_is_an_error(loss: TrajectoryLoss) -> None:
    with pytest.raises(ValueError, match="reward is not an accepted tensordict key"):
        loss.set_keys(reward="r")


def test_other_keys_can_be_set_for_one_loss(
    loss: TrajectoryLoss, key: str, initial: Gaussian
) -> None:
    expected, other = loss(start(initial))[key], MAKERS[key](seed=0)
    loss.set_keys(mean="mu", var=("start", "Sigma"))
    assert loss.in_keys == ["mu", ("start", "Sigma")]
    assert loss.rollout_keys == [("next", "mu"), ("next", "start", "Sigma")]
    renamed = TensorDict({"mu": initial.mean, "start": {"Sigma": initial.cov}})
    assert torch.equal(loss(renamed)[key], expected)
    assert torch.equal(loss(mu=initial.mean, start_Sigma=initial.cov), expected)
    assert torch.equal(other(start(initial))[key], expected)
    loss.set_keys(mean=None)
    assert loss.in_keys == [("observation", "mean"), ("start", "Sigma")]


def test_loss_takes_tensors_in_place_of_a_tensordict(
    loss: TrajectoryLoss, key: str, batch: Gaussian, rollout: TensorDict
) -> None:
    expected = loss(start(batch))[key]
    assert torch.equal(loss(batch.mean, batch.cov), expected)
    assert torch.equal(loss(observation_mean=batch.mean, observation_var=batch.cov), expected)
    assert torch.equal(loss(batch.mean, observation_var=batch.cov), expected)
    loss.select_out_keys(key)
    assert torch.equal(loss(batch.mean, batch.cov), expected)
    mean, var = (rollout[k] for k in loss.rollout_keys)
    expected = loss.rollout_loss(rollout)[key]
    assert torch.equal(loss.rollout_loss(mean, var), expected)
    named = {"next_observation_mean": mean, "next_observation_var": var}
    assert torch.equal(loss.rollout_loss(**named), expected)


# Reductions and masks


def test_reductions_sum_over_time_and_average_over_trajectories(key: str, batch: Gaussian) -> None:
    """The mean is the default, and a batch is a loop."""
    loss = MAKERS[key](seed=0)
    alone = torch.stack([loss(start(batch[i]))[key] for i in range(BATCH)])
    assert_tensors_close(loss(start(batch))[key], alone.mean(), rtol=1e-10, atol=0)
    steps = loss.per_step(batch)
    expected = {"none": steps, "sum": steps.sum(), "mean": steps.sum(-1).mean()}
    for reduction, value in expected.items():
        loss.reduction = reduction
        assert_tensors_close(loss(start(batch))[key], value, rtol=1e-14, atol=0)


def test_batch_of_any_shape_is_taken(loss: TrajectoryLoss, key: str, draws: Draws) -> None:
    initial = start_belief(draws, 2, 3)
    flat = Gaussian(initial.mean.flatten(0, 1), initial.cov.flatten(0, 1))
    assert_tensors_close(loss(start(initial))[key], loss(start(flat))[key], rtol=1e-12, atol=0)
    loss.reduction = "none"
    assert loss(start(initial))[key].shape == (2, 3, HORIZON)


def test_beliefs_of_single_precision_are_computed_in_double(
    loss: TrajectoryLoss, key: str, batch: Gaussian, rollout: TensorDict
) -> None:
    for method, read in ((loss, start(batch)), (loss.rollout_loss, rollout.detach())):
        single = method(read.float())[key]
        assert single.dtype == torch.float64
        assert_tensors_close(single, method(read)[key], rtol=1e-4, atol=0)


STEPS_MASK = torch.tensor([[True, True, False, True], [False] * HORIZON, [True] * HORIZON])
BELIEF_MASK = torch.tensor([True, False, True])
masks = pytest.mark.parametrize(
    "mask",
    [STEPS_MASK, STEPS_MASK[..., None], BELIEF_MASK, BELIEF_MASK[:, None]],
    ids=["steps", "steps of TorchRL", "beliefs", "column"],
)


def over_steps(mask: Tensor) -> Tensor:
    return mask.reshape(BATCH, -1).expand(BATCH, HORIZON)


@masks
@pytest.mark.parametrize("mask_key", [("collector", "mask"), "shifted_valid", ("my", "valid")])
def test_masked_steps_are_left_out(
    loss: TrajectoryLoss, key: str, batch: Gaussian, mask: Tensor, mask_key: str | tuple[str, str]
) -> None:
    counted, steps = over_steps(mask), loss.per_step(batch)
    total = steps[counted].sum()  # the mean is of two: the second does not count
    if mask_key == ("my", "valid"):
        loss.loss_mask_key = mask_key
    masked = start(batch).set(mask_key, mask)
    for reduction, value in {"none": steps * counted, "sum": total, "mean": total / 2}.items():
        loss.reduction = reduction
        assert_tensors_close(loss(masked)[key], value, rtol=1e-12, atol=0)


@masks
def test_what_is_masked_may_hold_anything(
    loss: TrajectoryLoss, key: str, batch: Gaussian, mask: Tensor
) -> None:
    """Neither the value nor a gradient notices it, and an invalid belief raises no error."""
    masked = start(batch).set("shifted_valid", mask)
    expected = loss(masked)[key]
    broken = copy.deepcopy(masked)
    broken["observation", "mean"][1] = float("nan")
    broken["observation", "var"][1] = -1e3 * torch.eye(2)
    value = loss(broken)[key]
    assert torch.equal(value, expected)
    gradients, others = policy_gradients(loss, value), policy_gradients(loss, expected)
    assert_tensors_close(gradients, others, rtol=1e-12, atol=1e-14)


@masks
def test_what_is_masked_in_a_rollout_may_hold_anything(
    loss: TrajectoryLoss, key: str, rollout: TensorDict, mask: Tensor
) -> None:
    counted, masked = over_steps(mask), rollout.detach()
    masked.batch_size = [BATCH]
    masked["shifted_valid"] = mask
    expected = loss.rollout_loss(masked)[key]
    broken, (mean_key, var_key) = masked.clone(), loss.rollout_keys
    broken[mean_key][~counted] = float("nan")
    broken[var_key][~counted] = -1e3 * torch.eye(2).double()
    mean, var = broken[mean_key].requires_grad_(), broken[var_key].requires_grad_()
    value = loss.rollout_loss(broken)[key]
    assert_tensors_close(value, expected, rtol=1e-12, atol=0)
    for gradient in torch.autograd.grad(value, (mean, var)):
        assert gradient.isfinite().all()
        assert (gradient[~counted] == 0).all()
        assert (gradient[counted] != 0).any()


def test_mask_can_be_switched_off(loss: TrajectoryLoss, key: str, batch: Gaussian) -> None:
    expected = loss(start(batch))[key]
    masked = start(batch).set("shifted_valid", BELIEF_MASK)
    assert not torch.equal(loss(masked)[key], expected)
    loss.loss_mask_key = None
    assert torch.equal(loss(masked)[key], expected)


def test_nothing_costs_nothing(loss: TrajectoryLoss, key: str, batch: Gaussian) -> None:
    masked = start(batch).set("shifted_valid", torch.zeros(BATCH, dtype=torch.bool))
    for reduction in ("none", "mean", "sum"):
        loss.reduction = reduction
        assert (loss(masked)[key] == 0).all()


# Rollouts


def test_rollout_of_the_prediction_costs_what_the_prediction_costs(
    loss: TrajectoryLoss, key: str, batch: Gaussian, rollout: TensorDict
) -> None:
    expected, value = loss(start(batch))[key], loss.rollout_loss(rollout)[key]
    assert_tensors_close(value, expected, rtol=1e-12, atol=0)
    gradients, others = policy_gradients(loss, value), policy_gradients(loss, expected)
    assert all((gradient != 0).all() for gradient in gradients)
    assert_tensors_close(gradients, others, rtol=1e-12, atol=0)


def test_rollout_is_scored_whatever_its_start(
    loss: TrajectoryLoss, key: str, batch: Gaussian, rollout: TensorDict
) -> None:
    """The rollout of an imagined environment holds the beliefs before each step too."""
    expected = loss.rollout_loss(rollout)[key]
    states = Gaussian(rollout["next", "observation", "mean"], rollout["next", "observation", "var"])
    before = Gaussian(
        torch.cat([batch.mean[:, None], states.mean[:, :-1]], 1),
        torch.cat([batch.cov[:, None], states.cov[:, :-1]], 1),
    )
    assert torch.equal(loss.rollout_loss(rollout.update(start(before)))[key], expected)


def test_trainer_of_torchrl_reaches_the_loss_of_rollouts(
    loss: TrajectoryLoss, key: str, rollout: TensorDict
) -> None:
    reached = Trainer.compute_loss(SimpleNamespace(loss_module=loss), rollout, "rollout_loss")
    assert torch.equal(reached[key], loss.rollout_loss(rollout)[key])


@pytest.mark.parametrize("steps", [1, 3])
def test_shorter_rollout_is_scored_as_the_beginning(
    loss: TrajectoryLoss, key: str, batch: Gaussian, rollout: TensorDict, steps: int
) -> None:
    loss.reduction = "none"
    scored, beginning = loss.rollout_loss(rollout[:, :steps])[key], loss.per_step(batch)[:, :steps]
    assert_tensors_close(scored, beginning, rtol=1e-12, atol=0)


def test_gradient_flows_into_a_rollout(loss: TrajectoryLoss, key: str, rollout: TensorDict) -> None:
    """It is the difference quotient in a random direction."""
    mean_key, var_key = loss.rollout_keys
    mean = rollout[mean_key].detach().requires_grad_()
    root = torch.linalg.cholesky(rollout[var_key].detach()).requires_grad_()

    def value(mean: Tensor, root: Tensor) -> Tensor:
        return loss.rollout_loss(mean, root @ root.mT)

    assert torch.autograd.gradcheck(value, (mean, root))


@pytest.mark.parametrize("shape", [(HORIZON + 1, 2), (BATCH, HORIZON + 1, 2), (2,)])
def test_rollout_of_another_length_is_an_error(
    loss: TrajectoryLoss, draws: Draws, shape: tuple[int, ...]
) -> None:
    said = f"a trajectory must have shape (*batch, t, D) with t up to {HORIZON}, got ({shape[0]},"
    with pytest.raises(ValueError, match=re.escape(said)):
        loss.rollout_loss(rollout_of(draws.belief(*shape)))


def test_real_rollout_is_an_error(loss: TrajectoryLoss) -> None:
    """An observation is no belief."""
    with pytest.raises(KeyError, match=r"reads \('next', 'observation', 'mean'\), got"):
        loss.rollout_loss(TensorDict({"next": {"observation": torch.zeros(HORIZON, 2)}}))


def test_failed_prediction_is_an_error_that_names_its_step(
    loss: TrajectoryLoss, initial: Gaussian, rollout: TensorDict
) -> None:
    """And so is the degenerate belief of a rollout."""
    negative = Gaussian(initial.mean, -100 * torch.eye(2, dtype=torch.float64))
    with pytest.raises(PredictionError, match=f"prediction of step 1 of {HORIZON} fail") as error:
        loss(start(negative))
    assert error.value.step == 1
    degenerate = rollout.detach().clone()
    degenerate["next", "observation", "var"][1, 2, 0, 0] = -3.0
    said = rf"comparison of step 3 of {HORIZON} failed: .* batch element \(1, 2\)"
    with pytest.raises(PredictionError, match=said) as error:
        loss.rollout_loss(degenerate)
    assert error.value.step == 3


# Parameters and state


def test_penalty_is_added_to_each_step_within_its_context_alone(
    loss: TrajectoryLoss, initial: Gaussian
) -> None:
    plain, predicted = loss.per_step(initial), loss.predict_states(initial)
    with loss.penalised(lambda states: states.mean[..., 0] ** 2):
        penalised = loss.per_step(initial)
    assert_tensors_close(penalised - plain, predicted.mean[:, 0] ** 2)
    assert torch.equal(loss.per_step(initial), plain)
    assert (penalised - plain).detach().min() > 0


def test_predictions_under_a_penalty_stay_compiled(
    loss: TrajectoryLoss, initial: Gaussian, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its gradient is that of the formulas in PyTorch, and those are not used."""

    def gradients() -> tuple[Tensor, ...]:
        with loss.penalised(lambda states: states.mean[..., 0] ** 2 + states.cov[..., 1, 1]):
            return policy_gradients(loss, loss.per_step(initial).sum())

    with monkeypatch.context() as patch:
        patch.setattr(rollout_module, "_trajectory", None)
        compiled = gradients()
    for module in (rollout_module, loss_module):
        monkeypatch.setattr(module, "serves", lambda *tensors: False)
    assert_tensors_close(compiled, gradients())


@pytest.mark.parametrize("objective", ["per_step", "mean_per_step"])
@pytest.mark.parametrize("name", ["centres", "weights", "log_widths"])
def test_gradient_is_the_difference_quotient(
    loss: TrajectoryLoss, initial: Gaussian, draws: Draws, objective: str, name: str
) -> None:
    parameter, per_step = loss.actor_network.get_parameter(name), getattr(loss, objective)
    direction = draws.normal(*parameter.shape)
    assert_gradient_is_the_difference_quotient(per_step, initial, parameter, direction)


def test_parameters_are_those_of_the_policy(loss: TrajectoryLoss) -> None:
    own = loss.actor_network.named_parameters()
    named = {f"actor_network.{name}": parameter for name, parameter in own}
    assert dict(loss.named_parameters()) == named
    assert list(map(id, loss.parameters())) == list(map(id, loss.actor_network.parameters()))
    outer = [name for name, _ in loss.named_parameters("outer")]
    assert outer == [f"outer.{name}" for name in named]


def test_optimiser_of_the_loss_trains_the_policy_alone(
    loss: TrajectoryLoss, key: str, initial: Gaussian
) -> None:
    model = copy.deepcopy(loss.dynamics.state_dict())
    optimiser, values = torch.optim.Adam(loss.parameters(), lr=0.02), []
    for _ in range(10):
        value = loss(start(initial))[key]
        optimiser.zero_grad()
        value.backward()
        assert all((parameter.grad != 0).all() for parameter in loss.actor_network.parameters())
        assert all(parameter.grad is None for parameter in loss.dynamics.parameters())
        optimiser.step()
        values.append(value.item())
    assert values[-1] < values[0]
    assert_close(TensorDict(loss.dynamics.state_dict()), TensorDict(model), rtol=0, atol=0)


def test_policy_is_used_as_it_is(loss: TrajectoryLoss, key: str, initial: Gaussian) -> None:
    """The loss is not functional in TorchRL's sense."""
    assert not loss.functional
    assert loss.get_stateful_net("actor_network") is loss.actor_network
    other = MAKERS[key](seed=1).actor_network
    before = loss(start(initial))[key]
    loss.from_stateful_net("actor_network", other)
    assert not torch.allclose(loss(start(initial))[key], before)
    assert all(map(torch.equal, loss.actor_network.parameters(), other.parameters()))


def test_reset_is_refused_in_place_of_nothing_being_reset(loss: TrajectoryLoss) -> None:
    with pytest.raises(NotImplementedError):
        loss.make_value_estimator()
    with pytest.raises(NotImplementedError, match="the policy cannot reset itself: load a new one"):
        loss.reset_parameters_recursive()


def test_fresh_loss_with_the_state_of_another_is_the_same(
    loss: TrajectoryLoss, key: str, initial: Gaussian, tmp_path: Path
) -> None:
    """Policy, model with its data, and aim: all are in the state."""
    other = MAKERS[key](seed=1)
    expected = loss(start(initial))[key]
    assert not torch.allclose(other(start(initial))[key], expected)
    torch.save(loss.state_dict(), tmp_path / "loss.pt")
    other.load_state_dict(torch.load(tmp_path / "loss.pt", weights_only=True))
    assert torch.equal(other(start(initial))[key], expected)
    buffers = {
        "loss_kl": {"demonstrated_mean", "demonstrated_cov"},
        "loss_cost": {"target", "to_widths"},
    }[key]
    assert {name.split(".")[0] for name in loss.state_dict()} == {
        "actor_network",
        "dynamics",
    } | buffers


def test_copy_is_the_same_and_independent(
    loss: TrajectoryLoss, key: str, initial: Gaussian
) -> None:
    expected = loss(start(initial))[key]
    other = copy.deepcopy(loss)
    assert torch.equal(other(start(initial))[key], expected)
    other.actor_network.weights.data.add_(1)
    other.set_keys(mean="mu")
    assert torch.equal(loss(start(initial))[key], expected)


def test_aim_goes_where_the_loss_goes(loss: TrajectoryLoss) -> None:
    """The other half of what ``to`` does; on a GPU, see test_device."""

    def dtypes() -> list[torch.dtype]:
        return [aim.dtype for aim in loss.buffers(recurse=False)]

    assert dtypes() == [torch.float64] * 2
    loss.to(torch.float32)
    assert dtypes() == [torch.float32] * 2
    loss.to("meta")
    assert {aim.device.type for aim in loss.buffers(recurse=False)} == {"meta"}
