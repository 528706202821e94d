"""Random problems of prediction, and what the package's public functions say about them."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import torch
from gpytorch.means import ConstantMean
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.gp.gaussian import Gaussian, symmetric
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import Targets
from torch_pmil.model.rollout import predict_mean_trajectory, predict_trajectory
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.multi_target_loss import MultiTargetKLLoss
from torch_pmil.search.target_losses import ExpectedSaturatingCost
from torch_pmil.search.trajectory_loss import TrajectoryLoss

Results = dict[str, Tensor]


@dataclass(frozen=True)
class Problem:
    """A prediction and what it is compared with; the loss holds policy, model and state space."""

    start: Gaussian
    loss: TrajectoryLoss
    noise: bool
    cotangents: Draws

    def results(self) -> tuple[Results, Results]:
        """Values by name, and the gradients of random sums of them."""
        loss, parameters = self.loss, list(self.loss.parameters())
        mean, cov = (t.detach().clone().requires_grad_() for t in (self.start.mean, self.start.cov))
        start = Gaussian(mean, cov)
        belief, policy = loss.begin(start)
        task = policy, loss.dynamics, loss.space, loss.horizon
        states = predict_trajectory(belief, *task, self.noise)
        values = {
            "mean": states.mean,
            "cov": states.cov,
            "states of the mean": predict_mean_trajectory(belief.mean, *task),
            "cost": loss.per_step(start),
            "cost of the mean": loss.mean_per_step(start),
        }
        cotangents, gradients = copy.deepcopy(self.cotangents), {}
        for name, value in values.items():
            leaves, cotangent = [mean, cov, *parameters], cotangents.normal(*value.shape)
            unused = {"allow_unused": True, "materialize_grads": True}
            slopes = torch.autograd.grad(value, leaves, cotangent, retain_graph=True, **unused)
            names = "start", "cov of start", "centres", "weights", "widths"
            for leaf, slope in zip(names, slopes, strict=True):
                gradients[f"{name} by {leaf}"] = slope
        return {name: value.detach() for name, value in values.items()}, gradients


def neighbour(problem: Problem, draws: Draws) -> Problem:
    """The problem with every number of it replaced by the next one below or above."""

    def moved(values: Tensor) -> Tensor:
        beyond = torch.where(draws.normal(*values.shape) > 0, torch.inf, -torch.inf)
        return torch.where(values == 0, values, torch.nextafter(values, beyond.to(values)))

    other = copy.deepcopy(problem)
    loss, f = other.loss, problem.loss.dynamics.expansion
    names = "inputs", "weights", "lengthscales", "signal_variance"
    of_model = {name: moved(getattr(f, name)) for name in names}
    upper = moved(f.gram_inverse).triu()
    inverse = upper + upper.triu(1).mT
    loss.dynamics._expansion = replace(f, gram_inverse=inverse, **of_model)
    for parameter in loss.parameters():
        parameter.data = moved(parameter.data)
    start = Gaussian(moved(other.start.mean), symmetric(moved(other.start.cov)))
    return replace(other, start=start)


class ProblemDraws(Draws):
    """Parts of problems."""

    def whole(self, low: int, high: int) -> int:
        """A number from low to high."""
        return int(torch.randint(low, high + 1, (), generator=self.generator))

    def chance(self, probability: float) -> bool:
        return self.uniform(0.0, 1.0, 1).item() < probability

    def logarithmic(self, low: float, high: float, *shape: int) -> Tensor:
        return self.uniform(math.log(low), math.log(high), *shape).exp()

    def number(self, low: int, high: int) -> int:
        """A number from low to high, all magnitudes alike."""
        return int(self.logarithmic(low, high + 1, 1))

    def problem(self, most_data: int, tied: bool = False) -> Problem:
        """One of at most so many data; ``tied`` where all outputs have the same lengthscales."""
        D, F = self.whole(1, 8), self.whole(1, 3)
        space = self.space(D)
        dynamics = self.dynamics(space, F, self.number(2, most_data), tied)
        batch = ((), (), (3,), (2, 1))[self.whole(0, 3)]
        loss = self.loss(space, dynamics, F)
        return Problem(self.start(*batch, D), loss, self.chance(0.5), Draws(self.whole(0, 999)))

    def space(self, D: int) -> StateSpace:
        """Some entries are angles; what is matched are combinations of all."""
        angles = tuple(d for d in range(D) if self.chance(0.3))
        names, units = tuple("abcdefgh"[:D]), ("",) * D
        M, K = self.whole(1, D), self.whole(0, 2)
        matched = MatchSpace(
            names[:M], units[:M], self.normal(K, D), 0.5 * self.normal(M, D + 2 * K)
        )
        return StateSpace(names, units, angles, matched)

    def dynamics(self, space: StateSpace, F: int, n: int, tied: bool = False) -> GPDynamics:
        """Lengthscales over three decades, signal-to-noise ratios from 1 to 1000."""
        D, inputs, targets = space.dim, len(space.feature_names) + F, self.targets(space.dim, F)
        E = targets.num_outputs if isinstance(targets, KnownPart) else D
        dynamics = GPDynamics(inputs, E, targets)
        x = torch.cat([space.features(self.normal(n, D)), self.uniform(-1, 1, n, F)], -1)
        lengthscales = self.logarithmic(0.1, 100.0, E, inputs)
        if tied:
            lengthscales = lengthscales[:1].repeat(E, 1)
        signal = self.logarithmic(1e-2, 1.0, E)
        noise = signal / self.logarithmic(1.0, 1e3, E).square()
        expected = (x @ (self.normal(E, inputs) / lengthscales).mT).sin()
        y = expected * signal.sqrt() + self.normal(n, E) * noise.sqrt()
        dynamics.set_data(x, y)
        dynamics.gp.covar_module.base_kernel.lengthscale = lengthscales[:, None]
        dynamics.gp.covar_module.outputscale = signal
        dynamics.gp.likelihood.noise = noise[:, None]
        if self.chance(0.3):
            dynamics.gp.mean_module = ConstantMean(batch_shape=torch.Size([E]))
            dynamics.gp.mean_module.constant.data = signal.sqrt() * self.normal(E)
            dynamics.gp.mean_module.requires_grad_(False)
        if n * E <= 300 and self.chance(0.3):
            own = x + 0.1 * self.normal(E, n, inputs)
            dynamics.gp.set_train_data(own, y.mT.contiguous(), strict=False)
        return dynamics

    def targets(self, D: int, F: int) -> Targets:
        """Differences, successors, or what any known part leaves to a model of some outputs."""
        kind = self.whole(0, 2)
        if kind < 2:
            return "difference" if kind else "successor"
        learned = torch.randperm(D, generator=self.generator)[: self.whole(1, D)].tolist()
        gain = self.normal(D, len(learned))
        gain[learned] = torch.eye(len(learned), dtype=torch.float64)
        return KnownPart(0.5 * self.normal(D, D + F), gain, tuple(learned))

    def policy(self, inputs: int, F: int) -> RBFPolicy:
        """Some of its weights are exactly zero."""
        m = self.number(1, 100)
        policy = RBFPolicy(
            self.normal(m, inputs),
            self.uniform(0.5, 2.0, F),
            self.uniform(0.5, 2.0, inputs),
            u_middle=torch.linspace(-0.5, 0.7, F, dtype=torch.float64),
        )
        policy.log_widths.data = self.uniform(-0.7, 1.0, F, inputs)
        kept = self.uniform(0.0, 1.0, m, F) < 0.8
        policy.weights.data = self.logarithmic(1e-2, 3.0, 1) * self.normal(m, F) * kept
        return policy

    def loss(self, space: StateSpace, dynamics: GPDynamics, F: int) -> TrajectoryLoss:
        T, features, M = self.whole(1, 4), len(space.feature_names), space.match_space.dim
        if self.chance(0.3):
            policy, to_target = self.policy(features, F), self.normal(M)
            width = self.uniform(0.3, 3.0, 1).item()
            weight = symmetric(self.cov(M, scale=1.0))
            return ExpectedSaturatingCost(policy, dynamics, space, to_target, width, T, weight)
        noise_std = self.uniform(0.01, 0.3, M)
        if self.chance(0.7):
            demonstrated = self.belief(T, M)
            policy = self.policy(features, F)
            return TrajectoryKLLoss(policy, dynamics, space, demonstrated, noise_std)
        S, K = self.whole(1, 3), self.whole(1, 2)
        demonstrated, targets = self.belief(S, T, M), self.normal(S, K)
        policy = self.policy(features + K, F)
        return MultiTargetKLLoss(policy, dynamics, space, demonstrated, targets, noise_std)

    def start(self, *shape: int) -> Gaussian:
        """Beliefs with a covariance that is full, singular, or zero."""
        D, kind = shape[-1], self.whole(0, 2)
        root, mean = self.normal(*shape, (0, (D + 1) // 2, 2 * D)[kind]), self.normal(*shape)
        return Gaussian(mean, symmetric(self.logarithmic(1e-3, 0.3, 1) * root @ root.mT))
