"""The prediction of T steps (Eq. 13) and its adjoint, for one start belief and one policy."""

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
from torch_pmil.model.compiled.cosines import adjoint_of_cosines, write_cosines
from torch_pmil.model.compiled.matching import match
from torch_pmil.model.compiled.matching_adjoints import adjoint_of_gp, adjoint_of_network
from torch_pmil.model.compiled.small_matrices import (
    make_symmetric,
    product,
    product_with_transpose,
    times_vector,
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
        """The addresses, of kernels that are compiled now if they were not before."""
        kernels = match, adjoint_of_gp, adjoint_of_network, write_cosines, adjoint_of_cosines
        return cls(*(kernel.address for kernel in kernels))


class Robot(NamedTuple):
    """What a prediction is made of.

    Args:
        model: the forward model.
        network: the policy before squashing.
        u_max: limits of the F actions, (F,).
        rows, turns, kept: features of the state, as in :class:`Augmentation`.
        differences: whether the model predicts changes of the state.
        steps: kernels.
    """

    model: Functions
    network: Functions
    u_max: Array1
    rows: Array2
    turns: Array1
    kept: int
    differences: bool
    steps: Steps


class Tape(NamedTuple):
    """What the prediction of T steps leaves for its adjoint.

    Args:
        mean, cov: of the states at t = 0..T, (T + 1, D) and (T + 1, D, D).
        of_model, of_network: the moments at every step.
        raw_cov: covariance of the actions before squashing, (T, F, F).
    """

    mean: Array2
    cov: Array3
    of_model: Record
    of_network: Record
    raw_cov: Array3

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
    """Mean and covariance of a Gaussian, or their cotangents, and a slope in another variable."""

    mean: Array1
    cov: Array2
    slope: Array2

    @classmethod
    def of(cls, size: int, inputs: int) -> Belief:
        """Of ``size`` entries, with a slope in so many inputs, (inputs, size)."""
        return cls(np.empty(size), np.empty((size, size)), np.empty((inputs, size)))


class StepWork(NamedTuple):
    """Beliefs within a step.

    Args:
        phases: of the features before sines and cosines, and as slope the gain in one row.
        features: slope in the state, (D, D').
        raw: of the action before squashing less a quarter turn; as slope the gain in one row.
        action: slope in the features, (D', F).
        inputs: features and action; slope in the state, (D, D' + F).
        change: what the model predicts; slope in the state, (D, D).
        of_model, of_network: for the moments.
        linear: scratch, (D', D).
    """

    phases: Belief
    features: Belief
    raw: Belief
    action: Belief
    inputs: Belief
    change: Belief
    of_model: Workspace
    of_network: Workspace
    linear: Array2

    @classmethod
    def of(cls, robot: Robot) -> StepWork:
        """Room for one step."""
        spaces = Workspace.of(robot.model), Workspace.of(robot.network)
        return cls(*beliefs_of(robot), *spaces, np.empty_like(robot.rows))


def beliefs_of(robot: Robot) -> tuple[Belief, ...]:
    """Room for the beliefs within a step, in the order of :class:`StepWork`."""
    (R, D), F = robot.rows.shape, len(robot.u_max)
    sizes = ((R, 1), (R, D), (F, 1), (F, R), (R + F, D), (D, D))
    return tuple(Belief.of(size, inputs) for size, inputs in sizes)


@Kernel
def predict(robot: Robot, tape: Tape, work: StepWork) -> int:
    """Fill a tape from ``mean[0]`` and ``cov[0]`` on; return the step 1..T that failed, or 0."""
    for t in range(len(tape.raw_cov)):
        write_features(robot, tape.mean[t], tape.cov[t], work)
        features, inputs, change = work.features, work.inputs, work.change
        record, raw_cov = tape.of_network, tape.raw_cov[t]
        mean, cov = features.mean, features.cov
        if not call(
            robot.steps.match, (robot.network, mean, cov, record, t, work.of_network, raw_cov)
        ):
            return t + 1
        write_inputs(robot, tape, t, work)
        record, mean, cov = tape.of_model, inputs.mean, inputs.cov
        if not call(
            robot.steps.match, (robot.model, mean, cov, record, t, work.of_model, change.cov)
        ):
            return t + 1
        _write_successor(robot, tape, t, work)
    return 0


@compiled
def write_features(robot, mean, cov, work):
    """Beliefs over phases and features of a state."""
    phases, features, rows = work.phases, work.features, robot.rows
    times_vector(rows, mean, phases.mean)
    product(rows, cov, work.linear)
    product_with_transpose(work.linear, rows, phases.cov)
    gain = phases.slope[0]
    for r in range(len(rows)):
        phases.mean[r] += robot.turns[r]
    call(
        robot.steps.write_cosines,
        (phases.mean, phases.cov, robot.kept, features.mean, features.cov, gain),
    )
    for r in range(len(rows)):
        for d in range(len(mean)):
            features.slope[d, r] = rows[r, d] * gain[r]


@compiled
def write_inputs(robot, tape, t, work):
    """Belief over the action, and jointly over features and action."""
    features, raw, action, inputs = work.features, work.raw, work.action, work.inputs
    R, F, u_max, gain = len(features.mean), len(robot.u_max), robot.u_max, raw.slope[0]
    record = tape.of_network
    for k in range(F):
        raw.mean[k] = record.total[t, k] + robot.network.offset[k] - pi / 2.0
    call(robot.steps.write_cosines, (raw.mean, tape.raw_cov[t], 0, action.mean, action.cov, gain))
    for k in range(F):
        gain[k] *= u_max[k]
        inputs.mean[R + k] = u_max[k] * action.mean[k]
        for other in range(F):
            inputs.cov[R + k, R + other] = u_max[k] * action.cov[k, other] * u_max[other]
        for d in range(R):
            action.slope[d, k] = record.slope[t, d, k] * gain[k]
    for d in range(R):
        inputs.mean[d] = features.mean[d]
        for e in range(R):
            inputs.cov[d, e] = features.cov[d, e]
        for k in range(F):
            cross = 0.0
            for e in range(R):
                cross += features.cov[d, e] * action.slope[e, k]
            inputs.cov[d, R + k] = inputs.cov[R + k, d] = cross
    for d in range(len(inputs.slope)):
        for e in range(R):
            inputs.slope[d, e] = features.slope[d, e]
        for k in range(F):
            cross = 0.0
            for e in range(R):
                cross += features.slope[d, e] * action.slope[e, k]
            inputs.slope[d, R + k] = cross


@part
def _write_successor(robot, tape, t, work):
    """The belief at t + 1, from that at t and what the model predicts."""
    mean, cov, change = tape.mean[t + 1], tape.cov[t + 1], work.change
    for d in range(len(mean)):
        mean[d] = tape.of_model.total[t, d] + robot.model.offset[d]
    if robot.differences:
        product(work.inputs.slope, tape.of_model.slope[t], change.slope)
        product(tape.cov[t], change.slope, cov)
    for d in range(len(mean)):
        if robot.differences:
            mean[d] += tape.mean[t, d]
        for e in range(len(mean)):
            known = 2.0 * cov[d, e] + tape.cov[t, d, e] if robot.differences else 0.0
            cov[d, e] = known + change.cov[d, e]
    make_symmetric(cov)
