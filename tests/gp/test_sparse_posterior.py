"""Sparse posteriors: the exact one where nothing is left out, and the formulas of FITC without the
matrix inversion lemma.
"""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torch_pmil.gp.gaussian import NotPositiveDefiniteError
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.kernel_pairs import gram
from torch_pmil.gp.sparse_posterior import inducing_data, sparse_posterior

OUTPUTS, INPUTS, DATA, INDUCING = 2, 3, 40, 12
Model = dict[str, Tensor]


@pytest.fixture
def model() -> Model:
    """Data of smooth functions, and hyper-parameters that differ by output."""
    generator = torch.Generator().manual_seed(0)
    inputs = torch.randn(DATA, INPUTS, dtype=torch.float64, generator=generator)
    return {
        "inputs": inputs,
        "targets": torch.stack([inputs.sum(-1).sin(), inputs[:, 0] * inputs[:, 1]]),
        "lengthscales": torch.tensor([[1.0, 1.5, 2.0], [2.0, 0.8, 1.2]], dtype=torch.float64),
        "signal_variance": torch.tensor([1.0, 2.5], dtype=torch.float64),
        "noise_variance": torch.tensor([0.01, 0.04], dtype=torch.float64),
        "offset": torch.tensor([0.3, -0.2], dtype=torch.float64),
    }


@pytest.fixture
def points() -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.randn(9, INPUTS, dtype=torch.float64, generator=generator)


NO_RIDGE = torch.zeros(OUTPUTS, dtype=torch.float64)


def test_gram_has_the_values_of_the_kernel(model: Model, points: Tensor) -> None:
    f = KernelExpansion.from_data(**model)
    values = gram(points, model["inputs"], model["lengthscales"], model["signal_variance"])
    assert_close(values.transpose(0, 1), f.kernel(points))


def test_all_data_as_inducing_inputs_give_the_exact_posterior(model: Model, points: Tensor) -> None:
    exact = KernelExpansion.from_data(**model)
    sparse = sparse_posterior(**model, inducing=model["inputs"], ridge=NO_RIDGE)
    for ours, wanted in zip(sparse.predict(points), exact.predict(points), strict=True):
        assert_close(ours, wanted, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("ridge", [0.0, 0.1])
@pytest.mark.parametrize("own", [False, True], ids=["shared", "own inducing inputs"])
def test_posterior_is_that_of_the_fitc_prior(
    model: Model, points: Tensor, own: bool, ridge: float
) -> None:
    """With Q = K_nm (K_mm + ridge)^-1 K_mn the data have the covariance Q + diag(K - Q) + noise,
    and with a new point the covariance Q alone.
    """
    inducing = model["inputs"][:INDUCING]
    if own:
        inducing = torch.stack([inducing, model["inputs"][-INDUCING:]])
    sparse = sparse_posterior(**model, inducing=inducing, ridge=NO_RIDGE + ridge)
    kernel = model["lengthscales"], model["signal_variance"]
    between = gram(inducing, inducing, *kernel) + ridge * torch.eye(INDUCING).double()
    known = gram(model["inputs"], inducing, *kernel)
    new = gram(points, inducing, *kernel)
    data_cov = known @ torch.linalg.solve(between, known.mT)
    independent = model["signal_variance"][:, None] - data_cov.diagonal(dim1=1, dim2=2)
    data_cov = data_cov + torch.diag_embed(independent + model["noise_variance"][:, None])
    cross = new @ torch.linalg.solve(between, known.mT)
    centred = (model["targets"] - model["offset"][:, None])[..., None]
    mean = (cross @ torch.linalg.solve(data_cov, centred))[..., 0] + model["offset"][:, None]
    told = (cross * torch.linalg.solve(data_cov, cross.mT).mT).sum(-1)
    variance = model["signal_variance"][:, None] - told
    ours = sparse.predict(points)
    assert_close(ours[0].mT, mean, rtol=1e-8, atol=1e-10)
    assert_close(ours[1].mT, variance, rtol=1e-8, atol=1e-10)


def test_gradients_are_those_of_differences(model: Model) -> None:
    small = {name: values[:5] if name == "inputs" else values for name, values in model.items()}
    small["targets"] = model["targets"][:, :5]

    def mean(inducing: Tensor, lengthscales: Tensor) -> Tensor:
        given = small | {"lengthscales": lengthscales}
        f = sparse_posterior(**given, inducing=inducing, ridge=NO_RIDGE + 1e-3)
        return torch.cat(f.predict(inducing[0] + 0.1))

    inducing = model["inputs"][5:7].clone().requires_grad_(True)
    lengthscales = model["lengthscales"].clone().requires_grad_(True)
    assert torch.autograd.gradcheck(mean, (inducing, lengthscales))


def test_inducing_inputs_that_coincide_need_a_ridge(model: Model) -> None:
    twice = model["inputs"][[0, 0]]
    with pytest.raises(NotPositiveDefiniteError, match="of the inducing inputs"):
        sparse_posterior(**model, inducing=twice, ridge=NO_RIDGE)
    sparse_posterior(**model, inducing=twice, ridge=NO_RIDGE + 1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inducing": torch.zeros(4, 2).double()}, "inducing must have shape"),
        ({"inducing": torch.zeros(3, 4, 3).double()}, "inducing must have shape"),
        ({"ridge": torch.zeros(3).double()}, "ridge must have shape"),
        ({"ridge": NO_RIDGE - 1}, "ridge must not be negative, got -1"),
        ({"noise_variance": NO_RIDGE}, "noise_variance of a sparse posterior must be positive"),
        ({"targets": torch.zeros(2, 3).double()}, "inputs must have shape"),
    ],
)
def test_bad_arguments_are_refused(model: Model, change: Model, message: str) -> None:
    given = model | {"inducing": model["inputs"][:4], "ridge": NO_RIDGE} | change
    with pytest.raises(ValueError, match=message):
        sparse_posterior(**given)


def hyperparameters(model: Model) -> tuple[Tensor, Tensor, Tensor]:
    return model["lengthscales"], model["signal_variance"], model["noise_variance"]


def trace_left(model: Model, chosen: Tensor) -> float:
    """Conditional variances of all data, over the noise, by a Schur complement."""
    values = gram(model["inputs"], model["inputs"], *hyperparameters(model)[:2])
    known = values[:, :, chosen]
    told = known @ torch.linalg.solve(values[:, chosen][:, :, chosen], known.mT)
    left = (values - told).diagonal(dim1=1, dim2=2).sum(-1)
    return (left / model["noise_variance"]).sum().item()


def test_each_inducing_datum_lowers_the_variance_of_all_data_the_most(model: Model) -> None:
    chosen = inducing_data(model["inputs"], *hyperparameters(model), 4)
    for count in range(1, 5):
        before = chosen[: count - 1].tolist()
        others = [i for i in range(DATA) if i not in before]
        left = [trace_left(model, torch.tensor([*before, other])) for other in others]
        assert trace_left(model, chosen[:count]) == pytest.approx(min(left), rel=1e-9)


def test_data_that_say_nothing_new_are_not_chosen(model: Model) -> None:
    inputs = model["inputs"][:5].repeat(3, 1)
    chosen = inducing_data(inputs, *hyperparameters(model), 15)
    assert sorted((chosen % 5).tolist()) == [0, 1, 2, 3, 4]


def test_more_inducing_inputs_than_data_are_refused(model: Model) -> None:
    with pytest.raises(ValueError, match="count must be a whole number from 1 to 40, got 41"):
        inducing_data(model["inputs"], *hyperparameters(model), 41)
