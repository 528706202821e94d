"""The kernels beside the formulas in PyTorch, through the package's public functions.

Where sums cancel, in models that are sure of many data, no two orders of summation agree to twelve
digits. The formulas themselves show what rounding allows there: they are evaluated again at
the numbers next to those of the problem, each a unit in the last place away at most.
"""

from __future__ import annotations

import pytest
import torch

from tests.helpers.draws import Draws
from tests.helpers.losses import make_kl
from tests.helpers.random_predictions import Problem, ProblemDraws, Results, neighbour
from tests.helpers.two_ways import formulas_alone, kernels_alone
from torch_pmil.gp.moment_accuracy import signal_to_noise
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.tasks.registry import load_experiment

VALUE, GRADIENT = 1e-12, 1e-10  # differences that need no excuse, of the largest entry
NEIGHBOURS = 4  # at which the formulas are evaluated again
SAFETY = 30.0  # times what these differ by; none of a thousand problems needs more than 13


def differences(ours: Results, reference: Results) -> dict[str, float]:
    """The largest difference of each result, of its largest entry."""
    found = {}
    for name, expected in reference.items():
        largest = expected.abs().max().item()
        found[name] = (ours[name] - expected).abs().max().item() / (largest or 1.0)
    return found


class Agreement:
    """How well kernels and formulas agree in one problem.

    Attributes:
        within: whether all values and all gradients do without an excuse.
        excess: the largest difference that does not, over what rounding allows; 0 if there is none.
    """

    def __init__(self, problem: Problem) -> None:
        with formulas_alone():
            reference = problem.results()
        with kernels_alone():
            ours = problem.results()
        bounds = VALUE, GRADIENT
        beyond = [
            {name: found for name, found in differences(own, expected).items() if found > bound}
            for own, expected, bound in zip(ours, reference, bounds, strict=True)
        ]
        self.within = tuple(not names for names in beyond)
        self.excess = 0.0
        if any(beyond):
            allowed = rounding(problem, reference)
            self.excess = max(
                found / max(allowed[name], bound / SAFETY)
                for names, bound in zip(beyond, bounds, strict=True)
                for name, found in names.items()
            )


def rounding(problem: Problem, reference: tuple[Results, Results]) -> dict[str, float]:
    """How far the formulas' results in neighbouring problems are from these."""
    largest: dict[str, float] = {}
    for seed in range(NEIGHBOURS):
        with formulas_alone():
            others = neighbour(problem, Draws(seed)).results()
        for other, expected in zip(others, reference, strict=True):
            for name, found in differences(other, expected).items():
                largest[name] = max(found, largest.get(name, 0.0))
    return largest


@pytest.mark.parametrize("tied", [False, True], ids=["own lengthscales", "tied"])
@pytest.mark.parametrize("seed", range(40))
def test_results_are_those_of_the_formulas(seed: int, tied: bool) -> None:
    assert Agreement(ProblemDraws(seed).problem(most_data=60, tied=tied)).excess < SAFETY


@pytest.mark.slow
def test_results_of_a_thousand_problems_are_those_of_the_formulas() -> None:
    agreements = [Agreement(ProblemDraws(seed).problem(most_data=300)) for seed in range(1000)]
    values, gradients = (sum(part) for part in zip(*(a.within for a in agreements), strict=True))
    worst = max(agreement.excess for agreement in agreements)
    print(f"values within {VALUE:g} in {values} of {len(agreements)} problems")
    print(f"gradients within {GRADIENT:g} in {gradients}")
    print(f"both in {sum(all(agreement.within) for agreement in agreements)}")
    print(f"the others within {worst:.1f} times the differences of neighbouring problems")
    assert worst < SAFETY


def fitted_problem(n: int) -> Problem:
    """A model that was fitted to n exact transitions of the double pendulum, and its loss."""
    draws, experiment = ProblemDraws(0), load_experiment("double_pendulum")
    states = experiment.initial.sample(n, draws.generator) + draws.uniform(-0.5, 0.5, n, 4)
    torques = 0.1 * experiment.actions.half_range * draws.uniform(-1.0, 1.0, n, 2)
    successors = experiment.make_env(num_envs=n, seed=0).simulate(states, torques)
    inputs = torch.cat([experiment.space.features(states), torques], -1)
    dynamics = GPDynamics(inputs.shape[-1], 4)
    dynamics.fit(inputs, successors - states)
    policy = experiment.make_policy(draws.generator)
    demonstrated, noise_std = experiment.demonstrated, experiment.noise_std
    loss = TrajectoryKLLoss(policy, dynamics, experiment.space, demonstrated, noise_std)
    return Problem(experiment.initial, loss, noise=True, cotangents=draws)


def test_results_of_a_fitted_model_are_those_of_the_formulas() -> None:
    """Its signal-to-noise ratios are near 100, beyond which the penalty is felt."""
    problem = fitted_problem(100)
    assert signal_to_noise(problem.loss.dynamics.expansion).max() > 80
    assert Agreement(problem).excess < SAFETY


def test_beliefs_in_threads_are_predicted_as_one_after_the_other(draws: Draws) -> None:
    loss, start = make_kl(seed=1), draws.belief(7, 2, scale=0.05)
    problem, before = Problem(start, loss, noise=True, cotangents=draws), torch.get_num_threads()
    results = []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            with kernels_alone():
                results.append(problem.results())
    finally:
        torch.set_num_threads(before)
    for alone, together in zip(*results, strict=True):
        assert all(torch.equal(alone[name], together[name]) for name in alone)
