"""Learning in a few lines: a robot, its recordings or a cost, and the policy learned from them."""

from __future__ import annotations

from typing import Any

from torch_pmil.runs.learner import Learner
from torch_pmil.search.sampled_cost import CostFunction
from torch_pmil.search.target_costs import Cost
from torch_pmil.tasks.own_cost import own_cost
from torch_pmil.tasks.own_robot import Recorded, own_robot


class PMIL(Learner):
    """Probabilistic model-based imitation learning of one's own robot (Algorithm 1).

    Args:
        env: an environment of TorchRL or gymnasium with a vector of real numbers to observe and
            bounded continuous actions, or the name of one of gymnasium. A physical robot is not
            measured from fresh starts: its own rollouts alone say what succeeds.
        demonstrations: a file or folder of recordings, or what was read of one.
        control_period: seconds between two actions.
        settings: what :func:`~torch_pmil.tasks.own_robot.own_robot` takes: ``state``,
            the names of the observation's entries, ``angles``, ``match``, every field of
            :class:`Task` and every setting of its :class:`~torch_pmil.tasks.method.Method`. With a
            ``cost``, the robot improves on its imitation, see ``docs/how_to/pilco.md``.

    ``task`` holds robot, demonstrations and settings. After
    :meth:`~torch_pmil.runs.learner.Learner.learn` it is the task as the run sampled it, ``result``
    is the finished run, and ``policy`` a function from the robot's state to its action.

    Raises:
        DemonstrationError: the demonstrations cannot be read, or do not fit the robot.
        TypeError, ValueError: the environment or a setting is not as it must be.

    Example: see ``docs/how_to/your_robot.md``.
    """

    def __init__(
        self, env: Any, demonstrations: Recorded, control_period: float, **settings: Any
    ) -> None:
        super().__init__(own_robot(env, demonstrations, control_period, **settings))


class PILCO(Learner):
    """Learns one's own robot from a cost (Deisenroth and Rasmussen 2011), without a teacher.

    Model, prediction, search, run, report and files are those of :class:`PMIL`, and so are
    ``learn``, ``policy``, ``evaluate``, ``save`` and ``report``.

    Args:
        env: an environment of TorchRL or gymnasium with a vector of real numbers to observe and
            bounded continuous actions, or the name of one of gymnasium, or a MujocoRobot.
        cost: what is minimised: a :class:`SaturatingCost`, a quadratic one, or a function
            of states and actions.
        horizon: number of actions of a motion.
        control_period: seconds between two actions.
        settings: what :func:`~torch_pmil.tasks.own_cost.own_cost` takes: ``state``, ``angles``,
            ``match``, ``success``, every field of :class:`CostTask` and every setting of its
            :class:`~torch_pmil.tasks.method.Method`.

    Raises:
        TypeError, ValueError: the environment, the cost or a setting is not as it must be.

    Example: see ``docs/how_to/pilco.md``.
    """

    def __init__(
        self,
        env: Any,
        cost: Cost | CostFunction,
        horizon: int,
        control_period: float,
        **settings: Any,
    ) -> None:
        super().__init__(own_cost(env, cost, horizon, control_period, **settings))
