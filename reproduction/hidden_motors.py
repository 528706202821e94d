"""The cost of hiding the motors' angles from the BioRob's model (Section 5.2.1).

One step is predicted with and without them, and without them by a state that remembers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from reproduction.reproduction import PaperExperiment, Results, Run
from torch_pmil.envs.biorob import ROTORS
from torch_pmil.envs.mujoco_model import state_columns
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.with_history import with_history

SEEDS, QUICK_SEEDS = range(10), range(1)
# rollouts of 2 s that the model learns from; the first number is that of a run's exploration
ROLLOUTS = (3, 6, 12, 24)
TESTED = 20  # further rollouts of 2 s
TEST_SEED = 8_000_000
KINDS = ("hidden", "known", "with_history")
PAST_ENTRIES, PAST_ACTIONS = 2, 3  # control periods


@dataclass(frozen=True, eq=False)
class Recorded:
    """What was recorded of n transitions.

    Args:
        remembered: states with what came before them, (n, D).
        motors: motors' angles and speeds, (n, 6).
        torques: (n, 3).
        successors: states one control period later, (n, 6).
    """

    remembered: Tensor
    motors: Tensor
    torques: Tensor
    successors: Tensor

    @property
    def states(self) -> Tensor:
        """Positions and velocities of the joints, (n, 6)."""
        return self.remembered[:, : self.successors.shape[1]]


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """No runs: models alone are learned."""
    return []


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Errors of the predicted changes of positions and velocities, by what the model sees."""
    seeds = QUICK_SEEDS if quick else SEEDS
    tested = record_movements(TEST_SEED, TESTED)
    measured = [[one_step_errors(seed, count, tested) for count in ROLLOUTS] for seed in seeds]
    errors = np.array(measured)  # (seeds, K, 3, 6)
    rms = np.sqrt(np.square(errors).mean(0))  # (K, 3, 6)
    names = load_experiment("biorob").space.names
    headline = {
        f"{name}_error_{kind}_{2 * count}s": value
        for count, kinds in zip(ROLLOUTS, rms, strict=True)
        for kind, values in zip(KINDS, kinds.tolist(), strict=True)
        for name, value in zip(names, values, strict=True)
    }
    for row, end in ((0, ""), (2, "_with_history")):
        ratios = np.exp(np.log(rms[:, row] / rms[:, 1]).mean(-1))
        headline |= {
            f"ratio_{2 * count}s{end}": float(ratio)
            for count, ratio in zip(ROLLOUTS, ratios, strict=True)
        }
    details = {"rollouts": list(ROLLOUTS), "tested": TESTED, "errors": errors.tolist()}
    return Results(headline, {}, details)


def one_step_errors(seed: int, rollouts: int, tested: Recorded) -> np.ndarray:
    """Root mean square error of the predicted change of each entry of the state, (3, 6).

    The rows are those of ``KINDS``.
    """
    learned, errors = record_movements(seed, rollouts), []
    for kind in KINDS:
        inputs, targets = model_data(learned, kind)
        test_inputs, test_targets = model_data(tested, kind)
        model = GPDynamics(inputs.shape[1], targets.shape[1])
        model.fit(inputs, targets)
        predicted, _ = model.expansion.predict(test_inputs)
        errors.append((predicted - test_targets).square().mean(0).sqrt())
    return torch.stack(errors).numpy()


def model_data(recorded: Recorded, kind: str) -> tuple[Tensor, Tensor]:
    """GP inputs, by what the model sees, and the changes of the state."""
    seen = {
        "hidden": [recorded.states],
        "known": [recorded.states, recorded.motors],
        "with_history": [recorded.remembered],
    }
    inputs = torch.cat([*seen[kind], recorded.torques], -1)
    return inputs, recorded.successors - recorded.states


@torch.no_grad()
def record_movements(seed: int, rollouts: int) -> Recorded:
    """Record PD movements, as at the start of a learning run."""
    plain = load_experiment("biorob")
    task = with_history(plain, past_entries=PAST_ENTRIES, past_actions=PAST_ACTIONS)
    env, dim, movements = task.make_env(seed=seed), plain.space.dim, task.exploration
    motion, recorded = movements.motion(torch.Generator().manual_seed(seed)), []
    controller = TensorDictModule(motion, in_keys=["observation"], out_keys=["action"])
    columns = state_columns(env.robot.model, ROTORS, positions_first=True)
    for _ in range(rollouts):
        motion.begin()
        rollout = env.rollout(movements.steps, controller)
        remembered, torques = rollout["observation"], rollout["action"]
        physics = env.robot.replay(remembered[0, :dim], torques, 1)
        successors = rollout["next", "observation"][:, :dim]
        recorded.append((remembered, physics[:-1, columns], torques, successors))
    return Recorded(*(torch.cat(each) for each in zip(*recorded, strict=True)))


HIDDEN_MOTORS = PaperExperiment(
    "hidden_motors", "what the hidden motor angles cost the BioRob's model", needed_runs, results
)
