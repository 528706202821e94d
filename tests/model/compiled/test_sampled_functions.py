"""Drawn functions by the kernels beside the formulas, and their slopes beside differences."""

from __future__ import annotations

import gc
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.two_ways import formulas_alone, kernels_alone
from torch_pmil.model.compiled import packing
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.function_samples import FunctionSamples

N, E = 5, 3
EXACT, SPARSE = 1000, 15  # most data of an exact posterior; the other has 12 inducing inputs
kinds_of_posteriors = pytest.mark.parametrize(
    "most_exact", [EXACT, SPARSE], ids=["exact", "sparse"]
)


def drawn_functions(
    draws: Draws, D: int = 3, n: int = 21, most_exact: int = EXACT
) -> FunctionSamples:
    """Of outputs with lengthscales, signals and offsets of their own, and data far from zero."""
    dynamics = GPDynamics(D, E, most_exact=most_exact, num_inducing=min(12, most_exact))
    dynamics.set_data(2.0 + draws.normal(n, D), draws.normal(n, E))
    kernel = dynamics.gp.covar_module
    kernel.base_kernel.lengthscale = draws.uniform(0.7, 3.0, E, 1, D)
    kernel.outputscale = draws.uniform(0.3, 2.0, E)
    dynamics.gp.likelihood.noise = torch.full((E, 1), 0.05, dtype=torch.float64)
    dynamics._expansion = None
    assert dynamics.sparse == (most_exact == SPARSE)
    functions = dynamics.functions(N, draws.generator)
    return replace(functions, expansion=replace(functions.expansion, offset=draws.normal(E)))


def value_and_gradient(
    functions: FunctionSamples, inputs: Tensor, of_outputs: Tensor
) -> list[Tensor]:
    x = inputs.clone().requires_grad_()
    outputs = functions(x)
    return [outputs.detach(), *torch.autograd.grad(outputs, x, of_outputs)]


@kinds_of_posteriors
@pytest.mark.parametrize("batch", [(), (3,), (2, 3), (0,)])
@pytest.mark.parametrize(("D", "n"), [(3, 21), (9, 24), (1, 17)])
def test_outputs_and_gradients_are_those_of_the_formulas(
    draws: Draws, D: int, n: int, batch: tuple[int, ...], most_exact: int
) -> None:
    functions = drawn_functions(draws, D, n, most_exact)
    given = functions, 2.0 + draws.normal(N, *batch, D), draws.normal(N, *batch, E)
    with formulas_alone():
        expected = value_and_gradient(*given)
    with kernels_alone():
        found = value_and_gradient(*given)
    for ours, reference in zip(found, expected, strict=True):
        assert ours.shape == reference.shape
        largest = reference.abs().max().item() if reference.numel() else 0.0
        assert_close(ours, reference, rtol=1e-10, atol=1e-12 * largest)


@kinds_of_posteriors
@pytest.mark.parametrize("batch", [(), (3,)])
def test_gradients_are_difference_quotients(
    draws: Draws, batch: tuple[int, ...], most_exact: int
) -> None:
    functions = drawn_functions(draws, most_exact=most_exact)
    with kernels_alone():
        assert gradcheck(functions, (2.0 + draws.normal(N, *batch, 3)).requires_grad_())


def test_inputs_may_lie_in_memory_in_any_order(draws: Draws) -> None:
    functions, inputs = drawn_functions(draws), draws.normal(3, 4, N)
    given = inputs.permute(2, 1, 0), draws.normal(E, 4, N).permute(2, 1, 0)
    contiguous = [each.contiguous() for each in given]
    results = [value_and_gradient(functions, *each) for each in (given, contiguous)]
    assert all(torch.equal(*pair) for pair in zip(*results, strict=True))


def test_functions_are_packed_once_and_let_go_with_their_pack(
    draws: Draws, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack, packed = packing._packed, []
    monkeypatch.setattr(packing, "_packed", lambda f: packed.append(f) or pack(f))
    functions, others = drawn_functions(draws), drawn_functions(draws)
    gc.collect()
    before = len(packing._packs_of_draws)
    for _ in range(3):
        functions(draws.normal(N, 3))
        others(draws.normal(N, 3))
    assert len(packed) == 2 and len(packing._packs_of_draws) == before + 2
    del functions, others
    gc.collect()
    assert len(packing._packs_of_draws) == before


@pytest.mark.parametrize("shape", [(N, 2), (N, 4), (N + 1, 3), (N - 1, 3), (3,)])
def test_inputs_of_other_shapes_are_refused_by_the_formulas(
    draws: Draws, shape: tuple[int, ...]
) -> None:
    """The kernels would read beyond their arrays."""
    with pytest.raises((RuntimeError, ValueError)):
        drawn_functions(draws)(draws.normal(*shape))


def test_functions_share_inputs_by_broadcasting(draws: Draws) -> None:
    functions, inputs = drawn_functions(draws), draws.normal(1, 4, 3)
    assert_close(functions(inputs), functions(inputs.expand(N, 4, 3)), rtol=1e-10, atol=1e-12)
