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
    if make is LinearPolicy:
        linear = LinearPolicy(spread, actions.half_range, actions.middle)
        _draw(linear.gains, settings, generator)
        return linear
    if make is not None:
        return _of_module(cast(MakeModule, make), actions, spread, draw_seed(generator))
    count = settings.num_centres
    chosen = torch.randint(len(inputs), (count,), generator=generator)
    jitter = torch.randn(count, len(spread), dtype=torch.float64, generator=generator)
    centres = inputs[chosen] + 0.1 * spread * jitter
    network = RBFPolicy(centres, actions.half_range, widths, actions.middle)
    _draw(network.weights, settings, generator)
    return network


def name_of(make: MakePolicy, actions: ActionSpace, inputs: int) -> str:
    """How a run's settings name a policy with ``inputs`` inputs that is not an RBF network."""
    if make is LinearPolicy:
        return LinearPolicy.__name__
    ones = torch.ones(inputs, dtype=torch.float64)
    return str(_of_module(cast(MakeModule, make), actions, ones, 0).module)


def _draw(weights: Tensor, settings: PolicySettings, generator: torch.Generator) -> None:
    """Draw small random weights in place."""
    white = torch.randn(weights.shape, dtype=torch.float64, generator=generator)
    weights.data.copy_(settings.initial_weight_std * white)


def _of_module(make: MakeModule, actions: ActionSpace, scale: Tensor, seed: int) -> ModulePolicy:
    """A policy by a module, made under a seed of PyTorch's generator."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        module = make(len(scale), len(actions.names))
    return ModulePolicy(module, scale, actions.half_range, actions.middle)
