"""The adjoint of the prediction: one sweep back over its tape, to start and network (Eq. 22)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from torch_pmil.model.compiled.arrays import NetworkGradient
from torch_pmil.model.compiled.building import Array1, Array2, Array3, Kernel, call, compiled, part
from torch_pmil.model.compiled.cosines import write_cotangents
from torch_pmil.model.compiled.matching_adjoints import add_cotangents, clear_cotangents
from torch_pmil.model.compiled.small_matrices import (
    product,
    product_of_transpose,
    product_with_transpose,
)
from torch_pmil.model.compiled.trajectory import (
    Belief,
    Robot,
    StepWork,
    Tape,
    beliefs_of,
    write_features,
    write_inputs,
)


class Cotangents(NamedTuple):
    """Cotangents of the beliefs within a step, as in :class:`StepWork`, some of them scratch."""

    phases: Belief
    features: Belief
    raw: Belief
    action: Belief
    inputs: Belief
    change: Belief
    joint: Belief
    of_output: Array2  # of the slope of the model's moments, (D' + F, E)
    through: Belief  # of the state, scratch

    @classmethod
    def of(cls, robot: Robot) -> Cotangents:
        """Room for one step."""
        size, (D, E) = robot.model.inputs.shape[0], robot.gain.shape
        return cls(*beliefs_of(robot), np.empty((size, E)), Belief.of(D, D))


@Kernel
def adjoint(
    robot: Robot,
    tape: Tape,
    d_means: Array2,
    d_covs: Array3,
    work: StepWork,
    back: Cotangents,
    d_mean: Array1,
    d_cov: Array2,
    out: NetworkGradient,
) -> bool:
    """Gradients in the start belief and the network from cotangents of the states at t = 1..T.

    Args:
        robot, tape, work: as in :func:`predict`, which has filled the tape.
        d_means, d_covs: cotangents, (T, D) and (T, D, D), the latter symmetric.
        d_mean, d_cov: out, gradients in mean (D,) and covariance (D, D) of the start.
        out: gradient in the network; the result is added to it.
    """
    clear_cotangents(d_mean, d_cov)
    means, covs = tape.mean, tape.cov
    for t in range(len(d_means) - 1, -1, -1):
        add_cotangents(1.0, d_means[t], d_covs[t], d_mean, d_cov)
        write_features(robot, means[t], covs[t], work)
        write_inputs(robot, tape, t, work)
        _adjoint_of_model(robot, tape, t, work, back, d_mean, d_cov)
        _adjoint_of_action(robot, tape, t, work, back, out)
        _adjoint_of_features(robot, work, back, d_mean, d_cov)
    return True


@part
def _adjoint_of_model(
    robot: Robot,
    tape: Tape,
    t: int,
    work: StepWork,
    back: Cotangents,
    d_mean: Array1,
    d_cov: Array2,
) -> None:
    """Cotangents of the model's inputs and their slope, and the direct ones of the state."""
    record, d_joint, d_change, cov = tape.of_model, back.joint, back.change, tape.cov[t]
    product(work.inputs.slope, record.slope[t], work.change.slope)
    _adjoint_of_successor(robot.known, robot.gain, d_mean, d_cov, work.left, work.lifted, back)
    _adjoint_of_cross(cov, record.slope[t], work, back)
    moments = robot.model, record, t, work.inputs.mean
    cotangents = d_change.mean, d_change.cov, back.of_output, work.of_model
    call(robot.steps.adjoint_of_gp, moments + cotangents + (back.inputs.mean, back.inputs.cov))
    _add_known_cotangents(record.slope[t], d_joint, back.inputs)
    _adjoint_of_state(work, d_joint, back.through.cov, d_mean, d_cov)


@compiled
def _adjoint_of_successor(
    known: Array2,
    gain: Array2,
    d_mean: Array1,
    d_cov: Array2,
    left: Array2,
    lifted: Array2,
    back: Cotangents,
) -> None:
    """Cotangents of the joint belief (of its slope the half) and the change, from the state's."""
    for i in range(known.shape[1]):
        back.joint.mean[i] = 0.0
        for d in range(len(d_mean)):
            back.joint.mean[i] += known[d, i] * d_mean[d]
    for a in range(gain.shape[1]):
        back.change.mean[a] = 0.0
        for d in range(len(d_mean)):
            back.change.mean[a] += gain[d, a] * d_mean[d]
    product(d_cov, known, left)
    product_of_transpose(known, left, back.joint.cov)
    product(d_cov, gain, lifted)
    product_of_transpose(known, lifted, back.joint.slope)
    product_of_transpose(gain, lifted, back.change.cov)


@compiled
def _adjoint_of_cross(cov: Array2, slope: Array2, work: StepWork, back: Cotangents) -> None:
    """Cotangents of the slopes of inputs and model, through the covariances with state and action.

    ``cov`` is that of the state, ``slope`` that of the model, (D' + F, E).
    """
    d_joint, direct, d_slope, inputs = back.joint, back.change.slope, back.inputs.slope, work.inputs
    D, E = direct.shape
    R, F = len(slope) - len(d_joint.mean) + D, len(d_joint.mean) - D
    for d in range(D):
        for a in range(E):
            direct[d, a] = 0.0
            for e in range(D):
                direct[d, a] += cov[d, e] * d_joint.slope[e, a]
            direct[d, a] *= 2.0
    product_with_transpose(direct, slope, d_slope)
    product_of_transpose(inputs.slope, direct, back.of_output)
    for k in range(F):
        for d in range(D):
            for e in range(D):
                d_slope[d, R + k] += 2.0 * cov[d, e] * d_joint.cov[e, D + k]
        for i in range(len(slope)):
            for a in range(E):
                back.of_output[i, a] += 2.0 * inputs.cov[i, R + k] * d_joint.slope[D + k, a]


@compiled
def _add_known_cotangents(slope: Array2, d_joint: Belief, d_inputs: Belief) -> None:
    """Add to the cotangents of the inputs what reaches the actions without the model.

    ``slope`` is that of the model; that of ``d_joint`` is half the cotangent.
    """
    D = len(d_inputs.slope)
    R, F = len(slope) - len(d_joint.mean) + D, len(d_joint.mean) - D
    for k in range(F):
        d_inputs.mean[R + k] += d_joint.mean[D + k]
        for other in range(F):
            d_inputs.cov[R + k, R + other] += d_joint.cov[D + k, D + other]
        for i in range(len(slope)):
            entry = 0.0
            for a in range(slope.shape[1]):
                entry += d_joint.slope[D + k, a] * slope[i, a]
            d_inputs.cov[R + k, i] += entry
            d_inputs.cov[i, R + k] += entry


@compiled
def _adjoint_of_state(
    work: StepWork, d_joint: Belief, through: Array2, d_mean: Array1, d_cov: Array2
) -> None:
    """Cotangents of the state (D,) and (D, D), from those of the joint belief; with scratch."""
    of_change, of_inputs, D = work.change.slope, work.inputs.slope, len(d_mean)
    F = len(d_joint.mean) - D
    R = of_inputs.shape[1] - F
    for d in range(D):
        d_mean[d] = d_joint.mean[d]
        for e in range(D):
            through[d, e] = 0.0
            for a in range(of_change.shape[1]):
                through[d, e] += d_joint.slope[d, a] * of_change[e, a]
            for k in range(F):
                through[d, e] += d_joint.cov[d, D + k] * of_inputs[e, R + k]
    for d in range(D):
        for e in range(D):
            d_cov[d, e] = d_joint.cov[d, e] + through[d, e] + through[e, d]


@part
def _adjoint_of_action(
    robot: Robot, tape: Tape, t: int, work: StepWork, back: Cotangents, out: NetworkGradient
) -> None:
    """Cotangents of the features and their slope, and the gradient in the network."""
    raw, d_raw, d_action, d_features = work.raw, back.raw, back.action, back.features
    record, gain, d_gain = tape.of_network, raw.slope[0], d_raw.slope[0]
    slope, d_inputs = record.slope[t], back.inputs
    _adjoint_of_joint_moments(robot.u_max, slope, gain, work.features, d_inputs, d_action, d_gain)
    action = raw.mean, tape.raw_cov[t], 0, gain
    of_action = d_action.mean, d_action.cov, d_gain, d_raw.mean, d_raw.cov
    call(robot.steps.adjoint_of_cosines, action + of_action)
    moments = robot.network, record, t, work.features.mean
    of_moments = d_raw.mean, d_raw.cov, d_action.slope, work.of_network
    results = d_features.mean, d_features.cov, out
    call(robot.steps.adjoint_of_network, moments + of_moments + results)
    _add_joint_cotangents(work.action.slope, d_inputs, d_features)


@compiled
def _adjoint_of_joint_moments(
    u_max: Array1,
    slope: Array2,
    gain: Array1,
    features: Belief,
    d_inputs: Belief,
    d_action: Belief,
    d_gain: Array1,
) -> None:
    """Cotangents of the action and of the gain of its slope.

    Args:
        u_max: limits of the actions, (F,).
        slope: of the network, (D', F).
        gain: mean slope of the sines times the limits, (F,).
        features: as in :class:`StepWork`.
        d_inputs: cotangents of features and action jointly.
        d_action: out, cotangents of the sines, and of the slope of the network.
        d_gain: out, cotangents of the gain before it was multiplied by the limits, (F,).
    """
    cov, D, R, F = features.cov, len(features.slope), len(features.mean), len(u_max)
    for k in range(F):
        d_action.mean[k] = u_max[k] * d_inputs.mean[R + k]
        for other in range(F):
            d_action.cov[k, other] = u_max[k] * u_max[other] * d_inputs.cov[R + k, R + other]
        of_gain = 0.0
        for d in range(R):
            entry = 0.0
            for e in range(R):
                entry += 2.0 * cov[d, e] * d_inputs.cov[e, R + k]
            for e in range(D):
                entry += features.slope[e, d] * d_inputs.slope[e, R + k]
            of_gain += entry * slope[d, k]
            d_action.slope[d, k] = entry * gain[k]
        d_gain[k] = u_max[k] * of_gain


@compiled
def _add_joint_cotangents(slope: Array2, d_inputs: Belief, d_features: Belief) -> None:
    """Add to the cotangents of the features what reaches them without the network.

    ``slope`` is that of the action, (D', F). The cotangent of the features' slope is written.
    """
    R, F = slope.shape
    for d in range(R):
        d_features.mean[d] += d_inputs.mean[d]
        for e in range(R):
            entry = d_inputs.cov[d, e]
            for k in range(F):
                entry += d_inputs.cov[d, R + k] * slope[e, k] + d_inputs.cov[e, R + k] * slope[d, k]
            d_features.cov[d, e] += entry
    for d in range(len(d_features.slope)):
        for e in range(R):
            entry = d_inputs.slope[d, e]
            for k in range(F):
                entry += d_inputs.slope[d, R + k] * slope[e, k]
            d_features.slope[d, e] = entry


@part
def _adjoint_of_features(
    robot: Robot, work: StepWork, back: Cotangents, d_mean: Array1, d_cov: Array2
) -> None:
    """Add the cotangents of the state, through its features."""
    phases, rows, d_features, d_phases = work.phases, robot.rows, back.features, back.phases
    gain, through = d_phases.slope[0], back.through
    _write_cotangent_of_gain(rows, d_features.slope, gain)
    waves = phases.mean, phases.cov, robot.kept, phases.slope[0]
    cotangents = d_features.mean, d_features.cov, gain, d_phases.mean, d_phases.cov
    call(robot.steps.adjoint_of_cosines, waves + cotangents)
    write_cotangents(rows, d_phases.mean, d_phases.cov, work.linear, through.mean, through.cov)
    add_cotangents(1.0, through.mean, through.cov, d_mean, d_cov)


@compiled
def _write_cotangent_of_gain(rows: Array2, d_slope: Array2, out: Array1) -> None:
    """Cotangents of the phases' gain, (D',), from those of the features' slope, (D, D')."""
    for r in range(len(rows)):
        out[r] = 0.0
        for d in range(len(d_slope)):
            out[r] += d_slope[d, r] * rows[r, d]
