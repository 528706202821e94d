"""Eq. 30: the dense formula, units that do not matter, and a known best frequency."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor

from reproduction.sampling_frequency import (
    FrequencyScore,
    Recording,
    held_out_log_likelihood,
    score_frequencies,
)
from tests.helpers.draws import Draws
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.model.dynamics import GPDynamics

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (), joint_match(NAMES, UNITS))
TURNING = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))
TIME_STEP = 0.01
WHITE = -0.5 * (1 + math.log(2 * math.pi))  # of a standard normal value, on average


def recording(seed: int, seconds: float = 6.0, noise: float = 0.0) -> Recording:
    """A damped oscillator of about 1 Hz, driven by forces held for 0.1 s, with noisy sensors."""
    draws, count = Draws(seed), round(seconds / TIME_STEP)
    forces = (20 * draws.normal(count // 10, 1)).repeat_interleave(10, 0)
    state, states = torch.zeros(2, dtype=torch.float64), []
    for force in [*forces, forces[-1]]:
        states.append(state)
        q, dq = state
        dq = dq + TIME_STEP * (force[0] - 40 * q - 2 * dq)
        state = torch.stack([q + TIME_STEP * dq, dq])
    states = torch.stack(states)
    return Recording(states + noise * states.std(0) * draws.normal(*states.shape), forces)


def dense(model: GPDynamics, inputs: Tensor, held: Tensor, targets: Tensor) -> list[float]:
    """Of each output, by kernel matrices and inverses as they stand in Eqs. 6, 7 and 30."""
    known, seen = model.train_inputs.numpy(), model.train_targets.numpy()
    lengthscales = model.gp.covar_module.base_kernel.lengthscale.detach().numpy()[:, 0]
    signals = model.gp.covar_module.outputscale.detach().numpy()
    noises = model.gp.likelihood.noise.detach().numpy()[:, 0]
    values = []
    x, y = inputs[held].numpy(), targets[held].numpy()
    for output, (lengthscale, signal, noise) in enumerate(
        zip(lengthscales, signals, noises, strict=True)
    ):
        known_known, cross, held_held = (
            signal * np.exp(-0.5 * (((a[:, None] - b) / lengthscale) ** 2).sum(-1))
            for a, b in ((known, known), (x, known), (x, x))
        )
        inverse = np.linalg.inv(known_known + noise * np.eye(len(known)))
        mean = cross @ inverse @ seen[:, output]
        cov = held_held - cross @ inverse @ cross.T + noise * np.eye(len(x))
        normal = stats.multivariate_normal(mean, (cov + cov.T) / 2)
        values.append(normal.logpdf(y[:, output]) / len(x))
    return values


def test_held_out_likelihood_is_that_of_the_dense_formula_and_of_the_forward_model(
    draws: Draws,
) -> None:
    inputs = draws.normal(43, 2)
    targets = torch.stack([inputs[:, 0].sin(), inputs.prod(-1)], -1) + 0.1 * draws.normal(43, 2)
    values = held_out_log_likelihood(inputs, targets, folds=4)
    for fold, held in enumerate(torch.arange(43).tensor_split(4)):
        training = [row for row in range(43) if row not in held]
        model = GPDynamics(num_inputs=2, num_outputs=2)
        model.fit(inputs[training], targets[training])
        assert values[fold].tolist() == pytest.approx(dense(model, inputs, held, targets), abs=1e-6)


def test_errors_that_go_together_are_counted_together(draws: Draws) -> None:
    inputs = torch.linspace(0, 10, 60, dtype=torch.float64)[:, None]
    targets = (0.7 * inputs).sin() + 1e-3 * draws.normal(60, 1)
    # a fold beyond the data, where the errors are smooth
    joint = held_out_log_likelihood(inputs, targets)[0]
    model = GPDynamics(num_inputs=1, num_outputs=1)
    model.fit(inputs[12:], targets[12:])
    mean, variance = model.expansion.predict(inputs[:12])
    std = (variance + model.gp.likelihood.noise[:, 0]).sqrt()
    alone = torch.distributions.Normal(mean, std).log_prob(targets[:12])
    assert joint > alone.mean() + 1


def test_standardised_form_has_no_units_and_raw_form_shifts_by_their_logarithm() -> None:
    units = torch.tensor([1000.0, 0.01], dtype=torch.float64)
    states, actions = recording(0)
    score, scaled = (
        score_frequencies([one], TIME_STEP, [10.0], SPACE)[0]
        for one in (Recording(states, actions), Recording(units * states, 50 * actions))
    )
    assert scaled.standardised.mean == pytest.approx(score.standardised.mean, abs=0.02)
    assert scaled.raw.mean == pytest.approx(score.raw.mean - units.log().mean().item(), abs=0.02)


def test_nothing_to_learn_scores_as_white_noise(draws: Draws) -> None:
    targets = draws.normal(200, 2)
    values = held_out_log_likelihood(draws.normal(200, 2), targets)
    score = FrequencyScore(10.0, 200, values, targets.std(0))
    assert score.standardised.mean == pytest.approx(WHITE, abs=0.1)


def test_held_forces_are_best_sampled_when_they_change_and_raw_form_keeps_rising() -> None:
    frequencies = [2.0, 5.0, 10.0, 25.0, 50.0]
    recordings = [recording(seed, 2.0, noise=0.005) for seed in range(3)]
    scores = score_frequencies(recordings, TIME_STEP, frequencies, SPACE)
    standardised = [score.standardised.mean for score in scores]
    assert frequencies[int(np.argmax(standardised))] == 10.0
    assert scores[-1].raw.mean > scores[0].raw.mean


def test_transitions_are_sampled_inside_each_recording_and_actions_are_means(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[tuple[Tensor, Tensor]] = []

    def remember(inputs: Tensor, targets: Tensor, folds: int, max_iterations: int) -> Tensor:
        seen.append((inputs, targets))
        return torch.zeros(folds, 2)

    monkeypatch.setattr("reproduction.sampling_frequency.held_out_log_likelihood", remember)
    recordings = [recording(0, 1.0), recording(1, 1.1)]
    (score,) = score_frequencies(recordings, TIME_STEP, [5.0], TURNING, folds=2)
    ((inputs, targets),) = seen
    assert len(inputs) == score.transitions == 5 + 5
    for number, (states, actions) in enumerate(recordings):
        for step in range(5):
            row, now = 5 * number + step, 20 * step
            torch.testing.assert_close(targets[row], states[now + 20] - states[now])
            torch.testing.assert_close(inputs[row, :3], TURNING.features(states[now]))
            torch.testing.assert_close(inputs[row, 3:], actions[now : now + 20].mean(0))


def test_interval_is_the_t_interval_over_the_folds(draws: Draws) -> None:
    values, spread = draws.normal(5, 3), draws.normal(3).exp()
    score = FrequencyScore(10.0, 50, values, spread)
    for interval, of_folds in (
        (score.raw, values.mean(1)),
        (score.standardised, (values + spread.log()).mean(1)),
    ):
        low, high = stats.t.interval(0.95, 4, loc=of_folds.mean(), scale=stats.sem(of_folds))
        ends = [interval.mean + sign * interval.half_width for sign in (-1, 1)]
        assert ends == pytest.approx([low, high])
