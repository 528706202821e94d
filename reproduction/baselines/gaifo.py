r"""Generative adversarial imitation from observation: TorchRL's GAIL loss, and its SAC as learner.

A discriminator D separates demonstrated pairs of observations from own ones. The policy is
rewarded for pairs that D takes for demonstrated.

.. math:: \max_D \; \mathbb E_{\exp}[\log D(z, z')] + \mathbb E_{\pi}[\log(1 - D(z, z'))], \qquad
    r(z, z') = -\log(1 - D(z, z'))

Both see the match space alone: the states that demonstrations show have velocities of differences,
by which D would recognise them.

The paper learns the policy with TRPO, from its latest rollouts alone. At our experience that is too
little: here an off-policy learner has all rollouts so far, and the discriminator too, as in
discriminator-actor-critic.

Sources: F. Torabi, G. Warnell, P. Stone (2018), Generative adversarial imitation from observation;
I. Kostrikov et al. (2019), Discriminator-actor-critic, ICLR.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import Tensor, nn
from torchrl.data import Bounded
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import GAILLoss, SACLoss, SoftUpdate

from reproduction.baselines.networks import Scaled, from_unit, seeded, to_unit
from reproduction.baselines.peer import Peer, consecutive
from torch_pmil.tasks.task import Task

BATCH = 128  # transitions of a step
SURE = 1e-6  # of the discriminator: a larger probability is no larger reward
CELLS = 64  # of each of the two hidden layers of the networks
LEARNING_RATE = 1e-3  # of Adam, of actor and critics
DISCOUNT = 0.95  # of the rewards
TARGET_RATE = 0.01  # of the target critics, at each step
Pair = tuple[Tensor, Tensor]  # now and a step later


class Discriminator(nn.Module):
    """Probability (*batch, 1) that a pair of observations (*batch, M) was demonstrated.

    Args:
        entries: M.
        cells: of each of its two hidden layers.
    """

    def __init__(self, entries: int, cells: int) -> None:
        super().__init__()
        self.network = nn.Sequential(MLP(2 * entries, 1, num_cells=[cells, cells]), nn.Sigmoid())

    def forward(self, observed: Tensor, following: Tensor) -> Tensor:
        """Of observations now and a step later."""
        return self.network(torch.cat([observed, following], -1))

    @torch.no_grad()
    def reward(self, observed: Tensor, following: Tensor) -> Tensor:
        """The reward r (*batch, 1) of a transition between observations (*batch, M)."""
        return -(1 - self(observed, following)).clamp_min(SURE).log()


class GAIfO(Peer):
    """Generative adversarial imitation from observation.

    Args:
        experiment: what to learn.
        seed: of the networks and the exploration.
        steps: of each network in a fit; as many as transitions are new, if these are more.
        discriminator_rate: of Adam, of the discriminator.
        penalty: of the discriminator's gradient.
    """

    label: ClassVar[str] = "GAIfO (SAC)"
    name: ClassVar[str] = "gaifo"

    def __init__(
        self,
        experiment: Task,
        seed: int,
        steps: int = 500,
        discriminator_rate: float = 3e-4,
        penalty: float = 1.0,
    ) -> None:
        super().__init__(experiment, seed)
        self.steps = steps
        space = experiment.space
        features, entries = len(space.feature_names), space.match_space.dim
        F = len(experiment.actions.names)
        with seeded(self.generator):
            self.discriminator = Discriminator(entries, CELLS)
            self.adversary = adversarial_loss(self.discriminator, penalty)
            self.policy = nn.Sequential(
                MLP(features, 2 * F, num_cells=[CELLS, CELLS], activation_class=nn.ReLU),
                NormalParamExtractor(),
            )
            self.learner = actor_critic_loss(self.policy, features, F, CELLS, DISCOUNT)
        self.targets = SoftUpdate(self.learner, tau=TARGET_RATE)
        self.optimizers = (
            torch.optim.Adam(self.adversary.parameters(), lr=discriminator_rate),
            torch.optim.Adam(self.learner.parameters(), lr=LEARNING_RATE),
        )
        self.scale = Scaled(nn.Identity(), features)
        self.seen = Scaled(nn.Identity(), entries)

    def fit(self) -> None:
        """Learn discriminator, critics and actor from all rollouts, in turns."""
        states, actions, following = self.transitions
        space, shown = self.experiment.space, self.experiment.demonstrations.positions
        self.seen.set_scale(shown.flatten(0, 1))
        self.scale.set_scale(space.features(self.demonstrated_transitions[0]))
        demonstrated = [self.seen(part) for part in consecutive(shown)]
        observed = [self.seen(space.observe(part)) for part in (states, following)]
        features = [self.scale(space.features(part)) for part in (states, following)]
        fractions = to_unit(actions, self.experiment.actions)
        with seeded(self.generator):
            for _ in range(self.steps_of_fit(self.steps)):
                rows, expert = (torch.randint(len(x), (BATCH,)) for x in (states, demonstrated[0]))
                pair = observed[0][rows], observed[1][rows]
                self._tell_apart(pair, (demonstrated[0][expert], demonstrated[1][expert]))
                reward = self.discriminator.reward(*pair)
                self._improve(features[0][rows], fractions[rows], reward, features[1][rows])

    def act(self, step: int, states: Tensor) -> Tensor:
        """The policy's most likely actions before they are squashed."""
        mean, _ = self._moments(states)
        return from_unit(mean.tanh(), self.experiment.actions)

    def explore(self, step: int, states: Tensor) -> Tensor:
        """Actions drawn from the policy."""
        mean, std = self._moments(states)
        noise = torch.randn(mean.shape, generator=self.generator)
        return from_unit((mean + std * noise).tanh(), self.experiment.actions)

    @torch.no_grad()
    def _moments(self, states: Tensor) -> tuple[Tensor, Tensor]:
        return self.policy(self.scale(self.experiment.space.features(states)))

    def _tell_apart(self, own: Pair, demonstrated: Pair) -> None:
        """A step of the discriminator on pairs of observations (BATCH, M)."""
        names = ("observed", "following", "own_observed", "own_following")
        batch = TensorDict(dict(zip(names, (*demonstrated, *own), strict=True)), [BATCH])
        _step(self.optimizers[0], self.adversary(batch)["loss"])

    def _improve(self, features: Tensor, fractions: Tensor, reward: Tensor, after: Tensor) -> None:
        """A step of actor, critics and temperature on transitions (BATCH, ...)."""
        never = torch.zeros(BATCH, 1, dtype=torch.bool)
        outcome = {"observation": after, "reward": reward, "done": never, "terminated": never}
        batch = {"observation": features, "action": fractions, "next": outcome}
        losses = self.learner(TensorDict(batch, [BATCH]))
        total = losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]
        _step(self.optimizers[1], total)
        self.targets.step()


def adversarial_loss(discriminator: Discriminator, penalty: float) -> GAILLoss:
    """TorchRL's GAIL loss, with the following state in the place of the action.

    Args:
        discriminator: of the demonstrated pairs.
        penalty: of its gradient.
    """
    module = TensorDictModule(discriminator, ["observed", "following"], ["probability"])
    loss = GAILLoss(module, use_grad_penalty=True, gp_lambda=penalty)
    loss.set_keys(
        expert_observation="observed",
        expert_action="following",
        collector_observation="own_observed",
        collector_action="own_following",
        discriminator_pred="probability",
    )
    return loss


def actor_critic_loss(
    policy: nn.Module, features: int, actions: int, cells: int, discount: float
) -> SACLoss:
    """TorchRL's SAC loss of a policy.

    Args:
        policy: features (*batch, D') to mean and standard deviation (*batch, F) each, of actions
            before they are squashed to [-1, 1].
        features: D'.
        actions: F.
        cells: of each of the critics' two hidden layers.
        discount: of the rewards.
    """
    actor = ProbabilisticActor(
        TensorDictModule(policy, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=Bounded(-torch.ones(actions), torch.ones(actions), (actions,)),
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = MLP(features + actions, 1, num_cells=[cells, cells], activation_class=nn.ReLU)
    loss = SACLoss(actor, ValueOperator(critic, in_keys=["observation", "action"]))
    loss.make_value_estimator(gamma=discount)
    return loss


def _step(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
