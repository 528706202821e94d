"""The RBF policy as a TensorDict module: the counterpart of TorchRL's ``RBFController``."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torch_pmil.control.policy import SquashedPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.torchrl_interop import keys


class BeliefPolicy(TensorDictModuleBase):
    r"""An RBF or linear policy on beliefs, with exact moments, or on plain observations.

    From ``("observation", "mean")`` (*batch, D) and ``"var"`` (*batch, D, D) it writes ``("action",
    "mean")`` (*batch, F), ``"var"`` (*batch, F, F) and ``"cross_covariance"``, :math:`\Sigma_x^{-1}
    \operatorname{cov}(x, u)` (*batch, D, F). From a plain ``"observation"``, as in the real
    environment, it writes a plain ``"action"``.

    Args:
        policy: a policy whose inputs are the features of the state.
        space: the state space that gives the features; the state itself if None. With angles, the
            module also writes ``("action", "feature_cross_covariance")``, :math:`\Sigma_f^{-1}
            \operatorname{cov}(f, u)` (*batch, D', F) for features f.

    Raises:
        ValueError: the policy's inputs are not the features of the space.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torch_pmil import RBFPolicy
        >>> network = RBFPolicy(torch.zeros(10, 4), torch.tensor([3.0]), scale=torch.ones(4))
        >>> policy = BeliefPolicy(network)
        >>> belief = TensorDict({"observation": {"mean": torch.zeros(4), "var": torch.eye(4)}})
        >>> policy(belief)["action", "cross_covariance"].shape
        torch.Size([4, 1])
        >>> policy(TensorDict({"observation": torch.zeros(4)}))["action"].shape
        torch.Size([1])
    """

    def __init__(self, policy: SquashedPolicy, space: StateSpace | None = None) -> None:
        super().__init__()
        inputs = policy.num_inputs
        self.policy, self.space = policy, keys.raw_space(inputs) if space is None else space
        if len(self.space.feature_names) != inputs:
            raise ValueError(
                f"the policy must have the inputs {self.space.feature_names}, got {inputs} inputs"
            )
        self.in_keys = list(keys.STATE_BELIEF)
        of_features = [keys.FEATURE_CROSS_COVARIANCE] if self.space.angles else []
        self.out_keys = [*keys.ACTION_BELIEF, *of_features]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, or its belief, into ``tensordict`` and return it.

        Raises KeyError where there is neither a belief nor an observation, and ValueError at an
        entry of another shape.
        """
        state = keys.lookup_belief(tensordict, keys.STATE_BELIEF, self.space.dim)
        if state is None:
            observation = keys.required(tensordict, keys.OBSERVATION, self.space.dim)
            return tensordict.set(keys.ACTION, self.policy(self.space.features(observation)))
        features, feature_slope = self.space.feature_moments(state)
        action, policy_slope = self.policy.controller.on_belief(features)
        written = action.mean, action.cov, feature_slope @ policy_slope, policy_slope
        for key, value in zip(self.out_keys, written, strict=False):
            tensordict.set(key, value)
        return tensordict
