"""Moments and their derivatives from sums over the data, against moment matching and its graph."""

from __future__ import annotations

import gc
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.gp import exponential_sums, moment_derivatives
from torch_pmil.gp.gaussian import Gaussian, symmetric
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_derivatives import MomentDerivatives, RecordedMoments
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.gp.moments import Moments

D, E = 3, 2


def gp_of_own_inputs(draws: Draws, n: int, D: int, E: int) -> KernelExpansion:
    """A GP posterior of which each output has inputs of its own."""
    gp = draws.gp(n, D, E)
    return KernelExpansion.from_data(
        draws.normal(E, n, D),
        draws.normal(E, n),
        gp.lengthscales,
        gp.signal_variance,
        gp.noise_variance,
        gp.offset,
    )


Make = Callable[[Draws, int, int, int], KernelExpansion]
kinds = pytest.mark.parametrize(
    ("make", "noise"),
    [(Draws.gp, False), (Draws.gp, True), (gp_of_own_inputs, False), (Draws.network, False)],
    ids=["GP", "observed GP", "GP of own inputs", "network"],
)


def parts(moments: Moments) -> tuple[Tensor, Tensor, Tensor]:
    return moments.mean, moments.cov, moments.inv_cov_cross_cov


def cotangents(draws: Draws, N: int, C: int, outputs: int = E) -> tuple[Tensor, Tensor, Tensor]:
    """C cotangents of the moments at each of N beliefs; that of the covariance is symmetric."""
    return (
        draws.normal(N, C, outputs),
        symmetric(draws.normal(N, C, outputs, outputs)),
        draws.normal(N, C, D, outputs),
    )


def adjoint_by_graph(
    f: KernelExpansion, belief: Gaussian, noise: bool, d_moments: tuple[Tensor, ...]
) -> tuple[Tensor, Tensor]:
    """The same as :meth:`MomentDerivatives.adjoint`, one copy after the other."""
    mean, cov = (t.clone().requires_grad_() for t in (belief.mean, belief.cov))
    moments = parts(moment_match(f, Gaussian(mean, cov), noise))
    copies = [
        torch.autograd.grad(moments, (mean, cov), [d[:, c] for d in d_moments], retain_graph=True)
        for c in range(d_moments[0].shape[1])
    ]
    d_mean, d_cov = (torch.stack(copy, 1) for copy in zip(*copies, strict=True))
    return d_mean, symmetric(d_cov)


def assert_adjoint_is_that_of_the_graph(
    draws: Draws, derivatives: MomentDerivatives, belief: Gaussian, noise: bool, C: int = 4
) -> None:
    d_moments = cotangents(draws, len(belief.mean), C, derivatives.f.num_outputs)
    d_mean, d_cov = derivatives.adjoint(*d_moments)
    for ours, theirs in zip(
        (d_mean, d_cov), adjoint_by_graph(derivatives.f, belief, noise, d_moments), strict=True
    ):
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-9 * theirs.abs().max().item())
    assert torch.equal(d_cov, d_cov.mT)


# --- one call ---


@kinds
@pytest.mark.parametrize("N", [1, 4])
def test_recorded_moments_are_those_of_moment_matching(
    draws: Draws, make: Make, noise: bool, N: int
) -> None:
    f, belief = make(draws, 9, D, E), draws.belief(N, D)
    recorded = RecordedMoments(f, noise)
    now, later = recorded(belief), recorded.derivatives.moments
    for expected, ours, again in zip(
        *map(parts, (moment_match(f, belief, noise), now, later)), strict=True
    ):
        torch.testing.assert_close(ours, expected, rtol=1e-11, atol=1e-11)
        torch.testing.assert_close(again, expected, rtol=1e-11, atol=1e-11)


def test_recorded_moments_have_no_graph(draws: Draws) -> None:
    f, belief = draws.network(5, D, E), draws.belief(1, D)
    f.weights.requires_grad_()
    recorded = RecordedMoments(f)
    moments = recorded(Gaussian(belief.mean.requires_grad_(), belief.cov.requires_grad_()))
    assert not any(part.requires_grad for part in parts(moments))


@kinds
@pytest.mark.parametrize(("N", "C"), [(1, 1), (1, 5), (3, 4)])
def test_adjoint_is_that_of_the_graph(
    draws: Draws, make: Make, noise: bool, N: int, C: int
) -> None:
    f, belief = make(draws, 9, D, E), draws.belief(N, D)
    recorded = RecordedMoments(f, noise)
    recorded(belief)
    assert_adjoint_is_that_of_the_graph(draws, recorded.derivatives, belief, noise, C)


@kinds
@pytest.mark.parametrize("outputs", [1, 3])
def test_adjoint_for_other_numbers_of_outputs(
    draws: Draws, make: Make, noise: bool, outputs: int
) -> None:
    f, belief = make(draws, 6, D, outputs), draws.belief(2, D)
    recorded = RecordedMoments(f, noise)
    recorded(belief)
    assert_adjoint_is_that_of_the_graph(draws, recorded.derivatives, belief, noise)


@kinds
@pytest.mark.parametrize("rank", [0, 1], ids=["zero", "singular"])
def test_adjoint_at_a_singular_covariance(draws: Draws, make: Make, noise: bool, rank: int) -> None:
    root = draws.normal(2, D, rank)
    f, belief = make(draws, 8, D, E), Gaussian(draws.normal(2, D), root @ root.mT)
    recorded = RecordedMoments(f, noise)
    recorded(belief)
    assert_adjoint_is_that_of_the_graph(draws, recorded.derivatives, belief, noise)


@kinds
def test_data_far_away_leave_zero_derivatives(draws: Draws, make: Make, noise: bool) -> None:
    f, belief = make(draws, 8, D, E), draws.belief(2, D)
    recorded = RecordedMoments(f, noise)
    moments = recorded(Gaussian(belief.mean + 1e3, belief.cov))
    torch.testing.assert_close(
        moments.mean, torch.as_tensor(f.offset, dtype=torch.float64).expand(2, E)
    )
    for derivative in recorded.derivatives.adjoint(*cotangents(draws, 2, 3)):
        assert (derivative == 0).all()


# --- several calls ---


@kinds
@pytest.mark.parametrize(
    "kept", [0, 500, 2**30], ids=["summed up at once", "in between", "at the end"]
)
def test_calls_are_linearised_together_in_their_order(
    draws: Draws, monkeypatch: pytest.MonkeyPatch, make: Make, noise: bool, kept: int
) -> None:
    monkeypatch.setattr(moment_derivatives, "KEPT_NUMBERS", kept)
    f, beliefs = make(draws, 7, D, E), draws.belief(5, 2, D)
    recorded = RecordedMoments(f, noise)
    called = [recorded(beliefs[t]) for t in range(5)]
    derivatives = recorded.derivatives
    for t in range(5):
        for ours, expected in zip(
            parts(called[t]), parts(moment_match(f, beliefs[t], noise)), strict=True
        ):
            torch.testing.assert_close(ours, expected, rtol=1e-11, atol=1e-11)
    for ours, expected in zip(
        parts(derivatives.moments), zip(*map(parts, called), strict=True), strict=True
    ):
        torch.testing.assert_close(ours, torch.cat(expected), rtol=1e-11, atol=1e-11)
    assert_adjoint_is_that_of_the_graph(draws, derivatives, beliefs.flattened, noise)


@kinds
def test_pieces_of_the_sums_do_not_change_the_jacobian(
    draws: Draws, monkeypatch: pytest.MonkeyPatch, make: Make, noise: bool
) -> None:
    f, belief = make(draws, 9, D, E), draws.belief(2, D)

    def jacobian() -> Tensor:
        recorded = RecordedMoments(f, noise)
        recorded(belief)
        return recorded.derivatives.jacobian

    whole = jacobian()
    monkeypatch.setattr(exponential_sums, "CACHED_NUMBERS", 10)
    torch.testing.assert_close(jacobian(), whole, rtol=1e-11, atol=1e-11)


def numbers_held(root: object) -> int:
    """By all tensors that can be reached from an object; views of one memory count once."""
    memory, seen, left = {}, set(), [root]
    while left:
        item = left.pop()
        if isinstance(item, Tensor):
            memory[item.data_ptr()] = item.untyped_storage().nbytes() // item.itemsize
        elif id(item) not in seen and not isinstance(item, type):
            seen.add(id(item))
            left.extend(gc.get_referents(item))
    return sum(memory.values())


def test_what_is_kept_of_many_calls_does_not_grow_with_the_data(
    draws: Draws, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(moment_derivatives, "KEPT_NUMBERS", 0)
    belief = draws.belief(1, D)

    def kept(n: int) -> int:
        recorded = RecordedMoments(draws.gp(n, D, E))
        for _ in range(10):
            recorded(belief)
        return numbers_held(recorded) - numbers_held(recorded.f)

    assert 0 < kept(20) == kept(80)


# --- laws of the derivatives themselves ---


@kinds
def test_derivatives_by_the_covariance_are_half_the_second_ones_by_the_mean(
    draws: Draws, make: Make, noise: bool
) -> None:
    """Price's theorem, for the expectations E f, E df/dx and E f f' of the same functions."""
    f, belief, h = make(draws, 8, D, E), draws.belief(2, D), 1e-5
    by_f, by_product, by_slope = (d[:, :1] for d in cotangents(draws, 2, 1))
    offset = torch.as_tensor(f.offset, dtype=torch.float64)

    def derivatives(mean: Tensor) -> tuple[Tensor, Tensor]:
        recorded = RecordedMoments(f, noise)
        moments = recorded(Gaussian(mean, belief.cov))
        through_product = 2 * (by_product @ (moments.mean - offset)[:, None, :, None]).squeeze(
            -1
        )  # E f f' = cov + mean mean'
        return tuple(
            d.squeeze(1)
            for d in recorded.derivatives.adjoint(by_f + through_product, by_product, by_slope)
        )

    steps = h * torch.eye(D, dtype=torch.float64)
    second = torch.stack(
        [derivatives(belief.mean + step)[0] - derivatives(belief.mean - step)[0] for step in steps],
        -1,
    ) / (2 * h)
    by_cov = derivatives(belief.mean)[1]
    torch.testing.assert_close(by_cov, second / 2, rtol=0, atol=1e-7 * by_cov.abs().max().item())


def test_single_kernel_has_the_derivatives_of_its_formula() -> None:
    """E f = alpha^2 / sqrt(1 + s) exp(-m^2 / 2(1 + s)) in one dimension, with unit width and the
    centre at zero.
    """
    m, s, alpha2 = 0.7, 0.4, 1.3
    one = torch.ones(1, 1, dtype=torch.float64)
    recorded = RecordedMoments(KernelExpansion(0 * one, one, one, alpha2 * one[0]))
    recorded(Gaussian(torch.full_like(one, m), torch.full_like(one[None], s)))
    mean = (
        alpha2
        / (1 + s) ** 0.5
        * torch.exp(torch.tensor(-m * m / 2 / (1 + s), dtype=torch.float64)).item()
    )
    d_mean, d_cov = recorded.derivatives.adjoint(
        one[None], 0 * one[None, None], 0 * one[None, None]
    )
    assert d_mean.item() == pytest.approx(-m / (1 + s) * mean, rel=1e-12)
    assert d_cov.item() == pytest.approx((m * m / (1 + s) - 1) / (1 + s) / 2 * mean, rel=1e-12)
    d_mean, d_cov = recorded.derivatives.adjoint(
        0 * one[None], 0 * one[None, None], one[None, None]
    )
    assert d_mean.item() == pytest.approx((m * m / (1 + s) - 1) / (1 + s) * mean, rel=1e-12)
    assert d_cov.item() == pytest.approx(
        (3 * m - m**3 / (1 + s)) / (1 + s) ** 2 / 2 * mean, rel=1e-12
    )


def test_kept_products_are_those_that_the_gradient_is_made_of(draws: Draws) -> None:
    """With them the moments and their gradient in the network cost no exponential, and are the
    same.
    """
    f, beliefs = draws.network(9, 3, 2), draws.belief(6, 3)
    recorded = RecordedMoments(f, keep_products=True)
    for half in (beliefs[:3], beliefs[3:]):
        recorded(half)
    found = []
    for products in (recorded.products, None):
        leaves = tuple(
            tensor.clone().requires_grad_() for tensor in (f.inputs, f.weights, f.lengthscales)
        )
        moments = moment_match(
            KernelExpansion(*leaves, f.signal_variance), beliefs, products=products
        )
        outputs = moments.mean, moments.cov, moments.inv_cov_cross_cov
        found.append(
            (*outputs, *torch.autograd.grad(sum(output.sin().sum() for output in outputs), leaves))
        )
    torch.testing.assert_close(*found, rtol=1e-12, atol=1e-12)
