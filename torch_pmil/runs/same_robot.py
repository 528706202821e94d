"""Whether the robot of a resumed run still moves as it did when the run began."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from torch_pmil.envs.rollouts import as_executed
from torch_pmil.seeds import Stream, generator_of
from torch_pmil.tasks.task import Task

STEPS = 20
ROUNDING = 1e-6  # by which the motions of one robot may differ on two processors, in their range


def motion_of(task: Task) -> list[float] | None:
    """The observations of a short seeded motion, which show whether the robot has changed.

    None for a robot that is not measured from fresh starts, such as a physical one, which is not
    moved. None too for a robot that moves differently each time.
    """
    if not task.evaluated:
        return None
    with torch.random.fork_rng(devices=[]):
        first, second = _observed(task), _observed(task)
    return first if first == second else None


def moves_alike(motion: object, recorded: object) -> bool:
    """Whether two motions are of one robot, as far as both are known.

    Example:
        >>> moves_alike([0.0, 1.0], [0.0, 1.0 + 1e-9]), moves_alike([0.0, 1.0], [0.0, 1.01])
        (True, False)
        >>> moves_alike([0.0, 1.0], None)
        True
    """
    if motion is None or recorded is None:
        return True
    ours, theirs = torch.tensor(motion), torch.tensor(recorded)
    if ours.shape != theirs.shape:
        return False
    return bool(((ours - theirs).abs() <= ROUNDING * theirs.abs().max()).all())


def _observed(task: Task) -> list[float]:
    robot, actions = task.robot(seed=0), task.actions
    generator = generator_of(Stream.MOTION, 0)

    def act(observation: Tensor) -> Tensor:
        share = 2 * torch.rand(actions.low.shape, generator=generator, dtype=torch.float64) - 1
        action = actions.middle + 0.5 * share * actions.half_range
        return action.expand(*observation.shape[:-1], -1)

    policy = TensorDictModule(act, in_keys=["observation"], out_keys=["action"])
    rollout = as_executed(robot.rollout(STEPS, policy))
    return rollout["next", "observation"].double().flatten().tolist()
