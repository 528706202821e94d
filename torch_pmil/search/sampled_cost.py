"""The expected cost by any function of states and actions, by samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

import torch
from torch import Tensor

from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.model.sampled_rollouts import SampledPrediction
from torch_pmil.search.expected_cost import ExpectedCost
from torch_pmil.search.trajectory_loss import LossOptions, Reduction

CostFunction = Callable[[Tensor, Tensor], Tensor]


class ExpectedSampledCost(ExpectedCost):
    r"""Mean over sampled trajectories of a cost function, summed over the horizon: ``"loss_cost"``.

    .. math:: \sum_{t=1}^T \mathbb E\left[c(x_t, u_{t-1})\right]

    Args:
        actor_network, dynamics, space, reduction: as in :class:`TrajectoryLoss`.
        cost: of states x_1..x_T, (\*batch, T, D), and the actions that led to them, (\*batch, T,
            F): costs (\*batch, T), differentiable in both.
        horizon: T, number of steps after the start.
        prediction: by which trajectories are sampled; ``SampledPrediction()`` if None.

    Raises:
        ValueError: the horizon or the reduction is not as it must be. When called: the costs have
            another shape, are no numbers or have no gradient.
        TypeError: when called: the cost function does not return a tensor.

    Example:
        >>> from torch_pmil import GPDynamics, RBFPolicy, joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> policy = RBFPolicy(torch.zeros(3, 1), torch.ones(1), torch.ones(1))
        >>> dynamics = GPDynamics(2, 1)
        >>> dynamics.set_data(torch.eye(2), torch.zeros(2, 1))
        >>> effort = lambda states, actions: actions.square().sum(-1)
        >>> loss = ExpectedSampledCost(policy, dynamics, space, effort, horizon=5)
        >>> loss.per_step(Gaussian(torch.zeros(1).double(), torch.eye(1).double()))
        tensor([0., 0., 0., 0., 0.], dtype=torch.float64, grad_fn=...)
    """

    prediction: SampledPrediction

    def __init__(
        self,
        actor_network: AnyPolicy,
        dynamics: ForwardModel,
        space: StateSpace,
        cost: CostFunction,
        horizon: int,
        reduction: Reduction = "mean",
        prediction: SampledPrediction | None = None,
    ) -> None:
        options: LossOptions = {"reduction": reduction, "prediction": prediction}
        super().__init__(actor_network, dynamics, space, horizon, **options)
        self.cost = cost

    @property
    def has_moments(self) -> bool:
        """False: no expectation of the cost is known in closed form."""
        return False

    def per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """Expected cost of each step up to a horizon, (*batch, horizon)."""
        (start, policy), steps = self.begin(initial), self._steps(horizon)
        states = self.prediction.rollouts(start, policy, self.dynamics, self.space, steps)
        costs = self.sample_costs(states).mean(0)
        if self._penalty is None:
            return costs
        return costs + self._penalty(self.predict_states(initial, steps))

    def sample_costs(self, states: Tensor) -> Tensor:
        r"""Costs (N, \*batch, T) of sampled trajectories x_0..x_T, (N, \*batch, T + 1, D)."""
        actions = self.actor_network(self.space.features(states[..., :-1, :]))
        costs = self.cost(states[..., 1:, :], actions)
        wanted = tuple(actions.shape[:-1])
        if not isinstance(costs, Tensor):
            raise TypeError(f"cost must return a tensor {wanted}, got {type(costs).__name__}")
        if costs.shape != wanted:
            raise ValueError(
                f"cost must return {wanted} for states {tuple(states[..., 1:, :].shape)} and "
                f"actions {tuple(actions.shape)}, got {tuple(costs.shape)}"
            )
        if actions.requires_grad and not costs.requires_grad:
            raise ValueError(
                "cost must be differentiable in states or actions, got numbers without a gradient"
            )
        self._check_numbers(costs, states[..., 1:, :])
        return costs

    def _check_numbers(self, costs: Tensor, states: Tensor) -> None:
        """Raise ValueError if a cost is not a number at a finite state (*batch, D)."""
        wrong = costs.isnan() & states.isfinite().all(-1)
        if wrong.any():
            values = zip(self.space.names, states[wrong][0].tolist(), strict=True)
            where = ", ".join(f"{name} = {value:.4g}" for name, value in values)
            raise ValueError(f"cost must be a number at every state, got nan at {where}")

    def _costs(self, observed: Gaussian) -> NoReturn:
        raise NotImplementedError(
            "a cost function has no expectation in closed form: call the loss, which samples"
        )

    def _mean_costs(self, observed: Tensor) -> NoReturn:
        self._costs(Gaussian(observed, torch.diag_embed(0 * observed)))
