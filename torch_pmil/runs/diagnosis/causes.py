"""Why a run did not learn: likely reasons in words, from predictions and executed rollouts.

This module knows no particular robot.

A threshold lies beyond what was measured of any run that learned; the comments say the nearest
value, of ``results/benchmarks/diagnosis/summary.json`` (``benchmarks/diagnosis.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.stats import binomtest
from torch import Tensor

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.calibration import two_sigma_coverage, within_two_sigma
from torch_pmil.runs.diagnosis.demonstration_checks import Finding
from torch_pmil.runs.diagnosis.hidden_past import PastEvidence
from torch_pmil.search.kl import gaussian_kl_terms

LEARNED = 0.95  # success rate of a run that has nothing to explain: the paper's
COVERED = 0.75  # share of one-step errors within two standard deviations; learned: 0.81 and more
# share of executed entries within two predicted standard deviations; learned: 0.75 and more
FOLLOWED = 0.7
UNKNOWN = 0.2  # share of the executed steps at which the model knows little; learned: up to 0.04
LITTLE = 0.5  # posterior over prior standard deviation, from which on it knows little
MISMATCH = 1.5  # largest loss of a step over the search's trust threshold; learned: up to 1.31
NEAR_LIMIT = 0.95  # of half the range of an action, from its middle
SATURATED = 0.5  # share of the steps near the limit; learned: up to 0.38
MOVED = 0.25  # farthest from the start, over the demonstrated; learned: 0.77 and more
FEWEST_STEPS = 20  # from which a share is told
LATEST = 3  # trials in which a search should come further
RARE = 0.05  # probability below which failures are no chance
# nats by which the past explains a motion better; learned: up to 94, by hidden motors
# (benchmarks/past_evidence.py)
EVIDENCE = 150.0


@dataclass(frozen=True)
class Reason:
    """Why a run did not learn.

    Args:
        cause: its name, one of a few.
        message: one or two sentences with the numbers, and what to do about it.
    """

    cause: str
    message: str


def saturated_fraction(actions: Tensor, space: ActionSpace) -> Tensor:
    """Fraction of steps at which each action is within 5 % of the end of its range.

    Args:
        actions: of rollouts, (N, T, F).
        space: of the robot's actions.

    Returns:
        (F,), from 0 to 1.

    Example:
        >>> import torch
        >>> limits = torch.zeros(2), torch.tensor([3.5, 3.5])
        >>> space = ActionSpace.around(*limits, ("tau1", "tau2"), ("N·m", "N·m"))
        >>> saturated_fraction(torch.tensor([[[3.5, 0.0], [-3.4, 1.0]]]), space)
        tensor([1., 0.], dtype=torch.float64)
    """
    away = (actions - space.middle).abs()
    return (away >= NEAR_LIMIT * space.half_range).double().mean((0, 1))


def covered_fraction(residuals: Tensor) -> Tensor:
    """Share of standardised one-step errors (S, D) within two standard deviations, (D,)."""
    return (residuals.abs() <= 2).double().mean(0)


def first_departure(predicted: Gaussian, executed: Tensor) -> tuple[int, int] | None:
    """First step t at which fewer than half of the rollouts are within two standard deviations.

    The standard deviations are the predicted ones; the entry of the state is told too.

    Args:
        predicted: marginals at t = 1..T, mean (T, D).
        executed: rollouts x_0..x_T, (N, T + 1, D).

    Returns:
        (t, entry), or None where they never leave.

    Example:
        >>> import torch
        >>> predicted = Gaussian(torch.zeros(2, 1), torch.ones(2, 1, 1))
        >>> first_departure(predicted, torch.tensor([[[0.0], [1.0], [3.0]]]))
        (2, 0)
    """
    inside = within_two_sigma(predicted, executed).mean(0)
    left = (inside < 0.5).any(-1).nonzero().flatten()
    if not len(left):
        return None
    return int(left[0]) + 1, int(inside[left[0]].argmin())


def first_mismatch(step_loss: Tensor, trust_threshold: float) -> int | None:
    """First step t whose loss is above the search's trust threshold, if some step is far above.

    Args:
        step_loss: losses of the steps t = 1..T, (T,).
        trust_threshold: loss of a step up to which the search trusts it, in the same unit.

    Example:
        >>> import torch
        >>> first_mismatch(torch.tensor([0.1, 0.5, 4.0, 30.0]), trust_threshold=3.0)
        3
        >>> first_mismatch(torch.tensor([0.1, 0.5, 4.0, 0.5]), trust_threshold=3.0)
    """
    if step_loss.amax() <= MISMATCH * trust_threshold:
        return None
    return int((step_loss > trust_threshold).nonzero()[0]) + 1


def group(findings: Sequence[Finding]) -> list[Reason]:
    """One reason for each cause among the findings, with the first finding of each in full.

    Example:
        >>> group([Finding("a", "one is off"), Finding("a", "two is off")])
        [Reason(cause='a', message='one is off (and 1 more of this kind)')]
    """
    messages: dict[str, list[str]] = {}
    for finding in findings:
        messages.setdefault(finding.cause, []).append(finding.message)
    return [
        Reason(cause, first + (f" (and {len(others)} more of this kind)" if others else ""))
        for cause, (first, *others) in messages.items()
    ]


def scaled(settings: Mapping[str, Any], name: str, factor: float) -> str:
    """NAME=VALUE of a setting whose numbers are so many times the present ones.

    Example:
        >>> scaled({"noise_std": [0.1, 0.25]}, "noise_std", 2)
        'noise_std=[0.2,0.5]'
    """
    value = settings[name]
    if isinstance(value, list):
        return f"{name}=[{','.join(f'{factor * number:g}' for number in value)}]"
    return f"{name}={factor * value:g}"


def larger_motion(settings: Mapping[str, Any]) -> str:
    """What makes a first motion larger, as NAME=VALUE.

    Example:
        >>> larger_motion({"random_action": 0.4}), larger_motion({"random_action": 0.8})
        ('random_action=0.8', 'random_action=1')
    """
    if "exploration.reach" in settings:
        return scaled(settings, "exploration.reach", 1.5)
    return scaled(settings, "random_action", min(2, 1 / settings["random_action"]))


def unpredictable(error: str) -> Reason:
    """The reason for a run whose newest model cannot predict the saved policy.

    Example:
        >>> unpredictable("prediction of step 3 of 25 failed").message[:57]
        'the model cannot predict the saved policy (prediction of '
    """
    return Reason(
        "model not right",
        f"the model cannot predict the saved policy ({error}), so what was predicted is compared "
        "with nothing; give it more data: more trials, or a larger first motion (random_action or "
        "exploration.reach)",
    )


def check_cut_short(ends: Sequence[str]) -> Reason | None:
    """A reason if the robot cut rollouts short.

    Args:
        ends: why the own rollout of each trial was cut short, "" where it was not.

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
        "of them is a failure, so mend what stops the robot, or give it more room",
    )


def check_saturation(actions: Tensor, space: ActionSpace, needed: Tensor | None) -> Reason | None:
    """A reason if an action is at the end of its range most of the time.

    Args:
        actions: of rollouts, (N, T, F).
        space: of the robot's actions.
        needed: largest torques along the demonstrations, (F,), N·m; None where nobody knows. Only
            actions that are torques are compared with them.

    Example:
        >>> import torch
        >>> space = ActionSpace.around(torch.zeros(1), torch.ones(1), ["tau"], ["N·m"])
        >>> reason = check_saturation(torch.ones(20, 25, 1), space, torch.tensor([3.0]))
        >>> for part in reason.message.split(", ")[:2]:
        ...     print(part.partition(";")[0])
        action tau (N·m) is near the end of its range from -1 to 1 in 100 % of the steps
        and the demonstrations need up to 3.0 N·m
    """
    fraction = saturated_fraction(actions, space)
    worst = int(fraction.argmax())
    if fraction[worst] <= SATURATED:
        return None
    low, high = space.low[worst].item(), space.high[worst].item()
    if needed is None or space.units[worst] != "N·m":
        need = _need(high, None)
    else:
        need = _need(max(-low, high), needed[worst].item())
    return Reason(
        "action at its limit",
        f"{space.labels[worst]} is near the end of its range from {low:g} to {high:g} in "
        f"{_percent(fraction[worst])} of the steps{need}",
    )


def _need(limit: float, needed: float | None) -> str:
    """The end of a sentence: what the demonstrations need, and what to do."""
    if needed is None:
        return "; a wider range, or a slower or smaller demonstration, leaves it room to correct"
    if needed > limit:
        return (
            f", and the demonstrations need up to {needed:.1f} N·m; give it more torque, or show "
            "the motion more slowly or smaller"
        )
    return (
        f", though the demonstrations need no more than {needed:.1f} N·m: the policy swings from "
        "limit to limit; try another seed"
    )


def check_motion(
    executed: Tensor, demonstrated: Tensor, noise_std: Tensor, settings: Mapping[str, Any]
) -> Reason | None:
    """A reason if the robot hardly moved.

    Args:
        executed: rollouts in the match space, z_0..z_T, (N, T + 1, M).
        demonstrated: demonstrations in the match space, of any number.
        noise_std: observation noise, () or (M,), in whose units distances are compared.
        settings: of the run, by name.

    Example:
        >>> import torch
        >>> way = torch.linspace(0, 1, 5)[None, :, None]
        >>> reason = check_motion(0.1 * way, way, torch.tensor(0.05), {"random_action": 0.4})
        >>> reason.message.partition(":")[0]
        'the robot went 10 % as far from its start as the demonstrations'
    """
    moved = moved_fraction(executed, demonstrated, noise_std)
    if not moved < MOVED:  # demonstrations that stand still give no number
        return None
    return Reason(
        "robot did not move",
        f"the robot went {_percent(moved)} as far from its start as the demonstrations: torques "
        "below its weight or static friction move and teach nothing; let its first motion be "
        f"larger ({larger_motion(settings)}), and begin at actions that hold it (holding_actions "
        "of an Task)",
    )


def moved_fraction(executed: Tensor, demonstrated: Tensor, noise_std: Tensor) -> float:
    """Distance of the robot from its start over that of the demonstrations.

    See :func:`check_motion` for the arguments.
    """
    return (_farthest(executed, noise_std) / _farthest(demonstrated, noise_std)).item()


def _farthest(positions: Tensor, noise_std: Tensor) -> Tensor:
    """Largest distance from the start, the median over trajectories (N, T + 1, M)."""
    return ((positions - positions[:, :1]) / noise_std).norm(dim=-1).amax(-1).median()


def check_model(
    residuals: Tensor,
    predicted: Gaussian,
    executed: Tensor,
    names: Sequence[str],
    time_step: float,
    settings: Mapping[str, Any],
) -> Reason | None:
    """A reason if the model promises more than the robot keeps, in a step or over the trajectory.

    Args:
        residuals: one-step errors of rollouts that the model was not fitted to, in predicted
            standard deviations, (S, D).
        predicted: marginals at t = 1..T, mean (T, D).
        executed: the rollouts x_0..x_T, (N, T + 1, D).
        names: of the D entries.
        time_step: s.
        settings: of the run, by name.

    Example:
        >>> import torch
        >>> still = Gaussian(torch.zeros(3, 1), torch.ones(3, 1, 1))
        >>> residuals, executed = torch.full((30, 1), 4.0), torch.full((10, 4, 1), 4.0)
        >>> reason = check_model(residuals, still, executed, ("q",), 0.1, {"random_action": 0.4})
        >>> reason.message.partition(", lie within")[0]
        '0 % of the one-step errors in q, and 0 % of the executed states'
    """
    covered, followed = covered_fraction(residuals), two_sigma_coverage(predicted, executed)
    told = len(residuals) >= FEWEST_STEPS
    if followed >= FOLLOWED and not (told and covered.amin() < COVERED):
        return None
    left, worst = first_departure(predicted, executed), int(covered.argmin())
    steps, departure = "", ""
    if told:
        steps = f"{_percent(covered[worst])} of the one-step errors in {names[worst]}, and "
    if left:
        time, entry = left[0] * time_step, names[left[1]]
        departure = f"; the rollouts leave the prediction at {time:.2f} s, first in {entry}"
    return Reason(
        "model not right",
        f"{steps}{_percent(followed)} of the executed states, lie within two predicted standard "
        f"deviations (95 % if the model were right){departure}; give it more data there (more "
        f"trials, or a larger first motion: {larger_motion(settings)}), and see that load, "
        "friction, delay and sensors have not changed",
    )


def check_past(evidence: PastEvidence) -> Reason | None:
    """A reason if the next state depends on what came before the present one.

    Example:
        >>> check_past(PastEvidence({1: -3.0, 2: -9.0}, 4.0, 200, 0.1))
        >>> late = check_past(PastEvidence({1: 380.0, 2: 73.0}, 63.0, 200, 0.1))
        >>> late.message.partition(" (")[0]
        'the action 0.10 s before explains the motion 380 nats better than state and action alone'
    """
    of_action, of_state = evidence.of_actions[evidence.periods], evidence.of_state
    if max(of_state, of_action) <= EVIDENCE:
        return None
    better = (
        f"nats better than state and action alone ({evidence.transitions} transitions; up to "
        f"{EVIDENCE:.0f} nats tell nothing)"
    )
    if of_action >= of_state / 2:  # what is merely hidden tells little by actions
        return Reason(
            "robot acts late",
            f"the action {evidence.periods * evidence.time_step:.2f} s before explains the motion "
            f"{of_action:.0f} {better}: commands take effect late; let the state hold them "
            f"(past_actions={evidence.periods} of PMIL)",
        )
    return Reason(
        "state does not show all",
        f"its change over the last {evidence.time_step:.2f} s explains the motion "
        f"{of_state:.0f} {better}: a velocity or a part of the robot is not measured; let the "
        "state hold the past (past_entries=1 and past_actions=1 of PMIL)",
    )


def check_experience(
    unknown: Tensor, data: int, time_step: float, settings: Mapping[str, Any]
) -> Reason | None:
    """A reason if the experience is far from where the policy goes.

    Args:
        unknown: at which steps t = 0..T-1 of the rollouts the model knows little, bool, (N, T).
        data: number of transitions that the model was fitted to.
        time_step: s.
        settings: of the run, by name.

    Example:
        >>> import torch
        >>> away = torch.arange(10) >= 4
        >>> reason = check_experience(away.expand(20, -1), 50, 0.1, {"random_action": 0.4})
        >>> reason.message.partition(", the robot")[0]
        'in 60 % of the executed steps, first at 0.40 s'
    """
    share = unknown.double().mean()
    if share <= UNKNOWN:
        return None
    first = int((unknown.double().mean(0) > UNKNOWN).nonzero()[0])
    return Reason(
        "too little experience",
        f"in {_percent(share)} of the executed steps, first at {first * time_step:.2f} s, the "
        f"robot is where the {data} transitions of its model tell little; give it more of them: "
        f"more trials, or a larger first motion ({larger_motion(settings)})",
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
    """A reason why a search is stuck at a step.

    Args:
        step_loss: losses of the steps t = 1..T, (T,).
        step: first step that the search does not trust, see :func:`first_mismatch`.
        name, unit: of the loss.
        mismatch: what does not match there, see :func:`worst_entry`.
        horizons: step up to which the search of each trial went.
        time_step: s.
        settings: of the run, by name.

    Example:
        >>> import torch
        >>> step_loss = torch.tensor([0.1, 0.5, 14.0, 30.0])
        >>> reason = check_search(step_loss, 3, "KL", "nats", "most in q", [2], 0.1, {})
        >>> reason.message.partition(";")[0]
        'the KL of a step rises from 0.5 at 0.20 s to 14 nats at 0.30 s (step 3 of 4), most in q'
    """
    rise = "is"
    if step > 1:
        rise = f"rises from {step_loss[step - 2]:.3g} at {(step - 1) * time_step:.2f} s to"
    hint = "more trials may lead them further"
    if not _advancing(horizons):
        hint = f"{LATEST} trials led them no further, so try {_other_search(settings)}"
    return Reason(
        "search stuck",
        f"the {name} of a step {rise} {step_loss[step - 1]:.3g} {unit} at "
        f"{step * time_step:.2f} s (step {step} of {len(step_loss)}), {mismatch}; the last "
        f"searches went up to step {', '.join(map(str, horizons[-LATEST - 2 :]))}: {hint}",
    )


def _other_search(settings: Mapping[str, Any]) -> str:
    """What may help a search that is stuck."""
    return (
        f"another seed, more iterations ({scaled(settings, 'search.stage_iterations', 2)}), a "
        f"larger threshold ({scaled(settings, 'search.trust_threshold', 2)}), or "
        f"{scaled(settings, 'noise_std', 2)}, which forgives more"
    )


def _advancing(horizons: Sequence[int]) -> bool:
    """Whether the last searches went further than those before, or there were few trials."""
    return len(horizons) <= LATEST or max(horizons[-LATEST:]) > max(horizons[:-LATEST])


def worst_entry(
    demonstrated: Gaussian, predicted: Gaussian, names: Sequence[str], units: Sequence[str]
) -> str:
    """The entry with the largest part in the KL of a step, in words.

    It is told with its means and standard deviations; the parts are those of
    :func:`~torch_pmil.search.kl.gaussian_kl_terms`.

    Args:
        demonstrated, predicted: marginals of the step, mean (M,), observation noise included.
        names, units: of the M entries.

    Example:
        >>> import torch
        >>> demonstrated = Gaussian(torch.zeros(2), 0.01 * torch.eye(2))
        >>> predicted = Gaussian(torch.tensor([0.0, 1.0]), 0.04 * torch.eye(2))
        >>> worst_entry(demonstrated, predicted, ("x", "y"), ("m", "m"))
        'most in y (predicted 1.00 ± 0.20 m, demonstrated 0.00 ± 0.10 m)'
    """
    terms = gaussian_kl_terms(demonstrated, predicted)
    worst = int((terms.mean + terms.spread).argmax())
    said = (
        f"{belief.mean[worst]:.2f} ± {belief.std[worst]:.2f} {units[worst]}".rstrip()
        for belief in (predicted, demonstrated)
    )
    return "most in {} (predicted {}, demonstrated {})".format(names[worst], *said)


def check_chance(failed: int, count: int, promised: float | None) -> Reason | None:
    """A reason if so many failures are no rare chance for a policy of which success is predicted.

    Args:
        failed: number of rollouts that are no success.
        count: of all.
        promised: success rate that the model predicts at least; None where none is predicted.

    Example:
        >>> check_chance(2, 20, 0.976).message.partition(";")[0]
        '2 of 20 rollouts failed, though the model predicts that 97.6 % of the starts succeed'
        >>> check_chance(2, 20, 0.994)
    """
    if promised is None or promised < LEARNED:
        return None
    probability = binomtest(count - failed, count, promised, "less").pvalue
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
    """The reason for a run in which nothing is wrong but its success rate.

    Args:
        failed: number of rollouts that are no success.
        count: of all.
        tolerance: error up to which a rollout is a success.
        largest: what is left of the objective, and where.
        settings: of the run, by name.
    """
    return Reason(
        "success criterion",
        f"the robot does what was predicted, and the search is content with it, yet {failed} of "
        f"{count} rollouts have an error above {tolerance:.3g}: the criterion asks for more than "
        f"the objective does. {largest}; {scaled(settings, 'noise_std', 0.5)}, or more trials with "
        f"confirmations={settings['confirmations'] + 2}, bring the robot nearer to the "
        "demonstrations",
    )


def _percent(share: Tensor | float) -> str:
    return f"{100 * share:.0f} %"
