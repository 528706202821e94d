"""Trajectories of particles that each follow a function of their own, and their adjoint.

A function is a sum of waves and of squared exponentials around the data. Without waves, and with
the posterior's weights, it is the model's mean.
"""

from __future__ import annotations

from math import cos, log, pi, sin, sqrt
from typing import Any, NamedTuple

from torch_pmil.model.compiled.arrays import Functions, NetworkGradient, zeros
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
from torch_pmil.model.compiled.matching import centre
from torch_pmil.model.compiled.thin_products import fill
from torch_pmil.model.compiled.trajectory import Robot
from torch_pmil.model.compiled.vectors import (
    LOG2_E,
    WIDTH,
    add,
    load,
    multiply,
    multiply_add,
    power_of_two,
    sines_and_cosines,
    splat,
    spread,
    store,
    total,
)

OF_EXPONENT = -2.0 * log(2.0)  # slope of 2^-x² over x times itself
OF_NU = 2.0 * log(2.0)  # slope of 2^(f x²) over f x times itself
QUARTER = pi / 2.0


class Draws(NamedTuple):
    """N functions of D' + F inputs, and of E outputs."""

    waves: Array3  # frequencies in quarter turns, (E, D' + F, J)
    cosines: Array3  # weights, (N, E, J)
    sines: Array3
    scales: Array2  # by which inputs are multiplied, (E, D' + F)
    inputs: Array3  # data times the scales, negative, (E, D' + F, n)
    weights: Array3  # of 2^-|x|², x being a scaled distance from a datum, (N, E, n)
    offset: Array1  # (E,)


class ParticleTape(NamedTuple):
    """What trajectories of N particles leave for their adjoint."""

    states: Array3  # at t = 0..T, (N, T + 1, D)
    inputs: Array3  # features and action, (N, T, D' + F)
    slopes: Array4  # of the outputs in these, (N, T, E, D' + F)
    gain: Array3  # derivatives of the features by their phases, (N, T, D')
    raw: Array3  # actions before squashing, (N, T, F)

    @classmethod
    def of(cls, robot: Robot, particles: int, horizon: int) -> ParticleTape:
        """Room for so many particles and steps."""
        (R, D), F, E = robot.rows.shape, len(robot.u_max), robot.gain.shape[1]
        shapes = (horizon + 1, D), (horizon, R + F), (horizon, E, R + F), (horizon, R), (horizon, F)
        return cls(*(zeros(particles, *shape) for shape in shapes))


class ParticleWork(NamedTuple):
    """Scratch for one step of one particle."""

    nu: Array2  # centres of the network less the point, (D', m)
    factors: Array1  # of the squares of these in an exponent of two, (D',)
    point: Array1  # scaled inputs, (D' + F,)
    sums: Array2  # what results sum up in each eighth of the data, (D' + F, 8)
    squares: Array2  # the same, (D', 8)
    d_inputs: Array1  # (D' + F,)
    d_next: Array1  # (D,)

    @classmethod
    def of(cls, robot: Robot) -> ParticleWork:
        """Room for this robot."""
        (R, m), F = robot.network.inputs.shape, len(robot.u_max)
        sums = (R + F, WIDTH), (R, WIDTH)
        shapes = (R, m), (R,), (R + F,), *sums, (R + F,), (len(robot.known),)
        return cls(*(zeros(*shape) for shape in shapes))


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
                output = _output(draws, i, a, inputs, tape.slopes[i, t, a], work) + noise[i, t, a]
                for d in range(D):
                    successor[d] += of_outputs[d, a] * output
    return True


@part
def _write_inputs(
    robot: Robot, state: Array1, inputs: Array1, gain: Array1, raw: Array1, work: ParticleWork
) -> None:
    """Features of a state and the action there, around the middle of its range."""
    write_waves(robot.rows, robot.turns, robot.kept, state, inputs, gain)
    centre(robot.network.inputs, inputs, work.nu)
    for k in range(len(raw)):
        raw[k] = _network_value(robot.network, k, work)
        inputs[len(robot.rows) + k] = robot.u_max[k] * sin(raw[k])


@part
def _network_value(f: Functions, k: int, work: ParticleWork) -> float:
    """Output k of the network at the point."""
    for d in range(len(work.nu)):
        work.factors[d] = -0.5 * LOG2_E / f.squares[k, d]
    kernels = work.nu, work.factors, LOG2_E * f.log_signal[k]
    return f.offset[k] + _weighted_kernels(*kernels, f.weights[k])


@compiled
def _weighted_kernels(nu: Array2, factors: Array1, constant: float, weights: Array1) -> float:
    """The sum of weights (m,) times two to the power of a constant and of scaled squares."""
    value = splat(0.0)
    for j in range(0, len(weights), WIDTH):
        kernel = power_of_two(_exponents(nu, factors, constant, j))
        value = multiply_add(load(weights, j), kernel, value)
    return total(value)


@part
def _exponents(nu: Array2, factors: Array1, constant: float, j: int) -> Any:
    """Eight exponents of kernels, from datum j on."""
    exponents = splat(constant)
    for d in range(len(factors)):
        x = load(nu, d * nu.shape[1] + j)
        exponents = multiply_add(multiply(spread(factors, d), x), x, exponents)
    return exponents


@part
def _output(
    draws: Draws, i: int, a: int, inputs: Array1, slope: Array1, work: ParticleWork
) -> float:
    """Output a of function i, and its slope (D' + F,)."""
    sums, point, scales = work.sums, work.point, draws.scales[a]
    fill(sums, 0.0)
    for d in range(len(inputs)):
        point[d] = scales[d] * inputs[d]
    value = _add_kernels(draws.inputs[a], draws.weights[i, a], point, sums)
    for d in range(len(inputs)):
        of_input = splat(OF_EXPONENT * scales[d])
        store(sums, d * WIDTH, multiply(of_input, load(sums, d * WIDTH)))
    value += _add_waves(draws.waves[a], draws.cosines[i, a], draws.sines[i, a], inputs, sums)
    for d in range(len(inputs)):
        slope[d] = total(load(sums, d * WIDTH))
    return value + draws.offset[a]


@compiled
def _add_waves(waves: Array2, cosines: Array1, sines: Array1, point: Array1, sums: Array2) -> float:
    """The sum of waves at a point; what its slope sums up in each eighth is added to ``sums``."""
    count, value = len(cosines), splat(0.0)
    for j in range(0, count, WIDTH):
        phase = splat(0.0)
        for d in range(len(point)):
            phase = multiply_add(spread(point, d), load(waves, d * count + j), phase)
        sine, cosine = sines_and_cosines(phase)
        of_cosine, of_sine = load(cosines, j), load(sines, j)
        value = multiply_add(of_cosine, cosine, multiply_add(of_sine, sine, value))
        turned = multiply_add(of_sine, cosine, multiply(multiply(splat(-1.0), of_cosine), sine))
        turned = multiply(splat(QUARTER), turned)
        for d in range(len(point)):
            slope = multiply_add(turned, load(waves, d * count + j), load(sums, d * WIDTH))
            store(sums, d * WIDTH, slope)
    return total(value)


@compiled
def _add_kernels(data: Array2, weights: Array1, point: Array1, sums: Array2) -> float:
    """The same for squared exponentials around scaled data."""
    count, value = len(weights), splat(0.0)
    for j in range(0, count, WIDTH):
        square = splat(0.0)
        for d in range(len(point)):
            distance = add(spread(point, d), load(data, d * count + j))
            square = multiply_add(distance, distance, square)
        term = multiply(load(weights, j), power_of_two(multiply(splat(-1.0), square)))
        value = add(value, term)
        for d in range(len(point)):
            distance = add(spread(point, d), load(data, d * count + j))
            store(sums, d * WIDTH, multiply_add(term, distance, load(sums, d * WIDTH)))
    return total(value)


@Kernel
def adjoint_of_particles(
    robot: Robot,
    tape: ParticleTape,
    d_states: Array3,
    units: Array1,
    work: ParticleWork,
    d_start: Array2,
    out: NetworkGradient,
) -> bool:
    """Gradients in starts and network from cotangents of the states at t = 1..T.

    Args:
        tape: filled by :func:`follow`.
        d_states: cotangents, (N, T, D).
        units: in which the cotangent of a state has at most the norm one, (D,); 0 for no bound.
        d_start: out, gradients in the starts, (N, D).
        out: gradient in the network, to which is added.
    """
    d_inputs, d_next = work.d_inputs, work.d_next
    R, known, gain, of_outputs = len(robot.rows), robot.known, tape.gain, robot.gain
    D = len(known)
    for i in range(len(d_states)):
        d_state = d_start[i]
        for d in range(D):
            d_state[d] = 0.0
        for t in range(d_states.shape[1] - 1, -1, -1):
            inputs, slopes = tape.inputs[i, t], tape.slopes[i, t]
            _write_bounded(d_state, d_states[i, t], units, d_next)
            for k in range(len(inputs)):
                d_inputs[k] = _column_times(known, D + k - R, d_next) if k >= R else 0.0
            for a in range(len(slopes)):
                of_output = _column_times(of_outputs, a, d_next)
                for k in range(len(inputs)):
                    d_inputs[k] += of_output * slopes[a, k]
            for d in range(D):
                d_state[d] = _column_times(known, d, d_next)
            centre(robot.network.inputs, inputs, work.nu)
            for k in range(len(robot.u_max)):
                scale = d_inputs[R + k] * robot.u_max[k] * cos(tape.raw[i, t, k])
                _adjoint_of_network_value(robot.network, k, scale, work, out)
            for r in range(R):
                for d in range(D):
                    d_state[d] += robot.rows[r, d] * gain[i, t, r] * d_inputs[r]
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
def _adjoint_of_network_value(
    f: Functions, k: int, scale: float, work: ParticleWork, out: NetworkGradient
) -> None:
    """Add the scale times the derivatives of output k by the point and by the network."""
    factors, sums, of_squares = work.factors, work.sums, out.squares[k]
    for d in range(len(work.nu)):
        factors[d] = -0.5 * LOG2_E / f.squares[k, d]
    fill(sums, 0.0)
    fill(work.squares, 0.0)
    kernels = work.nu, factors, LOG2_E * f.log_signal[k]
    _add_derivatives(*kernels, f.weights[k], scale, sums, work.squares, out.weights[k], out.inputs)
    for d in range(len(work.nu)):
        square = f.squares[k, d]
        work.d_inputs[d] += total(load(sums, d * WIDTH)) / square
        of_squares[d] += total(load(work.squares, d * WIDTH)) / square / square / 2.0


@compiled
def _add_derivatives(
    nu: Array2,
    factors: Array1,
    constant: float,
    weights: Array1,
    scale: float,
    sums: Array2,
    squares: Array2,
    of_weights: Array1,
    of_inputs: Array2,
) -> None:
    """Add a scale times the derivatives of :func:`_weighted_kernels` to weights and inputs.

    To ``sums`` and ``squares`` the terms are added, times distances and times their squares.
    """
    count = len(weights)
    for j in range(0, count, WIDTH):
        kernel = multiply(splat(scale), power_of_two(_exponents(nu, factors, constant, j)))
        store(of_weights, j, add(kernel, load(of_weights, j)))
        term = multiply(load(weights, j), kernel)
        for d in range(len(factors)):
            k, x = d * WIDTH, load(nu, d * count + j)
            moment = multiply(term, x)
            store(sums, k, add(moment, load(sums, k)))
            store(squares, k, multiply_add(moment, x, load(squares, k)))
            of_centre = multiply(spread(factors, d), moment)
            store(
                of_inputs,
                d * count + j,
                multiply_add(splat(OF_NU), of_centre, load(of_inputs, d * count + j)),
            )
