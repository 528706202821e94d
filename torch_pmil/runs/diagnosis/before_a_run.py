"""Checks of a task's demonstrations before anything is learned from them."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.runs.diagnosis.demonstration_checks import (
    check_agreement,
    check_count,
    check_duplicates,
    check_jumps,
    check_length,
    check_rest,
    check_spread,
    check_start,
    check_turns,
)
from torch_pmil.runs.diagnosis.findings import Finding
from torch_pmil.runs.diagnosis.reach_checks import (
    check_body,
    check_box,
    check_reach,
    check_stops,
    check_torques,
)
from torch_pmil.tasks.first_motion import longest_step
from torch_pmil.tasks.task import Task

TORQUE_STEPS = 400  # number of steps whose torques are computed
STRETCH = 20  # steps in a row, where the demonstrations have more in all
MARGIN = 3  # steps before and after a stretch, which its spline goes through


def check(task: Task) -> list[Finding]:
    """Check the demonstrations of a task; those shipped have no finding.

    Modes, jumps and the number are checked for each target. Reach and torques are checked if the
    task's states were recovered sample by sample, and as far as the robot knows its stops and
    its inverse dynamics. It takes seconds for 1,000 demonstrations or 20,000 samples.

    Example:
        >>> from torch_pmil.tasks.registry import load_experiment
        >>> check(load_experiment("double_pendulum"))
        []
    """
    demonstrations = task.demonstrations
    if demonstrations is None:
        return []
    noise_std = torch.as_tensor(task.noise_std, dtype=torch.float64)
    start = task.space.match_space.moments(task.initial)
    sets: Sequence[Demonstrations]
    if demonstrations.targets is None:
        sets, numbers = (demonstrations,), [list(range(len(demonstrations.positions)))]
    else:
        targets, sets = demonstrations.by_target()
        numbers = [
            (demonstrations.targets == target).all(-1).nonzero().flatten().tolist()
            for target in targets
        ]
    return [
        *_check_robot(task, demonstrations, noise_std),
        *check_start(demonstrations, start, noise_std),
        *check_spread(sets, start, noise_std),
        *check_jumps(sets, numbers, noise_std),
        *(check_turns(demonstrations) or check_rest(demonstrations, noise_std)),
        *check_agreement(sets, numbers, noise_std),
        *check_length(demonstrations, longest_step(task)),
        *check_duplicates(demonstrations, noise_std),
        *check_count(sets),
    ]


def _check_robot(
    task: Task, demonstrations: Demonstrations, noise_std: torch.Tensor
) -> list[Finding]:
    """Findings on motions that the robot itself cannot do."""
    time_step, states = task.time_step, _motions(task)
    if states is None:
        return []
    env, shown = task.first_robot(seed=0), task.space.observe(states)
    findings = check_reach(demonstrations, shown, noise_std)
    findings = findings or check_body(demonstrations, shown, noise_std)
    if task.state_box is not None:
        findings += check_box(task.state_box, states)
    if (excess := env.beyond_range(states)) is not None:
        findings += check_stops(excess, time_step)
    torques = None if findings else needed_torques(task)
    if torques is not None and env.torque_limits is not None:
        findings += check_torques(torques, env.torque_limits, env.action_names, time_step)
    return findings


def needed_torques(task: Task) -> torch.Tensor | None:
    """Torques along the demonstrations, (N, T, F), N·m.

    Beyond 400 steps in all, the torques of 400 steps are computed, in stretches of 20: half of them
    with the largest second differences of what was shown, the others evenly spaced over all
    demonstrations. The torques of other steps are 0.

    None if the states were not recovered sample by sample, or the robot does not know its inverse
    dynamics.
    """
    motions = _motions(task)
    if motions is None or motions.shape[1] < 3:
        return None
    env, (N, samples, _) = task.first_robot(seed=0), motions.shape
    torques = torch.zeros(N, samples - 1, len(task.actions.names), dtype=torch.float64)
    for number, first, last in _stretches(task):
        begin = max(first - MARGIN, 0)
        found = env.needed_torques(motions[number, begin : last + MARGIN + 1])
        if found is None:
            return None
        torques[number, first:last] = found[first - begin : last - begin]
    return torques


def _motions(task: Task) -> torch.Tensor | None:
    """Demonstrated states (N, T + 1, D), if they were recovered sample by sample."""
    if task.demonstrations is None:
        return None
    N, samples, _ = task.demonstrations.positions.shape
    whole = len(task.demonstrated_states) == N * samples
    return task.demonstrated_states.reshape(N, samples, -1) if whole else None


def _stretches(task: Task) -> list[tuple[int, int, int]]:
    """Demonstration, first step and last (excluded) of the steps whose torques are computed."""
    positions = task.demonstrations.positions / task.noise_std
    N, T = len(positions), positions.shape[1] - 1
    if N * T <= TORQUE_STEPS:
        return [(number, 0, T) for number in range(N)]
    stretches = [
        (number, first, min(first + STRETCH, T))
        for number in range(N)
        for first in range(0, T, STRETCH)
    ]
    change = positions.diff(n=2, dim=1).abs().amax(-1)  # (N, T - 1)
    change = torch.nn.functional.pad(change, (0, 1 + -T % STRETCH)).unflatten(1, (-1, STRETCH))
    fastest = change.amax(-1).flatten().argsort(descending=True, stable=True)
    count = TORQUE_STEPS // STRETCH // 2
    spaced = torch.linspace(0, len(stretches) - 1, count).long()
    chosen = set(fastest[:count].tolist()) | set(spaced.tolist())
    return [stretches[index] for index in sorted(chosen)]
