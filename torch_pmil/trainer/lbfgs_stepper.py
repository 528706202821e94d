"""L-BFGS as the optimisation step of any TorchRL trainer."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.trainers import OptimizationStepper, Trainer

from torch_pmil.checks import check_whole
from torch_pmil.gp.lbfgs import minimise


class LBFGSStepper(OptimizationStepper):
    """A run of L-BFGS with strong Wolfe line search on each batch, in place of one gradient step.

    The trainer needs no optimizer. The objective is the sum of the loss's entries ``loss_*`` on the
    batch, which must be one function of the parameters: a loss whose entries hide parameters from
    each other (an actor and a critic) is searched one entry at a time. A loss that draws random
    numbers draws the same ones throughout a step. Points where it is not finite are stepped back
    from, and the parameters end at the best point that was seen. Curvature is learned anew on each
    batch. A trainer's ``clip_norm`` has no meaning here.

    Args:
        max_iterations: limit of L-BFGS in a step; each iteration takes one to a few evaluations.
        loss_components: keys of the entries to minimise; None for all ``loss_*``.
        survives: errors by which the loss says that it has no value at some parameters.

    Raises:
        NotFiniteError: the loss is not finite at the parameters with which a step begins. An error
            of ``survives`` at these parameters is raised as well.
        ValueError: the loss has no entry to minimise, or no trainable parameter.

    Example:
        >>> stepper = LBFGSStepper(max_iterations=30)
        >>> trainer = Trainer(..., optimization_stepper=stepper)  # doctest: +SKIP
    """

    def __init__(
        self,
        max_iterations: int = 20,
        loss_components: Sequence[str] | None = None,
        survives: tuple[type[Exception], ...] = (),
    ) -> None:
        check_whole("max_iterations", max_iterations, 1)
        self.max_iterations, self.survives = max_iterations, survives
        self.loss_components = loss_components

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDictBase:
        """Minimise on ``sub_batch``; return the entries at the end, and counts.

        The counts are the numbers of iterations and of evaluations.
        """
        parameters = [p for p in trainer.loss_module.parameters() if p.requires_grad]
        if not parameters:
            raise ValueError(
                f"{type(trainer.loss_module).__name__} must have trainable parameters, got none"
            )
        random_state = torch.get_rng_state()

        def objective() -> Tensor:
            torch.set_rng_state(random_state)
            return self._total(trainer.compute_loss(sub_batch))

        result = minimise(parameters, objective, self.max_iterations, self.survives)
        torch.set_rng_state(random_state)
        with torch.no_grad():
            losses = trainer.compute_loss(sub_batch)
        counts = {
            "lbfgs_iterations": float(result.iterations),
            "lbfgs_evaluations": float(result.evaluations),
        }
        return TensorDict({**losses.detach().to_dict(), **counts})

    def _total(self, losses: TensorDictBase) -> Tensor:
        keys = set(losses.keys())
        chosen = self.loss_components or sorted(key for key in keys if key.startswith("loss"))
        missing = [key for key in chosen if key not in keys]
        if missing or not chosen:
            raise ValueError(
                f"the loss must have {missing or 'entries loss_*'}, got {sorted(keys)}"
            )
        return sum(losses[key] for key in chosen)
