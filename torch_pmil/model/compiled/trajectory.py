"""The prediction of T steps (Eq. 13), for one start belief and one policy.

A state has D entries, D' features and F actions, and the model E outputs.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from torch_pmil.model.compiled.arrays import Functions, Record, Workspace
from torch_pmil.model.compiled.building import (
    Address,
    Array1,
    Array2,
    Array3,
    Kernel,
    call,
    compiled,
    part,
)
from torch_pmil.model.compiled.cosines import adjoint_of_cosines, write_cosines, write_phases
from torch_pmil.model.compiled.matching import match
from torch_pmil.model.compiled.matching_adjoints import adjoint_of_gp, adjoint_of_network
from torch_pmil.model.compiled.small_matrices import (
    add,
    make_symmetric,
    product,
    product_with_transpose,
    scale,
)


class Steps(NamedTuple):
    """Addresses of the kernels that a step is made of."""

    match: Address
    adjoint_of_gp: Address
    adjoint_of_network: Address
    write_cosines: Address
    adjoint_of_cosines: Address

    @classmethod
    def compile(cls) -> Steps:
        """The addresses; kernels are compiled now if they were not before."""
        kernels = match, adjoint_of_gp, adjoint_of_network, write_cosines, adjoint_of_cosines
        return cls(*(kernel.address for kernel in kernels))


class Robot(NamedTuple):
    """What a prediction is made of."""

    model: Functions
    network: Functions  # the policy before squashing
    u_max: Array1  # limits of the F actions, (F,)
    rows: Array2  # features of the state, (D', D), as in `Augmentation`
    turns: Array1  # (D',)
    kept: int
    known: Array2  # this and gain: A (D, D + F) and C (D, E) of `KnownPart`
    gain: Array2
    drift: Array1  # known effect of the middles of the actions, which are around zero here, (D,)
    steps: Steps


class Tape(NamedTuple):
    """What the prediction of T steps leaves for its adjoint."""

    mean: Array2  # of the states at t = 0..T, (T + 1, D)
    cov: Array3  # (T + 1, D, D)
    of_model: Record
    of_network: Record
    raw_cov: Array3  # covariance of the actions before squashing, (T, F, F)

    @classmethod
    def of(cls, robot: Robot, horizon: int) -> Tape:
        """Room for so many steps."""
        D, F = robot.rows.shape[1], len(robot.u_max)
        return cls(
            np.empty((horizon + 1, D)),
            np.empty((horizon + 1, D, D)),
            Record.of(robot.model, horizon),
            Record.of(robot.network, horizon),
            np.empty((horizon, F, F)),
        )


class Belief(NamedTuple):
    """Mean and covariance of a Gaussian, and its slope in another variable, or their cotangents."""

    mean: Array1  # (K,)
    cov: Array2
    slope: Array2  # Sigma_x^-1 cov(x, .) for another variable x, (inputs, K)

    @classmethod
    def of(cls, size: int, inputs: int) -> Belief:
        """Of ``size`` entries, with a slope in so many inputs, (inputs, size)."""
        return cls(np.empty(size), np.empty((size, size)), np.empty((inputs, size)))


Beliefs = tuple[Belief, Belief, Belief, Belief, Belief, Belief, Belief]


class StepWork(NamedTuple):
    """Beliefs within a step."""

    phases: Belief  # of the features before sines and cosines; as slope the gain in one row
    features: Belief  # slope in the state, (D, D')
    raw: Belief  # action before squashing less a quarter turn; as slope the gain in one row
    action: Belief  # slope in the features, (D', F)
    inputs: Belief  # features and action; slope in the state, (D, D' + F)
    change: Belief  # what the model predicts; slope in the state, (D, E)
    joint: Belief  # state and action; as slope their covariance with the change, (D + F, E)
    of_model: Workspace
    of_network: Workspace
    linear: Array2  # scratch, (D', D)
    left: Array2  # scratch, (D, D + F)
    lifted: Array2  # scratch, (D, E)
    spread: Array2  # scratch, (D, D)

    @classmethod
    def of(cls, robot: Robot) -> StepWork:
        """Room for one step."""
        spaces = Workspace.of(robot.model), Workspace.of(robot.network)
        D = len(robot.known)
        scratch = robot.rows, robot.known, robot.gain, np.empty((D, D))
        return cls(*beliefs_of(robot), *spaces, *map(np.empty_like, scratch))


def beliefs_of(robot: Robot) -> Beliefs:
    """Room for the beliefs within a step, in the order of :class:`StepWork`."""
    (R, D), F = robot.rows.shape, len(robot.u_max)
    before_action = Belief.of(R, 1), Belief.of(R, D)
    action = Belief.of(F, 1), Belief.of(F, R)
    E = robot.gain.shape[1]
    joint = Belief(np.empty(D + F), np.empty((D + F, D + F)), np.empty((D + F, E)))
    return *before_action, *action, Belief.of(R + F, D), Belief.of(E, D), joint


@Kernel
def predict(robot: Robot, tape: Tape, work: StepWork) -> int:
    """Fill a tape from ``mean[0]`` and ``cov[0]`` on.

    Returns the step 1..T at which a covariance is not valid, or 0.
    """
    means, covs, of_network, of_model = tape.mean, tape.cov, tape.of_network, tape.of_model
    features, inputs, change = work.features, work.inputs, work.change.cov
    for t in range(len(tape.raw_cov)):
        write_features(robot, means[t], covs[t], work)
        network = robot.network, features.mean, features.cov, of_network, t, work.of_network
        if not call(robot.steps.match, (*network, tape.raw_cov[t])):
            return t + 1
        write_inputs(robot, tape, t, work)
        model = robot.model, inputs.mean, inputs.cov, of_model, t, work.of_model
        if not call(robot.steps.match, (*model, change)):
            return t + 1
        _write_successor(robot, tape, t, work)
    return 0


@part
def write_features(robot: Robot, mean: Array1, cov: Array2, work: StepWork) -> None:
    """Beliefs over phases and features of a state, mean (D,) and covariance (D, D)."""
    phases, features, gain = work.phases, work.features, work.phases.slope[0]
    write_phases(robot.rows, robot.turns, mean, cov, work.linear, phases.mean, phases.cov)
    out = features.mean, features.cov, gain
    call(robot.steps.write_cosines, (phases.mean, phases.cov, robot.kept, *out))
    _write_slope(robot.rows, gain, features.slope)


@compiled
def _write_slope(rows: Array2, gain: Array1, slope: Array2) -> None:
    """Slope of the features in the state, (D, D')."""
    for r in range(len(rows)):
        for d in range(len(slope)):
            slope[d, r] = rows[r, d] * gain[r]


@part
def write_inputs(robot: Robot, tape: Tape, t: int, work: StepWork) -> None:
    """Belief over the action, and jointly over features and action."""
    raw, action, record, u_max = work.raw, work.action, tape.of_network, robot.u_max
    mean, gain, total, offset = raw.mean, raw.slope[0], record.total[t], robot.network.offset
    for k in range(len(mean)):
        mean[k] = total[k] + offset[k] - pi / 2.0
    out = action.mean, action.cov, gain
    call(robot.steps.write_cosines, (mean, tape.raw_cov[t], 0, *out))
    _write_joint_moments(u_max, record.slope[t], gain, action, work.features, work.inputs)


@compiled
def _write_joint_moments(
    u_max: Array1, slope: Array2, gain: Array1, action: Belief, features: Belief, out: Belief
) -> None:
    """Belief ``out`` over features and action; the gain is scaled, the action's slope written.

    Args:
        slope: of the network, (D', F).
        gain: mean slope of the sines, (F,).
        action: over the sines.
    """
    cov, D, R, F = features.cov, len(out.slope), len(features.mean), len(u_max)
    for k in range(F):
        gain[k] *= u_max[k]
        out.mean[R + k] = u_max[k] * action.mean[k]
        for other in range(F):
            out.cov[R + k, R + other] = u_max[k] * action.cov[k, other] * u_max[other]
        for d in range(R):
            action.slope[d, k] = slope[d, k] * gain[k]
    for d in range(R):
        out.mean[d] = features.mean[d]
        for e in range(R):
            out.cov[d, e] = cov[d, e]
        for k in range(F):
            cross = 0.0
            for e in range(R):
                cross += cov[d, e] * action.slope[e, k]
            out.cov[d, R + k] = out.cov[R + k, d] = cross
    for d in range(D):
        for e in range(R):
            out.slope[d, e] = features.slope[d, e]
        for k in range(F):
            cross = 0.0
            for e in range(R):
                cross += features.slope[d, e] * action.slope[e, k]
            out.slope[d, R + k] = cross


@part
def _write_successor(robot: Robot, tape: Tape, t: int, work: StepWork) -> None:
    """The belief at t + 1, from those over state, action and what the model predicts."""
    mean, cov, change, record = tape.mean[t + 1], tape.cov[t + 1], work.change, tape.of_model
    joint, left, lifted, spread = work.joint, work.left, work.lifted, work.spread
    known, gain, offset = robot.known, robot.gain, robot.model.offset
    for a in range(len(offset)):
        change.mean[a] = record.total[t, a] + offset[a]
    product(work.inputs.slope, record.slope[t], change.slope)
    write_joint(tape.mean[t], tape.cov[t], record.slope[t], work)
    for d in range(len(mean)):
        mean[d] = robot.drift[d]
        for a in range(len(offset)):
            mean[d] += gain[d, a] * change.mean[a]
        for i in range(len(joint.mean)):
            mean[d] += known[d, i] * joint.mean[i]
    product(known, joint.slope, lifted)
    product_with_transpose(lifted, gain, cov)
    scale(cov, 2.0)
    product(known, joint.cov, left)
    product_with_transpose(left, known, spread)
    add(spread, cov)
    product(gain, change.cov, lifted)
    product_with_transpose(lifted, gain, spread)
    add(spread, cov)
    make_symmetric(cov)


@compiled
def write_joint(mean: Array1, cov: Array2, slope: Array2, work: StepWork) -> None:
    """Belief ``work.joint`` over state (mean and cov) and action, with cov(., change) as slope.

    ``slope`` is that of the model, (D' + F, E).
    """
    joint, inputs, change = work.joint, work.inputs, work.change
    D, R, F = len(mean), len(inputs.mean) - len(joint.mean) + len(mean), len(joint.mean) - len(mean)
    for d in range(D):
        joint.mean[d] = mean[d]
        for e in range(D):
            joint.cov[d, e] = cov[d, e]
        for k in range(F):
            cross = 0.0
            for e in range(D):
                cross += cov[d, e] * inputs.slope[e, R + k]
            joint.cov[d, D + k] = joint.cov[D + k, d] = cross
        for a in range(slope.shape[1]):
            cross = 0.0
            for e in range(D):
                cross += cov[d, e] * change.slope[e, a]
            joint.slope[d, a] = cross
    for k in range(F):
        joint.mean[D + k] = inputs.mean[R + k]
        for other in range(F):
            joint.cov[D + k, D + other] = inputs.cov[R + k, R + other]
        for a in range(slope.shape[1]):
            cross = 0.0
            for i in range(len(slope)):
                cross += inputs.cov[R + k, i] * slope[i, a]
            joint.slope[D + k, a] = cross
