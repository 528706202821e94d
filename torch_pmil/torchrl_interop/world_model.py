"""The counterpart of TorchRL's ``GPWorldModel``, with its constructor, keys and ``fit``."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor

from torch_pmil.checks import check_whole
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian, joint
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.experience import gp_data
from torch_pmil.model.forward_model import FitResult, Targets, known_part
from torch_pmil.model.rollout import successor_belief
from torch_pmil.torchrl_interop import keys


class GPWorldModel(TensorDictModuleBase):
    r"""GP model of x_{t+1} - x_t given state and action (Eqs. 2-7), as a TensorDict module.

    :meth:`forward` reads a belief over state and action and writes the belief over the next state,
    by exact moment matching (Eqs. 13-18) and with the model's noise (Eq. 5). Beliefs without
    ``var`` are certain. For a plain ``"observation"`` (*batch, D) and ``"action"`` (*batch, F) it
    writes the mean of ``("next", "observation")``. Both are differentiable, in float64.

    Args:
        obs_dim: number D of entries of the state.
        action_dim: number F of entries of the action.
        in_keys: keys of the action's mean (*batch, F), its covariance (*batch, F, F),
            :math:`\Sigma_x^{-1} \operatorname{cov}(x, u)` (*batch, D, F), the state's mean (*batch,
            D) and its covariance (*batch, D, D), in this order; optionally :math:`\Sigma_f^{-1}
            \operatorname{cov}(f, u)` (*batch, D', F) for features f, without which x and u are
            taken as jointly Gaussian.
        out_keys: keys of the next state's mean (*batch, D) and covariance (*batch, D, D).
        space: the state space that gives the features; the state itself if None.
        targets: what is learned, as in :class:`GPDynamics`.

    Raises:
        ValueError: the space, the known part or the number of keys does not fit.

    Example:
        >>> from tensordict import TensorDict
        >>> x = torch.linspace(-1, 1, 20)[:, None]
        >>> u = torch.linspace(1, -1, 20).square()[:, None]
        >>> model = GPWorldModel(obs_dim=1, action_dim=1)
        >>> after = {"observation": x + u / 10}
        >>> _ = model.fit(TensorDict({"observation": x, "action": u, "next": after}, [20]))
        >>> certain = TensorDict({"observation": torch.zeros(1), "action": torch.zeros(1)})
        >>> bool(model(certain)["next", "observation"].abs() < 1e-2)
        True
        >>> state = {"mean": torch.zeros(1), "var": torch.eye(1) / 100}
        >>> belief = TensorDict({"observation": state, "action": {"mean": torch.zeros(1)}})
        >>> model(belief)["next", "observation", "var"].shape
        torch.Size([1, 1])
    """

    def __init__(
        self,
        obs_dim: int,
        action_dim: int,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
        space: StateSpace | None = None,
        targets: Targets = "difference",
    ) -> None:
        super().__init__()
        check_whole("obs_dim", obs_dim, 1)
        check_whole("action_dim", action_dim, 1)
        self.space = keys.raw_space(obs_dim) if space is None else space
        if self.space.dim != obs_dim:
            found = f"the {self.space.dim} of {self.space.names}"
            raise ValueError(f"space must have obs_dim = {obs_dim} entries, got {found}")
        self.obs_dim, self.action_dim = obs_dim, action_dim
        self.num_features = len(self.space.feature_names)
        of_features = [keys.FEATURE_CROSS_COVARIANCE] if self.space.angles else []
        default = [*keys.ACTION_BELIEF, *keys.STATE_BELIEF, *of_features]
        self.in_keys = list(default if in_keys is None else in_keys)
        self.out_keys = list(keys.NEXT_BELIEF if out_keys is None else out_keys)
        if len(self.in_keys) not in (5, 6) or len(self.out_keys) != 2:
            found = f"{len(self.in_keys)} and {len(self.out_keys)}"
            raise ValueError(f"expected five or six in_keys and two out_keys, got {found}")
        known = known_part(targets, obs_dim).for_actions(action_dim)
        if known.dim != obs_dim:
            raise ValueError(f"targets must be of {obs_dim} entries, got those of {known.dim}")
        self.dynamics = GPDynamics(self.num_features + action_dim, known.num_outputs, known)

    def fit(self, dataset: TensorDictBase) -> FitResult:
        """Learn from transitions, with keys observation, action and (next, observation).

        Raises:
            KeyError: a key is missing.
            ValueError: shapes do not fit, an entry is not finite, or fewer than two transitions.
        """
        entries = keys.OBSERVATION, keys.ACTION, keys.NEXT_OBSERVATION
        sizes = self.obs_dim, self.action_dim, self.obs_dim
        states, actions, successors = (
            keys.required(dataset, key, size).detach().flatten(0, -2)
            for key, size in zip(entries, sizes, strict=True)
        )
        self.dynamics.fit_known_part(states, successors)
        known = self.dynamics.targets
        return self.dynamics.fit(*gp_data(states, actions, successors, self.space, known))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the next state, or its belief, into ``tensordict`` and return it.

        Raises:
            RuntimeError: the model has no data.
            KeyError: the action or the observation is missing.
            ValueError, NotPositiveDefiniteError: an entry has another shape, or is no covariance.
        """
        state = keys.lookup_belief(tensordict, self.in_keys[3:5], self.obs_dim)
        if state is None:
            return tensordict.set(keys.NEXT_OBSERVATION, self._successor(tensordict))
        successor = self._successor_belief(state, tensordict)
        return tensordict.set(self.out_keys[0], successor.mean).set(self.out_keys[1], successor.cov)

    def _successor(self, tensordict: TensorDictBase) -> Tensor:
        state = keys.required(tensordict, keys.OBSERVATION, self.obs_dim)
        action = keys.required(tensordict, keys.ACTION, self.action_dim)
        inputs = torch.cat([self.space.features(state), action], -1)
        known = self.dynamics.known_part(self.space)
        return known.successors(state, action, self.dynamics.expansion.mean(inputs))

    def _successor_belief(self, state: Gaussian, tensordict: TensorDictBase) -> Gaussian:
        action = keys.lookup_belief(tensordict, self.in_keys[:2], self.action_dim)
        if action is None:
            raise KeyError(f"expected {self.in_keys[0]}, got the keys {keys.keys_of(tensordict)}")
        slope = keys.lookup(tensordict, self.in_keys[2], (self.obs_dim, self.action_dim))
        slope = state.cov.new_zeros(*state.mean.shape, self.action_dim) if slope is None else slope
        features, feature_slope = self.space.feature_moments(state)
        cross_cov = self._feature_cross_cov(features, tensordict)
        if cross_cov is None:
            cross_cov = feature_slope.mT @ state.cov @ slope
        inputs = joint(features, action, cross_cov)
        moments = moment_match(self.dynamics.expansion, inputs, observation_noise=True)
        input_slope = torch.cat([feature_slope, slope], -1)
        known = self.dynamics.known_part(self.space)
        return successor_belief(state, inputs, input_slope, moments, known)

    def _feature_cross_cov(self, features: Gaussian, tensordict: TensorDictBase) -> Tensor | None:
        """Covariance cov(f, u), (*batch, D', F), or None if it is not given."""
        if len(self.in_keys) < 6:
            return None
        slope = keys.lookup(tensordict, self.in_keys[5], (self.num_features, self.action_dim))
        return None if slope is None else features.cov @ slope
