"""The trajectory of the model's mean alone, and its adjoint: nothing is uncertain."""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

from torch_pmil.model.compiled.arrays import Functions, NetworkGradient, zeros
from torch_pmil.model.compiled.building import Array1, Array2, Kernel, compiled, part
from torch_pmil.model.compiled.cosines import write_waves
from torch_pmil.model.compiled.matching import centre
from torch_pmil.model.compiled.thin_products import (
    add_multiple,
    add_squares,
    fill,
    multiply_entries,
    sum_products,
    write_powers,
)
from torch_pmil.model.compiled.trajectory import Robot
from torch_pmil.model.compiled.vectors import LOG2_E


class MeanTape(NamedTuple):
    """What the mean's trajectory leaves for its adjoint."""

    states: Array2  # at t = 0..T, (T + 1, D)
    inputs: Array2  # features and action, (T, D' + F)
    gain: Array2  # derivatives of the features by their phases, (T, D')
    raw: Array2  # actions before squashing, (T, F)

    @classmethod
    def of(cls, robot: Robot, horizon: int) -> MeanTape:
        """Room for so many steps."""
        (R, D), F = robot.rows.shape, len(robot.u_max)
        shapes = ((horizon + 1, D), (horizon, R + F), (horizon, R), (horizon, F))
        return cls(*(zeros(*shape) for shape in shapes))


class MeanWork(NamedTuple):
    """Room for the values of functions at one point."""

    nu: Array2  # data less the point, (D, n)
    exponents: Array1  # (n,)
    kernel: Array1  # (n,)

    @classmethod
    def of(cls, f: Functions) -> MeanWork:
        """Room for these functions."""
        n = f.inputs.shape[1]
        return cls(zeros(*f.inputs.shape), zeros(n), zeros(n))


@Kernel
def predict_mean(robot: Robot, tape: MeanTape, of_model: MeanWork, of_network: MeanWork) -> bool:
    """Fill a tape from ``states[0]`` on; the rest is scratch."""
    rows, turns, kept, u_max = robot.rows, robot.turns, robot.kept, robot.u_max
    states, gain, raw, known = tape.states, tape.gain, tape.raw, robot.known
    D = rows.shape[1]
    for t in range(len(raw)):
        inputs = tape.inputs[t]
        write_waves(rows, turns, kept, states[t], inputs, gain[t])
        centre(robot.network.inputs, inputs, of_network.nu)
        for k in range(len(u_max)):
            raw[t, k] = _value(robot.network, k, of_network)
            inputs[len(rows) + k] = u_max[k] * sin(raw[t, k])
        centre(robot.model.inputs, inputs, of_model.nu)
        for d in range(D):
            states[t + 1, d] = robot.drift[d]
            for e in range(D):
                states[t + 1, d] += known[d, e] * states[t, e]
            for k in range(len(u_max)):
                states[t + 1, d] += known[d, D + k] * inputs[len(rows) + k]
        for a in range(robot.gain.shape[1]):
            change = _value(robot.model, a, of_model)
            for d in range(D):
                states[t + 1, d] += robot.gain[d, a] * change
    return True


@compiled
def _value(f: Functions, a: int, work: MeanWork) -> float:
    """Function a at the point; its kernel stays in ``work``."""
    nu, exponents, squares = work.nu, work.exponents, f.squares[a]
    fill(exponents, LOG2_E * f.log_signal[a])
    for d in range(len(nu)):
        add_squares(-0.5 * LOG2_E / squares[d], nu[d], exponents)
    write_powers(exponents, work.kernel)
    return f.offset[a] + sum_products(f.weights[a], work.kernel)


@Kernel
def adjoint_of_mean(
    robot: Robot,
    tape: MeanTape,
    d_states: Array2,
    of_model: MeanWork,
    of_network: MeanWork,
    d_inputs: Array1,
    d_next: Array1,
    d_state: Array1,
    out: NetworkGradient,
) -> bool:
    """Gradients in start and network from cotangents of the states at t = 1..T.

    Args:
        tape: filled by :func:`predict_mean`.
        d_states: cotangents, (T, D).
        d_inputs, d_next: scratch, (D' + F,) and (D,).
        d_state: out, gradient in the start, (D,).
        out: gradient in the network, to which is added.
    """
    rows, gain, raw, u_max = robot.rows, tape.gain, tape.raw, robot.u_max
    R, F, D, known = len(rows), len(u_max), len(d_state), robot.known
    weights, squares = robot.model.weights, robot.model.squares
    nu, kernel = of_model.nu, of_model.kernel
    for d in range(len(d_state)):
        d_state[d] = 0.0
    for t in range(len(d_states) - 1, -1, -1):
        inputs = tape.inputs[t]
        for d in range(D):
            d_next[d] = d_state[d] + d_states[t, d]
        for i in range(R):
            d_inputs[i] = 0.0
        for k in range(F):
            d_inputs[R + k] = _column_times(known, D + k, d_next)
        centre(robot.model.inputs, inputs, nu)
        for a in range(robot.gain.shape[1]):
            of_change = _column_times(robot.gain, a, d_next)
            _value(robot.model, a, of_model)
            multiply_entries(weights[a], kernel, kernel)
            for i in range(R + F):
                d_inputs[i] += of_change * sum_products(nu[i], kernel) / squares[a, i]
        for d in range(D):
            d_state[d] = _column_times(known, d, d_next)
        centre(robot.network.inputs, inputs, of_network.nu)
        for k in range(F):
            scale = d_inputs[R + k] * u_max[k] * cos(raw[t, k])
            _adjoint_of_network_value(robot.network, k, scale, of_network, d_inputs, out)
        for r in range(R):
            for d in range(len(d_state)):
                d_state[d] += rows[r, d] * gain[t, r] * d_inputs[r]
    return True


@compiled
def _column_times(matrix: Array2, column: int, values: Array1) -> float:
    """A column of a matrix times as many values."""
    total = 0.0
    for row in range(len(values)):
        total += matrix[row, column] * values[row]
    return total


@part
def _adjoint_of_network_value(
    f: Functions, k: int, scale: float, work: MeanWork, d_inputs: Array1, out: NetworkGradient
) -> None:
    """Add the scale times the derivatives of function k by the point and by the network."""
    nu, kernel, product, squares = work.nu, work.kernel, work.exponents, f.squares[k]
    of_inputs, of_squares = out.inputs, out.squares[k]
    _value(f, k, work)
    add_multiple(scale, kernel, out.weights[k])
    multiply_entries(f.weights[k], kernel, kernel)
    for d in range(len(nu)):
        square = squares[d]
        multiply_entries(nu[d], kernel, product)
        d_inputs[d] += scale * sum_products(nu[d], kernel) / square
        add_multiple(-scale / square, product, of_inputs[d])
        of_squares[d] += scale * sum_products(nu[d], product) / square / square / 2.0
