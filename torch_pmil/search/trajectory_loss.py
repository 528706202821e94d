"""Base class of the search's losses: a TorchRL loss that predicts a trajectory (Eq. 21)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, TypedDict

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.objectives import LossModule

from torch_pmil.checks import check_whole
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.policy import Policy, SquashedPolicy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.model.compiled import kernels, serves
from torch_pmil.model.compiled.plans import Comparison, Objective
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.model.rollout import (
    PredictionError,
    compiled_plan,
    predict_mean_trajectory,
    predict_trajectory,
)
from torch_pmil.model.sampled_rollouts import SampledPrediction

Reduction = Literal["none", "mean", "sum"]
Prediction = Callable[[Gaussian, Policy, ForwardModel, StateSpace, int], Gaussian]
MeanPrediction = Callable[[Tensor, Policy, ForwardModel, StateSpace, int], Tensor]
Penalty = Callable[[Gaussian], Tensor]


class LossOptions(TypedDict, total=False):
    """Arguments that every :class:`TrajectoryLoss` takes by name."""

    reduction: Reduction
    prediction: Prediction | None
    mean_prediction: MeanPrediction


class TrajectoryLoss(LossModule):
    r"""Base class of losses that sum a cost over the steps of a predicted trajectory.

    When called, it reads the start beliefs p(x_0) at ``("observation", "mean")``, (\*batch, D), and
    ``("observation", "var")``, (\*batch, D, D), and predicts. :meth:`rollout_loss` reads beliefs
    that are predicted already, as a rollout through an imagined environment leaves them. Both write
    ``out_keys``.

    ``set_keys(mean=..., var=...)`` sets other keys. ``loss_mask_key`` is TorchRL's: the entry,
    (\*batch) or (\*batch, T), that is False where a belief or a step does not count and may hold
    anything; by default ``("collector", "mask")`` or ``"shifted_valid"``. Beliefs of another dtype
    are computed in that of the policy.

    The model is constant: ``parameters()`` gives those of the policy alone, while ``state_dict()``
    holds all. Every method that predicts raises PredictionError where that fails.

    Args:
        actor_network: the policy, whose parameters are learned.
        dynamics: the forward model.
        space: the robot's state space.
        reduction: "mean" over trajectories of the sum over their steps, "sum" over both, or "none":
            all steps, (\*batch, T), with 0 where they do not count.
        prediction: of p(x_1..T), as :class:`ParticlePrediction`. If None, exact moment matching;
            by samples where policy or model has no moments in closed form.
        mean_prediction: of the trajectory of the model's mean alone.

    Raises:
        ValueError: there is no such reduction.
    """

    _penalty: Penalty | None = None
    actor_network: AnyPolicy
    dynamics: ForwardModel
    label: str  # name of the loss in progress reports and figures
    unit: str  # unit of the loss there, "" for none

    @dataclass
    class _AcceptedKeys:
        """Keys that ``set_keys`` takes: mean and covariance of the belief over the state."""

        mean: NestedKey = ("observation", "mean")
        var: NestedKey = ("observation", "var")

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys

    def __init__(
        self,
        actor_network: AnyPolicy,
        dynamics: ForwardModel,
        space: StateSpace,
        reduction: Reduction = "mean",
        prediction: Prediction | None = None,
        mean_prediction: MeanPrediction = predict_mean_trajectory,
    ) -> None:
        super().__init__()
        if reduction not in ("none", "mean", "sum"):
            raise ValueError(f'reduction must be "none", "mean" or "sum", got {reduction!r}')
        self.actor_network = actor_network
        self.dynamics = dynamics
        self.space = space
        self.reduction = reduction
        if prediction is None:
            prediction = predict_trajectory if self.has_moments else SampledPrediction()
        self.prediction, self.mean_prediction = prediction, mean_prediction

    @property
    @abstractmethod
    def horizon(self) -> int:
        """T, number of steps after the start."""

    @abstractmethod
    def _costs(self, observed: Gaussian) -> Tensor:
        """Costs of the first steps, (*batch, steps), from marginals in the match space."""

    @abstractmethod
    def _mean_costs(self, observed: Tensor) -> Tensor:
        """Costs of the first steps, (*batch, steps), from means alone in the match space."""

    @property
    def has_moments(self) -> bool:
        """Whether the marginals of policy and model are known in closed form."""
        of_model = isinstance(self.dynamics, GPDynamics)
        return of_model and isinstance(self.actor_network, SquashedPolicy)

    @property
    def functional(self) -> bool:
        """False: the policy is used as it is, not through a copy of its parameters."""
        return False

    @property
    def in_keys(self) -> list[NestedKey]:
        """Keys of the belief over the start state."""
        return [self.tensor_keys.mean, self.tensor_keys.var]

    @property
    def rollout_keys(self) -> list[NestedKey]:
        """Keys of the predicted beliefs of a rollout: ``in_keys`` below "next"."""
        return [unravel_key(("next", key)) for key in self.in_keys]

    def _comparison(self, horizon: int) -> Comparison | None:
        """What the kernels compare the first steps with; None for a cost that they do not know."""
        return None

    def predict(self, initial: Gaussian, horizon: int | None = None) -> Gaussian:
        """Predicted observations at t = 1..horizon, mean (*batch, horizon, M)."""
        return self._observe(self.predict_states(initial, horizon))

    def predict_states(self, initial: Gaussian, horizon: int | None = None) -> Gaussian:
        """Predicted states at t = 1..horizon, mean (*batch, horizon, D)."""
        start, policy = self.begin(initial)
        return self.prediction(start, policy, self.dynamics, self.space, self._steps(horizon))

    def begin(self, initial: Gaussian) -> tuple[Gaussian, Policy]:
        """Start beliefs of the trajectories that are predicted for p(x_0), and the policy there."""
        return initial, self.actor_network

    def policy_inputs(self, states: Tensor) -> Tensor:
        """Inputs of the policy at states (*batch, D), a batch of the trajectories' shape."""
        return self.space.features(states)

    def per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """Cost of each predicted marginal up to a horizon, (*batch, horizon)."""
        states = self.predict_states(initial, horizon)
        costs = self._by_kernels(states, self._comparison(states.mean.shape[-2]))
        if costs is None:
            costs = self._score(self._observe(states))
        return costs if self._penalty is None else costs + self._penalty(states)

    def mean_per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """Cost of each step for the model's mean alone, (*batch, horizon).

        It is cheap, and has no local optimum of wide predictions.
        """
        (start, policy), steps = self.begin(initial), self._steps(horizon)
        states = self.mean_prediction(start.mean, policy, self.dynamics, self.space, steps)
        comparison = self._served(self._comparison(states.shape[-2]), states)
        costs = None if comparison is None else kernels().costs_of_states(states, comparison)
        return self._mean_costs(self.space.observe(states)) if costs is None else costs

    def step_loss_for_trust(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """Loss by which a search trusts each predicted marginal, the cost; (*batch, horizon)."""
        return self.per_step(initial, horizon)

    def spread(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """How unsure each predicted marginal is, (*batch, horizon).

        It is the ratio of the predicted variance to the variance of the model's data, both in the
        match space, averaged over its entries. It has no unit, whatever the task measures.
        """
        return self._spread_of(self.predict_states(initial, horizon))

    def trusts_start(self, initial: Gaussian, threshold: float) -> bool:
        """Whether moments are worth predicting from a start, at a search's trust threshold.

        Always true here, since the demonstrations may be as wide as the start.
        """
        return True

    def _spread_of(self, states: Gaussian) -> Tensor:
        variance = self.space.match_space.moments(states).cov.diagonal(dim1=-2, dim2=-1)
        return (variance / self._variance_of_data).mean(-1)

    @property
    def _variance_of_data(self) -> Tensor:
        """Variances (M,) of the states of the model's data, observed in the match space."""
        features = self.dynamics.train_inputs[:, : len(self.space.feature_names)]
        variance = self.space.observe(self.space.states(features)).var(0)
        return variance.clamp(min=torch.finfo(variance.dtype).tiny)

    def sample_costs(self, states: Tensor) -> Tensor:
        r"""Costs (N, \*batch, T) of sampled trajectories x_0..x_T, (N, \*batch, T + 1, D)."""
        return self._mean_costs(self.space.observe(states[..., 1:, :]))

    def typical_cost(self, states: Tensor) -> Tensor:
        r"""Cost that one state can affect, from trajectories x_0..x_T, (N, \*batch, T + 1, D).

        Here the cost of one step: each step has its own demonstration, so a state matters little to
        the costs of later steps.
        """
        costs = self.sample_costs(states).abs()
        return costs.mean().clamp(min=torch.finfo(costs.dtype).tiny)

    def objective(
        self, per_step: Callable[[Gaussian, int], Tensor], initial: Gaussian, horizon: int
    ) -> Objective | None:
        """The sum over the steps of one of this loss's methods, by kernels and without a graph.

        None if kernels cannot compute it, such as for several start beliefs, for a loss with its
        own prediction or comparison, or for :meth:`per_step` with a penalty.
        """
        method, of_class = getattr(per_step, "__func__", None), type(self)
        plain = (
            not initial.batch_shape
            and type(self.actor_network) is RBFPolicy
            and of_class.begin is TrajectoryLoss.begin
            and of_class.predict_states is TrajectoryLoss.predict_states
            and self.prediction is predict_trajectory
            and self.mean_prediction is predict_mean_trajectory
        )
        if not plain:
            return None
        states = initial.mean.expand(horizon, -1)
        comparison = self._served(self._comparison_of(method, horizon), states)
        if comparison is None:
            return None
        with torch.no_grad():
            plan = compiled_plan(initial, self.actor_network, self.dynamics, self.space, horizon)
        if plan is None:
            return None
        try:
            scale, mean_alone = self.actor_network.scale, method is TrajectoryLoss.mean_per_step
            return kernels().PolicyObjective(plan, comparison, initial, scale, mean_alone)
        except NotPositiveDefiniteError:  # the formulas name what is wrong with the demonstrations
            return None

    @contextmanager
    def penalised(self, penalty: Penalty) -> Iterator[None]:
        """Context in which :meth:`per_step` adds a penalty to the cost of each step.

        The penalty maps the predicted states, mean (*batch, T, D), to (*batch, T), in the unit of
        the loss.
        """
        self._penalty = penalty
        try:
            yield
        finally:
            self._penalty = None

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Loss of the trajectories that are predicted from the start beliefs (*batch, D).

        Raises KeyError if a belief is missing, ValueError if it is not over the state.
        """
        initial = self._belief(tensordict, self.in_keys)
        counted = self._counted(tensordict, (*initial.batch_shape, self.horizon))
        return self._reduced(self.per_step(_where(counted.any(-1), initial)), counted)

    @dispatch(source="rollout_keys")
    def rollout_loss(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Loss of beliefs over the state that are predicted already, (*batch, t, D) with t up to T.

        Gradients flow into the beliefs. Errors are those of a call; PredictionError names the step
        whose belief is degenerate.
        """
        states = self._belief(tensordict, self.rollout_keys)
        if not states.batch_shape or states.batch_shape[-1] > self.horizon:
            raise ValueError(
                f"a trajectory must have shape (*batch, t, D) with t up to {self.horizon}, got "
                f"{tuple(states.mean.shape)}"
            )
        counted = self._counted(tensordict, states.batch_shape)
        return self._reduced(self._costs_of_beliefs(_where(counted, states)), counted)

    def named_parameters(
        self, prefix: str = "", recurse: bool = True
    ) -> Iterator[tuple[str, nn.Parameter]]:
        """Names and parameters of the policy alone, without those of the model."""
        constant = set(self.dynamics.parameters())
        return (
            (name, parameter)
            for name, parameter in super().named_parameters(prefix, recurse)
            if parameter not in constant
        )

    def reset_parameters_recursive(self) -> None:
        """Not implemented: a new policy is made by its task."""
        raise NotImplementedError(
            "the policy cannot reset itself: load a new one with "
            "actor_network.load_state_dict(new.state_dict())"
        )

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        """Nothing to do: the loss has no value estimator."""

    def _steps(self, horizon: int | None) -> int:
        """Number of steps to predict, all if None; raises ValueError if there are fewer."""
        if horizon is None:
            return self.horizon
        check_whole("horizon", horizon, 1, self.horizon)
        return horizon

    def _comparison_of(self, method: object, horizon: int) -> Comparison | None:
        """:meth:`_comparison` for the sum of one of its methods; None if kernels do not know it."""
        without_penalty = method is TrajectoryLoss.per_step and self._penalty is None
        known = without_penalty or method is TrajectoryLoss.mean_per_step
        return self._comparison(horizon) if known else None

    def _by_kernels(self, states: Gaussian, comparison: Comparison | None) -> Tensor | None:
        """Costs of predicted states as kernels compute them; None if they do not."""
        served = self._served(comparison, states.mean)
        return None if served is None else kernels().costs_of_beliefs(states, served)

    def _served(self, comparison: Comparison | None, states: Tensor) -> Comparison | None:
        """A comparison with states (*batch, T, D), if kernels compute it."""
        if comparison is None or not serves(comparison.tensors, (states,)):
            return None
        broadcast = torch.broadcast_shapes(comparison.offset.shape[:-1], states.shape[:-1])
        fits = broadcast == states.shape[:-1] and states.shape[-1] == self.space.dim
        return comparison if fits else None

    def _observe(self, states: Gaussian) -> Gaussian:
        return self.space.match_space.moments(states)

    def _costs_of_beliefs(self, states: Gaussian) -> Tensor:
        """Costs of beliefs over the state, (*batch, t)."""
        return self._score(self._observe(states))

    def _score(self, observed: Gaussian) -> Tensor:
        try:
            return self._costs(observed)
        except NotPositiveDefiniteError as error:
            step = error.element[-1] + 1
            raise PredictionError(
                f"comparison of step {step} of {observed.batch_shape[-1]} failed: {error}", step
            ) from error

    def _belief(self, tensordict: TensorDictBase, keys: list[NestedKey]) -> Gaussian:
        present = tensordict.keys(include_nested=True)
        for key in keys:
            if key not in present:
                raise KeyError(
                    f"{type(self).__name__} reads {key!r}, got a tensordict with "
                    f"{sorted(present, key=str)}"
                )
        dtype = self.actor_network.u_max.dtype
        belief = Gaussian(*(tensordict.get(key).to(dtype) for key in keys))
        if belief.dim != self.space.dim:
            raise ValueError(
                f"{keys[0]!r} must hold the {self.space.dim} entries {self.space.names}, got "
                f"{belief.dim}"
            )
        return belief

    def _counted(self, tensordict: TensorDictBase, shape: tuple[int, ...]) -> Tensor:
        """Mask of the steps that TorchRL's masks leave, bool of shape (*batch, steps)."""
        ones = torch.ones(shape, device=self.actor_network.u_max.device)
        return self._reduce_loss(ones, tensordict, reduction="none").bool()

    def _reduced(self, costs: Tensor, counted: Tensor) -> TensorDict:
        costs = torch.where(counted, costs, 0.0)
        if self.reduction == "mean":
            costs = costs.sum(-1).sum() / counted.any(-1).sum().clamp(min=1)
        elif self.reduction == "sum":
            costs = costs.sum()
        return TensorDict({self.out_keys[0]: costs})


def _where(counted: Tensor, belief: Gaussian) -> Gaussian:
    """The beliefs that count, and standard ones for the others, lest these raise an error."""
    standard, counted = torch.eye(belief.dim).to(belief.cov), counted[..., None]
    mean = torch.where(counted, belief.mean, 0.0)
    return Gaussian(mean, torch.where(counted[..., None], belief.cov, standard))
