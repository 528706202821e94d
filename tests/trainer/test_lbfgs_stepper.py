"""L-BFGS as the optimisation step of TorchRL's own trainer, on TorchRL's own losses and on one that
is made to be difficult.
"""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss, LossModule
from torchrl.objectives.bc import BCLoss
from torchrl.trainers import Trainer

from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.gp.lbfgs import NotFiniteError
from torch_pmil.trainer.lbfgs_stepper import LBFGSStepper

FRAMES = 32


class Quadratic(LossModule):
    """Two entries over one parameter, with what a test adds to them."""

    def __init__(self, extra=lambda weight: 0.0) -> None:
        super().__init__()
        self.weight, self.extra = (
            nn.Parameter(torch.tensor([3.0, -1.0], dtype=torch.float64)),
            extra,
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shift = self.weight - tensordict["target"]
        return TensorDict(
            {
                "loss_a": shift[0] ** 2 + self.extra(self.weight),
                "loss_b": 100 * shift[1] ** 2,
                "metric": torch.ones(()),
            }
        )


def one_step(loss: LossModule, batch: TensorDictBase, **settings: object) -> TensorDictBase:
    return LBFGSStepper(**settings).step(
        SimpleNamespace(loss_module=loss, compute_loss=loss), batch
    )


@pytest.fixture
def target() -> TensorDict:
    return TensorDict({"target": torch.tensor([1.0, 2.0], dtype=torch.float64)})


def test_step_ends_at_the_minimum_of_the_sum_of_the_losses(target: TensorDict) -> None:
    loss = Quadratic()
    log = one_step(loss, target)
    torch.testing.assert_close(loss.weight.detach(), target["target"], rtol=0, atol=1e-6)
    assert log["loss_a"] < 1e-10 and log["loss_b"] < 1e-10 and log["metric"] == 1
    assert 1 < log["lbfgs_iterations"] <= log["lbfgs_evaluations"] < 20
    assert not log["loss_a"].requires_grad and loss.weight.grad is None


def test_chosen_entries_alone_are_minimised(target: TensorDict) -> None:
    loss = Quadratic()
    one_step(loss, target, loss_components=["loss_a"])
    torch.testing.assert_close(
        loss.weight.detach(), torch.tensor([1.0, -1.0], dtype=torch.float64), rtol=0, atol=1e-6
    )


def test_points_without_a_finite_loss_are_stepped_back_from(target: TensorDict) -> None:
    loss = Quadratic(extra=lambda weight: 1e-3 * (weight[0] - 0.9).log())
    one_step(loss, target)
    assert 0.9 < loss.weight[0] < 1.2


def test_loss_that_fails_at_the_start_says_so(target: TensorDict) -> None:
    with pytest.raises(NotFiniteError, match="the objective must be finite"):
        one_step(Quadratic(extra=lambda weight: (weight[1]).log()), target)


def test_errors_to_survive_are_stepped_back_from(target: TensorDict) -> None:
    def refuse(weight: Tensor) -> float:
        if weight[0] < 0.9:
            raise ArithmeticError("beyond")
        return 0.0

    loss = Quadratic(extra=refuse)
    one_step(loss, target, survives=(ArithmeticError,))
    torch.testing.assert_close(loss.weight.detach(), target["target"], rtol=0, atol=1e-4)


def test_random_loss_is_one_function_throughout_a_step(target: TensorDict) -> None:
    loss = Quadratic(extra=lambda weight: (torch.randn(2, dtype=torch.float64) * weight).sum())
    torch.manual_seed(0)
    draw = torch.randn(2, dtype=torch.float64)
    torch.manual_seed(0)
    one_step(loss, target)
    expected = target["target"] - draw / torch.tensor([2.0, 200.0], dtype=torch.float64)
    torch.testing.assert_close(loss.weight.detach(), expected, rtol=0, atol=1e-6)
    assert not torch.equal(torch.randn(2, dtype=torch.float64), draw)


@pytest.mark.parametrize("chosen", [["loss_c"], ["loss_a", "loss_c"]])
def test_missing_entry_is_refused(chosen: list[str], target: TensorDict) -> None:
    with pytest.raises(
        ValueError, match=r"must have \['loss_c'\], got \['loss_a', 'loss_b', 'metric'\]"
    ):
        one_step(Quadratic(), target, loss_components=chosen)


def test_loss_without_parameters_is_refused(target: TensorDict) -> None:
    loss = Quadratic()
    loss.weight.requires_grad_(False)
    with pytest.raises(ValueError, match="Quadratic must have trainable parameters, got none"):
        one_step(loss, target)


def test_no_iterations_are_refused() -> None:
    with pytest.raises(
        ValueError, match="max_iterations must be a whole number of at least 1, got 0"
    ):
        LBFGSStepper(max_iterations=0)


@pytest.mark.filterwarnings("ignore:The name target_actor_network_params")  # of TorchRL's loss
def test_trainer_of_torchrl_clones_a_linear_teacher() -> None:
    """Its hooks are called as with any other stepper."""
    torch.manual_seed(0)
    env = DoublePendulumEnv(seed=0)
    teacher, student = (nn.Linear(4, 2, dtype=torch.float64) for _ in range(2))
    teacher.weight.data.mul_(0.1)
    calls: list[str] = []
    states = env.rollout(FRAMES, TensorDictModule(teacher, ["observation"], ["action"]))[
        "observation"
    ]
    before = (student(states) - teacher(states)).square().mean()
    trainer = Trainer(
        collector=Collector(
            env,
            TensorDictModule(teacher, ["observation"], ["action"]),
            frames_per_batch=FRAMES,
            total_frames=2 * FRAMES,
            auto_register_policy_transforms=False,
        ),
        total_frames=2 * FRAMES,
        frame_skip=1,
        optim_steps_per_batch=1,
        loss_module=BCLoss(TensorDictModule(student, ["observation"], ["action"])),
        optimization_stepper=LBFGSStepper(max_iterations=100),
        progress_bar=False,
    )
    trainer.register_op("post_optim", lambda: calls.append("post_optim"))
    trainer.register_op("post_optim_log", lambda batch: calls.append("post_optim_log"))
    trainer.train()
    assert calls == ["post_optim", "post_optim_log"] * 2
    assert max(trainer._log_dict["loss_bc"]) < 1e-5 < 1e-2 < before


def test_ppo_loss_is_lowered() -> None:
    torch.manual_seed(0)
    network = nn.Sequential(
        nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 4), NormalParamExtractor()
    ).double()
    actor = ProbabilisticActor(
        TensorDictModule(network, ["observation"], ["loc", "scale"]),
        ["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(nn.Linear(4, 1, dtype=torch.float64), ["observation"])
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.0)
    batch = actor(
        TensorDict({"observation": torch.randn(64, 4, dtype=torch.float64)}, [64])
    ).detach()
    batch["advantage"], batch["value_target"] = (
        torch.randn(64, 1, dtype=torch.float64),
        torch.randn(64, 1, dtype=torch.float64),
    )
    before = loss(batch)
    after = one_step(loss, batch, loss_components=["loss_objective", "loss_critic"])
    assert after["loss_objective"] < before["loss_objective"] - 0.01
    assert after["loss_critic"] < before["loss_critic"] - 0.01
