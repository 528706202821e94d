"""What the first motion of a robot decides: how it is sampled."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from torch_pmil.control.exploration import CautiousMotion, RandomActions
from torch_pmil.envs.rollouts import as_executed, rollout_of, states_of
from torch_pmil.model.held_out import held_out_loss
from torch_pmil.model.past_evidence import PastEvidence, evidence_of_the_past
from torch_pmil.seeds import Stream, generator_of
from torch_pmil.tasks.falls import far_off
from torch_pmil.tasks.resampled import resampled
from torch_pmil.tasks.sampling import Sampling
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import Resting

SPAN = 4  # over which models predict, in longest steps
FEWEST_SPANS = 4  # of a motion by which samplings are judged
# models count as alike if they lose at most this multiple of the least loss, plus these nats for
# each observed entry, which an error of half the observation noise costs
ALIKE, SMALL = 1.25, 0.125
# nats for each entry that a good model loses at most. Where the best one loses more, the motion is
# too short to compare samplings: likelihoods of a falling pole seem to show a past that matters,
# and the shortest step gives the next models the most data
GOOD = 1.5
MOST = 100  # transitions that are evidence of the past
# a motion ran away if more than this share of it is far from what was demonstrated. The robot then
# moves again, by this share of the actions
NEARLY_ALL, GENTLER = 0.75, 0.5


@dataclass(frozen=True, eq=False)
class FirstMotion:
    """The first motion of a robot, at its own rate.

    Args:
        states: readings x_0..x_T, (T + 1, D).
        actions: u_0..u_{T-1}, (T, F), each held for the longest step of the task's samplings.
        resting: action at rest before it, (F,).
    """

    states: Tensor
    actions: Tensor
    resting: Tensor

    def as_rollout(self, task: Task) -> TensorDictBase:
        """The motion (T // held,) as the robot of a sampled task shows it."""
        held, history = task.held, task.history
        count = len(self.actions) // held
        states = self.states[: count * held + 1 : held]
        actions = self.actions[: count * held].unflatten(0, (count, held)).mean(1)
        if history is not None:
            states = history.along(states, actions, self.resting)
        rollout = rollout_of(states)
        rollout["action"] = actions
        return rollout


def explore(task: Task, seed: int, share: float = 1.0) -> FirstMotion:
    """Move the robot of a task by random actions, each held for the longest of its steps, if any.

    Such a motion can be seen at every step that divides the longest one.

    Args:
        task: with a random motion.
        seed: of the run.
        share: of the random actions.

    Raises:
        RunStopped, RolloutDiscarded, RobotError: raised by the robot's reset.
    """
    random = task.exploration
    assert isinstance(random, RandomActions)  # as a task has for which the motion decides
    held = replace(random, fraction=share * random.fraction, hold=longest_step(task))
    motion, env = held.motion(generator_of(Stream.MOTION, seed)), task.robot(seed)
    if task.state_box is not None:
        motion = CautiousMotion(motion, task.state_box)
    motion.begin()
    policy = TensorDictModule(motion, in_keys=["observation"], out_keys=["action"])
    rollout = as_executed(env.rollout(held.steps, policy))
    states = states_of(rollout).double()
    return FirstMotion(states, rollout["action"].double(), Resting(task)(states[0]))


def ran_away(task: Task, motion: FirstMotion) -> bool:
    """Whether nearly all of a motion is far from what was demonstrated, as where a pole fell."""
    if task.demonstrations is None:
        return False
    seen, shown = task.space.observe(motion.states), task.demonstrations.positions
    return far_off(seen, shown, task.noise_std).double().mean().item() > NEARLY_ALL


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


def choose(task: Task, motion: FirstMotion) -> Choice:
    """The sampling of a task by its first motion.

    Models of each step are compared by :func:`~torch_pmil.model.held_out.held_out_loss` over one
    span of time. The step is the longest of those that predict alike: its predictions take the
    least time, and pass through the fewest steps. If even the best model is bad, it is the shortest
    of all. The state holds the past if that explains the motion
    (:func:`~torch_pmil.model.past_evidence.evidence_of_the_past`) and the model then is good: past
    actions if they act late, else the last reading and action. A motion that was cut short too
    early to be judged decides nothing.

    Args:
        task: with ``samplings``.
        motion: of its robot.
    """
    first, longest = task.samplings[0], longest_step(task)
    if len(motion.actions) < FEWEST_SPANS * SPAN * longest:
        return Choice(first)
    held, lost = _step(task, motion)
    if all(each == replace(first, held=each.held) for each in task.samplings):
        return Choice(replace(first, held=held), lost)
    evidence, every = _evidence(task, motion, held)
    sampling = Sampling(held)
    if evidence.is_likely:
        late = -(-evidence.periods * every // held)
        past = Sampling(held, 0, late) if evidence.acts_late else Sampling(held, 1, 1)
        nats = _loss(resampled(task, past), motion, longest // held)
        lost[past.described(task.time_step)] = nats
        sampling = past if nats <= GOOD else sampling
    return Choice(sampling, lost, evidence.by_name)


def _step(task: Task, motion: FirstMotion) -> tuple[int, dict[str, float]]:
    """The step, in control periods, and what models lose by each."""
    first, longest = task.samplings[0], longest_step(task)
    steps = [replace(first, held=held) for held in sorted({each.held for each in task.samplings})]
    lost = [_loss(resampled(task, step), motion, longest // step.held) for step in steps]
    found, least = list(zip(steps, lost, strict=True)), min(lost)
    alike = [step.held for step, nats in found if nats <= ALIKE * least + SMALL]
    held = alike[-1] if least <= GOOD else steps[0].held
    period = task.time_step
    by_step = {step.described(period): nats for step, nats in found}
    return held, by_step


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


def longest_step(task: Task) -> int:
    """The longest step that a run may choose, in control periods."""
    return max((each.held for each in task.samplings), default=1)
