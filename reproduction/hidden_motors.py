"""The cost of hiding the motors' angles from the BioRob's model (Section 5.2.1).

One step is predicted with and without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from reproduction.reproduction import PaperExperiment, Results, Run
from torch_pmil.envs.biorob import ROTORS, BioRobEnv
from torch_pmil.envs.mujoco_model import state_columns
from torch_pmil.experiments import load_experiment
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.plotting import plot_errors_over_data

SEEDS, QUICK_SEEDS = range(5), range(1)
# rollouts of 2 s that the model learns from; the first number is that of a run's exploration
ROLLOUTS = (3, 6, 12, 24)
TESTED = 20  # further rollouts of 2 s
TEST_SEED = 8_000_000


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """No runs: models alone are learned."""
    return []


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Errors of the predicted changes of positions and velocities, motors hidden and known."""
    seeds = QUICK_SEEDS if quick else SEEDS
    tested = record_movements(TEST_SEED, TESTED)
    measured = [[one_step_errors(seed, count, tested) for count in ROLLOUTS] for seed in seeds]
    errors = np.array(measured)  # (seeds, K, 2, 6)
    rms = np.sqrt(np.square(errors).mean(0))  # (K, 2, 6)
    names = load_experiment("biorob").space.names
    headline = {
        f"{name}_error_{kind}_{2 * count}s": value
        for count, kinds in zip(ROLLOUTS, rms, strict=True)
        for kind, values in zip(("hidden", "known"), kinds.tolist(), strict=True)
        for name, value in zip(names, values, strict=True)
    }
    ratios = rms[:, 0] / rms[:, 1]
    headline |= {
        f"ratio_{2 * count}s": float(np.exp(np.log(values).mean()))
        for count, values in zip(ROLLOUTS, ratios, strict=True)
    }
    panels = {
        f"{quantity} ({unit})": {
            label: np.sqrt(np.square(errors[:, :, kind, part]).mean(-1))
            for kind, label in enumerate(("motors hidden", "motors known"))
        }
        for quantity, unit, part in (
            ("error of positions", "rad", slice(3)),
            ("error of velocities", "rad/s", slice(3, 6)),
        )
    }
    figure = plot_errors_over_data([2 * count for count in ROLLOUTS], panels)
    details = {"rollouts": list(ROLLOUTS), "tested": TESTED, "errors": errors.tolist()}
    return Results(headline, {"hidden_motors": figure}, details)


def one_step_errors(
    seed: int, rollouts: int, tested: tuple[Tensor, Tensor, Tensor, Tensor]
) -> np.ndarray:
    """Root mean square error of the predicted change of each entry of the state, (2, 6).

    The rows are with motors hidden, and with motors known.
    """
    learned = record_movements(seed, rollouts)
    errors = []
    for known in (False, True):
        inputs, targets = model_data(*learned, known)
        test_inputs, test_targets = model_data(*tested, known)
        model = GPDynamics(inputs.shape[1], targets.shape[1])
        model.fit(inputs, targets)
        predicted, _ = model.expansion.predict(test_inputs)
        errors.append((predicted - test_targets).square().mean(0).sqrt())
    return torch.stack(errors).numpy()


def model_data(
    states: Tensor, motors: Tensor, torques: Tensor, successors: Tensor, known: bool
) -> tuple[Tensor, Tensor]:
    """GP inputs, with the motors' angles and speeds or without, and the changes of the state."""
    inputs = [states, motors, torques] if known else [states, torques]
    return torch.cat(inputs, -1), successors - states


@torch.no_grad()
def record_movements(seed: int, rollouts: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Record PD movements, as at the start of a learning run.

    Returns:
        States (n, 6), motors' angles and speeds (n, 6), torques (n, 3) and successors (n, 6).
    """
    experiment, env = load_experiment("biorob"), BioRobEnv(seed=seed)
    movements = experiment.exploration
    motion, recorded = movements.motion(torch.Generator().manual_seed(seed)), []
    controller = TensorDictModule(motion, in_keys=["observation"], out_keys=["action"])
    columns = state_columns(env.model, ROTORS, positions_first=True)
    for _ in range(rollouts):
        motion.begin()
        rollout = env.rollout(movements.steps, controller)
        physics = env.replay(rollout["observation"][0], rollout["action"], 1)
        states, successors = rollout["observation"], rollout["next", "observation"]
        recorded.append((states, physics[:-1, columns], rollout["action"], successors))
    states, motors, actions, successors = (torch.cat(each) for each in zip(*recorded, strict=True))
    return states, motors, actions, successors


HIDDEN_MOTORS = PaperExperiment(
    "hidden_motors", "what the hidden motor angles cost the BioRob's model", needed_runs, results
)
