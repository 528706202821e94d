"""Trajectories of particles that each follow a function of their own, and their adjoint."""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from torch_pmil.model.compiled.arrays import Functions, NetworkGradient, filled_up, zeros
from torch_pmil.model.compiled.building import (
    Array1,
    Array2,
    Array3,
    Array4,
    Kernel,
    compiled,
    part,
)
from torch_pmil.model.compiled.cosines import write_waves
from torch_pmil.model.compiled.sampled_functions import Draws, add_rows, as_rows, evaluate
from torch_pmil.model.compiled.thin_products import add_multiple, fill
from torch_pmil.model.compiled.trajectory import Robot
from torch_pmil.model.compiled.vectors import (
    LOG2_E,
    WIDTH,
    add,
    load,
    multiply,
    multiply_add,
    power_of_two,
    splat,
    spread,
    store,
    total,
)


class ParticleTape(NamedTuple):
    """What trajectories of N particles leave for their adjoint."""

    states: Array3  # at t = 0..T, (N, T + 1, D)
    inputs: Array3  # features and action, (N, T, D' + F)
    slopes: Array4  # of the outputs in these, (N, T, E, W)
    gain: Array3  # derivatives of the features by their phases, (N, T, D')
    raw: Array3  # actions before squashing, (N, T, F)

    @classmethod
    def of(cls, robot: Robot, particles: int, horizon: int) -> ParticleTape:
        """Room for so many particles and steps."""
        (R, D), F, E = robot.rows.shape, len(robot.u_max), robot.gain.shape[1]
        slopes = horizon, E, filled_up(R + F)
        shapes = (horizon + 1, D), (horizon, R + F), slopes, (horizon, R), (horizon, F)
        return cls(*(zeros(particles, *shape) for shape in shapes))


class ParticleWork(NamedTuple):
    """Scratch for one step of one particle."""

    factors: Array1  # of squared distances in an exponent of two, (D',)
    point: Array1  # inputs, scaled or negative, (D' + F,)
    terms: Array1  # of a sum over waves, data or centres, as many as the most of them
    d_inputs: Array1  # (W,)
    d_centres: Array1  # (W,)
    d_next: Array1  # (D,)

    @classmethod
    def of(cls, robot: Robot, draws: Draws) -> ParticleWork:
        """Room for this robot and these functions."""
        (R, D), F, m = robot.rows.shape, len(robot.u_max), robot.network.inputs.shape[1]
        terms, inputs = max(m, draws.most_terms), filled_up(R + F)
        shapes = R, R + F, terms, inputs, inputs, D
        return cls(*(zeros(shape) for shape in shapes))


@Kernel
def follow(
    robot: Robot, draws: Draws, noise: Array3, tape: ParticleTape, work: ParticleWork
) -> bool:
    """Fill a tape from ``states[:, 0]`` on; the noise of the outputs is (N, T, E)."""
    known, of_outputs, D = robot.known, robot.gain, len(robot.known)
    for i in range(len(noise)):
        for t in range(noise.shape[1]):
            state, successor, inputs = tape.states[i, t], tape.states[i, t + 1], tape.inputs[i, t]
            _write_inputs(robot, state, inputs, tape.gain[i, t], tape.raw[i, t], work)
            for d in range(D):
                successor[d] = robot.drift[d]
                for e in range(D):
                    successor[d] += known[d, e] * state[e]
                for k in range(len(robot.u_max)):
                    successor[d] += known[d, D + k] * inputs[len(robot.rows) + k]
            for a in range(noise.shape[2]):
                slope, point, terms = tape.slopes[i, t, a], work.point, work.terms
                output = evaluate(draws, i, a, inputs, slope, point, terms) + noise[i, t, a]
                for d in range(D):
                    successor[d] += of_outputs[d, a] * output
    return True


@part
def _write_inputs(
    robot: Robot, state: Array1, inputs: Array1, gain: Array1, raw: Array1, work: ParticleWork
) -> None:
    """Features of a state and the action there, around the middle of its range."""
    write_waves(robot.rows, robot.turns, robot.kept, state, inputs, gain)
    network, R = robot.network, len(robot.rows)
    for k in range(len(raw)):
        _write_distance(network, k, inputs, work)
        of_kernels = network.inputs, work.point, work.factors, LOG2_E * network.log_signal[k]
        value = _write_terms_of_network(*of_kernels, network.weights[k], 1.0, work.terms)
        raw[k] = network.offset[k] + value
        inputs[R + k] = robot.u_max[k] * sin(raw[k])


@part
def _write_distance(network: Functions, k: int, inputs: Array1, work: ParticleWork) -> None:
    """The negative point and the factors of its squared distances from the centres."""
    for d in range(len(work.factors)):
        work.point[d] = -inputs[d]
        work.factors[d] = -0.5 * LOG2_E / network.squares[k, d]


@compiled
def _write_terms_of_network(
    centres: Array2,
    point: Array1,
    factors: Array1,
    constant: float,
    weights: Array1,
    scale: float,
    terms: Array1,
) -> float:
    """Kernels times a scale, and the sum of these times the weights."""
    count, value = len(weights), splat(0.0)
    for j in range(0, count, WIDTH):
        exponents = splat(constant)
        for d in range(len(factors)):
            distance = add(load(centres, d * count + j), spread(point, d))
            exponents = multiply_add(multiply(spread(factors, d), distance), distance, exponents)
        kernel = multiply(splat(scale), power_of_two(exponents))
        store(terms, j, kernel)
        value = multiply_add(load(weights, j), kernel, value)
    return total(value)


@Kernel
def adjoint_of_particles(
    robot: Robot,
    tape: ParticleTape,
    d_states: Array3,
    units: Array1,
    rows_of_centres: Array2,
    work: ParticleWork,
    d_start: Array2,
    of_kernels: Array4,
) -> bool:
    """Gradients in starts and kernels of the network from cotangents of the states at t = 1..T.

    Args:
        tape: filled by :func:`follow`.
        d_states: cotangents, (N, T, D).
        units: units (D,) in which the cotangent of a state is clipped to norm one; 0 for no bound.
        rows_of_centres: of the network, (m, W).
        d_start: out, gradients in the starts, (N, D).
        of_kernels: out, kernels times the gradients in the network's outputs, (F, N, T, m).
    """
    d_inputs, d_next = work.d_inputs, work.d_next
    R, known, of_outputs = len(robot.rows), robot.known, robot.gain
    D = len(known)
    for i in range(len(d_states)):
        d_state = d_start[i]
        for d in range(D):
            d_state[d] = 0.0
        for t in range(d_states.shape[1] - 1, -1, -1):
            slopes = tape.slopes[i, t]
            _write_bounded(d_state, d_states[i, t], units, d_next)
            fill(d_inputs, 0.0)
            for a in range(len(slopes)):
                add_multiple(_column_times(of_outputs, a, d_next), slopes[a], d_inputs)
            for d in range(D):
                d_state[d] = _column_times(known, d, d_next)
            for k in range(len(robot.u_max)):
                of_action = d_inputs[R + k] + _column_times(known, D + k, d_next)
                of_raw = of_action * robot.u_max[k] * cos(tape.raw[i, t, k])
                terms, inputs = of_kernels[k, i, t], tape.inputs[i, t]
                _adjoint_of_network(robot.network, k, of_raw, inputs, rows_of_centres, terms, work)
            for r in range(R):
                for d in range(D):
                    d_state[d] += robot.rows[r, d] * tape.gain[i, t, r] * d_inputs[r]
    return True


@compiled
def _write_bounded(later: Array1, own: Array1, units: Array1, out: Array1) -> None:
    """The cotangent of a state (D,), shortened to a norm of one in these units."""
    square = 0.0
    for d in range(len(out)):
        out[d] = later[d] + own[d]
        square += (units[d] * out[d]) ** 2
    if square > 1.0:
        for d in range(len(out)):
            out[d] /= sqrt(square)


@compiled
def _column_times(matrix: Array2, column: int, values: Array1) -> float:
    """A column of a matrix times as many values."""
    product = 0.0
    for row in range(len(values)):
        product += matrix[row, column] * values[row]
    return product


@part
def _adjoint_of_network(
    network: Functions,
    k: int,
    scale: float,
    inputs: Array1,
    rows_of_centres: Array2,
    of_kernels: Array1,
    work: ParticleWork,
) -> None:
    """Kernels of output k times the scale, and what they add to the gradient in the features."""
    terms, sums = work.terms, work.d_centres
    _write_distance(network, k, inputs, work)
    of_network = network.inputs, work.point, work.factors, LOG2_E * network.log_signal[k]
    value = _write_terms_of_network(*of_network, network.weights[k], scale, of_kernels)
    for j in range(0, len(of_kernels), WIDTH):
        store(terms, j, multiply(load(network.weights[k], j), load(of_kernels, j)))
    fill(sums, 0.0)
    add_rows(terms, rows_of_centres, sums)
    for d in range(len(work.factors)):
        work.d_inputs[d] += (sums[d] - inputs[d] * value) / network.squares[k, d]


# a line search may try parameters at which numbers overflow; it then steps back
@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def roll_back(
    robot: Robot,
    tape: ParticleTape,
    d_states: Array3,
    units: Array1,
    work: ParticleWork,
    d_start: Array2,
    out: NetworkGradient,
) -> None:
    """Write the gradients in the starts, and add those in the network to ``out``.

    Arguments are those of :func:`adjoint_of_particles`.
    """
    network, (N, T, _) = robot.network, d_states.shape
    centres, (F, m), R = network.inputs, network.weights.shape, len(network.inputs)
    of_kernels = zeros(F, N, T, m)
    sweep = robot, tape, d_states, units, as_rows(centres), work
    adjoint_of_particles(*sweep, d_start, of_kernels)
    x = tape.inputs[..., :R].reshape(-1, R)
    powers = np.concatenate([np.ones_like(x[:, :1]), x, np.square(x)], 1)
    for k in range(F):
        zeroth, first, second = np.split(powers.T @ of_kernels[k].reshape(-1, m), [1, R + 1])
        weights, squares = network.weights[k], network.squares[k][:, None]
        out.weights[k] += zeroth[0]
        out.inputs[:] += weights * (first - centres * zeroth) / squares
        distances = np.square(centres) * zeroth - 2.0 * centres * first + second
        out.squares[k] += (weights * distances / np.square(squares)).sum(1) / 2.0
