"""The adjoint of the prediction: from cotangents of all states to those of start and network.

One sweep from the last step to the first, over what the prediction left on its tape (Eq. 22).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from torch_pmil.model.compiled.arrays import NetworkGradient
from torch_pmil.model.compiled.building import Array1, Array2, Array3, Kernel, call, part
from torch_pmil.model.compiled.small_matrices import (
    clear,
    copy,
    make_symmetric,
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
    """Cotangents of the beliefs within a step, as in :class:`StepWork`.

    Args:
        phases, features, raw, action, inputs, change: as there.
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
        robot, tape, work: as in :func:`predict`.
        d_means, d_covs: cotangents, (T, D) and (T, D, D), the latter symmetric.
        back: room for cotangents.
        d_mean, d_cov: out, gradients in mean (D,) and covariance (D, D) of the start.
        out: gradient in the network, to which is added.
    """
    for d in range(len(d_mean)):
        d_mean[d] = 0.0
        for e in range(len(d_mean)):
            d_cov[d, e] = 0.0
    for t in range(len(d_means) - 1, -1, -1):
        for d in range(len(d_mean)):
            d_mean[d] += d_means[t, d]
            for e in range(len(d_mean)):
                d_cov[d, e] += d_covs[t, d, e]
        write_features(robot, tape.mean[t], tape.cov[t], work)
        write_inputs(robot, tape, t, work)
        _adjoint_of_model(robot, tape, t, work, back, d_mean, d_cov)
        _adjoint_of_action(robot, tape, t, work, back, out)
        _adjoint_of_features(robot, work, back, d_mean, d_cov)
    return True


@part
def _adjoint_of_model(robot, tape, t, work, back, d_mean, d_cov):
    """Cotangents of the model's inputs and their slope, and the direct ones of the state."""
    inputs, change, cov, slope = work.inputs, work.change, tape.cov[t], tape.of_model.slope[t]
    D, of_slope = len(d_mean), back.change.slope
    if robot.differences:
        product(inputs.slope, slope, change.slope)
        product(cov, d_cov, of_slope)
        for d in range(D):
            for e in range(D):
                of_slope[d, e] *= 2.0
        product_with_transpose(of_slope, slope, back.inputs.slope)
        product_of_transpose(inputs.slope, of_slope, back.of_output)
        product_with_transpose(d_cov, change.slope, back.change.cov)
    else:
        clear(back.inputs.slope)
        clear(back.of_output)
    call(
        robot.steps.adjoint_of_gp,
        (
            robot.model,
            tape.of_model,
            t,
            inputs.mean,
            d_mean,
            d_cov,
            back.of_output,
            work.of_model,
            back.inputs.mean,
            back.inputs.cov,
        ),
    )
    for d in range(D):
        if not robot.differences:
            d_mean[d] = 0.0
        for e in range(D):
            direct = d_cov[d, e] + back.change.cov[d, e] + back.change.cov[e, d]
            back.change.slope[d, e] = direct if robot.differences else 0.0
    copy(back.change.slope, d_cov)


@part
def _adjoint_of_action(robot, tape, t, work, back, out):
    """Cotangents of the features and their slope, and the gradient in the network."""
    features, raw, action = work.features, work.raw, work.action
    R, F, u_max, slope = len(features.mean), len(robot.u_max), robot.u_max, tape.of_network.slope[t]
    d_inputs, d_action, d_raw, d_features = back.inputs, back.action, back.raw, back.features
    D = len(d_features.slope)
    for k in range(F):
        d_action.mean[k] = u_max[k] * d_inputs.mean[R + k]
        for other in range(F):
            scale = u_max[k] * u_max[other]
            d_action.cov[k, other] = scale * d_inputs.cov[R + k, R + other]
        of_gain = 0.0
        for d in range(R):
            entry_of_slope = 0.0
            for e in range(R):
                entry_of_slope += 2.0 * features.cov[d, e] * d_inputs.cov[e, R + k]
            for e in range(D):
                entry_of_slope += features.slope[e, d] * d_inputs.slope[e, R + k]
            of_gain += entry_of_slope * slope[d, k]
            d_action.slope[d, k] = entry_of_slope * raw.slope[0, k]
        d_raw.slope[0, k] = u_max[k] * of_gain
    call(
        robot.steps.adjoint_of_cosines,
        (
            raw.mean,
            tape.raw_cov[t],
            0,
            raw.slope[0],
            d_action.mean,
            d_action.cov,
            d_raw.slope[0],
            d_raw.mean,
            d_raw.cov,
        ),
    )
    call(
        robot.steps.adjoint_of_network,
        (
            robot.network,
            tape.of_network,
            t,
            features.mean,
            d_raw.mean,
            d_raw.cov,
            d_action.slope,
            work.of_network,
            d_features.mean,
            d_features.cov,
            out,
        ),
    )
    for d in range(R):
        d_features.mean[d] += d_inputs.mean[d]
        for e in range(R):
            entry_of_cov = d_inputs.cov[d, e]
            for k in range(F):
                entry_of_cov += d_inputs.cov[d, R + k] * action.slope[e, k]
                entry_of_cov += d_inputs.cov[e, R + k] * action.slope[d, k]
            d_features.cov[d, e] += entry_of_cov
    for d in range(D):
        for e in range(R):
            entry_of_slope = d_inputs.slope[d, e]
            for k in range(F):
                entry_of_slope += d_inputs.slope[d, R + k] * action.slope[e, k]
            d_features.slope[d, e] = entry_of_slope


@part
def _adjoint_of_features(robot, work, back, d_mean, d_cov):
    """Add the cotangents of the state, through its features."""
    phases, rows, d_features, d_phases = work.phases, robot.rows, back.features, back.phases
    for r in range(len(rows)):
        of_gain = 0.0
        for d in range(len(d_mean)):
            of_gain += d_features.slope[d, r] * rows[r, d]
        d_phases.slope[0, r] = of_gain
    call(
        robot.steps.adjoint_of_cosines,
        (
            phases.mean,
            phases.cov,
            robot.kept,
            phases.slope[0],
            d_features.mean,
            d_features.cov,
            d_phases.slope[0],
            d_phases.mean,
            d_phases.cov,
        ),
    )
    product(d_phases.cov, rows, work.linear)
    product_of_transpose(rows, work.linear, back.change.cov)
    make_symmetric(back.change.cov)
    for d in range(len(d_mean)):
        for r in range(len(rows)):
            d_mean[d] += rows[r, d] * d_phases.mean[r]
        for e in range(len(d_mean)):
            d_cov[d, e] += back.change.cov[d, e]
