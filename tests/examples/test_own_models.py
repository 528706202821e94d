"""The models of the example: what they learn of a curve, and how sure they are."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from examples.own_models import Ensemble, Matern, WithPhysics
from tests.helpers.draws import Draws
from torch_pmil.model.own_dynamics import OwnDynamics


def curve(inputs: Tensor) -> Tensor:
    return torch.stack([inputs[..., 0].sin() * inputs[..., 1], 3 * inputs[..., 1]], -1)


@pytest.fixture
def inputs(draws: Draws) -> Tensor:
    return draws.uniform(-2, 2, 60, 2)


def test_matern_draws_functions_of_its_posterior(inputs: Tensor, draws: Draws) -> None:
    """Their mean is that of the exact posterior, by the standard error of 2,000 functions."""
    model = Matern()
    model.fit(inputs, curve(inputs))
    at = draws.uniform(-1.5, 1.5, 5, 2)
    k = model._kernel((at - model.middle) / model.size)
    exact = (k @ model.inverse @ model.y[..., None])[..., 0].mT * model.scale
    functions = model.sample(2000, draws.generator)
    outputs = functions(at.expand(2000, 5, 2))
    error = outputs.std(0) / 2000**0.5
    assert ((outputs.mean(0) - exact).abs() < 5 * error).all()
    prior = (model.signal - (k @ model.inverse * k).sum(-1)).mT * model.scale**2
    assert_close(outputs.var(0), prior, rtol=0.3, atol=1e-4)
    assert ((exact - curve(at)).abs() < 0.1).all()


def test_physics_that_are_right_leave_nothing_to_learn(inputs: Tensor, draws: Draws) -> None:
    model = WithPhysics(curve)
    model.fit(inputs, curve(inputs) + 1e-3 * draws.normal(60, 2))
    functions = model.sample(20, draws.generator)
    far = torch.tensor([[5.0, -4.0]], dtype=torch.float64)
    assert_close(functions(far.expand(20, 1, 2)), curve(far).expand(20, 1, 2), rtol=0, atol=0.02)


def test_members_of_an_ensemble_agree_on_the_data_and_differ_beyond(inputs: Tensor) -> None:
    own = OwnDynamics(Ensemble(), 2, 2)
    own.fit(inputs, curve(inputs))
    functions = own.functions(10, torch.Generator())
    with torch.no_grad():
        near, far = (functions(at.expand(10, -1, 2)) for at in (inputs[:20], 5 * inputs[:20]))
    assert (near.mean(0) - curve(inputs[:20])).square().mean().sqrt() < 0.3
    assert far.std(0).mean() > 3 * near.std(0).mean()
