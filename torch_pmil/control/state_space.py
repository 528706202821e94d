"""Meaning of a state's entries: features, which models see, and match space of trajectories."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torch_pmil.checks import check_finite_entries, check_real, check_tensor
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.trigonometry import Augmentation


@dataclass(frozen=True, eq=False)
class MatchSpace:
    r"""The space in which demonstrations were observed.

    .. math:: z = B\,[x, \sin(Ax), \cos(Ax)]

    Args:
        names, units: one for each of the M observed entries.
        angles: A, (K, D), rad.
        weights: B, (M, D + 2K).

    Raises:
        TypeError: angles or weights are not tensors.
        ValueError: there is no entry, a name comes twice, shapes do not fit, or a number is not
            finite.

    Example:
        >>> weights = torch.tensor([[0.0, 0.5, 0.0], [0.0, 0.0, 0.5]])
        >>> tip = MatchSpace(("x", "y"), ("m", "m"), torch.ones(1, 1), weights)
        >>> tip(torch.zeros(1))
        tensor([0.0000, 0.5000])
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    angles: Tensor
    weights: Tensor

    def __post_init__(self) -> None:
        _check_names(self.names)
        check_real("angles", self.angles)
        check_real("weights", self.weights)
        if self.angles.ndim != 2:  # K may be zero
            raise ValueError(f"angles must have shape (K, D), got {tuple(self.angles.shape)}")
        entries = len(self.names), 2 * self.angles.shape[0] + self.angles.shape[1]
        if len(self.units) != len(self.names) or self.weights.shape != entries:
            found = f"{tuple(self.weights.shape)} and {len(self.units)}"
            wanted = f"{entries} and units {len(self.names)} entries"
            raise ValueError(f"weights must have shape {wanted}, got {found}")
        check_finite_entries("angles", self.angles)
        check_finite_entries("weights", self.weights)

    @classmethod
    def of_entries(
        cls, names: Sequence[str], state: Sequence[str], units: Sequence[str] = ()
    ) -> MatchSpace:
        """Some of the entries of the state, as they are; ValueError if there is no such entry.

        Example:
            >>> MatchSpace.of_entries(("q",), state=("q", "dq"))(torch.tensor([1.0, 2.0]))
            tensor([1.])
        """
        if unknown := [name for name in names if name not in state]:
            raise ValueError(
                f"names must be entries of the state {', '.join(state)}, got {', '.join(unknown)}"
            )
        chosen = torch.eye(len(state), dtype=torch.float64)[[state.index(name) for name in names]]
        without_angles = torch.zeros(0, len(state), dtype=torch.float64)
        return cls(tuple(names), tuple(units) or ("",) * len(names), without_angles, chosen)

    @classmethod
    def of_links(
        cls,
        angles: Sequence[str],
        lengths: Sequence[float],
        state: Sequence[str],
        zero: float = 0.0,
        names: Sequence[str] = (),
    ) -> MatchSpace:
        r"""Positions of the ends of the links of an arm in a plane.

        .. math::
            x_k = \sum_{i \le k} l_i \sin(q_1 + \dots + q_i), \quad
            y_k = \sum_{i \le k} l_i \cos(q_1 + \dots + q_i)

        Args:
            angles: names of the joints' angles from base to tip, each (rad) from the link before,
                the first from upwards.
            lengths: of the links, m.
            state: names of the D entries of the state.
            zero: direction (rad from upwards) of the first link at angle 0; pi if it hangs.
            names: of the coordinates; x1, y1, x2, ... if empty.

        Raises:
            ValueError: there are not as many lengths, or an angle is not an entry of the state.

        Example:
            >>> state = ("q1", "dq1", "q2", "dq2")
            >>> two = MatchSpace.of_links(("q1", "q2"), (0.5, 0.5), state)
            >>> two(torch.zeros(4, dtype=torch.float64))
            tensor([0.0000, 0.5000, 0.0000, 1.0000], dtype=torch.float64)
        """
        K = len(angles)
        if len(lengths) != K:
            raise ValueError(f"lengths must be those of the {K} links, got {len(lengths)}")
        joints = cls.of_entries(angles, state).weights
        down_the_arm = torch.ones(K, K, dtype=torch.float64).tril()
        links = down_the_arm * torch.as_tensor(lengths, dtype=torch.float64)
        along, across = math.cos(zero) * links, math.sin(zero) * links
        x, y = torch.cat([along, across], -1), torch.cat([-across, along], -1)
        weights = torch.stack([x, y], 1).flatten(0, 1)  # rows x1, y1, x2, ...
        known = tuple(names) or tuple(f"{axis}{k}" for k in range(1, K + 1) for axis in "xy")
        of_state = torch.zeros(2 * K, len(state), dtype=torch.float64)
        return cls(known, ("m",) * 2 * K, down_the_arm @ joints, torch.cat([of_state, weights], -1))

    @property
    def dim(self) -> int:
        """Number of observed entries M."""
        return len(self.names)

    def __call__(self, states: Tensor) -> Tensor:
        """Observations (*batch, M) of states (*batch, D)."""
        check_tensor("states", states, ("*batch", self.angles.shape[-1]), finite=False)
        angles = states @ self.angles.to(states).mT
        return torch.cat([states, angles.sin(), angles.cos()], -1) @ self.weights.to(states).mT

    def slopes(self, states: Tensor) -> Tensor:
        """Derivatives (*batch, M, D) of the observations by the states (*batch, D)."""
        of_angles, weights = self.angles.to(states), self.weights.to(states)
        K, D = of_angles.shape
        plain, of_sines, of_cosines = weights.split([D, K, K], -1)
        angles = (states @ of_angles.mT)[..., None, :]
        return plain + (of_sines * angles.cos() - of_cosines * angles.sin()) @ of_angles

    def moments(self, state: Gaussian) -> Gaussian:
        """Exact mean and covariance of the observation of an uncertain state."""
        return self.augmentation.to(state.mean)(state)[0].affine(self.weights.to(state.mean))

    @cached_property
    def augmentation(self) -> Augmentation:
        """The map to the state, its sines and cosines."""
        plain = torch.eye(self.angles.shape[-1], dtype=torch.float64)
        return Augmentation.of(plain, self.angles.double())


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A robot's state: names and units of its D entries, which are angles, and its match space.

    Models and policies see D' = D + number of angles features: sin and cos in place of each angle.

    Args:
        names, units: one for each entry.
        angles: indices of the entries that are angles (rad) and wrap around.
        match_space: the space in which predictions are compared with demonstrations.

    Raises:
        ValueError: there is no entry, a name comes twice, sizes do not fit, or angles are not
            different indices.

    Example:
        >>> names, units = ("q", "dq"), ("rad", "rad/s")
        >>> space = StateSpace(names, units, (0,), joint_match(names, units))
        >>> space.feature_names
        ('dq', 'sin q', 'cos q')
        >>> space.features(torch.zeros(2))
        tensor([0., 0., 1.])
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    angles: tuple[int, ...]
    match_space: MatchSpace

    def __post_init__(self) -> None:
        _check_names(self.names)
        matched = self.match_space.angles.shape[-1]
        if len(self.units) != self.dim or matched != self.dim:
            raise ValueError(
                f"units and the match space must be for the {self.dim} entries of {self.names}, "
                f"got {len(self.units)} units and a match space of {matched}"
            )
        indices = isinstance(self.angles, tuple | list) and {type(i) for i in self.angles} <= {int}
        if not indices or not set(self.angles) <= set(range(self.dim)):
            raise ValueError(f"angles must be indices below {self.dim}, got {self.angles}")
        if len(set(self.angles)) < len(self.angles):
            raise ValueError(f"angles must be different indices, got {self.angles}")

    @property
    def dim(self) -> int:
        """Number of entries D."""
        return len(self.names)

    @property
    def plain(self) -> tuple[int, ...]:
        """Indices of the entries that are not angles."""
        return tuple(i for i in range(self.dim) if i not in self.angles)

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the D' entries that models and policies see."""
        sines, cosines = ([f"{f} {self.names[i]}" for i in self.angles] for f in ("sin", "cos"))
        return (*(self.names[i] for i in self.plain), *sines, *cosines)

    def observe(self, states: Tensor) -> Tensor:
        """Observations (*batch, M) of states (*batch, D) in the match space."""
        return self.match_space(states)

    def features(self, states: Tensor) -> Tensor:
        """Features (*batch, D') of states (*batch, D)."""
        check_tensor("states", states, ("*batch", self.dim), finite=False)
        selected = states @ self.augmentation.to(states).rows.mT
        sizes = [len(self.plain), len(self.angles), len(self.angles)]
        plain, for_sine, for_cosine = selected.split(sizes, -1)
        return torch.cat([plain, for_sine.sin(), for_cosine.cos()], -1)

    def states(self, features: Tensor) -> Tensor:
        """States (*batch, D) of features (*batch, D'), with each angle within half a turn.

        Example:
            >>> space = StateSpace(("q",), ("rad",), (0,), joint_match(("q",), ("rad",)))
            >>> round(space.states(space.features(torch.tensor([1.0]))).item(), 6)
            1.0
        """
        sizes = [len(self.plain), len(self.angles), len(self.angles)]
        plain, sines, cosines = features.split(sizes, -1)
        in_order = torch.cat([plain, torch.atan2(sines, cosines)], -1)
        return in_order[..., torch.argsort(torch.tensor((*self.plain, *self.angles)))]

    def feature_moments(self, state: Gaussian) -> tuple[Gaussian, Tensor]:
        """Exact moments of the features, and Sigma_x^-1 cov(x, features), (*batch, D, D')."""
        return self.augmentation.to(state.mean)(state)

    @cached_property
    def augmentation(self) -> Augmentation:
        """The map from a state to its features."""
        identity = torch.eye(self.dim, dtype=torch.float64)
        return Augmentation.of(identity[list(self.plain)], identity[list(self.angles)])


def with_unit(name: str, unit: str | None) -> str:
    """A name with its unit, if there is one, as in "x (m)"."""
    return f"{name} ({unit})" if unit else name


def _check_names(names: tuple[str, ...]) -> None:
    if not names:
        raise ValueError("names must be those of one entry at least, got none")
    if len(set(names)) < len(names):
        raise ValueError(f"names must be different, got {names}")


def joint_match(names: tuple[str, ...], units: tuple[str, ...]) -> MatchSpace:
    """Match space that is the state itself."""
    return MatchSpace(names, units, torch.zeros(0, len(names)), torch.eye(len(names)))
