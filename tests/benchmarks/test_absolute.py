"""The variations of the strangers' ablation differ from the package in what they are named for."""

from __future__ import annotations

import pytest
import torch

from benchmarks.absolute import FixedHorizons, LimitedDynamics, with_fixed_criteria, with_limits
from tests.helpers.short_run import short_experiment


def test_transitions_far_from_the_demonstrations_are_left_out() -> None:
    task = with_limits(short_experiment())
    model = task.make_dynamics()
    assert isinstance(model, LimitedDynamics)
    inputs = torch.zeros(20, model.num_inputs, dtype=torch.float64)
    inputs[:, 0] = torch.linspace(0, 2, 20) * model.limits[0]
    targets = torch.arange(20.0).double()[:, None].expand(-1, model.num_outputs)
    model.set_data(inputs, targets)
    assert model.train_targets[:, 0].tolist() == list(range(10))
    model.set_data(2 * inputs, targets)  # only five are within: fewer than inputs
    assert len(model.train_inputs) == 20


@pytest.mark.parametrize("horizon", [3, 25, 100])
def test_fixed_criteria_know_neither_length_nor_number_of_entries(horizon: int) -> None:
    search = with_fixed_criteria(short_experiment()).method.search
    assert isinstance(search, FixedHorizons)
    assert (search.first_steps(horizon), search.more_steps(horizon)) == (min(5, horizon), 3)
    assert search.trust_threshold == 3 / 4
