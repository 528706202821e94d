"""What a policy was predicted to do, and did, beside what was demonstrated."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.rollouts import states_of
from torch_pmil.gp.gaussian import Gaussian


@dataclass(frozen=True, eq=False)
class Outcome:
    """Predicted and executed trajectories of a policy beside the demonstrations of one target.

    Args:
        label: names the target; "" where there is only one.
        demonstrations: of it; None if there are none.
        demonstrated: their marginals at t = 1..T, mean (T, M), or None.
        predicted: p(x_1..T), mean (T, D).
        rollouts: (N, T), as the environment gives them, shorter if one was cut short.
        errors: of the rollouts, infinite where one was cut short, (N,).
        target: of a task with several, (K,).
    """

    label: str
    demonstrations: Demonstrations | None
    demonstrated: Gaussian | None
    predicted: Gaussian
    rollouts: TensorDictBase
    errors: Tensor
    target: Tensor | None = None

    @property
    def compared(self) -> Outcome:
        """The outcome up to where its rollouts end: all of it, unless one was cut short."""
        steps = self.rollouts.shape[-1]
        ended = replace(self, predicted=self.predicted[:steps])
        if self.demonstrations is None or self.demonstrated is None:
            return ended
        shown = replace(
            self.demonstrations, positions=self.demonstrations.positions[:, : steps + 1]
        )
        return replace(ended, demonstrations=shown, demonstrated=self.demonstrated[:steps])

    @property
    def executed(self) -> Tensor:
        """States x_0..x_T of the rollouts, (N, T + 1, D)."""
        return states_of(self.rollouts)
