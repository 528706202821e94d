"""How a robot of one's own is sampled, by its first motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch

from torch_pmil.control.recovered_states import rates_of
from torch_pmil.envs.rollouts import states_of
from torch_pmil.model.held_out import held_out_loss
from torch_pmil.model.past_evidence import PastEvidence, evidence_of_the_past
from torch_pmil.tasks.first_motion import FirstMotion, longest_step
from torch_pmil.tasks.resampled import resampled
from torch_pmil.tasks.sampling import Sampling
from torch_pmil.tasks.task import Task

SPAN = 4  # over which models predict, in longest steps
FEWEST_SPANS = 4  # of a motion by which samplings are judged
# models count as alike if they lose at most this multiple of the least loss, plus these nats for
# each observed entry, which an error of half the observation noise costs
ALIKE, SMALL = 1.25, 0.125
# nats for each entry that a good model loses at most. Where the best one loses more, the motion is
# too short to compare samplings: likelihoods of a falling pole seem to show a past that matters,
# and a short step gives the next models much data
GOOD = 1.5
MOST = 100  # transitions that are evidence of the past, and steps of a motion without a good model


@dataclass(frozen=True)
class Choice:
    """How a robot is sampled, and why.

    Args:
        sampling: the choice.
        lost: nats that a model of each sampling loses for each entry; the keys are the samplings.
        gained: nats by which a part of the past explains the motion better; the keys name the part.
    """

    sampling: Sampling
    lost: dict[str, float] = field(default_factory=dict)
    gained: dict[str, float] = field(default_factory=dict)

    def in_words(self, period: float) -> str:
        """What was chosen for a robot with this control period (s), and why.

        Example:
            >>> good = Choice(Sampling(2), {"steps of 0.1 s": 0.53, "steps of 0.2 s": 0.25})
            >>> good.in_words(0.1).partition(" (")[0]
            'steps of 0.2 s: the simplest that predicts the first motion well'
            >>> bad = Choice(Sampling(1), {"steps of 0.1 s": 4.9, "steps of 0.2 s": 3.8})
            >>> bad.in_words(0.1).partition(" (")[0]
            'steps of 0.1 s: no model predicts the first motion well'
        """
        chosen = self.sampling.described(period)
        if not self.lost:
            return f"{chosen}: the first motion was too short to compare others"
        lost, gained = (
            ", ".join(f"by {name}: {nats:.{digits}f}" for name, nats in of.items())
            for of, digits in ((self.lost, 2), (self.gained, 1))
        )
        why = "the simplest that predicts" if _is_good(self.lost) else "no model predicts"
        return (
            f"{chosen}: {why} the first motion well (nats lost for each entry "
            f"{lost}{gained and '; nats gained '}{gained})"
        )


def choose(task: Task, motion: FirstMotion) -> Choice:
    """The sampling of a task by its first motion.

    Models of each step are compared by :func:`~torch_pmil.model.held_out.held_out_loss` over one
    span of time. The step is the longest of those that predict alike: its predictions take the
    least time, and pass through the fewest steps. The state holds the past if that explains
    the motion (:func:`~torch_pmil.model.past_evidence.evidence_of_the_past`) and the model then is
    good: past actions if they act late, else the last reading and action. If no model is good
    without the past, the step is chosen among models with it. If none is good at all, it is the
    shortest that leaves a motion at most ``MOST`` steps, without the past: the time of a search
    grows with the cube of their number. But a robot that shows no velocities needs its last reading
    then: what moves has a velocity. A motion that was cut short too early to be judged decides
    nothing.

    Args:
        task: with ``samplings``.
        motion: of its robot.
    """
    first = task.samplings[0]
    if len(motion.actions) < FEWEST_SPANS * SPAN * longest_step(task):
        return Choice(first)
    steps = [replace(first, held=held) for held in sorted({each.held for each in task.samplings})]
    longest, lost = _compare(task, motion, steps)
    short = next((each for each in steps if task.horizon <= MOST * each.held), steps[-1])
    good = _is_good(lost)
    chosen = longest if good else short
    if all(each in steps for each in task.samplings):
        return Choice(chosen, lost)
    evidence, every = _evidence(task, motion, chosen.held)
    if evidence.is_likely:
        pasts = [_past(evidence, every, each.held) for each in ([chosen] if good else steps)]
        longest, lost_with_past = _compare(task, motion, pasts)
        lost |= lost_with_past
        if _is_good(lost_with_past):
            chosen = longest
        elif not (good or rates_of(task.space.names)):
            chosen = Sampling(longest.held, past_entries=1, past_actions=1)
    return Choice(chosen, lost, evidence.by_name)


def _compare(
    task: Task, motion: FirstMotion, samplings: Sequence[Sampling]
) -> tuple[Sampling, dict[str, float]]:
    """The last of the samplings that predict alike, and what the model of each loses."""
    longest = longest_step(task)
    lost = [_loss(resampled(task, each), motion, longest // each.held) for each in samplings]
    enough = ALIKE * min(lost) + SMALL
    alike = [each for each, nats in zip(samplings, lost, strict=True) if nats <= enough]
    names = (each.described(task.time_step) for each in samplings)
    return alike[-1], dict(zip(names, lost, strict=True))


def _is_good(lost: Mapping[str, float]) -> bool:
    """Whether a model loses little."""
    return min(lost.values()) <= GOOD


def _past(evidence: PastEvidence, every: int, held: int) -> Sampling:
    """The past that evidence asks for, sought at steps of ``every`` control periods."""
    if evidence.acts_late:
        return Sampling(held, past_actions=-(-evidence.periods * every // held))
    return Sampling(held, past_entries=1, past_actions=1)


def _evidence(task: Task, motion: FirstMotion, held: int) -> tuple[PastEvidence, int]:
    """Evidence of the past, and the length of the step at which it was sought, in control periods.

    It is the shortest step that divides the chosen one and leaves at most ``MOST`` transitions:
    longer steps show less of the past.
    """
    count = len(motion.actions)
    every = next(
        k for k in range(1, held + 1) if held % k == 0 and (count // k <= MOST or k == held)
    )
    seen = resampled(task, Sampling(every))
    rollout = motion.as_rollout(seen)[None, :MOST]
    period, targets = seen.time_step, seen.make_dynamics().targets
    of_motion = states_of(rollout), rollout["action"], seen.space
    return evidence_of_the_past(*of_motion, period, targets), every


def _loss(task: Task, motion: FirstMotion, every: int) -> float:
    """Nats that predictions over the span lose, if the longest step has ``every`` steps."""
    rollout, noise = motion.as_rollout(task), torch.as_tensor(task.noise_std, dtype=torch.float64)
    seen = states_of(rollout), rollout["action"], task.space, noise
    return held_out_loss(task.make_dynamics(), *seen, span=SPAN * every, every=every)
