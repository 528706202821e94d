"""The trajectory of the model's mean alone, and its adjoint: nothing is uncertain."""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np

from torch_pmil.model.compiled.arrays import Functions, NetworkGradient
from torch_pmil.model.compiled.building import Array1, Array2, Kernel, compiled, part
from torch_pmil.model.compiled.small_matrices import times_vector
from torch_pmil.model.compiled.thin_products import (
    add_multiple,
    add_squares,
    fill,
    multiply_entries,
    sum_products,
    write_exponentials,
)
from torch_pmil.model.compiled.trajectory import Robot


class MeanTape(NamedTuple):
    """What the mean's trajectory leaves for its adjoint.

    Args:
        states: at t = 0..T, (T + 1, D).
        inputs: features and action, (T, D' + F).
        gain: derivatives of the features by their phases, (T, D').
        raw: actions before squashing, (T, F).
    """

    states: Array2
    inputs: Array2
    gain: Array2
    raw: Array2

    @classmethod
    def of(cls, robot: Robot, horizon: int) -> MeanTape:
        """Room for so many steps."""
        (R, D), F = robot.rows.shape, len(robot.u_max)
        shapes = ((horizon + 1, D), (horizon, R + F), (horizon, R), (horizon, F))
        return cls(*(np.empty(shape) for shape in shapes))


class MeanWork(NamedTuple):
    """Room for the values of functions at one point.

    Args:
        nu: data less the point, (D, n).
        exponents, kernel: (n,).
    """

    nu: Array2
    exponents: Array1
    kernel: Array1

    @classmethod
    def of(cls, f: Functions) -> MeanWork:
        """Room for these functions."""
        n = f.inputs.shape[1]
        return cls(np.empty_like(f.inputs), np.empty(n), np.empty(n))


@Kernel
def predict_mean(robot: Robot, tape: MeanTape, of_model: MeanWork, of_network: MeanWork) -> bool:
    """Fill a tape from ``states[0]`` on."""
    D, R, F = robot.rows.shape[1], len(robot.rows), len(robot.u_max)
    for t in range(len(tape.inputs)):
        inputs = tape.inputs[t]
        times_vector(robot.rows, tape.states[t], inputs)
        for r in range(R):
            phase = inputs[r] + robot.turns[r]
            inputs[r] = phase if r < robot.kept else cos(phase)
            tape.gain[t, r] = 1.0 if r < robot.kept else -sin(phase)
        _centre(robot.network.inputs, inputs, of_network.nu)
        for k in range(F):
            tape.raw[t, k] = _value(robot.network, k, of_network)
            inputs[R + k] = robot.u_max[k] * sin(tape.raw[t, k])
        _centre(robot.model.inputs, inputs, of_model.nu)
        for d in range(D):
            change = _value(robot.model, d, of_model)
            tape.states[t + 1, d] = tape.states[t, d] + change if robot.differences else change
    return True


@compiled
def _centre(data, point, nu):
    for d in range(len(data)):
        for i in range(data.shape[1]):
            nu[d, i] = data[d, i] - point[d]


@compiled
def _value(f, a, work):
    """Function a at the point; its kernel stays in ``work``."""
    fill(work.exponents, f.log_signal[a])
    for d in range(len(work.nu)):
        add_squares(-0.5 / f.squares[a, d], work.nu[d], work.exponents)
    write_exponentials(work.exponents, work.kernel)
    return f.offset[a] + sum_products(f.weights[a], work.kernel)


@Kernel
def adjoint_of_mean(
    robot: Robot,
    tape: MeanTape,
    d_states: Array2,
    of_model: MeanWork,
    of_network: MeanWork,
    d_inputs: Array1,
    d_state: Array1,
    out: NetworkGradient,
) -> bool:
    """Gradients in start and network from cotangents of the states at t = 1..T.

    Args:
        robot, tape, of_model, of_network: as in :func:`predict_mean`.
        d_states: cotangents, (T, D).
        d_inputs: scratch, (D' + F,).
        d_state: out, gradient in the start, (D,).
        out: gradient in the network, to which is added.
    """
    D, R, F = robot.rows.shape[1], len(robot.rows), len(robot.u_max)
    for d in range(D):
        d_state[d] = 0.0
    for t in range(len(d_states) - 1, -1, -1):
        for i in range(R + F):
            d_inputs[i] = 0.0
        _centre(robot.model.inputs, tape.inputs[t], of_model.nu)
        for d in range(D):
            d_state[d] += d_states[t, d]
            _value(robot.model, d, of_model)
            multiply_entries(robot.model.weights[d], of_model.kernel, of_model.kernel)
            for i in range(R + F):
                slope = sum_products(of_model.nu[i], of_model.kernel) / robot.model.squares[d, i]
                d_inputs[i] += d_state[d] * slope
            if not robot.differences:
                d_state[d] = 0.0
        _centre(robot.network.inputs, tape.inputs[t], of_network.nu)
        for k in range(F):
            scale = d_inputs[R + k] * robot.u_max[k] * cos(tape.raw[t, k])
            _adjoint_of_network_value(robot.network, k, scale, of_network, d_inputs, out)
        for r in range(R):
            for d in range(D):
                d_state[d] += robot.rows[r, d] * tape.gain[t, r] * d_inputs[r]
    return True


@part
def _adjoint_of_network_value(f, k, scale, work, d_inputs, out):
    _value(f, k, work)
    add_multiple(scale, work.kernel, out.weights[k])
    multiply_entries(f.weights[k], work.kernel, work.kernel)
    for d in range(len(work.nu)):
        square = f.squares[k, d]
        multiply_entries(work.nu[d], work.kernel, work.exponents)
        d_inputs[d] += scale * sum_products(work.nu[d], work.kernel) / square
        add_multiple(-scale / square, work.exponents, out.inputs[d])
        form = sum_products(work.nu[d], work.exponents)
        out.squares[k, d] += scale * form / square / square / 2.0
