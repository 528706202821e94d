"""The adjoint of the prediction: from cotangents of all states to those of start and network.

One sweep from the last step to the first, over what the prediction left on its tape (Eq. 22).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from torch_pmil.model.compiled.arrays import NetworkGradient
from torch_pmil.model.compiled.building import Array1, Array2, Array3, Kernel, call, compiled, part
from torch_pmil.model.compiled.cosines import write_cotangents
from torch_pmil.model.compiled.matching_adjoints import add_cotangents, clear_cotangents
from torch_pmil.model.compiled.small_matrices import (
    clear,
    copy,
    product,
    product_of_transpose,
    product_with_transpose,
    scale,
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
    """Cotangents of the beliefs within a step, as in :class:`StepWork`.

    Args:
        phases, features, raw, action, inputs, change: cotangents of these; some arrays serve as
            scratch.
        of_output: of the slope of the model's moments, (D' + F, D).
    """

    phases: Belief
    features: Belief
    raw: Belief
    action: Belief
    inputs: Belief
    change: Belief
    of_output: Array2

    @classmethod
    def of(cls, robot: Robot) -> Cotangents:
        """Room for one step."""
        size, D = robot.model.inputs.shape[0], robot.rows.shape[1]
        return cls(*beliefs_of(robot), np.empty((size, D)))


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
        back: room for cotangents.
        d_mean, d_cov: out, gradients in mean (D,) and covariance (D, D) of the start.
        out: gradient in the network, to which is added.
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
    inputs, slope_of_change, record = work.inputs, work.change.slope, tape.of_model
    slope, d_inputs, of_output = record.slope[t], back.inputs, back.of_output
    direct, through_slope, differences = back.change.slope, back.change.cov, robot.differences
    if differences:
        product(inputs.slope, slope, slope_of_change)
        product(tape.cov[t], d_cov, direct)
        scale(direct, 2.0)
        product_with_transpose(direct, slope, d_inputs.slope)
        product_of_transpose(inputs.slope, direct, of_output)
        product_with_transpose(d_cov, slope_of_change, through_slope)
    else:
        clear(d_inputs.slope)
        clear(of_output)
    moments = robot.model, record, t, inputs.mean
    cotangents = d_mean, d_cov, of_output, work.of_model, d_inputs.mean, d_inputs.cov
    call(robot.steps.adjoint_of_gp, moments + cotangents)
    for d in range(len(d_mean)):
        if not differences:
            d_mean[d] = 0.0
        for e in range(len(d_mean)):
            both = d_cov[d, e] + through_slope[d, e] + through_slope[e, d]
            direct[d, e] = both if differences else 0.0
    copy(direct, d_cov)


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

    Args:
        slope: of the action in the features, (D', F).
        d_inputs: cotangents of features and action jointly.
        d_features: of the features; those of mean and covariance are added to, that of the slope is
            written.
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
    gain, through = d_phases.slope[0], back.change
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
