"""Adversarial imitation: the discriminator's reward, and the learner that follows it."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SoftUpdate

from reproduction.baselines.gaifo import BATCH, Discriminator, GAIfO, actor_critic_loss
from reproduction.baselines.peer import consecutive
from tests.reproduction.baselines.test_bco import linear_system
from torch_pmil.tasks.registry import load_experiment

SEED = 100


def test_reward_tells_demonstrated_observations_from_own_ones() -> None:
    experiment = load_experiment("double_pendulum")
    peer = GAIfO(experiment, SEED, steps=100, discriminator_rate=3e-3)
    own = linear_system(seed=1, steps=60)
    peer.add(own)
    peer.fit()
    shown, observe = experiment.demonstrations.positions, experiment.space.observe
    demonstrated = consecutive(shown)
    seen = observe(own["observation"]), observe(own["next", "observation"])
    rewards = [
        peer.discriminator.reward(*(peer.seen(part) for part in pair))
        for pair in (demonstrated, seen)
    ]
    assert rewards[0].mean() > 2 * rewards[1].mean()


def test_a_fit_has_as_many_steps_as_transitions_are_new(monkeypatch: pytest.MonkeyPatch) -> None:
    peer = GAIfO(load_experiment("double_pendulum"), SEED, steps=3)
    steps: list[int] = []
    monkeypatch.setattr(peer, "_improve", lambda *batch: steps.append(len(batch)))
    for new, expected in ((7, 7), (2, 3)):
        peer.add(linear_system(seed=1, steps=new))
        peer.fit()
        assert len(steps) == expected
        steps.clear()


def test_reward_grows_with_the_probability_and_is_finite() -> None:
    discriminator = Discriminator(entries=1, cells=4)
    for parameter in discriminator.parameters():
        torch.nn.init.zeros_(parameter)
    observed = torch.zeros(2, 1)
    torch.testing.assert_close(
        discriminator.reward(observed, observed), torch.full((2, 1), 2.0).log()
    )
    torch.nn.init.constant_(list(discriminator.parameters())[-1], 100.0)
    assert 10 < discriminator.reward(observed, observed)[0].item() < 20


def test_learner_finds_the_action_that_is_rewarded() -> None:
    """One state, discount 0, and a reward that falls with the distance from 0.5."""
    torch.manual_seed(0)
    policy = torch.nn.Sequential(
        torch.nn.Linear(1, 2), torch.nn.Tanh(), torch.nn.Linear(2, 2), Halves()
    )
    loss = actor_critic_loss(policy, features=1, actions=1, cells=32, discount=0.0)
    targets = SoftUpdate(loss, tau=0.1)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-2)
    still = torch.zeros(BATCH, 1)
    never = torch.zeros(BATCH, 1, dtype=torch.bool)
    for _ in range(300):
        action = 2 * torch.rand(BATCH, 1) - 1
        outcome = {"observation": still, "done": never, "terminated": never}
        outcome["reward"] = -20 * (action - 0.5).square()
        batch = {"observation": still, "action": action, "next": outcome}
        losses = loss(TensorDict(batch, [BATCH]))
        optimizer.zero_grad()
        (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
        optimizer.step()
        targets.step()
    mean, _ = policy(still[:1])
    assert abs(mean.tanh().item() - 0.5) < 0.2


class Halves(torch.nn.Module):
    """Means, and standard deviations of the other half."""

    def forward(self, outputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        mean, raw = outputs.chunk(2, -1)
        return mean, raw.exp().clamp(0.01, 2.0)
