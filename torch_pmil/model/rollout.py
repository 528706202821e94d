r"""Trajectory distribution p(x_1), ..., p(x_T) from p(x_0), a policy and a model (Eq. 13)."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torch_pmil.checks import check_tensor, check_whole
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.policy import Act, Policy, SquashedController
from torch_pmil.control.rbf_policy import Controller
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import (
    Gaussian,
    Moments,
    NotPositiveDefiniteError,
    check_belief,
    joint,
    symmetric,
)
from torch_pmil.gp.moment_matching import exact_moments, moment_match
from torch_pmil.model.compiled import kernels, serves
from torch_pmil.model.compiled.plans import Plan
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import ForwardModel


class PredictionError(RuntimeError):
    """A prediction failed; ``step`` is the time step 1..T."""

    def __init__(self, message: str, step: int) -> None:
        super().__init__(message)
        self.step = step


def predict_step(
    state: Gaussian,
    controller: SquashedController,
    dynamics: GPDynamics,
    space: StateSpace,
    observation_noise: bool = True,
) -> Gaussian:
    r"""Map p(x_t) to p(x_{t+1}) by exact moment matching of the policy and of the model.

    1. Features of the state (sin and cos of its angles).
    2. The policy's action and its covariance with the features.
    3. The GP's moments at the joint belief over features and action.
    4. The known part of the dynamics, :func:`successor_belief`.

    Args:
        state: belief over the state, D entries.
        controller: the policy's controller.
        dynamics, space: forward model and state space of the robot.
        observation_noise: whether the next state's variance holds the model's noise (Eqs. 2 and 5).

    Raises:
        ValueError, NotPositiveDefiniteError: as :func:`check_start_belief`.
    """
    check_start_belief(state, "state", dynamics, space)
    return _propagate(
        state,
        controller.on_belief,
        lambda inputs: moment_match(dynamics.expansion, inputs, observation_noise),
        dynamics.known_part(space),
        space,
    )


def _propagate(
    state: Gaussian,
    act: Callable[[Gaussian], tuple[Gaussian, Tensor]],
    respond: Callable[[Gaussian], Moments],
    known: KnownPart,
    space: StateSpace,
) -> Gaussian:
    """:func:`predict_step` with policy and model as functions of beliefs."""
    features, slope = space.feature_moments(state)
    action, policy_slope = act(features)
    inputs = joint(features, action, features.cov @ policy_slope)
    input_slope = torch.cat([slope, slope @ policy_slope], -1)
    return successor_belief(state, inputs, input_slope, respond(inputs), known)


def successor_belief(
    state: Gaussian, inputs: Gaussian, input_slope: Tensor, moments: Moments, known: KnownPart
) -> Gaussian:
    r"""Belief p(x_{t+1}) from p(x_t), p(u_t), the model's moments and the known part.

    With :math:`z = [x_t, u_t]` and :math:`x_{t+1} = A z + C g`,

    .. math::
        \Sigma_{t+1} = A \Sigma_z A^\top + C S C^\top
            + A \operatorname{cov}(z, g) C^\top + C \operatorname{cov}(g, z) A^\top

    Args:
        state: p(x_t), D entries.
        inputs: belief over the model's inputs; the last F entries are the actions.
        input_slope: Sigma_x^-1 cov(x, inputs), (*batch, D, D' + F).
        moments: moments of the model at its inputs.
        known: known part of the dynamics.
    """
    F = known.num_actions
    A, C = known.matrix.to(state.mean), known.gain.to(state.mean)
    action = Gaussian(inputs.mean[..., -F:], inputs.cov[..., -F:, -F:])
    z = joint(state, action, state.cov @ input_slope[..., -F:])
    with_inputs = torch.cat([state.cov @ input_slope, inputs.cov[..., -F:, :]], -2)
    cross = A @ (with_inputs @ moments.inv_cov_cross_cov) @ C.mT
    mean = z.mean @ A.mT + moments.mean @ C.mT
    return Gaussian(mean, symmetric(A @ z.cov @ A.mT + C @ moments.cov @ C.mT + 2 * cross))


def predict_trajectory(
    initial: Gaussian,
    policy: Policy,
    dynamics: ForwardModel,
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
        ValueError: ``initial`` does not fit the state, its mean is not finite, or there is no step.
        PredictionError: names the time step and the matrix that has no Cholesky factor, or the
            state that is not finite.
        TypeError: policy or model has no moments in closed form.
    """
    try:
        check_start_belief(initial, "initial", dynamics, space)
    except NotPositiveDefiniteError as error:
        raise PredictionError(f"prediction of step 1 of {horizon} failed: {error}", 1) from error
    check_whole("horizon", horizon, 1)
    start, controller = initial.flattened, policy.controller
    if not (isinstance(controller, SquashedController) and isinstance(dynamics, GPDynamics)):
        raise TypeError(
            "moments are known of an RBFPolicy or LinearPolicy and a GPDynamics alone, got "
            f"{type(policy).__name__} and {type(dynamics).__name__}: predict by SampledPrediction()"
        )
    given = controller, dynamics, space, horizon, observation_noise
    plan = _compiled(start.mean, start.cov, *given)
    trajectory = None if plan is None else kernels().predict_beliefs(start, plan)
    if trajectory is None:
        trajectory = _trajectory(start, *given)
    shape = initial.batch_shape
    return Gaussian(*(t.reshape(*shape, *t.shape[1:]) for t in (trajectory.mean, trajectory.cov)))


def _trajectory(
    state: Gaussian,
    controller: SquashedController,
    dynamics: GPDynamics,
    space: StateSpace,
    horizon: int,
    observation_noise: bool,
) -> Gaussian:
    """:func:`predict_trajectory` from N beliefs by the formulas in PyTorch."""
    states = []
    state = Gaussian(state.mean, symmetric(state.cov))
    model = dynamics.expansion
    known = dynamics.known_part(space)
    for step in range(1, horizon + 1):
        try:
            state = _propagate(
                state,
                lambda features: controller.squashed(controller.unchecked_moments(features)),
                lambda inputs: exact_moments(model, inputs, observation_noise),
                known,
                space,
            )
        except NotPositiveDefiniteError as error:
            message = f"prediction of step {step} of {horizon} failed: {error}"
            raise PredictionError(message, step) from error
        states.append(state)
    means, covs = [state.mean for state in states], [state.cov for state in states]
    trajectory = Gaussian(torch.stack(means, 1), torch.stack(covs, 1))
    check_finite(trajectory, space)
    return trajectory


def check_start_belief(
    belief: Gaussian, name: str, dynamics: ForwardModel, space: StateSpace
) -> None:
    """Raise ValueError or NotPositiveDefiniteError unless this is a valid belief over the state."""
    check_belief(belief, name, dynamics.train_inputs)
    if not belief.dim == space.dim == dynamics.dim:
        raise ValueError(
            f"{name} must be over the {space.dim} entries of the state, like the prediction, got "
            f"{belief.dim} entries and {dynamics.dim} outputs"
        )


def check_finite(trajectory: Gaussian, space: StateSpace) -> None:
    """Raise PredictionError for the first step at which marginals (*batch, T, D) are not finite.

    The message names an entry that overflowed, if any, since it makes others NaN.
    """
    finite = trajectory.mean.isfinite() & trajectory.cov.isfinite().all(-1)
    if not finite.all():
        horizon, D = finite.shape[-2:]
        wrong, infinite = (
            found.reshape(-1, horizon, D).any(0) for found in (~finite, trajectory.mean.isinf())
        )
        step = int(wrong.any(-1).nonzero()[0])
        output = int((infinite[step] if infinite[step].any() else wrong[step]).nonzero()[0])
        raise PredictionError(
            f"prediction of step {step + 1} of {horizon} failed: {space.names[output]} is not "
            "finite",
            step + 1,
        )


def predict_mean_trajectory(
    initial: Tensor, policy: Policy, dynamics: ForwardModel, space: StateSpace, horizon: int
) -> Tensor:
    """Trajectory of the model's mean alone, as if nothing were uncertain: O(n) a step.

    Returns states at t = 1..T, (*batch, T, D), from ``initial`` x_0, (*batch, D).
    """
    check_tensor("initial", initial, ("*batch", space.dim))
    check_whole("horizon", horizon, 1)
    start, controller = initial.reshape(-1, space.dim), policy.controller
    plan = _compiled(start, start, controller, dynamics, space, horizon)
    if plan is None:
        states = _mean_trajectory(start, controller, dynamics, space, horizon)
    else:
        states = kernels().predict_states(start, plan)
    return states.reshape(*initial.shape[:-1], horizon, space.dim)


def _mean_trajectory(
    state: Tensor, controller: Act, dynamics: ForwardModel, space: StateSpace, horizon: int
) -> Tensor:
    states, known = list[Tensor](), dynamics.known_part(space)
    for _ in range(horizon):
        features = space.features(state)
        action = controller(features)
        outputs = dynamics.mean(torch.cat([features, action], -1))
        state = known.successors(state, action, outputs)
        states.append(state)
    return torch.stack(states, -2)


def compiled_plan(
    initial: Gaussian, policy: Policy, dynamics: ForwardModel, space: StateSpace, horizon: int
) -> Plan | None:
    """What the kernels predict from one belief, mean (D,), if they do."""
    start = initial.flattened
    return _compiled(start.mean, start.cov, policy.controller, dynamics, space, horizon)


def _compiled(
    mean: Tensor,
    cov: Tensor,
    controller: Act,
    dynamics: ForwardModel,
    space: StateSpace,
    horizon: int,
    observation_noise: bool = True,
) -> Plan | None:
    """The plan of these trajectories for the kernels, which check no shapes, or None."""
    if not (isinstance(controller, Controller) and isinstance(dynamics, GPDynamics)):
        return None
    f, network, F = dynamics.expansion, controller.network, len(controller.u_max)
    features, offset = len(space.feature_names), torch.as_tensor(network.offset, dtype=mean.dtype)
    fit = (
        (f.num_inputs, f.num_outputs) == (features + F, dynamics.num_outputs)
        and dynamics.dim == space.dim
        and (network.num_inputs, network.num_outputs) == (features, F)
        and network.weights.shape[:-2] in ((), mean.shape[:1])
        and (f.gram_inverse is not None and network.gram_inverse is None)
    )
    constant = *f.tensors, controller.u_max, controller.u_middle, network.signal_variance, offset
    if not (fit and serves(constant, (mean, cov, *controller.parameters))):
        return None
    return Plan(f, dynamics.known_part(space), space, controller, horizon, observation_noise)
