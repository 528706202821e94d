"""Tensors and plans as the arrays that kernels read, and gradients as tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from torch_pmil.gp.gaussian import cholesky
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.trigonometry import Augmentation
from torch_pmil.model.compiled.arrays import Functions, NetworkGradient, filled_up, zeros
from torch_pmil.model.compiled.building import Array, Array1, Array2, Array3
from torch_pmil.model.compiled.costs import Observation
from torch_pmil.model.compiled.plans import Comparison, Drawn, Plan
from torch_pmil.model.compiled.sampled_functions import Draws, as_rows
from torch_pmil.model.compiled.trajectory import Robot, Steps
from torch_pmil.model.compiled.vectors import LOG2_E

Parameters = Sequence[Tensor]  # centres, weights and widths of a policy
DEMONSTRATED = "demonstrated covariance"


def robots_of(
    plan: Plan, parameters: Parameters, beliefs: int, moments: bool = True
) -> list[Robot]:
    """What the kernels predict with, for each belief, or for states if ``moments`` is False."""
    centres, weights, widths = (parameter.detach() for parameter in parameters)
    f, controller = plan.model, plan.controller
    model = functions_of(f) if moments else _packed(replace(f, gram_inverse=None))
    model = model._replace(
        inputs=_from_middle(model.inputs, array(controller.u_middle)),
        variance=array(f.prior_variance(plan.observation_noise)),
    )
    rows, turns, kept = _combinations(plan.space.augmentation)
    packed = [
        _packed(replace(controller.network, inputs=centres, weights=own, lengthscales=widths))
        for own in (weights if weights.ndim == 3 else [weights])
    ]
    limits, steps = array(controller.u_max), Steps.compile()
    matrix, gain = array(plan.known.matrix), array(plan.known.gain)
    drift = matrix[:, len(matrix) :] @ array(controller.u_middle)
    return [
        Robot(model, network, limits, rows, turns, kept, matrix, gain, drift, steps)
        for network in (packed if len(packed) > 1 else packed * beliefs)
    ]


def mean_of(model: Functions) -> Draws:
    """The mean of a robot's model, as one function."""
    signal, none = np.exp(model.log_signal)[:, None], zeros(1, len(model.weights), 0)
    waves = zeros(len(model.weights), len(model.inputs), 0)
    return _draws(model, waves, none, none, (model.weights * signal)[None])


def draws_of(model: Functions, drawn: Drawn, middle: Tensor) -> Draws:
    """Functions that were drawn from a robot's model, with ``middle`` of its actions' ranges."""
    turn = drawn.frequencies[..., -len(middle) :] @ middle  # (E, J): inputs are around the middle
    cosines, sines = drawn.weights.chunk(2, -1)
    moved = cosines * turn.cos() + sines * turn.sin(), sines * turn.cos() - cosines * turn.sin()
    return _draws_with(model, drawn, *moved)


_packs_of_draws: WeakKeyDictionary[Drawn, Draws] = WeakKeyDictionary()


def packed_draws(drawn: Drawn) -> Draws:
    """Drawn functions, packed for inputs that are not shifted, and cached while they exist."""
    if drawn not in _packs_of_draws:
        model = _packed(replace(drawn.expansion, gram_inverse=None))
        _packs_of_draws[drawn] = _draws_with(model, drawn, *drawn.weights.chunk(2, -1))
    return _packs_of_draws[drawn]


def _draws_with(model: Functions, drawn: Drawn, cosines: Tensor, sines: Tensor) -> Draws:
    """Functions that were drawn, with these weights of their waves, (N, E, J) each."""
    parts = drawn.frequencies.mT, cosines, sines, drawn.updates
    waves, cosine, sine, updates = (_with_zeros(array(each)) for each in parts)
    return _draws(model, waves, cosine, sine, updates * np.exp(model.log_signal)[:, None])


def _draws(
    model: Functions, waves: Array3, cosines: Array3, sines: Array3, weights: Array3
) -> Draws:
    scales, origin = np.sqrt(0.5 * LOG2_E / model.squares), model.inputs.mean(1)
    around = model.inputs - origin[:, None]
    of_prior = waves / (np.pi / 2), as_rows(waves), cosines, sines
    data = -scales[:, :, None] * around, as_rows(around)
    return Draws(*of_prior, origin, scales, *data, weights, model.offset)


def _with_zeros(values: Array3) -> Array3:
    """Values (a, b, n), with zeros up to a multiple of eight."""
    *shape, n = values.shape
    filled = zeros(*shape, filled_up(n))
    filled[..., :n] = values
    return filled


def _from_middle(inputs: Array2, middle: Array1) -> Array2:
    """Inputs (D' + F, n) with actions less the middle of their range: the model is stationary."""
    moved = zeros(*inputs.shape)
    moved[:] = inputs
    moved[-len(middle) :] -= middle[:, None]
    return moved


def observation_of(comparison: Comparison, batch: tuple[int, ...]) -> Observation:
    """The map for states (*batch, D) in one row."""
    offset = comparison.offset.expand(*batch, -1).flatten(0, -2)
    combinations = _combinations(comparison.augmentation)
    return Observation(*combinations, *map(array, (comparison.matrix, offset, comparison.noise)))


def determinants_of(comparison: Comparison, batch: tuple[int, ...]) -> tuple[Array3, Array1]:
    """Demonstrated covariances, and half the logarithms of their determinants; empty if none."""
    if comparison.demonstrated is None:
        return np.empty((0, 0, 0)), np.empty(0)
    factor = cholesky(comparison.demonstrated, DEMONSTRATED)
    half_log_det = factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    flat = comparison.demonstrated.expand(*batch, -1, -1).flatten(0, -3)
    return array(flat), array(half_log_det.expand(batch).flatten())


def roots_of(comparison: Comparison, batch: tuple[int, ...]) -> Array3:
    """Matrices G with G' G the inverse of the demonstrated covariances; else the identity."""
    root = torch.eye(comparison.offset.shape[-1], dtype=torch.float64)
    if comparison.demonstrated is not None:
        factor = cholesky(comparison.demonstrated, DEMONSTRATED)
        root = torch.linalg.solve_triangular(factor, root, upper=False)
    return array(root.expand(*batch, -1, -1).flatten(0, -3))


_packs: WeakKeyDictionary[KernelExpansion, Functions] = WeakKeyDictionary()


def functions_of(f: KernelExpansion) -> Functions:
    """A GP's posterior as the kernels read it, cached while the posterior exists."""
    if f not in _packs:
        _packs[f] = _packed(f)
    return _packs[f]


def _packed(f: KernelExpansion) -> Functions:
    """Functions, filled up with data of weight zero."""
    (n, D), E = f.inputs.shape, f.num_outputs
    padded = filled_up(n)
    inputs, weights = zeros(D, padded), zeros(E, padded)
    inputs[:, :n], weights[:, :n] = array(f.inputs.mT), array(f.weights)
    log_signal, squares = array(f.log_signal_variance), array(f.lengthscales.square())
    offsets = np.array(np.broadcast_to(np.asarray(f.offset, dtype=float), E))
    own = _own_weights(f.weights, f.gram_inverse, padded)
    signal = np.exp(log_signal)
    alike = bool((squares == squares[0]).all() & np.isfinite(signal).all())
    tied = E > 1 and len(own) > 0 and alike
    if tied:
        weights, log_signal = weights * signal[:, None], np.zeros(E)
        own *= np.square(signal)[:, None, None]
    return Functions(inputs, weights, squares, log_signal, offsets, np.zeros(E), own, tied)


def _own_weights(weights: Tensor, gram_inverse: Tensor | None, padded: int) -> Array3:
    """Weights of pairs of data in a GP's variances, as in :class:`Functions`."""
    if gram_inverse is None:
        return np.zeros((0, 0, 0))
    E, n = weights.shape
    own = zeros(E, padded, padded)
    inverses = gram_inverse.detach().numpy()
    for out, beta, inverse in zip(own, array(weights), inverses, strict=True):
        for i in range(n):  # row by row: no other matrix of that size is needed
            out[i, i:n] = beta[i] * beta[i:] - inverse[i, i:]
            out[i, i] /= 2
    return own


def _combinations(augmentation: Augmentation) -> tuple[Array2, Array1, int]:
    """Rows, turns and number of the kept ones of the combinations of the state."""
    return array(augmentation.rows), array(augmentation.turns), augmentation.kept


def gradients_of(gradients: list[NetworkGradient], parameters: Parameters) -> list[Tensor]:
    """Gradients in centres (m, D'), weights (F, m) or (N, F, m), and widths (F, D')."""
    centres, weights, widths = parameters
    m = len(centres)
    of_weights = np.stack([gradient.weights[:, :m] for gradient in gradients])
    of_inputs = np.sum([gradient.inputs[:, :m] for gradient in gradients], 0).T
    of_squares = np.sum([gradient.squares for gradient in gradients], 0)
    return [
        torch.from_numpy(of_inputs),
        torch.from_numpy(of_weights if weights.ndim == 3 else of_weights.sum(0)),
        2 * widths.detach() * torch.from_numpy(of_squares),
    ]


def array(values: Tensor) -> Array:
    """The values of a tensor as kernels take them, C-contiguous."""
    return np.ascontiguousarray(values.detach().numpy(), dtype=np.float64)
