"""The first motion of a robot, by which a run chooses how it is sampled."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from torch_pmil.control.exploration import CautiousMotion, RandomActions
from torch_pmil.envs.rollouts import as_executed, rollout_of, states_of
from torch_pmil.seeds import Stream, generator_of
from torch_pmil.tasks.falls import far_off
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import Resting

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


def longest_step(task: Task) -> int:
    """The longest step that a run may choose, in control periods."""
    return max((each.held for each in task.samplings), default=1)
