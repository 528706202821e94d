"""The settings of the method: how policy, model, exploration, search and ending are chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from torch_pmil.control.exploration import PDMovements
from torch_pmil.control.module_policy import MakePolicy
from torch_pmil.gp.lbfgs import MakeOptimizer
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.promise import LARGEST
from torch_pmil.settings import Settings, setting

OF_FEATURES: dict[str, Any] = {
    "above": 0,
    "words": "numbers, one for each feature of the state",
    "unit": "the unit of the feature",
}


@dataclass(frozen=True, eq=False)
class PolicySettings(Settings):
    """A new policy: Gaussian basis functions at demonstrated states.

    A policy is zero beyond the reach of its functions, so starts at the edge of what was
    demonstrated may need an ``input_scale`` above 1. ``least_widths`` are for demonstrations that
    are slow or move only a part of the robot: they say how far the robot strays from them. None
    stands for the standard deviations of the start.
    """

    num_centres: int = setting(
        100, "basis functions of the policy", least=1, most=10_000, unit="basis functions"
    )
    initial_weight_std: float = setting(
        0.1,
        "standard deviation of a new policy's weights",
        least=0,
        unit="rad, before the squashing",
    )
    input_scale: float = setting(
        1.0,
        "width of a new policy's basis functions: a larger one reaches further",
        above=0,
        unit="standard deviations of the demonstrated features",
    )
    input_widths: Tensor | None = setting(
        None, "the widths themselves, in place of input_scale", **OF_FEATURES
    )
    least_widths: Tensor | None = setting(
        None, "smallest width that input_scale may give", **OF_FEATURES
    )


@dataclass(frozen=True)
class ModelSettings(Settings):
    """The forward model.

    With ``velocities_alone``, positions follow from velocities by a rule with two fitted numbers.
    """

    velocities_alone: bool = setting(
        False, "whether the model learns velocities alone, from which their positions follow"
    )
    tied_lengthscales: bool = setting(
        False, "whether all outputs of the model share lengthscales, which makes predictions faster"
    )


@dataclass(frozen=True)
class RandomMotion(Settings):
    """Exploration by random actions around those that hold the start, if they are known.

    Otherwise they are around the middle of the range. ``explore_demonstrated`` suits actions that
    are targets of servos: they are around those that hold the robot in the mean demonstrated
    states, one after the other, so that the model knows the way from the first motion on.
    """

    random_action: float = setting(
        0.4,
        "how far the random actions of the first motion go",
        above=0,
        most=1,
        unit="half the range of the actions",
    )
    explore_demonstrated: bool = setting(
        False, "whether the first motion follows the demonstrations, around what holds the robot"
    )


@dataclass(frozen=True)
class EndingSettings(Settings):
    """When a run ends: the model that learned from the last own rollout predicts the promise.

    More confirmations suit a success that is a lenient measure, or that cannot be predicted.
    """

    promise: float = setting(
        0.95,
        "success rate from fresh starts that a finished run promises: a lower one ends sooner",
        above=0,
        most=LARGEST,
        unit="fresh starts",
    )
    confirmations: int = setting(
        1,
        "successes in a row of own rollouts without which no run ends",
        least=1,
        unit="own rollouts",
    )


@dataclass(frozen=True, eq=False)
class Method(Settings):
    """How a task is learned: the settings of each part of the method.

    ``optimizer`` is that of the policy search, see :func:`~torch_pmil.gp.lbfgs.minimise`.
    ``make_policy`` makes a module of a user's own from the numbers of features and of actions, in
    place of the RBF network, or is :class:`~torch_pmil.control.linear_policy.LinearPolicy`.
    ``own_model`` is a forward model of a user's own
    (:class:`~torch_pmil.model.own_dynamics.OwnDynamics`), in place of the GPs.

    Example:
        >>> Method(policy=PolicySettings(num_centres=50)).adjustable["num_centres"]
        50
    """

    policy: PolicySettings = field(default_factory=PolicySettings)
    model: ModelSettings = field(default_factory=ModelSettings)
    exploration: RandomMotion | PDMovements = field(default_factory=RandomMotion)
    search: SearchSettings = field(default_factory=SearchSettings)
    ending: EndingSettings = field(default_factory=EndingSettings)
    optimizer: MakeOptimizer = torch.optim.LBFGS
    make_policy: MakePolicy | None = None
    own_model: Any = None


# a position follows from its velocity, so that nothing is learned twice, with half the computing;
# where joints hang on springs, as the BioRob's do, it does not follow exactly enough
VELOCITIES = ModelSettings(velocities_alone=True)
# what is sure is followed, and where nothing is sure to the end, samples lead: the robots of the
# package learn sooner with one or both, except those that need a match followed step by step
SURE = SearchSettings(trust_threshold=0.15, trust_what_is_sure=True)
ON_SAMPLES = replace(SURE, sample_steps=500)


def with_least_widths(widths: Sequence[float], num_centres: int = 100, **parts: Any) -> Method:
    """A method whose new policies have so many basis functions of at least these widths.

    ``parts`` are its other settings.
    """
    least = torch.tensor(widths, dtype=torch.float64)
    return Method(PolicySettings(num_centres=num_centres, least_widths=least), **parts)
