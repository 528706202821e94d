"""Agreement with the numbers in tests/reference, to 1e-8 of the largest reference entry of each
input covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd.functional import jacobian

from torch_pmil.control.rbf_policy import Controller, RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.gp.sparse_posterior import sparse_posterior
from torch_pmil.gp.trigonometry import augment, squash
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.rollout import predict_step
from torch_pmil.search.target_losses import (
    ExpectedQuadraticCost,
    ExpectedSaturatingCost,
    TargetLoss,
)

FOLDER = Path(__file__).parent / "reference"
POLICY_NUGGET = (
    1e-6  # which the reference adds to the variances of the network, before it is squashed
)
POLICY_NOISE = 1e-4  # in the reference's weights (K + 1e-4 I)^-1 targets

FITC_RIDGE = 1e-6  # variance that the reference adds at the inducing inputs

gp_files = pytest.mark.parametrize(
    "name", ["gp_moments_n10_D2_E1", "gp_moments_n60_D6_E4", "fitc_moments_n30_D4_E2"]
)
policy_files = pytest.mark.parametrize("name", ["policy_N20_D4_F2", "policy_N100_D6_F2"])
rollout_files = pytest.mark.parametrize("name", ["rollout_D4F2_ang2_c100_812p", "rollout_D6F3_c20"])
covariances = pytest.mark.parametrize("k", range(4), ids=["1e-6", "1e-2", "0.5", "singular"])


@cache
def load(name: str) -> dict[str, Tensor]:
    with np.load(FOLDER / f"{name}.npz") as file:
        return {key: torch.as_tensor(file[key]) for key in file}


def assert_agrees(ours: Tensor, reference: Tensor, rounding: Tensor | float = 0.0) -> None:
    assert ours.shape == reference.shape
    assert (ours - reference).abs().max() <= 1e-8 * reference.abs().max() + rounding


def rounding_of(data: dict[str, Tensor]) -> Tensor:
    """What float64 may lose, on either side, in a network's covariance: a small difference of sums
    of terms as large as w_i w_j.
    """
    return 100 * torch.finfo(torch.float64).eps * data["weights"].square().max()


def symmetrised(gradient: Tensor) -> Tensor:
    return (gradient + gradient.mT) / 2


def belief_at(data: dict[str, Tensor], k: int) -> Gaussian:
    return Gaussian(data["m"][k], data["s"][k])


def assert_derivatives_agree(
    function: Callable[..., tuple[Tensor, ...]],
    data: dict[str, Tensor],
    k: int,
    names: dict[str, str],
) -> None:
    """``function(m, s)`` returns one output for each entry of ``names``: derivative wrt m ->
    derivative wrt s.
    """
    for (by_mean, by_cov), (d_mean, d_cov) in zip(
        names.items(), jacobian(function, (data["m"][k], data["s"][k])), strict=True
    ):
        rounding = rounding_of(data) if "weights" in data else 0.0
        assert_agrees(d_mean, data[by_mean][k], rounding)
        assert_agrees(symmetrised(d_cov), data[by_cov][k], rounding)


def gp_of(data: dict[str, Tensor]) -> KernelExpansion:
    signal, noise = data["signal_std"].square(), data["noise_std"].square()
    observed, kernel = (data["X"], data["y"].mT), (data["lengthscales"], signal, noise)
    if "inducing" not in data:
        return KernelExpansion.from_data(*observed, *kernel)
    inducing = data["inducing"].permute(2, 0, 1)
    return sparse_posterior(*observed, inducing, *kernel, FITC_RIDGE * torch.ones_like(noise))


@gp_files
@covariances
def test_gp_moments_agree(name: str, k: int) -> None:
    data = load(name)
    moments = moment_match(gp_of(data), belief_at(data, k))
    assert_agrees(moments.mean, data["M"][k])
    assert_agrees(moments.cov, data["S"][k])
    assert_agrees(moments.inv_cov_cross_cov, data["V"][k])


@gp_files
@covariances
def test_gp_moments_have_the_reference_derivatives(name: str, k: int) -> None:
    data = load(name)
    gp = gp_of(data)

    def moments(m: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        result = moment_match(gp, Gaussian(m, s))
        return result.mean, result.cov, result.inv_cov_cross_cov

    assert_derivatives_agree(
        moments, data, k, {"dM_dm": "dM_ds", "dS_dm": "dS_ds", "dV_dm": "dV_ds"}
    )


class ReferenceController(Controller):
    """The policy with the reference's 1e-6 on the variances of the unsquashed action."""

    def on_belief(self, features: Gaussian) -> tuple[Gaussian, Tensor]:
        raw = moment_match(self.network, features)
        action, slope = squash(raw.gaussian.add_noise(POLICY_NUGGET), self.u_max)
        return action, raw.inv_cov_cross_cov * slope[..., None, :]


def controller_of(
    log_lengthscales: Tensor, centres: Tensor, targets: Tensor, u_max: Tensor
) -> ReferenceController:
    """From the reference's parameters: weights (K_a + 1e-4 I)^-1 targets_a, differentiably."""
    scaled = centres / log_lengthscales.exp()[:, None, :]  # (F, N, D)
    squared_distance = (scaled[:, :, None, :] - scaled[:, None, :, :]).square().sum(-1)
    gram = torch.exp(-squared_distance / 2) + POLICY_NOISE * torch.eye(
        len(centres), dtype=torch.float64
    )
    weights = torch.linalg.solve(gram, targets.mT[..., None])[..., 0]
    return ReferenceController(
        KernelExpansion(centres, weights, log_lengthscales.exp(), torch.ones_like(u_max)),
        u_max,
        torch.zeros_like(u_max),
    )


def policy_parameters(
    data: dict[str, Tensor], log_hyp: str = "log_hyp"
) -> tuple[Tensor, Tensor, Tensor]:
    return data[log_hyp][:-2].mT, data["centres"], data["targets"]


def column_major(gradients: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    """Derivatives wrt log lengthscales (.., F, D), centres (.., N, D) and targets (.., N, F) in the
    reference's order of parameters.
    """
    lengthscales, centres, targets = gradients
    unused = torch.zeros(*lengthscales.shape[:-1], 2, dtype=torch.float64)
    return torch.cat(
        [
            torch.cat([lengthscales, unused], -1).flatten(-2),
            centres.mT.flatten(-2),
            targets.mT.flatten(-2),
        ],
        -1,
    )


@policy_files
@covariances
def test_rbf_network_moments_agree(name: str, k: int) -> None:
    data = load(name)
    network = KernelExpansion(
        data["centres"], data["weights"].mT, data["lengthscales"], torch.ones_like(data["maxU"])
    )
    moments = moment_match(network, belief_at(data, k))
    assert_agrees(moments.mean, data["rbf_mean"][k])
    assert_agrees(
        moments.gaussian.add_noise(POLICY_NUGGET).cov, data["rbf_cov"][k], rounding_of(data)
    )
    assert_agrees(moments.inv_cov_cross_cov, data["rbf_C"][k])


@policy_files
@covariances
def test_squashed_rbf_network_moments_agree(name: str, k: int) -> None:
    data = load(name)
    action, inv_cov_cross_cov = controller_of(*policy_parameters(data), data["maxU"]).on_belief(
        belief_at(data, k)
    )
    assert_agrees(action.mean, data["rbf_sin_mean"][k])
    assert_agrees(action.cov, data["rbf_sin_cov"][k], rounding_of(data))
    assert_agrees(inv_cov_cross_cov, data["rbf_sin_C"][k])


@policy_files
@covariances
def test_squashed_rbf_network_has_the_reference_derivatives_in_the_belief(
    name: str, k: int
) -> None:
    data = load(name)
    controller = controller_of(*policy_parameters(data), data["maxU"])

    def moments(m: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        action, inv_cov_cross_cov = controller.on_belief(Gaussian(m, s))
        return action.mean, action.cov, inv_cov_cross_cov

    names = {
        "rbf_sin_dMdm": "rbf_sin_dMds",
        "rbf_sin_dSdm": "rbf_sin_dSds",
        "rbf_sin_dCdm": "rbf_sin_dCds",
    }
    assert_derivatives_agree(moments, data, k, names)


@policy_files
@covariances
def test_squashed_rbf_network_has_the_reference_derivatives_in_its_parameters(
    name: str, k: int
) -> None:
    """The reference's parameters are targets: its derivatives hold those of the weights with
    respect to all of them.
    """
    data = load(name)

    def moments(
        log_lengthscales: Tensor, centres: Tensor, targets: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        controller = controller_of(log_lengthscales, centres, targets, data["maxU"])
        action, inv_cov_cross_cov = controller.on_belief(belief_at(data, k))
        return action.mean, action.cov, inv_cov_cross_cov

    names = ["rbf_sin_dMdp", "rbf_sin_dSdp", "rbf_sin_dCdp"]
    for gradients, reference in zip(jacobian(moments, policy_parameters(data)), names, strict=True):
        assert_agrees(column_major(gradients), data[reference][k], rounding_of(data))


@policy_files
@covariances
def test_squashed_linear_policy_agrees(name: str, k: int) -> None:
    data = load(name)
    action, slope = squash(belief_at(data, k).affine(data["lin_w"], data["lin_b"]), data["maxU"])
    assert_agrees(action.mean, data["lin_sin_mean"][k])
    assert_agrees(action.cov, data["lin_sin_cov"][k])
    assert_agrees(data["lin_w"].mT * slope, data["lin_sin_C"][k])


@policy_files
@covariances
def test_squashing_agrees(name: str, k: int) -> None:
    data = load(name)
    squashed, slope = squash(belief_at(data, k), data["gsin_e"])
    assert_agrees(squashed.mean, data["gsin_mean"][k])
    assert_agrees(squashed.cov, data["gsin_cov"][k])
    assert_agrees(torch.diag(slope), data["gsin_C"][k])


def trigonometric_moments(m: Tensor, s: Tensor, angles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, covariance and s^-1 cov(x, .) of sin and cos alone, in the reference's order sin, cos,
    sin, cos.
    """
    identity = torch.eye(len(m), dtype=torch.float64)
    sines_and_cosines, inv_cov_cross_cov = augment(Gaussian(m, s), identity[:0], identity[angles])
    order = torch.arange(2 * len(angles)).reshape(2, -1).mT.flatten()
    trig = sines_and_cosines.marginal(order)
    return trig.mean, trig.cov, inv_cov_cross_cov[:, order]


@policy_files
@covariances
def test_sin_and_cos_agree(name: str, k: int) -> None:
    data = load(name)
    mean, cov, inv_cov_cross_cov = trigonometric_moments(
        data["m"][k], data["s"][k], data["gtrig_idx0"]
    )
    assert_agrees(mean, data["gtrig_mean"][k])
    assert_agrees(cov, data["gtrig_cov"][k])
    assert_agrees(inv_cov_cross_cov, data["gtrig_C"][k])


@policy_files
@covariances
def test_sin_and_cos_have_the_reference_derivatives(name: str, k: int) -> None:
    """This one derivative with respect to a covariance comes unsymmetrised."""
    data = load(name)
    (mean_by_m, _), (cov_by_m, cov_by_s), _ = jacobian(
        lambda m, s: trigonometric_moments(m, s, data["gtrig_idx0"]), (data["m"][k], data["s"][k])
    )
    assert_agrees(mean_by_m, data["gtrig_dMdm"][k])
    assert_agrees(cov_by_m, data["gtrig_dVdm"][k])
    assert_agrees(symmetrised(cov_by_s), symmetrised(data["gtrig_dVdv"][k]))


def space_of(data: dict[str, Tensor]) -> StateSpace:
    names = tuple(f"x{i}" for i in range(len(data["m0"])))
    units = ("",) * len(names)
    return StateSpace(names, units, tuple(data["angle_idx0"].tolist()), joint_match(names, units))


def feature_order(data: dict[str, Tensor]) -> list[int]:
    """Where our features [others, sin.., cos..] stand in the reference's [others, sin, cos, sin,
    cos, ..].
    """
    angles = len(data["angle_idx0"])
    others = len(data["m0"]) - angles
    return [
        *range(others),
        *range(others, others + 2 * angles, 2),
        *range(others + 1, others + 2 * angles, 2),
    ]


def dynamics_of(data: dict[str, Tensor]) -> GPDynamics:
    """The reference's GP, its inputs permuted to our order, through the GPyTorch model."""
    order = feature_order(data) + list(range(len(data["poli0"]), data["X"].shape[-1]))
    dynamics = GPDynamics(data["X"].shape[-1], data["y"].shape[-1])
    dynamics.set_data(data["X"][:, order], data["y"])
    dynamics.gp.covar_module.base_kernel.lengthscale = data["lengthscales"][:, None, order]
    dynamics.gp.covar_module.outputscale = data["signal_std"].square()
    dynamics.gp.likelihood.noise = data["noise_std"].square()[:, None]
    return dynamics


def rollout_controller(
    data: dict[str, Tensor], log_lengthscales: Tensor, centres: Tensor, targets: Tensor
) -> Controller:
    order = feature_order(data)
    return controller_of(log_lengthscales[:, order], centres[:, order], targets, data["maxU"])


def roll_out(data: dict[str, Tensor], controller: Controller) -> Gaussian:
    """As predict_trajectory, without noise, and with the reference's controller."""
    dynamics, space, states = dynamics_of(data), space_of(data), [Gaussian(data["m0"], data["S0"])]
    for _ in range(int(data["T"])):
        states.append(
            predict_step(states[-1], controller, dynamics, space, observation_noise=False)
        )
    return Gaussian(
        torch.stack([state.mean for state in states]), torch.stack([state.cov for state in states])
    )


@rollout_files
def test_rollout_agrees_at_all_steps(name: str) -> None:
    data = load(name)
    states = roll_out(data, rollout_controller(data, *policy_parameters(data, "policy_log_hyp")))
    assert_agrees(states.mean, data["means"])
    assert_agrees(states.cov, data["covs"])


@rollout_files
def test_first_step_has_the_reference_jacobians_in_the_state(name: str) -> None:
    data = load(name)
    dynamics, space = dynamics_of(data), space_of(data)
    controller = rollout_controller(data, *policy_parameters(data, "policy_log_hyp"))

    def step(m: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
        state = predict_step(Gaussian(m, s), controller, dynamics, space, observation_noise=False)
        return state.mean, state.cov

    (mean_by_m, mean_by_s), (cov_by_m, cov_by_s) = jacobian(step, (data["m0"], data["S0"]))
    assert_agrees(mean_by_m, data["step_dMdm"])
    assert_agrees(cov_by_m, data["step_dSdm"])
    assert_agrees(symmetrised(mean_by_s), data["step_dMds"])
    assert_agrees(symmetrised(cov_by_s), data["step_dSds"])


@rollout_files
def test_first_step_has_the_reference_jacobians_in_the_policy(name: str) -> None:
    data = load(name)
    dynamics, space = dynamics_of(data), space_of(data)

    def step(*parameters: Tensor) -> tuple[Tensor, Tensor]:
        initial, controller = (
            Gaussian(data["m0"], data["S0"]),
            rollout_controller(data, *parameters),
        )
        state = predict_step(initial, controller, dynamics, space, observation_noise=False)
        return state.mean, state.cov

    by_mean, by_cov = jacobian(step, policy_parameters(data, "policy_log_hyp"))
    assert_agrees(column_major(by_mean), data["step_dMdp"])
    assert_agrees(column_major(by_cov), data["step_dSdp"])


def cost_of(kind: type[TargetLoss], state: Gaussian, W: Tensor, z: Tensor) -> Tensor:
    """Costs of states with the weights W around z, by a loss of this package."""
    names = tuple(map(str, range(state.dim)))
    space = StateSpace(names, names, (), joint_match(names, names))
    policy = RBFPolicy(torch.zeros(1, state.dim), torch.ones(1), torch.ones(state.dim))
    model = GPDynamics(state.dim + 1, state.dim)
    return kind(policy, model, space, z, width=1.0, horizon=1, weight=W)._costs(state)


quadratic_cost = partial(cost_of, ExpectedQuadraticCost)
saturating_cost = partial(cost_of, ExpectedSaturatingCost)


@policy_files
@covariances
def test_saturating_cost_agrees_with_its_derivatives(name: str, k: int) -> None:
    data = load(name)
    mean, cov = data["m"][k].clone().requires_grad_(), data["s"][k].clone().requires_grad_()
    cost = saturating_cost(Gaussian(mean, cov), data["loss_W"], data["loss_z"])
    d_mean, d_cov = torch.autograd.grad(cost, (mean, cov))
    assert_agrees(cost.detach(), data["sat_L"][k])
    assert_agrees(d_mean, data["sat_dLdm"][k])
    assert_agrees(symmetrised(d_cov), data["sat_dLds"][k])


@rollout_files
@pytest.mark.parametrize(("cost", "key"), [(quadratic_cost, "quad"), (saturating_cost, "sat")])
def test_rollout_has_the_reference_gradient_of_a_cost(
    name: str, cost: Callable[..., Tensor], key: str
) -> None:
    data = load(name)
    parameters = [
        parameter.clone().requires_grad_()
        for parameter in policy_parameters(data, "policy_log_hyp")
    ]
    states = roll_out(data, rollout_controller(data, *parameters))[1:]
    total = cost(states, data["W"], data["z"]).sum()
    lengthscales, centres, targets = torch.autograd.grad(total, parameters)
    assert_agrees(total.detach(), data[f"J_{key}"])
    assert_agrees(lengthscales.mT, data[f"dJ_{key}_hyp"][:-2])
    assert_agrees(centres, data[f"dJ_{key}_centres"])
    assert_agrees(targets, data[f"dJ_{key}_targets"])
