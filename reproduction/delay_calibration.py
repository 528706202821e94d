"""The double pendulum whose torques take effect late: what its GPs make of it.

A torque takes effect 0, 20, 50 or 100 ms after the state on which it was decided; until then that
of the period before acts on. The next state thus depends on a torque that the model does not see.
Each robot is learned as ever, and the model of all its experience then predicts 1, 5, 10 and 25
steps of the saved policy from states of fresh rollouts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from reproduction.learned import load_learned, remeasured
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.model.rollout import predict_trajectory
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

DELAYS = (0.0, 0.02, 0.05, 0.1)  # s
AHEAD = (1, 5, 10, 25)  # control steps
SEEDS, TRIALS = range(10), 12
STARTS, START_SEED = 20, 5_000_000  # no start that a run has seen


class DelayedDoublePendulumEnv(DoublePendulumEnv):
    """The double pendulum with torques that take effect late.

    Until then those of the control period before act on; after a reset no actions act yet.

    Args:
        delay: s, a whole number of simulation time steps of 2 ms, at most a control period.
        settings: of :class:`DoublePendulumEnv`.

    Example:
        >>> env = DelayedDoublePendulumEnv(delay=0.1, initial_std=[0.0] * 4)
        >>> states = states_of(env.rollout(2))  # a whole period late: nothing happens in the first
        >>> (states[1] - states[0]).abs().max() < 1e-9 < (states[2] - states[1]).abs().max()
        tensor(True)
    """

    def __init__(self, delay: float, **settings: Any) -> None:
        super().__init__(**settings)
        self.late_substeps = round(delay / self.model.opt.timestep)
        self._acting = torch.zeros(len(self._physics), self.model.nu, dtype=torch.float64)

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        self._acting = torch.zeros_like(self._acting)
        return super()._reset(tensordict, **kwargs)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        torque, before = self._rows("action", tensordict["action"]), self._physics
        late = self.late_substeps
        for held, substeps in ((self._acting, late), (torque, self.substeps - late)):
            if substeps:
                states, sensors = self._simulate(self._physics, held, substeps, self._models)
                self._physics = states[:, -1].clone()
        self._check_physics(before, self._physics)
        self._acting = torque
        return self._without_reward(self._measure(sensors))


def with_delay(delay: float) -> Task:
    """The double pendulum whose torques take effect ``delay`` seconds late.

    Example:
        >>> with_delay(0.05).name, with_delay(0.0).name
        ('double_pendulum_late_50ms', 'double_pendulum')
    """
    experiment = load_experiment("double_pendulum")
    if not delay:
        return experiment
    return replace(
        experiment,
        name=f"double_pendulum_late_{1000 * delay:g}ms",
        make_env=partial(DelayedDoublePendulumEnv, delay),
    )


@dataclass(frozen=True)
class Calibration:
    """How sure predictions are, against how right they are; over all entries of the state.

    Args:
        coverage: fraction of entries within two predicted standard deviations; of Gaussians 0.954.
        standardised_error: root mean square of the errors in predicted standard deviations; of
            Gaussians 1.
        nll: negative log-likelihood of the executed states, nats a state. Where entries follow from
            others, which leaves the state no density, it is that of these others: compare models
            of the same entries.
    """

    coverage: float
    standardised_error: float
    nll: float

    @classmethod
    def of(
        cls, predicted: Gaussian, executed: Tensor, learned: Sequence[int] | None = None
    ) -> Calibration:
        """The calibration of beliefs, mean (N, D), at executed states (N, D).

        ``learned`` are the entries from which the others follow; None for all.

        Example:
            >>> standard = Gaussian(torch.zeros(2, 1), torch.ones(2, 1, 1))
            >>> Calibration.of(standard, torch.tensor([[0.0], [3.0]])).coverage
            0.5
        """
        z = (executed - predicted.mean) / predicted.std
        entries = list(range(predicted.dim) if learned is None else learned)
        mean, cov = predicted.mean[:, entries], predicted.cov[:, entries][..., entries]
        normal = torch.distributions.MultivariateNormal(mean, cov)
        return cls(
            coverage=(z.abs() <= 2).double().mean().item(),
            standardised_error=z.square().mean().sqrt().item(),
            nll=-normal.log_prob(executed[:, entries]).mean().item(),
        )


CALIBRATION = tuple(entry.name for entry in fields(Calibration))


def calibrations(folder: Path, experiment: Task, starts: int) -> dict[int, Calibration]:
    """Calibration of a run's model of its saved policy, by the number of steps ahead."""
    learned = load_learned(folder, experiment)
    states = states_of(learned.rollouts(experiment, starts, START_SEED))
    shown = None if experiment.history is None else len(experiment.history.names)
    robot = learned.policy.policy, learned.dynamics, experiment.space
    return calibrations_ahead(states, *robot, shown)


@torch.no_grad()
def calibrations_ahead(
    states: Tensor,
    policy: AnyPolicy,
    dynamics: ForwardModel,
    space: StateSpace,
    shown: int | None = None,
) -> dict[int, Calibration]:
    """Calibration of a model by the number of steps ahead, 1, 5, 10 and 25 if there are as many.

    Each prediction begins at an executed state, without uncertainty.

    Args:
        states: x_0..x_T of rollouts of the policy, (N, T + 1, D).
        policy, dynamics, space: policy, forward model and state space of one robot.
        shown: number of entries that are compared, the first ones, where others repeat the past;
            None for all.
    """
    found, kept = {}, range(space.dim)[:shown]
    learned = [entry for entry in dynamics.known_part(space).learned if entry in kept]
    for steps in (steps for steps in AHEAD if steps < states.shape[1]):
        begin, end = states[:, :-steps].flatten(0, 1), states[:, steps:].flatten(0, 1)[:, :shown]
        certain = Gaussian(begin, torch.zeros(*begin.shape, begin.shape[-1]).to(begin))
        ahead = predict_trajectory(certain, policy, dynamics, space, steps)
        last = Gaussian(ahead.mean[:, -1, :shown], ahead.cov[:, -1, :shown, :shown])
        found[steps] = Calibration.of(last, end, learned)
    return found


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ours with each delay; without one it is the plain double pendulum."""
    seeds, trials = (SEEDS[:1], 3) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root, with_delay(delay), seed, trials) for delay in DELAYS for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Calibration over the steps ahead, and success, with each delay; means over the runs."""
    starts = 5 if quick else STARTS
    runs_each = len(folders) // len(DELAYS)
    delays = [delay for delay in DELAYS for _ in range(runs_each)]
    runs = [
        measured(folder, with_delay(delay), starts)
        for delay, folder in zip(delays, folders, strict=True)
    ]
    names = [f"{1000 * delay:g}ms" for delay in DELAYS]
    success = np.reshape([run["success_rate"] for run in runs], (len(DELAYS), runs_each))
    quantities = {
        quantity: np.reshape(
            [[step[quantity] for step in run["calibration"]] for run in runs],
            (len(DELAYS), runs_each, len(AHEAD)),
        )
        for quantity in CALIBRATION
    }
    headline = {
        f"{quantity}_{steps}_ahead_{name}": values[index, :, column].mean().item()
        for quantity, values in quantities.items()
        for index, name in enumerate(names)
        for column, steps in enumerate(AHEAD)
    }
    headline |= {
        f"success_{name}": rate for name, rate in zip(names, success.mean(1).tolist(), strict=True)
    }
    details = {"starts": starts, "steps_ahead": list(AHEAD), "measured": runs}
    return Results(headline, {}, details)


def measured(folder: Path, experiment: Task, starts: int) -> dict[str, Any]:
    """Success of a run's saved policy, and the calibration of its model by steps ahead."""
    found = calibrations(folder, experiment, starts)
    return {
        **remeasured(folder, experiment, starts, START_SEED),
        "calibration": rows_of(found),
    }


def rows_of(found: Mapping[int, Calibration]) -> list[dict[str, float]]:
    """Calibrations by the number of steps ahead, as a summary has them."""
    return [{"steps": steps, **asdict(of)} for steps, of in found.items()]


DELAY_CALIBRATION = PaperExperiment(
    "delay_calibration",
    "what the GPs make of torques that take effect late",
    needed_runs,
    results,
)
