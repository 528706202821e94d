"""The known linear part of a robot's dynamics; a model learns the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import pad

from torch_pmil.checks import check_positive, check_tensor, check_whole

# weight of the trapezoidal rule over that of the data: it counts where nothing moves
RULE_RIDGE = 1e-6
# share of a joint's travel by which it may be off the rule, and the least share of transitions that
# keep within it, for the others to be left out
OFF, MOST = 0.1, 1 / 3
HASTY = 2.0  # change of speed, in the mean one, from which a transition counts less


@dataclass(frozen=True, eq=False)
class KnownPart:
    r"""What is known of the next state, given state, action and the learned function g.

    .. math:: x_{t+1} = A\,[x_t, u_t] + C\,g(x_t, u_t)

    A model learns the E outputs of g, at most as many as the state has entries: positions may
    follow from velocities. Each output is added to an entry of its own, as it is.

    Args:
        matrix: A, (D, D + F); (D, D) fits any number of actions, which then have no known effect.
        gain: C, (D, E).
        learned: index of the own entry of each output, E; these rows of C are the identity.
        followed: P pairs of indices, of a position and the velocity from which it follows.

    Raises:
        TypeError: a matrix is not a tensor.
        ValueError: shapes do not fit, a number is not finite, or ``learned`` does not fit C.

    Example:
        >>> known = KnownPart.of_velocities(["q", "dq"], {"q": "dq"}, num_actions=1, time_step=0.1)
        >>> known.matrix
        tensor([[1.0000, 0.1000, 0.0000],
                [0.0000, 1.0000, 0.0000]], dtype=torch.float64)
        >>> x, u = torch.tensor([[0.0, 1.0]]), torch.zeros(1, 1)
        >>> known.targets(x, u, torch.tensor([[0.2, 3.0]]))
        tensor([[2.]])
        >>> known.successors(x, u, torch.tensor([[2.0]]))
        tensor([[0.2000, 3.0000]])
    """

    matrix: Tensor
    gain: Tensor
    learned: tuple[int, ...]
    followed: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        check_tensor("gain", self.gain, ("D", "E"))
        D, E = self.gain.shape
        check_tensor("matrix", self.matrix, (D, "D + F"))
        if self.num_actions < 0:
            raise ValueError(
                f"matrix must have a column for each of the {D} entries of the state, got "
                f"{self.matrix.shape[-1]}"
            )
        own = self.gain[list(self.learned)] if set(self.learned) <= set(range(D)) else None
        if own is None or not torch.equal(own, torch.eye(E, dtype=own.dtype)):
            raise ValueError(
                f"learned must be {E} entries of the state whose rows of gain are the identity, "
                f"got {self.learned}"
            )

    @classmethod
    def of_differences(cls, dim: int) -> KnownPart:
        r"""All D entries change by what is learned, :math:`x_{t+1} = x_t + g(x_t, u_t)`."""
        identity = torch.eye(dim, dtype=torch.float64)
        return cls(identity, identity, tuple(range(dim)))

    @classmethod
    def of_successors(cls, dim: int) -> KnownPart:
        r"""Nothing is known: :math:`x_{t+1} = g(x_t, u_t)`."""
        identity = torch.eye(dim, dtype=torch.float64)
        return cls(torch.zeros_like(identity), identity, tuple(range(dim)))

    @classmethod
    def of_velocities(
        cls,
        names: Sequence[str],
        velocities: Mapping[str, str],
        num_actions: int,
        time_step: float,
    ) -> KnownPart:
        r"""Positions follow from velocities; of all other entries the differences are learned.

        .. math:: q_{t+1} = q_t + \Delta t \, (\dot q_t + \dot q_{t+1}) / 2

        The error of this trapezoidal rule is :math:`\Delta t^3 / 12` times the change of the
        acceleration in a second. Where a servo changes a joint's speed within one period,
        :meth:`fitted_rule` is better.

        Args:
            names: of the D entries of the state.
            velocities: name of the velocity of each position that is not learned.
            num_actions: F.
            time_step: control period, s.

        Raises:
            ValueError: a name is not an entry, or a velocity follows from another one.
        """
        time_step = check_positive("time_step", time_step)
        check_whole("num_actions", num_actions, 1)
        index = {name: number for number, name in enumerate(names)}
        unknown = [name for pair in velocities.items() for name in pair if name not in index]
        if unknown or set(velocities) & set(velocities.values()):
            raise ValueError(
                f"velocities must be entries of {', '.join(names)} that are learned, for others of "
                f"them, got {dict(velocities)}"
            )
        learned = tuple(number for name, number in index.items() if name not in velocities)
        followed = tuple((index[position], index[rate]) for position, rate in velocities.items())
        identity = torch.eye(len(names), dtype=torch.float64)
        known = cls(pad(identity, (0, num_actions)), identity[:, list(learned)], learned, followed)
        return known.with_rule(torch.full((len(followed), 2), time_step / 2, dtype=torch.float64))

    @classmethod
    def of_readings(cls, shift: Tensor, gain: Tensor, measured: Sequence[int]) -> KnownPart:
        r"""The measured entries y change by what is learned; the rest of the state follows.

        .. math:: x_{t+1} = S\,[x_t, u_t] + C\,(y_t + g(x_t, u_t))

        S is ``shift`` (D, D + F), and ``measured`` the indices of the E entries y.
        """
        matrix = shift.clone()
        matrix[:, list(measured)] += gain
        return cls(matrix, gain, tuple(measured))

    @property
    def rule(self) -> Tensor:
        r"""Numbers a and b (P, 2), s, of :math:`q' = q + a \dot q + b \dot q'` for each position.

        Both are half the control period by the trapezoidal rule.
        """
        rows, rates = ([pair[end] for pair in self.followed] for end in (0, 1))
        b = self.gain[rows, [self.learned.index(rate) for rate in rates]]
        return torch.stack([self.matrix[rows, rates] - b, b], -1)

    def with_rule(self, rule: Tensor) -> KnownPart:
        """The same with another rule (P, 2)."""
        check_tensor("rule", rule, (len(self.followed), 2))
        matrix, gain = self.matrix.clone(), self.gain.clone()
        for (row, rate), (a, b) in zip(self.followed, rule.to(matrix), strict=True):
            matrix[row, rate], gain[row, self.learned.index(rate)] = a + b, b
        return replace(self, matrix=matrix, gain=gain)

    def fitted_rule(self, states: Tensor, successors: Tensor) -> Tensor:
        r"""The rule (P, 2) from transitions (n, D), near the present one.

        It is exact for a linear servo with held targets: :math:`q'` and :math:`\dot q'` are linear
        in q, :math:`\dot q` and the target, which can be eliminated. Where the present rule, mostly
        the trapezoidal one, holds at all, transitions that are far off are left out: a joint turned
        back between the readings, or met a stop. The others count less the more the speed changed.
        The rule of a robot that once tumbled is thus that of its calmer motions.
        """
        numbers = []
        for (row, rate), before in zip(self.followed, self.rule, strict=True):
            speeds = torch.stack([states[:, rate], successors[:, rate]], -1)
            left = successors[:, row] - states[:, row] - speeds @ before
            way = speeds.abs() @ before.abs()
            kept = left.abs() <= OFF * way.clamp(min=OFF * way.mean())
            if kept.double().mean() >= MOST:
                speeds, left = speeds[kept], left[kept]
            numbers.append(before + _explained(speeds, left))
        return torch.stack(numbers)

    def for_actions(self, num_actions: int) -> KnownPart:
        """The same with a column for each of F actions; ValueError if it is for another number."""
        if self.num_actions == num_actions:
            return self
        if self.num_actions:
            raise ValueError(
                f"the known part must be of the {num_actions} actions, got one of "
                f"{self.num_actions}"
            )
        return _for_actions(self, num_actions)

    @property
    def dim(self) -> int:
        """Number of entries of the state D."""
        return self.gain.shape[0]

    @property
    def num_outputs(self) -> int:
        """Number of learned outputs E."""
        return self.gain.shape[1]

    @property
    def num_actions(self) -> int:
        """Number of actions F, or 0 for any."""
        return self.matrix.shape[-1] - self.dim

    @property
    def uncertain(self) -> Tensor:
        """Whether anything is learned of each entry of the state, bool, (D,)."""
        return self.gain.any(-1)

    def targets(self, states: Tensor, actions: Tensor, successors: Tensor) -> Tensor:
        """Outputs g (*batch, E) that explain x_t, x_{t+1} (*batch, D) and u_t (*batch, F)."""
        return (successors - self._expected(states, actions))[..., list(self.learned)]

    def successors(self, states: Tensor, actions: Tensor, outputs: Tensor) -> Tensor:
        """x_{t+1} (*batch, D) of x_t (*batch, D), u_t (*batch, F) and g (*batch, E)."""
        return self._expected(states, actions) + outputs @ self.gain.to(outputs).mT

    def _expected(self, states: Tensor, actions: Tensor) -> Tensor:
        matrix = self.for_actions(actions.shape[-1]).matrix
        return torch.cat([states, actions], -1) @ matrix.to(states).mT


@lru_cache(64)  # each prediction of a search asks for it
def _for_actions(known: KnownPart, num_actions: int) -> KnownPart:
    return replace(known, matrix=pad(known.matrix, (0, num_actions)))


def _explained(speeds: Tensor, left: Tensor) -> Tensor:
    """The two numbers by which speeds (n, 2) explain what is left (n,), by least squares."""
    tiny = torch.finfo(left.dtype).tiny
    changes = speeds.diff(dim=-1).abs()
    hasty = (HASTY * changes.mean()).clamp(min=tiny)
    weighted = speeds / (1 + (changes / hasty).square())
    normal = speeds.mT @ weighted
    ridge = (RULE_RIDGE * normal.diagonal().mean()).clamp(min=tiny)
    return torch.linalg.solve(normal + ridge * torch.eye(2, dtype=left.dtype), weighted.mT @ left)
