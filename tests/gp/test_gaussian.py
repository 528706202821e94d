"""Gaussian beliefs."""

from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError, check_belief, cholesky, joint


def test_marginal_takes_entries_in_the_order_asked_for(draws: Draws) -> None:
    belief = draws.belief(5, 3)
    part = belief.marginal(torch.tensor([2, 0]))
    assert torch.equal(part.mean, belief.mean[:, [2, 0]])
    assert torch.equal(part.cov[:, 0, 1], belief.cov[:, 2, 0])
    assert torch.equal(part.cov[:, 0, 0], belief.cov[:, 2, 2])


def test_affine_map_acts_on_mean_and_covariance(draws: Draws) -> None:
    belief, matrix, offset = draws.belief(4, 3), draws.normal(2, 3), draws.normal(2)
    mapped = belief.affine(matrix, offset)
    for i in range(4):
        assert_close(mapped.mean[i], matrix @ belief.mean[i] + offset)
        assert_close(mapped.cov[i], matrix @ belief.cov[i] @ matrix.T)


def test_joint_has_the_marginals_it_was_made_of(draws: Draws) -> None:
    x, y, cross_cov = draws.belief(2, 3), draws.belief(2, 2), draws.normal(2, 3, 2)
    both = joint(x, y, cross_cov)
    for part, index in ((x, torch.arange(3)), (y, torch.arange(3, 5))):
        assert torch.equal(both.marginal(index).mean, part.mean)
        assert torch.equal(both.marginal(index).cov, part.cov)
    assert torch.equal(both.cov[:, :3, 3:], cross_cov)
    assert torch.equal(both.cov, both.cov.mT)


def test_noise_adds_to_the_variances(draws: Draws) -> None:
    belief, variance = draws.belief(4, 2), draws.uniform(0.1, 1.0, 4, 2)
    assert_close(belief.add_noise(variance).cov - belief.cov, torch.diag_embed(variance))
    assert_close(belief.add_noise(0.5).std.square(), belief.std.square() + 0.5)
    assert torch.equal(belief.add_noise(variance).mean, belief.mean)


@pytest.mark.parametrize("rank", [1, 3], ids=["singular", "regular"])
def test_samples_have_the_mean_and_covariance(draws: Draws, rank: int) -> None:
    root = draws.normal(3, rank)
    belief = Gaussian(draws.normal(3), root @ root.mT)
    count = 20_000
    deviation = belief.sample(count, draws.generator) - belief.mean
    products = deviation[:, :, None] * deviation[:, None, :]
    assert (deviation.mean(0).abs() <= 4 * belief.std / count**0.5).all()
    assert ((products.mean(0) - belief.cov).abs() <= 4 * products.std(0) / count**0.5).all()


def test_samples_of_the_same_seed_are_the_same(draws: Draws) -> None:
    belief = draws.belief(2, 3)
    first, second = (belief.sample(4, torch.Generator().manual_seed(1)) for _ in range(2))
    assert first.shape == (4, 2, 3)
    assert torch.equal(first, second)


def test_part_of_a_batch_keeps_the_variable(draws: Draws) -> None:
    belief = draws.belief(4, 5, 2)
    assert belief[1:3].batch_shape == (2, 5)
    assert belief[0, 1].dim == 2
    assert torch.equal(belief[0, 1].cov, belief.cov[0, 1])


def test_detached_belief_has_no_graph(draws: Draws) -> None:
    belief = Gaussian(draws.normal(2).requires_grad_(), draws.cov(2).requires_grad_()).detach()
    assert not belief.mean.requires_grad and not belief.cov.requires_grad


def test_number_in_place_of_a_mean_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"cov must have shape .* got \(1, 1\)"):
        Gaussian(torch.zeros(()), torch.zeros(1, 1))


def test_cholesky_error_names_matrix_element_and_eigenvalues() -> None:
    matrices = torch.eye(2).repeat(2, 3, 1, 1)
    matrices[1, 2, 0, 0] = -4.0
    message = r"the test's matrix .* eigenvalues from -4 to 1 at batch element \(1, 2\)"
    with pytest.raises(NotPositiveDefiniteError, match=message):
        cholesky(matrices, "the test's matrix")


def test_cholesky_adds_no_jitter(draws: Draws) -> None:
    cov = draws.cov(5, 3)
    factor = cholesky(cov, "cov")
    assert_close(factor @ factor.mT, cov, rtol=1e-14, atol=1e-15)


# --- beliefs that are none ---

NAN = float("nan")


@pytest.mark.parametrize(
    ("mean", "cov", "message"),
    [
        ([NAN, 0.0], [[1.0, 0.0], [0.0, 1.0]], r"mean of start must be finite, got nan in entry"),
        ([0.0, torch.inf], [[1.0, 0.0], [0.0, 1.0]], r"got inf in entry \(1,\)"),
        ([0.0, 0.0], [[1.0, NAN], [0.0, 1.0]], r"covariance of start must be finite, got nan"),
        ([0.0, 0.0], [[1.0, 0.5], [0.0, 1.0]], "must be symmetric, got entries that differ by 0.5"),
        ([0.0, 0.0], [[1.0, 0.0], [0.0, -0.1]], "must be positive definite, got eigenvalues from"),
        ([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]], "must be positive definite, got eigenvalues from"),
    ],
    ids=["nan mean", "infinite mean", "nan above", "asymmetric", "negative", "indefinite"],
)
def test_what_is_no_belief_is_an_error(mean: list, cov: list, message: str) -> None:
    belief = Gaussian(torch.tensor(mean), torch.tensor(cov))
    with pytest.raises(ValueError, match=message) as error:
        check_belief(belief, "start", belief.mean)
    assert "\n" not in str(error.value)


def test_element_of_the_batch_is_named() -> None:
    cov = torch.eye(2).repeat(3, 1, 1)
    cov[2, 0, 0] = -1
    with pytest.raises(NotPositiveDefiniteError, match=r"at batch element \(2,\)"):
        check_belief(Gaussian(torch.zeros(3, 2), cov), "start", cov)


def test_rounding_makes_a_belief_no_error(draws: Draws) -> None:
    root = draws.normal(4, 2)
    cov = root @ root.mT  # singular
    cov[0, 1] += 1e-15
    check_belief(Gaussian(draws.normal(4), cov), "start", cov)
    check_belief(Gaussian(draws.normal(4), 0 * cov), "start", cov)
    check_belief(Gaussian(draws.normal(0, 4), cov.new_zeros(0, 4, 4)), "start", cov)
