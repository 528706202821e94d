"""Section 5.1, Figures 2 to 6: one learned policy, predicted and executed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from reproduction import one_dimension
from reproduction.learned import load_learned
from reproduction.plots.gaussian_process import plot_gp, plot_moment_matching
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.envs.rollouts import states_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.calibration import two_sigma_coverage
from torch_pmil.plotting import Figure, plot_demonstrations, plot_distributions, plot_poses
from torch_pmil.search.kl import trajectory_kl
from torch_pmil.tasks.double_pendulum import joints_of
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import MEASURED_STARTS, Task
from torch_pmil.trainer.trials import success_rate

SEED = 0
START_SEED = 4_000_000  # no start that the run has seen


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """One run of the double pendulum."""
    return [learning_run(root, load_experiment("double_pendulum"), SEED, trials=3 if quick else 12)]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Distributions, rollouts and poses of that run; the small figures of the method's parts."""
    experiment, (folder,) = load_experiment("double_pendulum"), folders
    learned = load_learned(folder, experiment)
    states = learned.predicted(experiment)
    rollouts = learned.rollouts(experiment, MEASURED_STARTS, START_SEED)
    executed = states_of(rollouts)
    match_space = experiment.space.match_space
    predicted = match_space.moments(states).add_noise(experiment.noise_std**2)
    headline = {
        "experience_s": learned.summary["experience_s"],
        "success_rate": success_rate(experiment.error(rollouts), experiment.tolerance),
        "two_sigma_coverage": two_sigma_coverage(states, executed),
        **comparison(experiment.demonstrated, predicted),
    }
    moment_matching, figure4 = moment_matching_figure()
    figures = {
        "figure2": gp_figure(),
        "figure3": demonstrations_figure(experiment),
        "figure4": figure4,
        "figure5": plot_poses(
            joints_of(match_space(executed[0])), experiment.demonstrations.time_step
        ),
        "figure6": plot_distributions(
            match_space.names,
            match_space.units,
            experiment.demonstrations.time_step,
            experiment.demonstrations.positions,
            experiment.demonstrated,
            predicted,
            match_space(executed),
        ),
    }
    return Results(headline | moment_matching, figures)


def comparison(demonstrated: Gaussian, predicted: Gaussian) -> dict[str, float]:
    """Distance of the predicted from the demonstrated positions.

    The KL, the largest difference of the means, and the correlation of spreads in x1.
    """
    spreads = torch.stack([demonstrated.std[:, 0], predicted.std[:, 0]])
    return {
        "kl_nats": trajectory_kl(demonstrated, predicted).item(),
        "largest_mean_difference_m": (demonstrated.mean - predicted.mean).abs().max().item(),
        "x1_std_correlation": torch.corrcoef(spreads)[0, 1].item(),
    }


def demonstrations_figure(experiment: Task) -> Figure:
    """Figure 3: the double pendulum's demonstrations."""
    match_space, demonstrations = experiment.space.match_space, experiment.demonstrations
    return plot_demonstrations(
        match_space.names,
        match_space.units,
        demonstrations.time_step,
        demonstrations.positions,
        experiment.demonstrated,
    )


def gp_figure() -> Figure:
    """Figure 2: a Gaussian process of one input."""
    gp, grid = one_dimension.fitted_gp(), torch.linspace(-6, 6, 400, dtype=torch.float64)
    inputs, targets = gp.train_inputs[:, 0], gp.train_targets[:, 0]
    return plot_gp(
        inputs, targets, grid, one_dimension.posterior(gp, grid), one_dimension.TEST_INPUT
    )


def moment_matching_figure() -> tuple[dict[str, float], Figure]:
    """Figure 4: moment matching, and how well the moments agree with samples."""
    gp, belief = one_dimension.fitted_gp(), one_dimension.BELIEF
    grid = torch.linspace(-3.2, 2.0, 400, dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    samples = one_dimension.sample_output(gp, belief, one_dimension.SAMPLES, generator)
    matched = one_dimension.matched_output(gp, belief).gaussian
    figure = plot_moment_matching(grid, one_dimension.posterior(gp, grid), belief, samples, matched)
    return agreement(matched, samples), figure


def agreement(matched: Gaussian, samples: Tensor) -> dict[str, float]:
    """Agreement of matched moments with samples of the exact distribution.

    It is the difference of the means in standard errors and the ratio of the standard deviations.
    """
    standard_error = samples.std() / len(samples) ** 0.5
    difference = (matched.mean[0] - samples.mean()) / standard_error
    return {
        "moment_matching_mean_difference_se": difference.item(),
        "moment_matching_std_ratio": (matched.std[0] / samples.std()).item(),
    }


FIGURE6 = PaperExperiment(
    "figure6",
    "demonstrated, predicted and executed trajectories of one learned policy",
    needed_runs,
    results,
)
