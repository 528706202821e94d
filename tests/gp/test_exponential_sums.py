"""Sums of exponentials over all pairs of data, against the whole matrix."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.memory import LargestResult
from torch_pmil.gp import exponential_sums
from torch_pmil.gp.exponential_sums import ExponentialSum, pairwise_kernel_sums

# beliefs, pairs of outputs, pairs of an output with itself, rows of left and right
N, P, OWN, D = 3, 6, 3, 4

# n data, and numbers that the cache holds: all Q in one piece, several in one, one by one, by
# several rows and by single rows of Q
sizes = pytest.mark.parametrize(
    ("n", "cached"),
    [(7, 2**16), (7, 2 * 7**2), (7, 15), (7, 12), (9, 14), (9, 3), (1, 2**16), (2, 2**16)],
    ids=["all", "two", "one", "rows", "two rows", "row", "one datum", "two data"],
)
with_and_without_M = pytest.mark.parametrize("own", [0, OWN], ids=["no M", "M"])


def whole_matrix(left: Tensor, right: Tensor, M: Tensor | None) -> Tensor:
    """Q, (N, P, n, n), with the factors of its first pairs."""
    Q = torch.einsum("...di,...dj->...ij", left, right).exp()
    if M is None:
        return Q
    return torch.cat([Q[:, : len(M)] * M, Q[:, len(M) :]], 1)


def operands(
    draws: Draws, n: int, k: int, columns: int, own: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None]:
    left, right = (0.5 * draws.normal(N, P, D, n) for _ in range(2))
    return (
        left,
        right,
        draws.normal(N, P, k, n),
        draws.normal(N, P, n, columns),
        draws.normal(own, n, n) if own else None,
    )


def assert_products_of_the_whole_matrix(
    left: Tensor, right: Tensor, w: Tensor, z: Tensor, M: Tensor | None
) -> None:
    Q = whole_matrix(left, right, M)
    wQ, Qz = pairwise_kernel_sums(left, right, w, z, M)
    assert_close(wQ, w @ Q, rtol=1e-12, atol=1e-12)
    assert_close(Qz, Q @ z, rtol=1e-12, atol=1e-12)


# --- products ---


@sizes
@with_and_without_M
@pytest.mark.parametrize(("k", "columns"), [(1, 1), (5, 1), (2, 3)])
def test_products_are_those_of_the_whole_matrix(
    draws: Draws,
    monkeypatch: pytest.MonkeyPatch,
    n: int,
    cached: int,
    own: int,
    k: int,
    columns: int,
) -> None:
    monkeypatch.setattr(exponential_sums, "CACHED_NUMBERS", cached)
    assert_products_of_the_whole_matrix(*operands(draws, n, k, columns, own))


@sizes
def test_columns_that_all_beliefs_share_need_no_copies(
    draws: Draws, monkeypatch: pytest.MonkeyPatch, n: int, cached: int
) -> None:
    monkeypatch.setattr(exponential_sums, "CACHED_NUMBERS", cached)
    left, right, w, z, M = operands(draws, n, 2, 1, OWN)
    assert_products_of_the_whole_matrix(left, right, w, z[0].expand(N, -1, -1, -1), M)


@with_and_without_M
def test_operands_stay_as_they_are(draws: Draws, own: int) -> None:
    given = operands(draws, 7, 2, 1, own)
    before = [None if operand is None else operand.clone() for operand in given]
    pairwise_kernel_sums(*given)
    for now, then in zip(given, before, strict=True):
        assert now is None or torch.equal(now, then)


@pytest.fixture
def restored_threads() -> Iterator[None]:
    """Torch works with as many threads afterwards as before."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@sizes
@with_and_without_M
@pytest.mark.usefixtures("restored_threads")
def test_number_of_threads_does_not_change_the_products(
    draws: Draws, monkeypatch: pytest.MonkeyPatch, n: int, cached: int, own: int
) -> None:
    monkeypatch.setattr(exponential_sums, "CACHED_NUMBERS", cached)
    given = operands(draws, n, 3, 2, own)
    products = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        products.append(pairwise_kernel_sums(*given))
    for one, two in zip(*products, strict=True):
        assert_close(one, two, rtol=1e-13, atol=1e-13)


@with_and_without_M
@pytest.mark.parametrize("n", [20, 60, 150])
def test_no_array_is_larger_than_a_few_caches(
    draws: Draws, monkeypatch: pytest.MonkeyPatch, n: int, own: int
) -> None:
    """Even though all Q have hundreds of times as many numbers; operands and products are smaller
    here.
    """
    cached = 1000
    monkeypatch.setattr(exponential_sums, "CACHED_NUMBERS", cached)
    left, right, w, z = (
        0.1 * draws.normal(1, P, *shape) for shape in ((1, n), (1, n), (1, n), (n, 1))
    )
    M = draws.normal(own, n, n) if own else None
    with LargestResult() as largest:
        pairwise_kernel_sums(left, right, w, z, M)
    assert cached / 2 <= largest.numbers <= 4 * cached * torch.get_num_threads()


# --- the sum and its gradient ---

ONE = 2  # the entry of left that is 1


def terms(draws: Draws, n: int, own: int) -> dict[str, Tensor | None]:
    """All arguments of the sum; the entries of left and right that are 1 are left out."""
    return {
        "left": 0.5 * draws.normal(N, P, D - 1, n),
        "right": 0.5 * draws.normal(N, P, D - 1, n),
        "w": draws.normal(P, 1, n),
        "z": draws.normal(P, 1, n),
        "M": draws.normal(own, n, n) if own else None,
    }


def with_ones(left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    one = torch.ones_like(left[:, :, :1])
    return torch.cat([left[:, :, :ONE], one, left[:, :, ONE:]], 2), torch.cat([right, one], 2)


def exponential_sum(left: Tensor, right: Tensor, w: Tensor, z: Tensor, M: Tensor | None) -> Tensor:
    return ExponentialSum.apply(*with_ones(left, right), w, z, M, ONE)


def naive_sum(left: Tensor, right: Tensor, w: Tensor, z: Tensor, M: Tensor | None) -> Tensor:
    Q = whole_matrix(*with_ones(left, right), M)
    return torch.einsum("pi,npij,pj->np", w[:, 0], Q, z[:, 0])


@sizes
@with_and_without_M
def test_sum_and_gradient_are_those_of_the_whole_matrix(
    draws: Draws, monkeypatch: pytest.MonkeyPatch, n: int, cached: int, own: int
) -> None:
    monkeypatch.setattr(exponential_sums, "CACHED_NUMBERS", cached)
    arguments, cotangent = terms(draws, n, own), draws.normal(N, P)
    leaves = [argument.requires_grad_() for argument in arguments.values() if argument is not None]
    results = []
    for function in (exponential_sum, naive_sum):
        total = function(**arguments)
        results.append((total, *torch.autograd.grad(total, leaves, cotangent)))
    for ours, naive in zip(*results, strict=True):
        assert_close(ours, naive, rtol=1e-11, atol=1e-11)


@with_and_without_M
def test_gradient_in_all_arguments(draws: Draws, own: int) -> None:
    arguments = terms(draws, 3, own)
    variables = tuple(
        argument.requires_grad_() if argument is not None else None
        for argument in arguments.values()
    )
    assert gradcheck(exponential_sum, variables)


@pytest.mark.parametrize("name", ["left", "right", "w", "z", "M"])
def test_gradient_in_one_argument_alone(draws: Draws, name: str) -> None:
    arguments = terms(draws, 3, OWN)
    assert gradcheck(
        lambda variable: exponential_sum(**{**arguments, name: variable}),
        arguments[name].requires_grad_(),
    )


def test_sum_is_the_same_without_a_graph(draws: Draws) -> None:
    arguments = terms(draws, 5, OWN)
    left, right = with_ones(arguments["left"], arguments["right"])
    rest = arguments["w"], arguments["z"], arguments["M"], ONE
    with torch.no_grad():
        without = ExponentialSum.apply(left, right, *rest)
    recorded = ExponentialSum.apply(left.requires_grad_(), right, *rest)
    assert recorded.requires_grad and not without.requires_grad
    assert torch.equal(without, recorded)


def test_gradient_is_not_differentiable_again(draws: Draws) -> None:
    arguments = terms(draws, 3, OWN)
    w = arguments["w"].requires_grad_()
    (gradient,) = torch.autograd.grad(
        exponential_sum(**arguments).square().sum(), w, create_graph=True
    )
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()
