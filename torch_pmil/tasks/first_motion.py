"""What the first motion of a robot decides: how it is sampled."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from torch_pmil.control.exploration import CautiousMotion, RandomActions
from torch_pmil.envs.rollouts import as_executed, rollout_of, states_of
from torch_pmil.model.held_out import held_out_loss
from torch_pmil.seeds import Stream, generator_of
from torch_pmil.tasks.sampling import Sampling
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import Resting

SPAN = 4  # over which models predict, in longest steps
FEWEST_SPANS = 4  # of a motion by which samplings are judged
# what models that count as alike may lose: a share of the least, and nats for each observed entry,
# those of an error of half the observation noise for a longer step, which saves most of the work,
# and of a quarter for less of the past
ALIKE, OF_STEP, OF_PAST = 1.25, 0.1, 0.03
# nats for each entry that a good model loses at most. Where the best one loses more, the motion was
# too short to learn from, and short steps leave the next models the most data
GOOD = 1.0


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


def explore(task: Task, seed: int) -> FirstMotion:
    """Move the robot of a task by random actions, each held for the longest of its steps.

    Such a motion can be seen at every step that divides the longest one.

    Raises:
        RunStopped, RolloutDiscarded, RobotError: raised by the robot's reset.
    """
    exploration = task.exploration
    assert isinstance(exploration, RandomActions)  # as a task with samplings has
    held = replace(exploration, hold=_longest(task))
    motion, env = held.motion(generator_of(Stream.MOTION, seed)), task.robot(seed)
    if task.state_box is not None:
        motion, env.guard = CautiousMotion(motion, task.state_box), task.state_box.guard
    motion.begin()
    policy = TensorDictModule(motion, in_keys=["observation"], out_keys=["action"])
    rollout = as_executed(env.rollout(exploration.steps, policy))
    states = states_of(rollout).double()
    return FirstMotion(states, rollout["action"].double(), Resting(task)(states[0]))


def choose(task: Task, motion: FirstMotion) -> tuple[Sampling, dict[str, float]]:
    """The sampling of a task whose model predicts the first motion best.

    Models are compared by :func:`~torch_pmil.model.held_out.held_out_loss` over one span of time.
    The step is the longest of those that predict alike: its predictions take the least time, and
    pass through the fewest steps. If even the best model is bad, it is the shortest of them. Then
    the past is the first of those that predict alike at this step, which has the least of it. A
    motion that was cut short too early to be judged decides nothing.

    Args:
        task: with ``samplings``.
        motion: of its robot.

    Returns:
        The sampling, and the loss of each that was tried, described in words.
    """
    samplings, longest = task.samplings, _longest(task)
    if len(motion.actions) < FEWEST_SPANS * SPAN * longest:
        return samplings[0], {}
    tried: dict[str, float] = {}

    def alike(compared: Iterable[Sampling], small: float) -> list[Sampling]:
        found = {sampling: loss(sampling) for sampling in compared}
        return [each for each in found if found[each] <= ALIKE * min(found.values()) + small]

    def loss(sampling: Sampling) -> float:
        name = sampling.described(task.demonstrations.time_step)
        if name not in tried:
            tried[name] = _loss(sampling.of(task), motion, longest // sampling.held)
        return tried[name]

    first = samplings[0]
    helds = sorted({each.held for each in samplings})
    steps = alike((replace(first, held=held) for held in helds), OF_STEP)
    held = steps[-1 if min(tried.values()) <= GOOD else 0].held
    return alike((each for each in samplings if each.held == held), OF_PAST)[0], tried


def _loss(task: Task, motion: FirstMotion, every: int) -> float:
    """Nats that predictions over the span lose, if the longest step has ``every`` steps."""
    rollout, noise = motion.as_rollout(task), torch.as_tensor(task.noise_std, dtype=torch.float64)
    seen = states_of(rollout), rollout["action"], task.space, noise
    return held_out_loss(task.make_dynamics(), *seen, span=SPAN * every, every=every)


def _longest(task: Task) -> int:
    return max(each.held for each in task.samplings)
