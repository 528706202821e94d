"""The figures of a run: what was learned, how, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from math import nan

import torch
from torch import Tensor

from torch_pmil import plotting
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.recovered_states import rates_of
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, with_unit
from torch_pmil.model.calibration import standardised_residuals
from torch_pmil.model.rollout import predict_mean_trajectory
from torch_pmil.runs.summaries import judged_alone, rate_of
from torch_pmil.runs.training import RunResult
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.tasks.handwriting import writing_of
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.task import Task

SLICED = 4  # inputs of the model that slices go over
SHARES = (0.2, 0.4, 0.6, 1.0)  # of the horizon: times at which the policy is shown
MARGIN = 0.3  # around the executed motion, in its range


def figures_of(task: Task, result: RunResult) -> Iterator[tuple[str, plotting.Figure]]:
    """All figures of a run with their names, which end in ``_target_0``, ... for one of several.

    Those that show a prediction alone are left out if the model cannot predict.
    """
    yield "learning_curve", _learning_curve(task, result)
    for number, outcome in enumerate(result.outcomes):
        target = f"_target_{number}" if len(result.outcomes) > 1 else ""
        for name, figure in _of_outcome(task, result, outcome):
            yield name + target, figure
    yield "calibration", _calibration(task, result)
    yield "model", _model(task, result)
    first = result.outcomes[0]
    if task.sketch is not None:
        joints = task.sketch(first.executed[0])
        yield "poses", plotting.plot_poses(joints, task.time_step)
    if task.plane is not None and is_predicted(first):
        writing = writing_of(task, first.predicted, first.rollouts)
        yield "writing", plotting.plot_writing({task.name.replace("_", " "): writing})


def is_predicted(outcome: Outcome) -> bool:
    """Whether the newest model can predict the saved policy's trajectory."""
    return bool(outcome.predicted.mean.isfinite().all())


def _learning_curve(task: Task, result: RunResult) -> plotting.Figure:
    objective, trials, summary = task.objective, result.trials, result.summary
    saved_loss = sum(summary.get("loss_per_step", [nan]))  # NaN without a prediction
    return plotting.plot_learning_curve(
        [t.experience_s for t in trials],
        [rate_of(vars(t)) for t in trials],
        [t.loss for t in trials],
        with_unit(f"predicted {objective.label}", objective.unit),
        (summary["experience_s"], summary["saved_success_rate"], saved_loss),
        of_one_rollout=judged_alone(summary),
    )


def _of_outcome(
    task: Task, result: RunResult, outcome: Outcome
) -> Iterator[tuple[str, plotting.Figure]]:
    """The figures of one target: trajectories, KL of each step if it was minimised, and policy."""
    match_space, time_step = task.space.match_space, task.time_step
    names, demonstrated, shown = match_space.names, outcome.demonstrated, outcome.demonstrations
    predicted = match_space.moments(outcome.predicted).add_noise(task.noise_std**2)
    yield (
        "trajectories",
        plotting.plot_distributions(
            names,
            match_space.units,
            time_step,
            None if shown is None else shown.positions,
            demonstrated,
            predicted,
            _whole(match_space(outcome.executed), task.horizon),
        ),
    )
    if not is_predicted(outcome):
        return
    if demonstrated is not None and issubclass(task.objective, TrajectoryKLLoss):
        yield "kl_per_step", plotting.plot_kl_per_step(names, time_step, demonstrated, predicted)
    planes = planes_of(task.space, len(task.actions.names), outcome.executed)
    if planes:
        yield "policy", _policy(task, result, outcome, planes)


def _whole(path: Tensor, steps: int) -> Tensor:
    """Paths (N, up to T + 1, M) that go on as NaN where they were cut short, (N, T + 1, M)."""
    return torch.nn.functional.pad(path, (0, 0, 0, steps + 1 - path.shape[1]), value=nan)


def planes_of(space: StateSpace, actions: int, executed: Tensor) -> list[plotting.Plane]:
    """The planes of each position q and its velocity dq, a little larger than the executed motion.

    Each plane shows its own joint's action if every joint has one, else the first action.

    Args:
        space: of the robot.
        actions: F.
        executed: states of rollouts, (N, T + 1, D).

    Example:
        >>> from torch_pmil.tasks.registry import load_experiment
        >>> space = load_experiment("double_pendulum").space
        >>> planes = planes_of(space, 2, torch.eye(4)[None])
        >>> [(plane.x, plane.y, plane.action) for plane in planes]
        [(0, 1, 0), (2, 3, 1)]
    """
    low, high = executed.flatten(0, 1).aminmax(dim=0)
    margin = (MARGIN * (high - low)).clamp(min=torch.finfo(low.dtype).eps)
    spans = torch.stack([low - margin, high + margin], -1).tolist()
    pairs = [(position, rate) for rate, position in rates_of(space.names).items()]
    own = actions == len(pairs)
    return [
        plotting.Plane(x, y, index if own else 0, (tuple(spans[x]), tuple(spans[y])))
        for index, (x, y) in enumerate(pairs)
    ]


def _policy(
    task: Task, result: RunResult, outcome: Outcome, planes: list[plotting.Plane]
) -> plotting.Figure:
    """The policy in planes of the state at predicted times; arrows are the model's mean."""
    policy, space, dynamics = result.policy, task.space, result.dynamics
    if outcome.target is not None:
        assert isinstance(policy.policy, RBFPolicy)  # the loss of several targets demands it
        network = policy.policy.for_target(outcome.target)
        policy = StatePolicy(network, space, policy.control_period, actions=policy.actions)
    steps = [max(round(share * task.horizon), 1) for share in SHARES]
    titles = [f"t = {step * policy.control_period:g} s" for step in steps]
    states = outcome.predicted.mean[[step - 1 for step in steps]]

    def following(at: Tensor) -> Tensor:
        return predict_mean_trajectory(at, policy.policy, dynamics, space, horizon=1)[:, 0]

    return plotting.plot_policy(policy, planes, states, titles, following)


def _calibration(task: Task, result: RunResult) -> plotting.Figure:
    """Calibration of the model on rollouts of the saved policy, of all targets together."""
    states = torch.cat([outcome.executed for outcome in result.outcomes])
    actions = torch.cat([outcome.rollouts["action"] for outcome in result.outcomes])
    space, time_step = task.space, task.time_step
    residuals = standardised_residuals(result.dynamics, space, states, actions)
    learned = result.dynamics.known_part(space).uncertain
    names = [name for name, own in zip(space.names, learned.tolist(), strict=True) if own]
    return plotting.plot_calibration(names, time_step, residuals[..., learned])


def _model(task: Task, result: RunResult) -> plotting.Figure:
    """Slices through the model, over its most relevant inputs, where the robot was halfway."""
    space, dynamics, outcome = task.space, result.dynamics, result.outcomes[0]
    halfway = outcome.rollouts.shape[-1] // 2
    features = space.features(outcome.executed[0, halfway])
    point = torch.cat([features, outcome.rollouts["action"][0, halfway]])
    learned = dynamics.known_part(space).learned
    relevance = (dynamics.train_inputs.std(0) / dynamics.lengthscales).amax(0)
    units = dict(zip(space.names, space.units, strict=True))
    of_features = [with_unit(name, units.get(name)) for name in space.feature_names]
    return plotting.plot_gp_slices(
        dynamics,
        point,
        [*of_features, *task.actions.labels],
        [space.names[entry] for entry in learned],
        [space.units[entry] for entry in learned],
        sliced(relevance, len(task.actions.names)),
    )


def sliced(relevance: Tensor, actions: int) -> list[int]:
    """The inputs that slices go over: the most relevant actions and features, one feature at least.

    Args:
        relevance: of each input, the features before the actions, (D' + F,).
        actions: F.

    Example:
        >>> sliced(torch.tensor([3.0, 1.0, 5.0, 4.0, 0.1, 0.2]), actions=2)
        [2, 3, 4, 5]
    """
    features, shown = len(relevance) - actions, min(actions, SLICED - 1)
    chosen = [
        relevance[:features].topk(min(SLICED - shown, features)).indices,
        features + relevance[features:].topk(shown).indices,
    ]
    return torch.cat(chosen).sort().values.tolist()
