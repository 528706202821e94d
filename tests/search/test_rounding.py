"""How much of a loss is rounding, by how sure a fitted model may be."""

from __future__ import annotations

import pytest
import torch

from tests.helpers.draws import Draws
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.gp.hyperparameters import MOST_SIGNAL_TO_NOISE
from torch_pmil.tasks.handwriting import handwriting
from torch_pmil.tasks.task import Task

pytestmark = pytest.mark.robot
DATA = 150


def waves() -> Task:
    """Slow strokes, of which a simulation without noise makes a very sure model."""
    along = torch.linspace(0, 1, 31, dtype=torch.float64)
    strokes = [
        torch.stack([0.3 * along, height * (6 * along).sin()], -1) for height in (0.05, 0.06)
    ]
    task = handwriting(Demonstrations(torch.stack(strokes), 0.1, ("x", "y")))
    return task.with_settings(velocities_alone=False)


@torch.no_grad()
def roughness(most_signal_to_noise: float) -> float:
    """Largest difference of the KL, nats, among policies whose weights differ by 1e-14."""
    experiment, draws = waves(), Draws(seed=0)
    shown, half_range = experiment.demonstrated_states, experiment.actions.half_range
    chosen = shown[torch.randint(len(shown), (DATA,), generator=draws.generator)]
    states = chosen + 0.2 * shown.std(0) * draws.normal(DATA, 4)
    torques = draws.uniform(-0.5, 0.5, DATA, 2) * half_range
    changes = experiment.make_env(seed=0).simulate(states, torques) - states
    dynamics = experiment.make_dynamics()
    dynamics.most_signal_to_noise = most_signal_to_noise
    dynamics.fit(torch.cat([experiment.space.features(states), torques], -1), changes)
    loss = experiment.make_loss(experiment.make_policy(draws.generator), dynamics)
    weights, losses = loss.actor_network.weights.clone(), []
    for _ in range(20):
        loss.actor_network.weights.copy_(weights * (1 + 1e-14 * draws.normal(*weights.shape)))
        losses.append(loss.per_step(experiment.initial).sum())
    return (max(losses) - min(losses)).item()


def test_rounding_of_a_loss_is_too_small_to_end_a_search() -> None:
    """With PILCO's bound of 500 it is so large that L-BFGS finds no step that is better."""
    usual, surer = roughness(MOST_SIGNAL_TO_NOISE), roughness(500.0)
    assert usual < 1e-3
    assert surer > 30 * usual
