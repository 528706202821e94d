"""Checks for demonstrations of motions that the learning robot cannot do.

``noise_std`` is the observation noise, () or (M,), the unit in which entries are compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import scipy
from torch import Tensor

from torch_pmil.control.state_box import StateBox
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.runs.diagnosis.demonstration_checks import SIGNIFICANCE, place
from torch_pmil.runs.diagnosis.findings import UNREACHABLE, Finding

OUT_OF_REACH = 2.0  # standard deviations of the observation noise
STOP_MARGIN = 0.05  # rad or m, that a joint may be beyond its stop
TORQUE_MARGIN = 1.3  # of the limit: so uncertain are torques of a motion known at the control rate


def check_reach(demonstrations: Demonstrations, shown: Tensor, noise_std: Tensor) -> list[Finding]:
    """Find places where the robot cannot be, by what it shows in the recovered states.

    ``shown`` is (N, T + 1, M), as the positions of the demonstrations.
    """
    apart = (demonstrations.positions - shown).abs()
    return [
        Finding(
            UNREACHABLE,
            f"demonstration {number} leaves the workspace: at "
            f"{step * demonstrations.time_step:.2f} s the robot stays "
            f"{apart[number, step, entry]:.3g} away in {demonstrations.names[entry]}; scale it or "
            "place it elsewhere",
            fatal=True,
        )
        for number, step, entry in _worst(apart / noise_std, OUT_OF_REACH)
    ]


def check_body(demonstrations: Demonstrations, shown: Tensor, noise_std: Tensor) -> list[Finding]:
    r"""Find places where the robot cannot be, a little off in all demonstrations alike.

    The observation noise of N demonstrations leaves their mean with a standard deviation of
    :math:`\sigma_{\mathrm{obs}} / \sqrt N`. If the mean is farther than this from what the robot
    can show (by :math:`\chi^2` over all entries and times), and somewhere by more than the noise,
    another body or another base has shown it. Arguments as for :func:`check_reach`.
    """
    positions = demonstrations.positions
    off = (positions - shown).mean(0)  # (T + 1, M)
    size = off.abs() / noise_std
    bound = scipy.special.chdtri(size.numel(), SIGNIFICANCE)
    if len(positions) * size.square().sum() <= bound or size.amax() <= 1:
        return []
    step, entry = place(size)
    message = (
        "the demonstrations show positions that this robot cannot reach: their mean is up to "
        f"{off[step, entry].abs():.2g} off, in {demonstrations.names[entry]} at "
        f"{step * demonstrations.time_step:.2f} s; measure the links and the base of the body "
        "that showed them, or match only what both bodies can show"
    )
    return [Finding(UNREACHABLE, message)]


def check_stops(excess: Tensor, time_step: float) -> list[Finding]:
    """Find joints beyond their stops: excess (N, T + 1, J) in rad or m, 0 within."""
    return [
        Finding(
            UNREACHABLE,
            f"demonstration {number} leaves the workspace: at {step * time_step:.2f} s joint "
            f"{joint} would be {excess[number, step, joint]:.3g} beyond its stop; scale it or "
            "place it elsewhere",
            fatal=True,
        )
        for number, step, joint in _worst(excess, STOP_MARGIN)
    ]


def check_box(box: StateBox, states: Tensor) -> list[Finding]:
    """Find demonstrated states (N, T + 1, D) outside the limits of the learning robot's motion."""
    return [
        Finding(
            UNREACHABLE,
            f"demonstration {number} goes where the robot must not go: {line}; widen the box, or "
            "show a slower or smaller motion",
        )
        for number, line in enumerate(map(box.guard, states))
        if line
    ]


def check_torques(
    torques: Tensor, limits: Tensor, names: Sequence[str], time_step: float
) -> list[Finding]:
    """Find torques (N, T, F) of the control periods beyond the limits (F,) of the motors, N·m."""
    return [
        Finding(
            UNREACHABLE,
            f"demonstration {number} needs {torques[number, step, motor].abs():.1f} N·m of motor "
            f"{names[motor]} at {step * time_step:.2f} s, which has {limits[motor]:g} N·m; show "
            "it more slowly or smaller, or smooth it",
        )
        for number, step, motor in _worst(torques.abs() / limits, TORQUE_MARGIN)
    ]


def _worst(sizes: Tensor, bound: float) -> Iterator[tuple[int, int, int]]:
    """Demonstration, step and entry of the largest of its sizes (N, T, K), if above a bound."""
    for number, size in enumerate(sizes):
        step, entry = place(size)
        if size[step, entry] > bound:
            yield number, step, entry
