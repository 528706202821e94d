"""An experiment: a robot, its demonstrations, the method's settings, and what a success is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, ClassVar, Self, TypeVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from torch_pmil.checks import check_noise, check_positive, check_tensor, check_whole
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.exploration import Exploration, PDMovements, RandomActions
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.recovered_states import rates_of, without_turns
from torch_pmil.control.state_box import StateBox
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import DemonstrationError, Demonstrations
from torch_pmil.demonstrations.distribution import expert_distribution
from torch_pmil.envs import AdaptedEnv, MujocoRobotEnv
from torch_pmil.envs.history import History
from torch_pmil.envs.robot import RobotEnv
from torch_pmil.envs.rollouts import OfStates, as_executed, states_of
from torch_pmil.files import short
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.experience import FEWEST_TRANSITIONS
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.promise import Promise, check_rate
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.trainer.plan_tracking import PlanTracking
from torch_pmil.trainer.trials import own_error

HELD_STARTS = 200  # at which a new policy is told to hold the robot
START_REACH = 3.0  # standard deviations of the start that the model's data reach at least
MOST_CENTRES = 10_000  # whose pairs a prediction goes through

Held = TypeVar("Held", bound="Experiment | PDMovements | SearchSettings")


@dataclass(frozen=True, eq=False)
class Outcome:
    """Predicted and executed trajectories of a policy beside the demonstrations of one target.

    Args:
        label: names the target; "" where there is one task alone.
        demonstrations: of it.
        demonstrated: their marginals at t = 1..T, mean (T, M).
        predicted: p(x_1..T), mean (T, D).
        rollouts: (N, T), as the environment gives them; of a rollout that was cut short, as far as
            it came.
        errors: of the rollouts, infinite where one was cut short, (N,).
    """

    label: str
    demonstrations: Demonstrations
    demonstrated: Gaussian
    predicted: Gaussian
    rollouts: TensorDictBase
    errors: Tensor

    @property
    def compared(self) -> Outcome:
        """The outcome up to where its rollouts end: all of it, unless one was cut short."""
        steps = self.rollouts.shape[-1]
        positions = self.demonstrations.positions[:, : steps + 1]
        return replace(
            self,
            demonstrations=replace(self.demonstrations, positions=positions),
            demonstrated=self.demonstrated[:steps],
            predicted=self.predicted[:steps],
        )

    @property
    def executed(self) -> Tensor:
        """States x_0..x_T of the rollouts, (N, T + 1, D)."""
        return states_of(self.rollouts)


@dataclass(frozen=True, eq=False)
class Experiment:
    """An imitation task.

    Args:
        name: as on the command line.
        make_env: environment for given ``num_envs`` (None or N), ``from_pixels`` and ``seed``.
        space: the robot's state space; the demonstrations are in its match space.
        demonstrations: N demonstrations.
        noise_std: observation noise, in the units of the match space: one number, or one for each
            entry, (M,).
        initial: p(x_0).
        actions: names, units and range of the robot's actions.
        demonstrated_states: states recovered from the demonstrations, (S, D), where the policy's
            centres are drawn.
        num_centres: m.
        error: of rollouts (*batch, T), as the environment gives them, (*batch);
            :func:`~torch_pmil.envs.rollouts.of_states` makes it of a function of the states
            x_0..x_T.
        tolerance: error up to which a rollout is a success.
        promise: success rate from fresh starts, below 1, that a run's end promises: the model that
            learned from the last own rollout predicts it, with a confidence of 95 %. A lower one
            ends sooner.
        confirmations: successes of own rollouts in a row without which no run ends: more where a
            success is a lenient measure, or where nothing can be predicted of it.
        predicted_error: error of predicted states x_0..x_T, (*batch, T + 1, D) to (*batch), where
            ``error`` reads more of a rollout than its states. None for that of ``error``, if it is
            made by ``of_states``; otherwise no success is predicted, and the confirmations alone
            end a run.
        evaluated: whether policies are measured from fresh starts, which are no experience, beside
            their own rollouts; False for a robot that a person resets.
        random_action: of exploration by random actions around those that hold the start, if they
            are known, or else the middle of the range; as a fraction of half the range.
        explore_demonstrated: whether these actions are around those that hold the robot in the mean
            demonstrated states, one after the other, and not in the start. So the model knows the
            way of the demonstrations from the first motion on, where actions are targets of servos.
        pd_movements: exploration by a PD controller; random actions for one horizon if None.
        initial_weight_std: of the policy's initial weights.
        input_scale: width of the policy's initial basis functions, in standard deviations of the
            demonstrated features; a policy is nothing beyond the reach of its functions, so starts
            at the rim of what was demonstrated may need more than 1.
        input_widths: the widths themselves (D',), in the units of the features; None for those by
            ``input_scale``.
        least_widths: widths (D',) below which none by ``input_scale`` falls, in the units of the
            features: how far a robot strays that moves slowly, or with a part of it alone. None for
            the standard deviations of the start, of which sine and cosine have that of their angle.
        holding_actions: actions (S, F) that hold the robot in states (S, D); a new policy holds it
            at the start. None: it need not.
        box: lowest and highest value of entries of the state or of the match space in which the
            robot shall stay while it learns, by name; see :class:`StateBox`. None for no limits.
        leaving_threshold: predicted probability of leaving them up to which a policy may run.
        held_states: states (S, D) beside the starts in which a new policy holds the robot. A servo
            whose target is not near the joint pulls with all its force, whatever the target: where
            actions are targets, a search that begins elsewhere has no slope to follow.
        velocities_alone: whether the model learns no positions of which the velocity is an entry,
            dNAME beside NAME: they follow from it by a rule whose two numbers are fitted.
        tied_lengthscales: whether all outputs of the model have the same lengthscales.
        history: past readings and actions that are entries of the state, see
            :func:`~torch_pmil.tasks.with_history.with_history`; None for none.
        plan_weight: weight of the actions in a plan on the mean of the model
            (:class:`~torch_pmil.trainer.plan_tracking.PlanTracking`), from which each search starts
            besides; None for no plan.
        search: budget and horizon of the policy search.
        draws: whether the environment gives pictures, for the video.

    ``objective`` is the class of the loss that :meth:`make_loss` gives.

    Raises:
        DemonstrationError: the demonstrations are too short.
        TypeError, ValueError: a setting is of another kind, shape or range.
    """

    objective: ClassVar[type[TrajectoryLoss]] = TrajectoryKLLoss

    name: str
    make_env: Callable[..., MujocoRobotEnv | AdaptedEnv]
    space: StateSpace
    demonstrations: Demonstrations
    noise_std: float | Tensor
    initial: Gaussian
    actions: ActionSpace
    demonstrated_states: Tensor
    num_centres: int
    error: Callable[[TensorDictBase], Tensor]
    tolerance: float
    promise: float = 0.95
    confirmations: int = 1
    predicted_error: Callable[[Tensor], Tensor] | None = None
    evaluated: bool = True
    random_action: float = 0.4
    explore_demonstrated: bool = False
    pd_movements: PDMovements | None = None
    initial_weight_std: float = 0.1
    input_scale: float = 1.0
    input_widths: Tensor | None = None
    least_widths: Tensor | None = None
    holding_actions: Callable[[Tensor], Tensor] | None = None
    box: Mapping[str, tuple[float, float]] | None = None
    leaving_threshold: float = 0.05
    held_states: Tensor | None = None
    velocities_alone: bool = False
    tied_lengthscales: bool = False
    history: History | None = None
    plan_weight: float | None = None
    search: SearchSettings = field(default_factory=SearchSettings)
    draws: bool = True

    def __post_init__(self) -> None:
        self._check_settings()
        transitions = self.exploration.rollouts * self.exploration.steps
        if transitions < FEWEST_TRANSITIONS and self.pd_movements is not None:
            raise ValueError(
                f"exploration.rollouts times exploration.steps must be at least "
                f"{FEWEST_TRANSITIONS}, got {transitions}"
            )
        if transitions < FEWEST_TRANSITIONS:
            raise DemonstrationError(
                f"demonstrations must have {FEWEST_TRANSITIONS + 1} samples at least, since the "
                f"robot explores for as long and its model needs {FEWEST_TRANSITIONS} transitions, "
                f"got {self.horizon + 1}"
            )

    def _check_settings(self) -> None:
        D = self.space.dim
        if outside := self.state_box and self.state_box.guard(self.initial.mean):
            raise ValueError(f"box must hold the mean of initial, but {outside}")
        check_noise(self.noise_std, self.space.match_space.names)
        check_tensor("demonstrated_states", self.demonstrated_states, ("S", D))
        if self.held_states is not None:
            check_tensor("held_states", self.held_states, ("S", D))
        if self.initial.dim != D:
            raise ValueError(
                f"initial must be over the {D} entries of the state, got {self.initial.dim}"
            )
        check_whole("num_centres", self.num_centres, 1, MOST_CENTRES)
        check_whole("confirmations", self.confirmations, 1)
        check_rate("promise", self.promise)
        for name in ("input_scale", "random_action"):
            check_positive(name, getattr(self, name))
        if self.random_action > 1:
            raise ValueError(f"random_action must be at most 1, got {self.random_action!r}")
        for name in ("tolerance", "initial_weight_std"):
            check_positive(name, getattr(self, name), zero=True)
        for name in ("input_widths", "least_widths"):
            widths = getattr(self, name)
            if widths is not None:
                check_tensor(name, widths, (len(self.space.feature_names),))
                if not (widths > 0).all():
                    raise ValueError(f"{name} must be positive, got {widths.tolist()}")
        for name in ("evaluated", "velocities_alone", "tied_lengthscales", "explore_demonstrated"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name} must be true or false, got {getattr(self, name)!r}")
        if self.explore_demonstrated:
            self._check_demonstrated_way()
        if self.plan_weight is not None:
            self._check_plan(self.plan_weight)
        if self.velocities_alone and not rates_of(self.space.names):
            raise ValueError(
                "velocities_alone needs entries of the state that are velocities of others, dNAME "
                f"beside NAME, got {', '.join(self.space.names)}"
            )
        if not isinstance(self.search, SearchSettings):
            raise TypeError(f"search must be SearchSettings, got {type(self.search).__name__}")
        check_positive("search.trust_threshold", self.search.trust_threshold, zero=True)
        if self.pd_movements is not None and self.pd_movements.pose.shape != (D,):
            raise ValueError(
                f"exploration.pose must be a state of {D} entries, got "
                f"{len(self.pd_movements.pose)}"
            )

    def _check_demonstrated_way(self) -> None:
        """Raise ValueError unless it is known what holds the robot along the demonstrations."""
        states, held = len(self.demonstrated_states), self.holding_actions is not None
        count, samples = self.demonstrations.positions.shape[:2]
        if not held or states != count * samples:
            raise ValueError(
                "explore_demonstrated needs holding_actions, and demonstrated_states of all "
                f"{count} times {samples} samples, got {states} states"
                f"{'' if held else ' and no holding_actions'}"
            )

    def _check_plan(self, weight: float) -> None:
        """Raise ValueError unless the demonstrations tell states that a plan can be near to."""
        check_positive("plan_weight", weight)
        count, samples = self.demonstrations.positions.shape[:2]
        if self.demonstrations.targets is not None or len(self.demonstrated_states) != (
            count * samples
        ):
            raise ValueError(
                "plan_weight needs demonstrations of one task, and demonstrated_states of all "
                f"{count} times {samples} samples, got {len(self.demonstrated_states)} states"
                f"{'' if self.demonstrations.targets is None else ' of several targets'}"
            )
        variance = self.plan_tracking(weight).variance
        still = [
            name
            for name, least in zip(self.space.names, variance.amin(0).tolist(), strict=True)
            if not least > 0
        ]
        if still:
            raise ValueError(
                "plan_weight needs states that vary, between demonstrations or starts, got no "
                f"variance of {', '.join(still)}"
            )

    @property
    def state_box(self) -> StateBox | None:
        """Limits of the robot's motion while it learns; None if there are none."""
        if self.box is None:
            return None
        return StateBox(self.space, self.box, self.leaving_threshold)

    @property
    def promised(self) -> Promise | None:
        """The success rate that ends a run; None where no success can be predicted."""
        error = self.predicted_error
        if error is None and isinstance(self.error, OfStates):
            error = self.error.of_states
        return None if error is None else Promise(self.promise, error, self.tolerance)

    @property
    def tracking(self) -> PlanTracking | None:
        """How to plan on the mean of the model; None if no search starts so."""
        return None if self.plan_weight is None else self.plan_tracking(self.plan_weight)

    def plan_tracking(self, action_weight: float) -> PlanTracking:
        """How to plan on the mean of the model towards the mean demonstrated states.

        Args:
            action_weight: weight of the actions.
        """
        turned = self.demonstrated_states.unflatten(0, self.demonstrations.positions.shape[:2])
        states = without_turns(turned, self.initial.mean, self.space.angles)
        mean, held = states.mean(0), self.holding_actions
        return PlanTracking(
            self.space,
            self.actions,
            self.initial.mean,
            mean,
            states.var(0) + self.initial.std.square(),
            None if held is None else held(mean[:-1]),
            action_weight,
        )

    @property
    def horizon(self) -> int:
        """T, number of control steps."""
        return self.demonstrations.positions.shape[1] - 1

    @property
    def demonstrated(self) -> Gaussian:
        """Demonstrated marginals at t = 1..T, observation noise included."""
        return expert_distribution(self.demonstrations, self.noise_std)

    @property
    def exploration(self) -> Exploration:
        """The robot's motion before anything is learned."""
        if self.pd_movements is not None:
            return self.pd_movements
        around = None
        if self.explore_demonstrated:
            around = self._demonstrated_actions
        elif self.holding_actions is not None:
            around = self.holding_actions(self.initial.mean[None])[0]
        return RandomActions(self.actions, self.random_action, self.horizon, around=around)

    @property
    def _demonstrated_actions(self) -> Tensor:
        """Actions (T, F) that hold the robot in the mean demonstrated states x_1..x_T."""
        assert self.holding_actions is not None
        each = self.demonstrated_states.unflatten(0, self.demonstrations.positions.shape[:2])
        return self.holding_actions(each.mean(0)[1:])

    @property
    def limits(self) -> Tensor:
        """Largest absolute values of the state (D,) in the data of the model.

        They are three times the demonstrated ones, and hold the robot's starts at least; angles
        have no limit. A training widens them where they would leave its model fewer transitions
        of the exploration than it has inputs (:func:`~torch_pmil.model.experience.widened`).
        """
        start = self.initial.mean.abs() + START_REACH * self.initial.std
        limits = torch.maximum(3 * self.demonstrated_states.abs().amax(0), start)
        limits[list(self.space.angles)] = torch.inf
        if self.history is not None:
            limits[self.history.dim - self.history.num_past_actions :] = torch.inf
        return limits

    @property
    def settings(self) -> dict[str, object]:
        """Numbers that a run depends on, as its summary and its checkpoints hold them."""
        return {
            "horizon": self.horizon,
            "num_centres": self.num_centres,
            "noise_std": torch.as_tensor(self.noise_std, dtype=torch.float64).tolist(),
            "random_action": self.random_action,
            "explore_demonstrated": self.explore_demonstrated,
            "exploration": self.exploration.settings,
            "initial_weight_std": self.initial_weight_std,
            "input_scale": self.input_scale,
            "input_widths": None if self.input_widths is None else self.input_widths.tolist(),
            "least_widths": self._least_widths.tolist(),
            "holds_start": self.holding_actions is not None,
            "tolerance": self.tolerance,
            "promise": self.promise,
            "confirmations": self.confirmations,
            "evaluated": self.evaluated,
            "velocities_alone": self.velocities_alone,
            "tied_lengthscales": self.tied_lengthscales,
            "plan_weight": self.plan_weight,
            "history": self.history and asdict(self.history),
            "state_box": self.state_box and self.state_box.settings,
            "search": asdict(self.search),
        }

    @property
    def adjustable(self) -> dict[str, object]:
        """What :meth:`with_settings` changes: names and present values, in types that JSON has."""
        settings: dict[str, Any] = self.settings
        moved = self.pd_movements is not None
        groups = ("exploration", "search") if moved else ("search",)
        unused = {
            "search",
            "history",
            *(("random_action", "explore_demonstrated") if moved else ()),
        }
        if self.holding_actions is None:
            unused.add("explore_demonstrated")
        own = {entry.name for entry in fields(self)} - unused
        return {name: value for name, value in settings.items() if name in own} | {
            f"{group}.{name}": value for group in groups for name, value in settings[group].items()
        }

    def with_settings(self, **changes: object) -> Self:
        """The experiment with other settings, under the names of the command line.

        Args:
            changes: any of :attr:`adjustable`: numbers, lists of them, or true and false.

        Raises:
            ValueError: it has no such setting, or one is of another type, shape or range.

        Example:
            >>> from torch_pmil import load_experiment
            >>> changes = {"noise_std": 0.1, "search.final_iterations": 60}
            >>> experiment = load_experiment("double_pendulum").with_settings(**changes)
            >>> experiment.noise_std, experiment.search.final_iterations
            (0.1, 60)
        """
        known = self.adjustable
        for name in changes:
            if name not in known:
                raise ValueError(
                    f"a setting of {self.name} must be one of {', '.join(known)}, got {name}"
                )
        grouped = replace(
            self,
            search=_with(self.search, "search.", changes),
            pd_movements=self.pd_movements and _with(self.pd_movements, "exploration.", changes),
        )
        return _with(grouped, "", changes)

    def robot(self, seed: int) -> MujocoRobotEnv | AdaptedEnv:
        """The robot that learns."""
        return self.make_env(seed=seed)

    def robots(self, starts: int, seed: int) -> MujocoRobotEnv | AdaptedEnv:
        """Robots to measure a policy on, one for each of ``starts`` fresh starts."""
        return self.make_env(num_envs=starts, seed=seed)

    @torch.no_grad()
    def executed(self, policy: StatePolicy, starts: int, seed: int) -> TensorDictBase:
        """Rollouts of a policy by :meth:`robots`, over the whole horizon."""
        return self.robots(starts, seed).rollout(self.horizon, policy.as_tensordict_module())

    @torch.no_grad()
    def errors(self, policy: StatePolicy, starts: int, seed: int) -> Tensor:
        """Errors (starts,) of a policy's rollouts from fresh starts, infinite if cut short.

        Where policies are not measured beside their own rollouts, the one robot does all of them in
        turn.
        """
        if self.evaluated:
            return self.error(self.executed(policy, starts, seed))
        robot, module = self.robot(seed), policy.as_tensordict_module()
        if self.state_box is not None:
            robot.guard = self.state_box.guard
        errors = [self._own_error(robot, module) for _ in range(starts)]
        return torch.tensor(errors, dtype=torch.float64)

    def _own_error(self, robot: RobotEnv, module: TensorDictModule) -> float:
        rollout = as_executed(robot.rollout(self.horizon, module))
        return own_error(rollout, robot.cut_short, self.horizon, self.error)

    def first_robot(self, seed: int) -> MujocoRobotEnv | AdaptedEnv:
        """One robot for the first task, to be filmed."""
        return self.make_env(seed=seed)

    def outcomes(
        self, predicted: Gaussian, rollouts: TensorDictBase, errors: Tensor
    ) -> list[Outcome]:
        """The outcome of each task: its parts of the prediction, the rollouts and their errors.

        The rollouts are those of :meth:`robots`, or of :meth:`robot` in a batch.
        """
        return [Outcome("", self.demonstrations, self.demonstrated, predicted, rollouts, errors)]

    def make_dynamics(self) -> GPDynamics:
        """A forward model of the robot, without data."""
        actions, time_step = len(self.actions.names), self.demonstrations.time_step
        inputs, tied = len(self.space.feature_names) + actions, self.tied_lengthscales
        if self.history is not None:
            past = self.history
            known = KnownPart.of_readings(past.shift, past.gain, past.measured)
            return GPDynamics(inputs, known.num_outputs, known, tied_lengthscales=tied)
        if not self.velocities_alone:
            return GPDynamics(inputs, self.space.dim, tied_lengthscales=tied)
        names = self.space.names
        velocities = {names[entry]: names[rate] for rate, entry in rates_of(names).items()}
        known = KnownPart.of_velocities(names, velocities, actions, time_step)
        return GPDynamics(inputs, known.num_outputs, known, tied_lengthscales=tied)

    def make_loss(self, policy: RBFPolicy, dynamics: GPDynamics) -> TrajectoryLoss:
        """The loss of the policy search: the KL between demonstrated and predicted trajectories."""
        return TrajectoryKLLoss(policy, dynamics, self.space, self.demonstrated, self.noise_std)

    def make_policy(self, generator: torch.Generator) -> RBFPolicy:
        """A new policy with centres near demonstrated states, see :meth:`policy_near`.

        It holds the robot at the start if the experiment knows the actions for it.
        """
        return self.policy_near(self.demonstrated_inputs, generator)

    def policy_near(self, inputs: Tensor, generator: torch.Generator) -> RBFPolicy:
        """A new policy with centres near some of the inputs (S, D') and small random weights.

        Its widths are the standard deviations of all inputs, or ``least_widths``, unless the
        experiment gives them. It holds the robot at the start if the experiment knows the actions
        for it.
        """
        std = self._spread(inputs)
        chosen = torch.randint(len(inputs), (self.num_centres,), generator=generator)
        jitter = torch.randn(self.num_centres, len(std), dtype=torch.float64, generator=generator)
        centres, actions = inputs[chosen] + 0.1 * std * jitter, self.actions
        policy = RBFPolicy(centres, actions.half_range, self.widths(std), actions.middle)
        white = torch.randn(policy.weights.shape, dtype=torch.float64, generator=generator)
        policy.weights.data.copy_(self.initial_weight_std * white)
        if self.holding_actions is not None:
            held = self.initial.sample(HELD_STARTS, generator)
            if self.held_states is not None:
                held = torch.cat([held, self.held_states])
            policy.fit_weights(self.start_inputs(held), self.holding_actions(held))
        return policy

    def widths(self, std: Tensor) -> Tensor:
        """Widths (D',) of a new policy's basis functions, from its inputs' standard deviations."""
        return self.input_scale * std if self.input_widths is None else self.input_widths

    def _spread(self, inputs: Tensor) -> Tensor:
        """Standard deviations (D',) of inputs (S, D') by which centres and widths are scaled.

        An input that hardly changes, as of a robot or a link that stays where it is, has the one
        that makes its width the least: without it a policy acts at a point alone.
        """
        std = inputs.std(0)
        least = self._least_widths / self.input_scale
        return torch.cat([torch.maximum(std[: len(least)], least), std[len(least) :]])

    @property
    def _least_widths(self) -> Tensor:
        if self.least_widths is not None:
            return self.least_widths
        std, angles = self.initial.std, list(self.space.angles)
        return torch.cat([std[list(self.space.plain)], std[angles], std[angles]])

    @property
    def demonstrated_inputs(self) -> Tensor:
        """Inputs of a policy in the demonstrated states, (S, D')."""
        return self.space.features(self.demonstrated_states)

    def start_inputs(self, starts: Tensor) -> Tensor:
        """Inputs of a policy (S, D') in starts (S, D)."""
        return self.space.features(starts)


def _with(held: Held, prefix: str, changes: Mapping[str, object]) -> Held:
    """A dataclass with the changes of its own fields, whose names begin with the prefix."""
    own: dict[str, Any] = {
        entry.name: _numbers(name, changes[name], str(entry.type))
        for entry in fields(held)
        if (name := f"{prefix}{entry.name}") in changes
    }
    try:
        return replace(held, **own)
    except ValueError as error:  # begins with the name of a field
        raise ValueError(f"{prefix}{error}") from error


def _numbers(name: str, value: object, kind: str) -> object:
    """A value as a tensor where a field of that kind has no other, or where it is a list."""
    if "Tensor" not in kind or ("float" in kind and not isinstance(value, list | tuple)):
        return value
    try:
        return torch.as_tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise ValueError(f"{name} must be numbers, got {short(value)}") from error


def independent_start(mean: Tensor, std: Tensor) -> Gaussian:
    """p(x_0) of independent entries with these means and standard deviations, (D,) each."""
    return Gaussian(mean, torch.diag(std**2))


def actions_of(env: MujocoRobotEnv | AdaptedEnv) -> ActionSpace:
    """Names, units and range of the actions of one robot.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> print(actions_of(DoublePendulumEnv()))
        tau1 (N·m) from -3.5 to 3.5, tau2 (N·m) from -3.5 to 3.5
    """
    bounds = env.action_spec.space
    return ActionSpace(env.action_names, env.action_units, bounds.low, bounds.high)


def fitting(
    demonstrations: Demonstrations,
    space: StateSpace,
    env: MujocoRobotEnv | AdaptedEnv,
    target_names: tuple[str, ...] = (),
) -> Demonstrations:
    """Demonstrations with their columns in the order of the match space.

    Raises:
        DemonstrationError: their names, targets or time step are not those of the task.
    """
    if demonstrations.target_names != target_names:
        wanted = ", ".join(target_names) or "none"
        found = ", ".join(demonstrations.target_names) or "none"
        raise DemonstrationError(f"targets of the demonstrations must be {wanted}, got {found}")
    demonstrations = demonstrations.in_order(space.match_space.names)
    if abs(demonstrations.time_step / env.control_period - 1) > 1e-6:
        raise DemonstrationError(
            f"demonstrations must have a time step of {env.control_period} s, the robot's control "
            f"period, got {demonstrations.time_step} s; pmil align --time-step "
            f"{env.control_period} resamples a recording"
        )
    return demonstrations
