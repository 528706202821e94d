"""The policy and model of a run, loaded from its folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule

from torch_pmil.control.policy_file import load_policy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.tensor_file import load_tensors
from torch_pmil.envs.rollouts import without_sensor_noise
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.runs.summaries import RunError, read_summary
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.state_checks import check_model, check_state
from torch_pmil.trainer.trials import success_rate


class Acting(Protocol):
    """What acts on robots, such as a :class:`StatePolicy`."""

    def as_tensordict_module(self) -> TensorDictModule:
        """A module that reads the readings and writes the actions."""


@dataclass(frozen=True)
class Learned:
    """A policy with the model that it was searched on.

    Args:
        summary: of the run.
        policy: the saved one.
        dynamics: the model of all its experience.
    """

    summary: dict
    policy: StatePolicy
    dynamics: ForwardModel

    @torch.no_grad()
    def predicted(self, experiment: Task) -> Gaussian:
        """p(x_1..T) of the policy under its model, mean (T, D)."""
        loss = experiment.make_loss(self.policy.policy, self.dynamics)
        return loss.predict_states(experiment.initial)

    @torch.no_grad()
    def rollouts(self, experiment: Task, starts: int, seed: int) -> TensorDictBase:
        """Rollouts of the robot from fresh starts, (starts, T), as the environment gives them."""
        return executed(self.policy, experiment, starts, seed)


@torch.no_grad()
def executed(policy: Acting, task: Task, starts: int, seed: int) -> TensorDictBase:
    """Rollouts of a policy from fresh starts, over the whole horizon, (starts, T)."""
    return task.robots(starts, seed).rollout(task.horizon, policy.as_tensordict_module())


def load_learned(folder: Path, experiment: Task) -> Learned:
    """Policy and model of a finished run. Nothing that the files carry is executed.

    Args:
        folder: of the run.
        experiment: what it learned.

    Raises:
        RunError: the run is of another experiment, or its model is damaged.
        PolicyFileError: its policy is damaged.
        OSError: a file cannot be read.
    """
    summary = read_summary(folder)
    if summary["experiment"] != experiment.name:
        raise RunError(
            f"{folder} must be a run of {experiment.name}, got one of {summary['experiment']}"
        )
    dynamics = experiment.make_dynamics()
    try:
        state = load_tensors(folder / "dynamics.pt")
        check_state("dynamics", dynamics.state_dict(), state)
        check_model("dynamics", state)
        dynamics.load_state_dict(state)
    except (RuntimeError, ValueError, TypeError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise RunError(
            f"{folder}: dynamics.pt is damaged, or of another version: {reason}"
        ) from error
    return Learned(summary, load_policy(folder / "policy.pt"), dynamics)


@torch.no_grad()
def measured_success(policy: Acting, experiment: Task, starts: int, seed: int) -> float:
    """Success rate of a policy on an experiment's robot, by the true states.

    What noisy sensors say does not count.

    Args:
        policy: acts on the readings.
        experiment: says the robot, the horizon and what a success is.
        starts: number of rollouts.
        seed: of the starts.

    Returns:
        Fraction from 0 to 1.
    """
    rollouts = without_sensor_noise(executed(policy, experiment, starts, seed))
    return success_rate(experiment.error(rollouts), experiment.tolerance)


def remeasured(folder: Path, experiment: Task, starts: int, seed: int) -> dict[str, Any]:
    """The main numbers of a run, for the details of a summary, with its policy measured anew.

    Args:
        folder: of the run.
        experiment: what it learned.
        starts: number of rollouts.
        seed: of their starts.

    Raises:
        RunError, PolicyFileError, OSError: as :func:`load_learned`.
    """
    return measured_anew(load_learned(folder, experiment), experiment, starts, seed)


def measured_anew(learned: Learned, experiment: Task, starts: int, seed: int) -> dict[str, Any]:
    """:func:`remeasured` of a run that is loaded already."""
    return {
        "experiment": experiment.name,
        "seed": learned.summary["seed"],
        "success_rate": measured_success(learned.policy, experiment, starts, seed),
        "experience_s": learned.summary["experience_s"],
        "trials": len(learned.summary["trials"]),
        "stop_reason": learned.summary["stop_reason"],
    }
