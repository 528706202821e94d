"""New policies: an RBF network near given inputs, linear feedback, or a module of a user's own."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.linear_policy import LinearPolicy
from torch_pmil.control.module_policy import AnyPolicy, MakeModule, MakePolicy, ModulePolicy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.seeds import draw_seed
from torch_pmil.tasks.method import PolicySettings


def new_policy(
    make: MakePolicy | None,
    settings: PolicySettings,
    actions: ActionSpace,
    inputs: Tensor,
    spread: Tensor,
    widths: Tensor,
    generator: torch.Generator,
) -> AnyPolicy:
    """A policy drawn from a generator.

    Args:
        make: what makes a module, or the class of a linear policy; None for an RBF network.
        settings: number of basis functions and size of the weights.
        actions: range of the actions.
        inputs: near which the network's centres are, (S, D').
        spread: typical distances of inputs, (D',).
        widths: of the network's basis functions, (D',).
        generator: source of the draws.
    """
    if make is None:
        return _network(settings, actions, inputs, spread, widths, generator)
    if make is LinearPolicy:
        return _linear(settings, actions, spread, generator)
    return _of_module(cast(MakeModule, make), actions, spread, draw_seed(generator))


def name_of(make: MakePolicy, actions: ActionSpace, inputs: int) -> str:
    """What a policy of so many inputs is, that is no RBF network, as a run's settings hold it."""
    if make is LinearPolicy:
        return LinearPolicy.__name__
    ones = torch.ones(inputs, dtype=torch.float64)
    return str(_of_module(cast(MakeModule, make), actions, ones, 0).module)


def _network(
    settings: PolicySettings,
    actions: ActionSpace,
    inputs: Tensor,
    spread: Tensor,
    widths: Tensor,
    generator: torch.Generator,
) -> RBFPolicy:
    """An RBF network with centres near some of the inputs and small random weights."""
    count = settings.num_centres
    chosen = torch.randint(len(inputs), (count,), generator=generator)
    jitter = torch.randn(count, len(spread), dtype=torch.float64, generator=generator)
    centres = inputs[chosen] + 0.1 * spread * jitter
    policy = RBFPolicy(centres, actions.half_range, widths, actions.middle)
    white = torch.randn(policy.weights.shape, dtype=torch.float64, generator=generator)
    policy.weights.data.copy_(settings.initial_weight_std * white)
    return policy


def _linear(
    settings: PolicySettings, actions: ActionSpace, scale: Tensor, generator: torch.Generator
) -> LinearPolicy:
    """A linear policy with small random gains."""
    policy = LinearPolicy(scale, actions.half_range, actions.middle)
    white = torch.randn(policy.gains.shape, dtype=torch.float64, generator=generator)
    policy.gains.data.copy_(settings.initial_weight_std * white)
    return policy


def _of_module(make: MakeModule, actions: ActionSpace, scale: Tensor, seed: int) -> ModulePolicy:
    """A policy by a module, made under a seed of PyTorch's generator."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        module = make(len(scale), len(actions.names))
    return ModulePolicy(module, scale, actions.half_range, actions.middle)
