"""A policy of one's own: any module from features to actions, within the actions' range."""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from typing import Self

import torch
from torch import Tensor, nn

from torch_pmil.control.linear_policy import LinearPolicy
from torch_pmil.control.policy import PolicyNetwork
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.lbfgs import minimise

MakeModule = Callable[[int, int], nn.Module]  # from the numbers of features and of actions

FITS = 100  # iterations of L-BFGS by which a module learns given actions


class ModulePolicy(PolicyNetwork):
    r"""Any module whose output is squashed to the range of the actions.

    .. math:: \pi(x) = \bar u + u_{\max} \tanh f(x / s)

    The module f maps features (\*batch, D'), divided by their typical sizes s, to (\*batch, F). So
    its parameters are of order one in any units, as a search by Adam needs them. It has no moments
    in closed form, and is predicted by samples. Its numbers become float64. It stays in evaluation
    mode, without dropout, so that the robot does what was predicted.

    Args:
        module: f.
        scale: s, (D',), in the units of the features.
        u_max: largest distances (F,) of an action from the middle of its range, in its unit.
        u_middle: middles of the actions' ranges (F,).

    Raises:
        TypeError: the module is not a ``torch.nn.Module``, or does not return a tensor.
        ValueError: it has no parameters, or does not take any batch. Or its output has another
            shape, is not finite, is random, or has no gradient.

    Example:
        >>> one = torch.ones(1)
        >>> policy = ModulePolicy(nn.Linear(3, 1), torch.ones(3), u_max=one, u_middle=0 * one)
        >>> policy(torch.zeros(5, 3)).shape
        torch.Size([5, 1])
    """

    def __init__(self, module: nn.Module, scale: Tensor, u_max: Tensor, u_middle: Tensor) -> None:
        if not isinstance(module, nn.Module):
            raise TypeError(f"policy must be a torch.nn.Module, got {type(module).__name__}")
        super().__init__(scale, u_max, u_middle)
        self.module = module.double().eval()
        self._check()

    def train(self, mode: bool = True) -> Self:
        """Change nothing in the module, which stays in evaluation mode."""
        super().train(mode)
        self.module.eval()
        return self

    @property
    def controller(self) -> ModulePolicy:
        """The policy itself, a function of the features."""
        return self

    def forward(self, features: Tensor) -> Tensor:
        """Action (*batch, F) at features of the state (*batch, D')."""
        return self.u_middle + self.u_max * self.module(features.double() / self.scale).tanh()

    def fit_weights(self, features: Tensor, actions: Tensor) -> None:
        """Fit the parameters to given actions (S, F) at features (S, D') by least squares."""
        parameters = [each for each in self.parameters() if each.requires_grad]

        def error() -> Tensor:
            return ((self(features) - actions) / self.u_max).square().mean()

        minimise(parameters, error, FITS)

    def _check(self) -> None:
        """Raise unless the module maps features to actions and can be searched."""
        if not any(parameter.requires_grad for parameter in self.module.parameters()):
            raise ValueError("policy must have parameters to search, got a module without any")
        for batch in ((2,), (), (2, 3)):
            output = self._tried(batch)
            if not output.requires_grad:
                raise ValueError("policy must be differentiable, got actions without a gradient")
            if not torch.equal(output, self._tried(batch)):
                raise ValueError("policy must act alike at the same features, got random actions")

    @torch.enable_grad()
    def _tried(self, batch: tuple[int, ...]) -> Tensor:
        """Output of the module for such a batch, if it is one."""
        features = torch.ones(*batch, self.num_inputs, dtype=torch.float64)
        shape = (*batch, len(self.u_max))
        wanted = f"features {tuple(features.shape)} to {shape}"
        try:
            output = self.module(features)
        except (RuntimeError, TypeError, ValueError, IndexError) as error:
            why = str(error).splitlines()[0]  # PyTorch's, for shapes that do not fit
            raise ValueError(f"policy must map {wanted}, but its call failed: {why}") from error
        if not isinstance(output, Tensor):
            raise TypeError(f"policy must map {wanted}, got a {type(output).__name__}")
        if output.shape != shape:
            raise ValueError(f"policy must map {wanted}, got {tuple(output.shape)}")
        if not output.isfinite().all():
            raise ValueError(f"policy must map {wanted}, got numbers that are not finite")
        return output


def check_maker(make: object) -> None:
    """Raise TypeError unless an object takes the numbers of features and of actions, in that order.

    :class:`LinearPolicy` itself is one too.

    Example:
        >>> check_maker(nn.Linear)
    """
    wanted = (
        "policy must make a torch.nn.Module from the numbers of features and actions, as "
        "torch.nn.Linear does"
    )
    if isinstance(make, nn.Module) or not callable(make):
        raise TypeError(f"{wanted}, got {type(make).__name__}")
    taken = signature(make)
    try:
        if make is not LinearPolicy:
            taken.bind(1, 1)
    except TypeError as error:
        raise TypeError(f"{wanted}, got a function of {taken}: {error}") from error


# how a policy in place of the RBF network is made
MakePolicy = MakeModule | type[LinearPolicy]
AnyPolicy = RBFPolicy | LinearPolicy | ModulePolicy
