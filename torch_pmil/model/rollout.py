r"""Trajectory distribution p(x_1), ..., p(x_T) from p(x_0), a policy and a model (Eq. 13)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torch_pmil.control.rbf_policy import Controller, Policy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.checks import check_tensor, check_whole
from torch_pmil.gp.gaussian import (
    Gaussian,
    NotPositiveDefiniteError,
    check_belief,
    joint,
    symmetric,
)
from torch_pmil.gp.moment_derivatives import RecordedMoments
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.gp.moments import Moments
from torch_pmil.model.dynamics import GPDynamics, Targets
from torch_pmil.model.recurrence import unroll
from torch_pmil.model.step_derivatives import StepDerivatives


class PredictionError(RuntimeError):
    """A prediction broke down; the message names what failed, and ``step`` the time step 1..T."""

    def __init__(self, message: str, step: int) -> None:
        super().__init__(message)
        self.step = step


def predict_step(
    state: Gaussian,
    controller: Controller,
    dynamics: GPDynamics,
    space: StateSpace,
    observation_noise: bool = True,
) -> Gaussian:
    r"""Map p(x_t) to p(x_{t+1}) by exact moment matching of the policy and of the model.

    1. Features of the state (sin and cos of its angles).
    2. The policy's action and its covariance with the features.
    3. The GP's moments at the joint belief over features and action.
    4. For differences, :math:`\Sigma_{t+1} = \Sigma_t + S + C + C^\top`.

    Args:
        state: belief over the state, D entries.
        controller: the policy's controller.
        dynamics, space: forward model and state space of the robot.
        observation_noise: whether the next state's variance holds the model's noise (Eqs. 2 and 5).

    Returns:
        Belief over the next state.

    Raises:
        ValueError, NotPositiveDefiniteError: as of :func:`check_start_belief`.
    """
    check_start_belief(state, "state", dynamics, space)
    return _propagate(
        state,
        controller.on_belief,
        lambda inputs: moment_match(dynamics.expansion, inputs, observation_noise),
        dynamics.targets,
        space,
    )


def _propagate(
    state: Gaussian,
    act: Callable[[Gaussian], tuple[Gaussian, Tensor]],
    respond: Callable[[Gaussian], Moments],
    targets: Targets,
    space: StateSpace,
) -> Gaussian:
    """:func:`predict_step` for a policy and a model that are given as functions of beliefs."""
    features, slope = space.feature_moments(state)
    action, policy_slope = act(features)
    moments = respond(joint(features, action, features.cov @ policy_slope))
    return successor_belief(state, torch.cat([slope, slope @ policy_slope], -1), moments, targets)


def successor_belief(
    state: Gaussian, input_slope: Tensor, moments: Moments, targets: Targets
) -> Gaussian:
    r"""Belief p(x_{t+1}) from p(x_t) and the model's moments.

    For differences, :math:`\Sigma_{t+1} = \Sigma_t + S + C + C^\top`.

    Args:
        state: p(x_t), D entries.
        input_slope: Sigma_x^-1 cov(x, inputs of the model), (*batch, D, D' + F).
        moments: moments of the model at its inputs.
        targets: what the model predicts, "difference" or "successor".
    """
    if targets == "successor":
        return Gaussian(moments.mean, symmetric(moments.cov))
    C = state.cov @ (input_slope @ moments.inv_cov_cross_cov)
    cov = symmetric(torch.add(state.cov + moments.cov, C, alpha=2))
    return Gaussian(state.mean + moments.mean, cov)


def predict_trajectory(
    initial: Gaussian,
    policy: Policy,
    dynamics: GPDynamics,
    space: StateSpace,
    horizon: int,
    observation_noise: bool = True,
) -> Gaussian:
    """Predicted marginals p(x_1), ..., p(x_T) (Section 4.1.2).

    Args:
        initial: p(x_0), any batch shape.
        policy, dynamics, space: policy, forward model and state space of one robot.
        horizon: T, number of steps.
        observation_noise: as in :func:`predict_step`.

    Returns:
        A Gaussian of mean (*batch, T, D); differentiable in the policy.

    Raises:
        ValueError: ``initial`` has another dtype or number of entries than the state, or a mean
            that is not finite, or there is no step.
        PredictionError: names the time step and the matrix that has no Cholesky factor, or the
            state that is not finite.
    """
    try:
        check_start_belief(initial, "initial", dynamics, space)
    except NotPositiveDefiniteError as error:
        raise PredictionError(f"prediction of step 1 of {horizon} failed: {error}", 1) from error
    check_whole("horizon", horizon, 1)
    controller = policy.controller
    step = _MomentStep(controller, dynamics, space, observation_noise, horizon)
    start = Gaussian(initial.mean, symmetric(initial.cov)).flattened.flat
    states = unroll(step, start, controller.parameters, horizon)
    flat = states.movedim(0, -2).reshape(*initial.batch_shape, horizon, -1)
    trajectory = Gaussian.from_flat(flat, initial.dim)
    check_finite(trajectory, space)
    return trajectory


def check_start_belief(
    belief: Gaussian, name: str, dynamics: GPDynamics, space: StateSpace
) -> None:
    """Refuse a belief from which nothing can be predicted.

    Raises:
        ValueError: it is not over the state of the space or of the model, has another dtype, or a
            mean that is not finite.
        NotPositiveDefiniteError: its covariance is none.
    """
    check_belief(belief, name, dynamics.train_inputs)
    if not belief.dim == space.dim == dynamics.num_outputs:
        raise ValueError(
            f"{name} must be over the {space.dim} entries of the state, like the model's outputs, "
            f"got {belief.dim} entries and {dynamics.num_outputs} outputs"
        )


class _MomentStep:
    """:func:`predict_step` as a step of a recurrence of flat beliefs."""

    def __init__(
        self,
        controller: Controller,
        dynamics: GPDynamics,
        space: StateSpace,
        observation_noise: bool,
        horizon: int,
    ) -> None:
        self.controller, self.space = controller, space
        self.targets, self.horizon = dynamics.targets, horizon
        self.network = RecordedMoments(controller.network, keep_products=True)
        self.model = RecordedMoments(dynamics.expansion, observation_noise)
        self.taken = 0

    def advance(self, state: Tensor) -> Tensor:
        self.taken += 1
        belief = Gaussian.from_flat(state, self.space.dim)
        try:
            following = _propagate(belief, self._act, self.model, self.targets, self.space)
        except NotPositiveDefiniteError as error:
            raise PredictionError(
                f"prediction of step {self.taken} of {self.horizon} failed: {error}", self.taken
            ) from error
        return following.flat

    def _act(self, features: Gaussian) -> tuple[Gaussian, Tensor]:
        return self.controller.squashed(self.network(features))

    def jacobian(self, states: Tensor) -> Tensor:
        size = states.shape[-1]
        identity = torch.eye(size, dtype=states.dtype, device=states.device)
        d_next = Gaussian.cotangent_from_flat(identity, self.space.dim)
        d_mean, d_cov = (t.expand(states[..., 0].numel(), *t.shape) for t in d_next)
        d_state = self._derivatives(states).state_adjoint(d_mean, d_cov)
        return Gaussian.flat_cotangent(*d_state).view(*states.shape, size)

    def parameter_gradients(
        self, states: Tensor, parameters: Sequence[Tensor], adjoints: Tensor
    ) -> Sequence[Tensor]:
        step = self._derivatives(states)
        d_next = adjoints.flatten(0, 1)[:, None]
        d_mean, d_cov = Gaussian.cotangent_from_flat(d_next, self.space.dim)
        d_network = [cotangent.squeeze(1) for cotangent in step.network_adjoint(d_mean, d_cov)]
        leaves = [parameter.detach().requires_grad_() for parameter in parameters]
        with torch.enable_grad():
            network = self.controller.with_parameters(*leaves).network.repeated(len(states))
            moments = moment_match(network, step.features, products=self.network.products)
        return torch.autograd.grad(
            (moments.mean, moments.cov, moments.inv_cov_cross_cov), leaves, d_network
        )

    def _derivatives(self, states: Tensor) -> StepDerivatives:
        state = Gaussian.from_flat(states.flatten(0, -2), self.space.dim)
        differences = self.targets == "difference"
        return StepDerivatives(
            state,
            self.network.derivatives,
            self.controller.u_max,
            self.model.derivatives,
            differences,
            self.space,
        )


def check_finite(trajectory: Gaussian, space: StateSpace) -> None:
    """Raise PredictionError for the first step at which marginals (*batch, T, D) are not finite.

    The message names the entry of the state.
    """
    finite = trajectory.mean.isfinite() & trajectory.cov.isfinite().all(-1)
    if not finite.all():
        step, output = (~finite).reshape(-1, *finite.shape[-2:]).any(0).nonzero()[0].tolist()
        horizon = finite.shape[-2]
        raise PredictionError(
            f"prediction of step {step + 1} of {horizon} failed: {space.names[output]} is not "
            "finite",
            step + 1,
        )


def predict_mean_trajectory(
    initial: Tensor, policy: Policy, dynamics: GPDynamics, space: StateSpace, horizon: int
) -> Tensor:
    """Trajectory of the model's mean alone, as if nothing were uncertain: O(n) a step.

    Args:
        initial: x_0, (*batch, D).
        policy, dynamics, space: policy, forward model and state space of one robot.
        horizon: T, number of steps.

    Returns:
        States at t = 1..T, (*batch, T, D).

    Raises:
        ValueError: the state has another number of entries, or there is no step.
    """
    check_tensor("initial", initial, ("*batch", space.dim))
    check_whole("horizon", horizon, 1)
    controller = policy.controller
    step = _MeanStep(controller, dynamics, space)
    states = unroll(step, initial.reshape(-1, space.dim), controller.parameters, horizon)
    return states.movedim(0, -2).reshape(*initial.shape[:-1], horizon, space.dim)


class _MeanStep:
    """The model's mean as a step of a recurrence."""

    def __init__(self, controller: Controller, dynamics: GPDynamics, space: StateSpace) -> None:
        self.controller, self.space = controller, space
        self.expansion, self.targets = dynamics.expansion, dynamics.targets

    def advance(self, state: Tensor) -> Tensor:
        return self._follow(state, self.controller)

    def jacobian(self, states: Tensor) -> Tensor:
        certain = Gaussian(states, torch.diag_embed(torch.zeros_like(states)))
        features, slope = self.space.feature_moments(certain)
        raw, raw_slope = self.controller.network.mean_and_gradient(features.mean)
        action_slope = (self.controller.u_max * raw.cos())[..., None] * raw_slope
        inputs = torch.cat([features.mean, self.controller.u_max * raw.sin()], -1)
        _, model_slope = self.expansion.mean_and_gradient(inputs)
        jacobian = model_slope @ torch.cat([slope.mT, action_slope @ slope.mT], -2)
        if self.targets == "difference":
            jacobian.diagonal(dim1=-2, dim2=-1).add_(1)
        return jacobian

    def parameter_gradients(
        self, states: Tensor, parameters: Sequence[Tensor], adjoints: Tensor
    ) -> Sequence[Tensor]:
        leaves = [parameter.detach().requires_grad_() for parameter in parameters]
        with torch.enable_grad():
            following = self._follow(states, self.controller.with_parameters(*leaves))
        return torch.autograd.grad(following, leaves, adjoints)

    def _follow(self, state: Tensor, controller: Controller) -> Tensor:
        features = self.space.features(state)
        mean = self.expansion.mean(torch.cat([features, controller(features)], -1))
        return mean if self.targets == "successor" else state + mean
