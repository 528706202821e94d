"""A task: a robot, its demonstrations, what is compared with them, and what a success is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Self

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.checks import check_noise, check_tensor
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.exploration import Exploration, PDMovements, RandomActions
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.recovered_states import rates_of
from torch_pmil.control.state_box import StateBox
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import DemonstrationError, Demonstrations
from torch_pmil.demonstrations.distribution import expert_distribution
from torch_pmil.envs import AdaptedEnv, MujocoRobotEnv
from torch_pmil.envs.guards import set_guards
from torch_pmil.envs.history import History
from torch_pmil.envs.rollouts import OfStates, as_executed
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.experience import FEWEST_TRANSITIONS
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.model.own_dynamics import OwnDynamics
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.promise import Promise
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.seeds import Stream, generator_of
from torch_pmil.settings import Settings, setting
from torch_pmil.tasks.falls import FallGuard
from torch_pmil.tasks.method import Method
from torch_pmil.tasks.new_policy import name_of, new_policy
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.sampling import Sampling
from torch_pmil.tasks.task_checks import (
    check_demonstrated_way,
    check_folder_name,
    check_movements,
)
from torch_pmil.trainer.problem import Problem
from torch_pmil.trainer.trials import own_error

HELD_STARTS = 200  # in which a new policy holds the robot
MEASURED_STARTS = 20  # fresh starts of a measurement


@dataclass(frozen=True, eq=False, kw_only=True)
class Task(Settings):
    """What is learned, and the method by which it is learned.

    Args:
        name: names the folder of its runs.
        make_env: environment for given ``num_envs`` (None or N), ``from_pixels`` and ``seed``.
        space: the robot's state space; the demonstrations are in its match space.
        demonstrations: N demonstrations; a :class:`CostTask` has None, and no demonstrated states.
        noise_std: observation noise, in the units of the match space: one number, or one for each
            entry, (M,).
        initial: p(x_0).
        actions: names, units and range of the robot's actions.
        demonstrated_states: states recovered from the demonstrations, (S, D), at which the policy's
            centres are drawn.
        error: of rollouts (*batch, T), as the environment gives them, (*batch);
            :func:`~torch_pmil.envs.rollouts.of_states` makes it from a function of the states
            x_0..x_T.
        tolerance: largest error of a success.
        method: settings of policy, model, exploration, search and ending.
        predicted_error: error of predicted states x_0..x_T, (*batch, T + 1, D) to (*batch), if
            ``error`` reads more of a rollout than its states. None for that of ``error``, if it is
            made by ``of_states``; otherwise no success is predicted, and the confirmations alone
            end a run.
        evaluated: whether policies are measured from fresh starts, which are no experience, beside
            their own rollouts; False for a robot that a person resets.
        holding_actions: actions (S, F) that hold the robot in states (S, D), by which a new policy
            holds it at the start. None if they are unknown.
        held_states: further states (S, D) in which a new policy holds the robot. A servo whose
            target is far away pulls with all its force, whatever the target: a search that begins
            there has no slope to follow.
        box: lowest and highest value of entries of the state or of the match space in which the
            robot must stay while it learns, by name; see :class:`StateBox`. None for no limits.
        leaving_threshold: largest predicted probability of leaving them at which a policy runs.
        history: past readings and actions that are entries of the state, see
            :func:`~torch_pmil.tasks.with_history.with_history`.
        sketch: joint positions (*batch, P, 2), m, in a plane, from the base to the tip, at states
            (*batch, D). The report then shows poses.
        plane: directions (2, M) of the match space, to the right and up, in which the robot writes;
            the report then shows the strokes.
        draws: whether the environment gives pictures, for the video.
        held: control periods of the robot for which an action is held.
        samplings: among which a run chooses by its first motion; the first is used if nothing is
            chosen. Empty if the task is sampled already.

    Raises:
        DemonstrationError: the demonstrations are too short.
        TypeError, ValueError: a setting is of another kind, shape or range.
    """

    name: str
    make_env: Callable[..., MujocoRobotEnv | AdaptedEnv]
    space: StateSpace
    demonstrations: Demonstrations
    initial: Gaussian
    actions: ActionSpace
    demonstrated_states: Tensor
    error: Callable[[TensorDictBase], Tensor]
    noise_std: float | Tensor = setting(
        ...,
        "standard deviation of the observation noise: a larger one forgives more",
        words="above 0, one number or one for each entry of the match space",
        unit="the unit of the entry",
    )
    tolerance: float = setting(
        ..., "largest error of a success", least=0, unit="the unit of the task's error"
    )
    evaluated: bool = setting(
        True, "whether policies are measured from fresh starts beside their own rollouts"
    )
    method: Method = field(default_factory=Method)
    predicted_error: Callable[[Tensor], Tensor] | None = None
    holding_actions: Callable[[Tensor], Tensor] | None = None
    held_states: Tensor | None = None
    box: Mapping[str, tuple[float, float]] | None = None
    leaving_threshold: float = 0.05
    history: History | None = None
    sketch: Callable[[Tensor], Tensor] | None = None
    plane: Tensor | None = None
    draws: bool = True
    held: int = 1
    samplings: tuple[Sampling, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        check_task(self)

    @property
    def state_box(self) -> StateBox | None:
        """Limits of the robot's motion while it learns; None if there are no limits."""
        if self.box is None:
            return None
        return StateBox(self.space, self.box, self.leaving_threshold)

    @property
    def promised(self) -> Promise | None:
        """The success rate that ends a run; None if no success can be predicted."""
        error = self.predicted_error
        if error is None and isinstance(self.error, OfStates):
            error = self.error.of_states
        if error is None:
            return None
        return Promise(self.method.ending.promise, error, self.tolerance)

    def scaled_by(self, states: Tensor) -> Self:
        """The same task for a robot whose first motion is along these states, (T + 1, D)."""
        return self

    @property
    def objective(self) -> type[TrajectoryLoss]:
        """Class of the loss."""
        return TrajectoryKLLoss

    @property
    def horizon(self) -> int:
        """T, number of control steps."""
        return self.demonstrations.positions.shape[1] - 1

    @property
    def unscaled(self) -> bool:
        """Whether the first motion must show how far the robot goes."""
        return False

    @property
    def time_step(self) -> float:
        """Control period, s."""
        return self.demonstrations.time_step

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the entries of a target; none of a task without targets."""
        return () if self.demonstrations is None else self.demonstrations.target_names

    @property
    def demonstrated(self) -> Gaussian:
        """Demonstrated marginals at t = 1..T, observation noise included."""
        return expert_distribution(self.demonstrations, self.noise_std)

    @property
    def exploration(self) -> Exploration:
        """The robot's motion before anything is learned."""
        chosen, around = self.method.exploration, None
        if isinstance(chosen, PDMovements):
            return chosen
        if self.holding_actions is not None:
            around = self.holding_actions(self.initial.mean[None])[0]
            if chosen.explore_demonstrated:
                count = len(self.demonstrations.positions)
                mean = self.demonstrated_states.unflatten(0, (count, -1)).mean(0)
                around = self.holding_actions(mean[1:])
        return RandomActions(self.actions, chosen.random_action, self.horizon, around=around)

    @property
    def _least_widths(self) -> Tensor:
        """Smallest widths (D',) of a new policy's basis functions."""
        if self.method.policy.least_widths is not None:
            return self.method.policy.least_widths
        std, angles = self.initial.std, list(self.space.angles)
        return torch.cat([std[list(self.space.plain)], std[angles], std[angles]])

    @property
    def settings(self) -> dict[str, object]:
        """Numbers that a run depends on, as its summary and its checkpoints hold them."""
        return {
            **{name: value for name, value in self.adjustable.items() if "." not in name},
            "horizon": self.horizon,
            "exploration": self.exploration.settings,
            "search": asdict(self.method.search),
            "least_widths": self._least_widths.tolist(),
            "optimizer": getattr(self.method.optimizer, "__name__", str(self.method.optimizer)),
            "holds_start": self.holding_actions is not None,
            "held": self.held,
            "history": self.history and asdict(self.history),
            "state_box": self.state_box and self.state_box.settings,
            **self._own_parts,
        }

    @property
    def _own_parts(self) -> dict[str, object]:
        """Policy and model of a user's own, as a run's settings hold them."""
        method, parts = self.method, dict[str, object]()
        if method.make_policy is not None:
            inputs = len(self.space.feature_names)
            parts["policy"] = name_of(method.make_policy, self.actions, inputs)
        if method.own_model is not None:
            parts["model"] = type(method.own_model).__name__
        return parts

    def problem(self, seed: int) -> Problem:
        """What a trainer solves, with a new policy and a model without data."""
        policy = self.make_policy(generator_of(Stream.POLICIES, seed))
        measured = None
        if self.evaluated:
            measured = self.robots(MEASURED_STARTS, seed + Stream.MEASURED_STARTS)
        env, fall = self.robot(seed), None
        if self.demonstrations is not None:
            fall = FallGuard(env, self.space, self.demonstrations.positions, self.noise_std)
        return Problem(
            env=env,
            loss=self.make_loss(policy, self.make_dynamics()),
            initial=self.initial,
            error=self.error,
            tolerance=self.tolerance,
            make_policy=self.make_policy,
            exploration=self.exploration,
            measured=measured,
            box=self.state_box,
            fall=fall,
        )

    def robot(self, seed: int) -> MujocoRobotEnv | AdaptedEnv:
        """The robot that learns, whose motions end where they leave the box."""
        env, box = self.make_env(seed=seed), self.state_box
        set_guards(env, None if box is None else box.guard)
        return env

    def robots(self, starts: int, seed: int) -> MujocoRobotEnv | AdaptedEnv:
        """Robots to measure a policy on, one for each of ``starts`` fresh starts."""
        return self.make_env(num_envs=starts, seed=seed)

    def first_robot(self, seed: int) -> MujocoRobotEnv | AdaptedEnv:
        """One robot for the first target, to be filmed."""
        return self.make_env(seed=seed)

    @torch.no_grad()
    def errors(self, policy: StatePolicy, starts: int, seed: int) -> Tensor:
        """Errors of rollouts from fresh starts, infinite if cut short, (starts,) for each target.

        If not ``evaluated``, the one robot does all of them in turn.
        """
        module = policy.as_tensordict_module()
        if self.evaluated:
            return self.error(self.robots(starts, seed).rollout(self.horizon, module))
        robot, errors = self.robot(seed), []
        for _ in range(starts):
            rollout = as_executed(robot.rollout(self.horizon, module))
            errors.append(own_error(rollout, robot.cut_short, self.horizon, self.error))
        return torch.tensor(errors, dtype=torch.float64)

    def outcomes(
        self, predicted: Gaussian, rollouts: TensorDictBase, errors: Tensor
    ) -> list[Outcome]:
        """The outcome for each target, of batched rollouts of :meth:`robots` or :meth:`robot`."""
        shown = self.demonstrations
        marginals = None if shown is None else self.demonstrated
        return [Outcome("", shown, marginals, predicted, rollouts, errors)]

    def make_dynamics(self) -> ForwardModel:
        """A forward model of the robot, without data."""
        inputs = len(self.space.feature_names) + len(self.actions.names)
        method, known = self.method, self._known_part
        if method.own_model is not None:
            return OwnDynamics(method.own_model, inputs, known.num_outputs, known)
        tied = method.model.tied_lengthscales
        return GPDynamics(inputs, known.num_outputs, known, tied_lengthscales=tied)

    @property
    def _known_part(self) -> KnownPart:
        """What is known of the robot's next state before anything is learned."""
        past, names = self.history, self.space.names
        if past is not None:
            return KnownPart.of_readings(past.shift, past.gain, past.measured)
        if self.method.model.velocities_alone:
            velocities = {names[entry]: names[rate] for rate, entry in rates_of(names).items()}
            return KnownPart.of_velocities(
                names, velocities, len(self.actions.names), self.time_step
            )
        return KnownPart.of_differences(self.space.dim)

    def make_loss(self, policy: AnyPolicy, dynamics: ForwardModel) -> TrajectoryLoss:
        """The loss of the policy search: the KL between demonstrated and predicted trajectories."""
        return TrajectoryKLLoss(policy, dynamics, self.space, self.demonstrated, self.noise_std)

    def make_policy(self, generator: torch.Generator) -> AnyPolicy:
        """A new policy with centres near demonstrated states, see :meth:`policy_near`."""
        return self.policy_near(self.demonstrated_inputs, generator)

    def policy_near(self, inputs: Tensor, generator: torch.Generator) -> AnyPolicy:
        """A new policy for inputs (S, D'): an RBF network, or one of another kind.

        With ``holding_actions`` it holds the robot at the start.
        """
        settings, spread = self.method.policy, self._spread(inputs)
        of_inputs = inputs, spread, self.widths(spread), generator
        policy = new_policy(self.method.make_policy, settings, self.actions, *of_inputs)
        if self.holding_actions is not None:
            held = self.initial.sample(HELD_STARTS, generator)
            if self.held_states is not None:
                held = torch.cat([held, self.held_states])
            policy.fit_weights(self.start_inputs(held), self.holding_actions(held))
        return policy

    def widths(self, std: Tensor) -> Tensor:
        """Widths (D',) of a new policy's basis functions, from its inputs' standard deviations."""
        settings = self.method.policy
        given = settings.input_widths
        return settings.input_scale * std if given is None else given

    def _spread(self, inputs: Tensor) -> Tensor:
        """Standard deviations (D',) of inputs (S, D') that scale centres and widths.

        They are large enough that no width is below the smallest allowed: a policy would act at a
        single point along an input that hardly changes.
        """
        std = inputs.std(0)
        least = self._least_widths / self.method.policy.input_scale
        return torch.cat([torch.maximum(std[: len(least)], least), std[len(least) :]])

    @property
    def demonstrated_inputs(self) -> Tensor:
        """Inputs of a policy in the demonstrated states, (S, D')."""
        return self.space.features(self.demonstrated_states)

    def start_inputs(self, starts: Tensor) -> Tensor:
        """Inputs of a policy (S, D') in starts (S, D)."""
        return self.space.features(starts)


def check_initial(initial: Gaussian, dim: int) -> None:
    """Raise ValueError unless p(x_0) is over so many entries."""
    if initial.dim != dim:
        raise ValueError(f"initial must be over the {dim} entries of the state, got {initial.dim}")


def check_task(task: Task) -> None:
    """Raise TypeError or ValueError unless the parts of a task fit each other."""
    D, method, settings = task.space.dim, task.method, task.method.policy
    check_folder_name(task.name)
    for name in ("error", "predicted_error", "holding_actions", "sketch"):
        function = getattr(task, name)
        if not callable(function) and (function is not None or name == "error"):
            raise TypeError(f"{name} must be a function, got {type(function).__name__}")
    if outside := task.state_box and task.state_box.guard(task.initial.mean):
        raise ValueError(f"box must hold the mean of initial, but {outside}")
    names = task.space.match_space.names
    noise = check_noise(task.noise_std, names, zero=task.demonstrations is None)
    if noise.ndim:  # a list of numbers becomes a tensor
        object.__setattr__(task, "noise_std", noise)
    if task.demonstrations is not None:
        check_tensor("demonstrated_states", task.demonstrated_states, ("S", D))
    if task.held_states is not None:
        check_tensor("held_states", task.held_states, ("S", D))
    check_initial(task.initial, D)
    for name in ("input_widths", "least_widths"):
        if (widths := getattr(settings, name)) is not None:
            check_tensor(name, widths, (len(task.space.feature_names),))
    if method.model.velocities_alone and not rates_of(task.space.names):
        raise ValueError(
            "velocities_alone needs entries of the state that are velocities of others, dNAME "
            f"beside NAME, got {', '.join(task.space.names)}"
        )
    if isinstance(method.exploration, PDMovements):
        check_movements(method.exploration, D)
        return
    if method.exploration.explore_demonstrated:
        check_demonstrated_way(task.demonstrations, task.holding_actions, task.demonstrated_states)
    if task.horizon < FEWEST_TRANSITIONS:
        what = "horizon" if task.demonstrations is None else "demonstrations"
        raise DemonstrationError(
            f"{what} must have {FEWEST_TRANSITIONS + 1} samples at least, since the robot "
            f"explores for as long and its model needs {FEWEST_TRANSITIONS} transitions, got "
            f"{task.horizon + 1}"
        )
