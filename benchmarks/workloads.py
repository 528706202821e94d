r"""The workloads of ``prediction.py``: a predicted trajectory's KL and its policy gradient.

All do the same work, in several ways.

The task is the double pendulum's (D = 4 states, F = 2 torques, 100 basis functions), float64. The
data are n transitions of the robot under random torques, without noise. The hyper-parameters are
PILCO's first ones (lengthscales std(input), signal std(target), noise a tenth of it), the
lengthscales times factors between 1/2 and 2 that differ by output and input: equal ones would hide
a mistake in the products of two outputs. The policy has random weights, and beyond the demonstrated
25 steps the demonstration stays where it ends.

=========================  =====================================================================
``torch_pmil``             ``TrajectoryKLLoss``, by the compiled kernels; model and policy see
                           sin and cos of the two angles: 6 features, 8 GP inputs
``torch_pmil_formulas``    the same by the formulas in PyTorch, see :func:`by_formulas`
``torch_pmil_fitted``      the same as ``torch_pmil`` with the hyper-parameters of a fit: since the
                           data have no noise, signal-to-noise ratios of several hundreds
``torch_pmil_raw_angles``  ``TrajectoryKLLoss``; model and policy see the four states themselves:
                           6 GP inputs, as ``torchrl``
``torchrl``                ``GPWorldModel`` and ``RBFController``, see :func:`torchrl_rollout`
``exp_floor``              D (D + 1) / 2 · n² · T exponentials alone, by PyTorch, as a measure of
                           the machine
=========================  =====================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from unittest import mock

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.modules import GPWorldModel, RBFController

from torch_pmil import Gaussian, GPDynamics, RBFPolicy, TrajectoryKLLoss, trajectory_kl
from torch_pmil.model import compiled
from torch_pmil.model.dynamics import MOST_EXACT
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SEED = 0
ROLLOUT_STEPS = 25  # of the rollouts that the data are taken from
# of those rollouts, as a fraction of the limits: the pendulum swings and does not turn over
RANDOM_TORQUE = 0.1
NOISE_RATIO = 0.1  # noise over signal, standard deviations
# exponentials at a time: argument and result are 0.25 MB each and stay in the level-2 cache
CHUNK = 2**15

Evaluate = Callable[[], list[Tensor]]  # the loss (nats) and its gradients; the floor has neither


@dataclass(frozen=True)
class Problem:
    """An experiment with a model, a policy, and the demonstrated marginals at t = 1..horizon."""

    experiment: Task
    dynamics: GPDynamics
    policy: RBFPolicy
    demonstrated: Gaussian

    @property
    def loss(self) -> TrajectoryKLLoss:
        """The objective of the policy search."""
        return TrajectoryKLLoss(
            self.policy,
            self.dynamics,
            self.experiment.space,
            self.demonstrated,
            self.experiment.noise_std,
        )


def make_problem(
    n: int,
    horizon: int,
    raw_angles: bool = False,
    fitted: bool = False,
    most_exact: int = MOST_EXACT,
) -> Problem:
    """The benchmark's problem, always the same for the same arguments.

    Args:
        n: number of transitions that the model knows.
        horizon: T.
        raw_angles: whether model and policy see the angles themselves in place of their sin and
            cos.
        fitted: whether the hyper-parameters are those of a fit.
        most_exact: largest n of an exact posterior.
    """
    experiment = load_experiment("double_pendulum")
    if raw_angles:
        space = replace(experiment.space, angles=())
        experiment = replace(experiment.with_settings(least_widths=None), space=space)
    generator = torch.Generator().manual_seed(SEED)
    states, torques, successors = random_transitions(experiment, n, generator)
    inputs = torch.cat([experiment.space.features(states), torques], -1)
    steps = torch.arange(horizon).clamp(max=experiment.horizon - 1)
    return Problem(
        experiment,
        (fit_dynamics if fitted else make_dynamics)(inputs, successors - states, most_exact),
        experiment.make_policy(generator),
        experiment.demonstrated[steps],
    )


def random_transitions(
    experiment: Task, n: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """States (n, D), torques (n, F) in N·m and successors (n, D) under random torques.

    Rollouts start from the initial belief.
    """
    robots = math.ceil(n / ROLLOUT_STEPS)
    env = experiment.make_env(num_envs=robots, seed=SEED)
    states, torques = [experiment.initial.sample(robots, generator)], []
    for _ in range(ROLLOUT_STEPS):
        shape = (robots, len(experiment.actions.names))
        uniform = torch.rand(shape, dtype=torch.float64, generator=generator)
        torques.append(RANDOM_TORQUE * experiment.actions.half_range * (2 * uniform - 1))
        states.append(env.simulate(states[-1], torques[-1]))
    before, actions, after = (torch.cat(parts)[:n] for parts in (states[:-1], torques, states[1:]))
    return before, actions, after


def make_dynamics(inputs: Tensor, targets: Tensor, most_exact: int = MOST_EXACT) -> GPDynamics:
    """The model of given data, without a fit."""
    dynamics = GPDynamics(inputs.shape[-1], targets.shape[-1], most_exact=most_exact)
    signal_variance = targets.var(0)
    lengthscales = inputs.std(0) * lengthscale_factors(dynamics.num_outputs, dynamics.num_inputs)
    dynamics.gp.covar_module.base_kernel.lengthscale = lengthscales[:, None]
    dynamics.gp.covar_module.outputscale = signal_variance
    dynamics.gp.likelihood.noise = NOISE_RATIO**2 * signal_variance[:, None]
    dynamics.set_data(inputs, targets)
    _ = dynamics.expansion  # K^-1, computed once and kept
    return dynamics


def lengthscale_factors(outputs: int, inputs: int) -> Tensor:
    """Factors between 1/2 and 2, each another, (outputs, inputs)."""
    count = torch.arange(outputs * inputs, dtype=torch.float64)
    return 2 ** torch.sin(count).view(outputs, inputs)


def fit_dynamics(inputs: Tensor, targets: Tensor, most_exact: int = MOST_EXACT) -> GPDynamics:
    """The model of given data with the hyper-parameters of a fit."""
    dynamics = GPDynamics(inputs.shape[-1], targets.shape[-1], most_exact=most_exact)
    dynamics.fit(inputs, targets)
    _ = dynamics.expansion
    return dynamics


def signal_to_noise(dynamics: GPDynamics) -> Tensor:
    """Ratios of the standard deviations of signal and noise, (D,)."""
    posterior = dynamics.expansion
    return (posterior.signal_variance / posterior.noise_variance).sqrt()


def torch_pmil(n: int, horizon: int, raw_angles: bool = False, fitted: bool = False) -> Evaluate:
    """This package, by its public names."""
    problem = make_problem(n, horizon, raw_angles, fitted)
    loss, initial = problem.loss, problem.experiment.initial
    parameters = list(problem.policy.parameters())

    def evaluate() -> list[Tensor]:
        value = loss.per_step(initial).sum()
        return [value, *torch.autograd.grad(value, parameters)]

    return evaluate


def by_formulas(evaluate: Evaluate) -> Evaluate:
    """The same without compiled kernels, as with ``TORCH_PMIL_COMPILED=0``."""

    def evaluate_formulas() -> list[Tensor]:
        with mock.patch.object(compiled, "available", lambda: False):
            return evaluate()

    return evaluate_formulas


def torchrl(n: int, horizon: int) -> Evaluate:
    """TorchRL's rollout with this package's KL at its end."""
    problem = make_problem(n, horizon, raw_angles=True)
    experiment = problem.experiment
    model, controller = world_model(problem.dynamics), rbf_controller(problem.policy)
    parameters = list(controller.parameters())

    def evaluate() -> list[Tensor]:
        states = torchrl_rollout(model, controller, experiment.initial, horizon)
        predicted = experiment.space.match_space.moments(states)
        value = trajectory_kl(problem.demonstrated, predicted.add_noise(experiment.noise_std**2))
        return [value, *torch.autograd.grad(value, parameters)]

    return evaluate


def torchrl_rollout(
    model: GPWorldModel, controller: RBFController, initial: Gaussian, horizon: int
) -> Gaussian:
    """p(x_1), ..., p(x_T) by TorchRL's moment matching, in a plain loop.

    TorchRL's ``ImaginedEnv`` takes one action only.

    The mathematics, data, hyper-parameters and policy are those of ``torch_pmil_raw_angles``, but
    for the terms that TorchRL adds to keep its matrices definite: 1e-6 to the raw action's
    covariance and 1e-8 to the state's.
    """
    mean, var, means, covs = initial.mean, initial.cov, [], []
    for _ in range(horizon):
        action = dict(zip(("mean", "var", "cross_covariance"), controller(mean, var), strict=True))
        beliefs = TensorDict({"observation": {"mean": mean, "var": var}, "action": action})
        successor = model(beliefs)["next", "observation"]
        mean, var = successor["mean"], successor["var"]
        means.append(mean)
        covs.append(var)
    return Gaussian(torch.stack(means), torch.stack(covs))


def world_model(dynamics: GPDynamics) -> GPWorldModel:
    """TorchRL's model with the posterior of ours.

    Its own ``fit`` standardises the targets and reads the result in other units.

    Raises:
        ImportError: botorch is missing.
    """
    posterior = dynamics.expansion
    model = GPWorldModel(
        obs_dim=dynamics.num_outputs, action_dim=dynamics.num_inputs - dynamics.num_outputs
    )
    model.X_tilde_train = dynamics.train_inputs
    model.ell, model.alpha_sq = posterior.lengthscales, posterior.signal_variance[:, None]
    model.sigma_sq_eps = posterior.noise_variance
    model._cached_inv_K_noisy, model._cached_beta = posterior.gram_inverse, posterior.weights
    return model


def rbf_controller(policy: RBFPolicy) -> RBFController:
    """TorchRL's policy with the centres, weights and (unit) widths of ours.

    All its outputs share one vector of lengthscales.
    """
    m, inputs = policy.centres.shape
    controller = RBFController(inputs, len(policy.u_max), policy.u_max, n_basis=m).double()
    with torch.no_grad():
        controller.centers.copy_(policy.centres * policy.scale)
        controller.weights.copy_(policy.weights)
        controller.lengthscales.copy_(policy.scale)
    return controller


def exp_floor(n: int, horizon: int) -> Evaluate:
    """The exponentials of the D (D + 1) / 2 pairs of outputs alone, forward only, by PyTorch.

    Arguments are between -10 and 0. The kernels have exponentials of their own, and half as many
    for the pair of an output with itself.
    """
    states = load_experiment("double_pendulum").space.dim
    count = states * (states + 1) // 2 * n**2 * horizon
    argument = torch.linspace(-10, 0, min(CHUNK, count), dtype=torch.float64)
    result = torch.empty_like(argument)
    chunks, rest = divmod(count, len(argument))

    def evaluate() -> list[Tensor]:
        for _ in range(chunks):
            torch.exp(argument, out=result)
        torch.exp(argument[:rest], out=result[:rest])
        return []

    return evaluate


WORKLOADS: dict[str, Callable[[int, int], Evaluate]] = {
    "torch_pmil": torch_pmil,
    "torch_pmil_formulas": lambda n, horizon: by_formulas(torch_pmil(n, horizon)),
    "torch_pmil_fitted": lambda n, horizon: torch_pmil(n, horizon, fitted=True),
    "torch_pmil_raw_angles": lambda n, horizon: torch_pmil(n, horizon, raw_angles=True),
    "torchrl": torchrl,
    "exp_floor": exp_floor,
}
