"""Why a run did not learn: likely reasons in words, from predictions and executed rollouts.

This module knows no particular robot. ``settings`` are those of the run by name, and ``time_step``
is in s. ``actions`` of rollouts are (N, T, F); ``executed`` rollouts are x_0..x_T, (N, T + 1, D),
and ``predicted`` their marginals at t = 1..T, mean (T, D); ``step_loss`` is that of these, (T,).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import scipy
from torch import Tensor

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.recovered_states import rates_of
from torch_pmil.demonstrations.turns import declared_by, wrapped_within
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.calibration import two_sigma_coverage
from torch_pmil.model.past_evidence import PastEvidence
from torch_pmil.runs.diagnosis.findings import WRAPS, Finding
from torch_pmil.runs.diagnosis.measures import (
    COVERED,
    EVIDENCE,
    FEWEST_STEPS,
    FOLLOWED,
    LEARNED,
    MOVED,
    RARE,
    SATURATED,
    UNKNOWN,
    covered_fraction,
    first_departure,
    moved_fraction,
    saturated_fraction,
)

LATEST = 3  # trials in which a search should come further


@dataclass(frozen=True)
class Reason:
    """Why a run did not learn: one of a few causes, the numbers, and what to do about it."""

    cause: str
    message: str


def group(findings: Sequence[Finding]) -> list[Reason]:
    """One reason for each cause among the findings, with the first finding of each in full."""
    messages: dict[str, list[str]] = {}
    for finding in findings:
        messages.setdefault(finding.cause, []).append(finding.message)
    return [
        Reason(cause, first + (f" (and {len(others)} more of this kind)" if others else ""))
        for cause, (first, *others) in messages.items()
    ]


def scaled(settings: Mapping[str, Any], name: str, factor: float) -> str:
    """A setting as NAME=VALUE, with its numbers multiplied by a factor.

    Example:
        >>> scaled({"noise_std": [0.1, 0.25]}, "noise_std", 2)
        'noise_std=[0.2,0.5]'
    """
    value = settings[name]
    if isinstance(value, list):
        return f"{name}=[{','.join(f'{factor * number:g}' for number in value)}]"
    return f"{name}={factor * value:g}"


def forgiving(settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The setting that lets an objective forgive more, and what it is in words, if there is one.

    Example:
        >>> forgiving({"cost.width": 0.25}), forgiving({})
        ([('cost.width', 'a wider target')], [])
    """
    known = ("noise_std", "more tolerance"), ("cost.width", "a wider target")
    return [each for each in known if each[0] in settings][:1]


def larger_motion(settings: Mapping[str, Any]) -> str:
    """A setting for a larger first motion, as NAME=VALUE, or what else makes it larger.

    Example:
        >>> larger_motion({"random_action": 0.8})
        'random_action=1'
    """
    if "exploration.reach" in settings:
        return scaled(settings, "exploration.reach", 1.5)
    if settings["random_action"] >= 1:
        return "random_action is at its largest: a wider range of the actions"
    return scaled(settings, "random_action", min(2, 1 / settings["random_action"]))


def unpredictable(error: str) -> Reason:
    """The reason for a run whose newest model cannot predict the saved policy."""
    return Reason(
        "model not right",
        f"the model cannot predict the saved policy ({error}), so no prediction can be compared "
        "with the rollouts; give it more data: more trials, or a larger first motion "
        "(random_action or exploration.reach)",
    )


def check_readings(
    motions: Sequence[Tensor], names: Sequence[str], declared: Collection[int], time_step: float
) -> list[Finding]:
    """Find entries of executed rollouts, (T_n + 1, D) each, that jump by a turn.

    Args:
        motions: what the robot's sensors read.
        names: of the first entries; those after them, and velocities dNAME, are left out.
        declared: indices of the entries that are angles already.
        time_step: between two readings.

    Example:
        >>> import torch
        >>> q = torch.tensor([2.7, 2.9, 3.1, -2.98, -2.78])[:, None]
        >>> check_readings([q], ("q",), (), 0.1)[0].message.partition(":")[0]
        'q of the robot jumps by a turn (6.283) at 0.30 s, from 3.10 to -2.98'
    """
    known, found = {*declared, *rates_of(tuple(names))}, []
    for entry, name in enumerate(names):
        columns = [motion[:, entry] for motion in motions]
        if entry in known or (jump := wrapped_within(columns)) is None:
            continue
        turn, number, sample = jump
        before, after = columns[number][sample - 1 : sample + 1].tolist()
        message = (
            f"{name} of the robot jumps by a turn ({turn:.4g}) at {sample * time_step:.2f} s, from "
            f"{before:.2f} to {after:.2f}: if it is an angle, {declared_by(name, turn)}"
        )
        found.append(Finding(WRAPS, message))
    return found


def check_cut_short(ends: Sequence[str]) -> Reason | None:
    """A reason if the robot cut rollouts short, from why it cut each own rollout, or "".

    Example:
        >>> check_cut_short(["", "dq1 = 12.3 rad/s is beyond 10 rad/s"]).message.partition(";")[0]
        '1 of 2 own rollouts were cut short, the last one: dq1 = 12.3 rad/s is beyond 10 rad/s'
    """
    said = [line for line in ends if line]
    if not said:
        return None
    return Reason(
        "rollouts cut short",
        f"{len(said)} of {len(ends)} own rollouts were cut short, the last one: {said[-1]}; each "
        "of them counts as a failure: remove what stops the robot, or give it more room",
    )


def check_saturation(actions: Tensor, space: ActionSpace, needed: Tensor | None) -> Reason | None:
    """A reason if an action is at the end of its range most of the time.

    Actions that are torques are compared with the largest that the demonstrations need, (F,), N·m,
    None if unknown.
    """
    fraction = saturated_fraction(actions, space)
    worst = int(fraction.argmax())
    if fraction[worst] <= SATURATED:
        return None
    low, high = space.low[worst].item(), space.high[worst].item()
    torque = needed[worst].item() if needed is not None and space.units[worst] == "N·m" else None
    if torque is None:
        need = "; a wider range, or a slower or smaller demonstration, leaves it room to correct"
    elif torque > max(-low, high):
        need = (
            f", and the demonstrations need up to {torque:.1f} N·m; allow more torque, or show the "
            "motion more slowly or smaller"
        )
    else:
        need = (
            f", though the demonstrations need no more than {torque:.1f} N·m: the policy switches "
            "between its limits; try another seed"
        )
    return Reason(
        "action at its limit",
        f"{space.labels[worst]} is near the end of its range from {low:g} to {high:g} in "
        f"{_percent(fraction[worst])} of the steps{need}",
    )


def check_motion(
    executed: Tensor, demonstrated: Tensor, noise_std: Tensor, settings: Mapping[str, Any]
) -> Reason | None:
    """A reason if the robot hardly moved; arguments as for :func:`moved_fraction`."""
    moved = moved_fraction(executed, demonstrated, noise_std)
    if not moved < MOVED:  # demonstrations that stand still give no number
        return None
    return Reason(
        "robot did not move",
        f"the robot moved {_percent(moved)} as far from its start as the demonstrations: torques "
        "that do not overcome gravity or static friction teach the model nothing; make the first "
        f"motion larger ({larger_motion(settings)}), and begin at actions that hold the robot "
        "(holding_actions of a Task); or convert the recordings, if their unit is not the robot's",
    )


def check_model(
    residuals: Tensor,
    predicted: Gaussian,
    executed: Tensor,
    names: Sequence[str],
    time_step: float,
    settings: Mapping[str, Any],
) -> Reason | None:
    """A reason if the model is too sure of itself, in a step or over the trajectory.

    The residuals (S, D) are one-step errors of rollouts that the model was not fitted to, in
    predicted standard deviations.
    """
    covered, followed = covered_fraction(residuals), two_sigma_coverage(predicted, executed)
    enough = len(residuals) >= FEWEST_STEPS
    if followed >= FOLLOWED and not (enough and covered.amin() < COVERED):
        return None
    left, worst = first_departure(predicted, executed), int(covered.argmin())
    steps, departure = "", ""
    if enough:
        steps = f"{_percent(covered[worst])} of the one-step errors in {names[worst]}, and "
    if left:
        time, entry = left[0] * time_step, names[left[1]]
        departure = f"; the rollouts leave the prediction at {time:.2f} s, first in {entry}"
    return Reason(
        "model not right",
        f"{steps}{_percent(followed)} of the executed states, lie within two predicted standard "
        f"deviations (95 % if the model were right){departure}; give it more data there (more "
        f"trials, or a larger first motion: {larger_motion(settings)}), and check whether load, "
        "friction, delay or sensors have changed",
    )


def check_past(evidence: PastEvidence) -> Reason | None:
    """A reason if the next state depends on what came before the present one."""
    if evidence.most <= EVIDENCE:
        return None
    better = (
        f"nats better than state and action alone ({evidence.transitions} transitions; a "
        f"difference up to {EVIDENCE:.0f} nats means nothing)"
    )
    if evidence.acts_late:
        return Reason(
            "robot acts late",
            f"the action {evidence.periods * evidence.time_step:.2f} s before explains the motion "
            f"{evidence.of_action:.0f} {better}: commands take effect late; let the state "
            f"hold them (past_actions={evidence.periods} of PMIL)",
        )
    return Reason(
        "state does not show all",
        f"its change over the last {evidence.time_step:.2f} s explains the motion "
        f"{evidence.of_state:.0f} {better}: a velocity or a part of the robot is not measured; let "
        "the state hold the past (past_entries=1 and past_actions=1 of PMIL)",
    )


def check_experience(
    unknown: Tensor, data: int, time_step: float, settings: Mapping[str, Any]
) -> Reason | None:
    """A reason if the experience, so many transitions, is far from where the policy goes.

    At the ``unknown`` steps t = 0..T-1 of rollouts, bool, (N, T), the model knows little.
    """
    share = unknown.double().mean()
    if share <= UNKNOWN:
        return None
    first = int((unknown.double().mean(0) > UNKNOWN).nonzero()[0])
    return Reason(
        "too little experience",
        f"in {_percent(share)} of the executed steps, first at {first * time_step:.2f} s, the "
        f"model has few of its {data} transitions nearby; collect more there: more trials, or a "
        f"larger first motion ({larger_motion(settings)})",
    )


def check_search(
    step_loss: Tensor,
    step: int,
    name: str,
    unit: str,
    mismatch: str,
    horizons: Sequence[int],
    time_step: float,
    settings: Mapping[str, Any],
) -> Reason:
    """A reason why a search came no further than to a step: it is stuck, or had too few trials.

    Args:
        step: first step that the search does not trust.
        name, unit: of the loss.
        mismatch: what does not match there, in words.
        horizons: step up to which the search of each trial went.
    """
    wider = "".join(
        f", or {what} ({scaled(settings, name, 2)})" for name, what in forgiving(settings)
    )
    rise, cause, hint = "is", "too few trials", "more trials may lead them further"
    if step > 1:
        rise = f"rises from {step_loss[step - 2]:.3g} at {(step - 1) * time_step:.2f} s to"
    if len(horizons) > LATEST and max(horizons[-LATEST:]) <= max(horizons[:-LATEST]):
        cause, hint = (
            "search stuck",
            f"{LATEST} trials led them no further, so try another seed, more iterations "
            f"({scaled(settings, 'search.stage_iterations', 2)}), a larger threshold "
            f"({scaled(settings, 'search.trust_threshold', 2)}){wider}",
        )
    return Reason(
        cause,
        f"the {name} of a step {rise} {step_loss[step - 1]:.3g} {unit} at "
        f"{step * time_step:.2f} s (step {step} of {len(step_loss)}), {mismatch}; the last "
        f"searches went up to step {', '.join(map(str, horizons[-LATEST - 2 :]))}: {hint}",
    )


def check_chance(failed: int, count: int, promised: float | None) -> Reason | None:
    """A reason if chance explains that so many rollouts failed of a policy predicted to succeed.

    Args:
        failed: number of rollouts that failed, of ``count``.
        promised: success rate that the model predicts at least, if it does.

    Example:
        >>> check_chance(2, 20, 0.976).message.partition(";")[0]
        '2 of 20 rollouts failed, though the model predicts that 97.6 % of the starts succeed'
    """
    if promised is None or promised < LEARNED:
        return None
    probability = scipy.special.bdtr(count - failed, count, promised)
    if probability < RARE:
        return None
    return Reason(
        "chance of few starts",
        f"{failed} of {count} rollouts failed, though the model predicts that {100 * promised:.1f} "
        f"% of the starts succeed; even if it is right, {count} starts have as many failures with "
        f"a probability of {100 * probability:.0f} %: measure the policy from more starts",
    )


def unexplained(
    failed: int, count: int, tolerance: float, largest: str, settings: Mapping[str, Any]
) -> Reason:
    """The reason where ``failed`` of ``count`` rollouts fail, and all else is right.

    ``largest`` is what is left of the objective, in words.
    """
    stricter = "".join(f"{scaled(settings, name, 0.5)}, or " for name, _ in forgiving(settings))
    return Reason(
        "success criterion",
        "the robot does what was predicted, and the prediction is good enough for the search, yet "
        f"{failed} of {count} rollouts have an error above {tolerance:.3g}: the criterion is "
        f"stricter than the objective. {largest}; {stricter}more trials with "
        f"confirmations={settings['confirmations'] + 2}, bring the robot nearer to its goal",
    )


def _percent(share: Tensor | float) -> str:
    return f"{100 * share:.0f} %"
