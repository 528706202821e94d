"""Why a run did not learn: each reason is provoked by fitted models and robots that moved."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor

from reproduction.delay_calibration import with_delay
from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.rollouts import rollout_of, states_of
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.runs.diagnosis.after_a_run import evidence_in, likely_reasons
from torch_pmil.runs.diagnosis.before_a_run import needed_torques
from torch_pmil.runs.diagnosis.causes import check_past
from torch_pmil.runs.diagnosis.measures import LEARNED, MATCHED
from torch_pmil.runs.training import train
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.promise import PredictedSuccess, Promise
from torch_pmil.tasks.fitting import actions_of
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import with_history

STARTS, LEARNED_FROM = 8, 5
HEAVY = (0.5, 0.9)  # kg
STUCK = (5, 8, 8, 8, 8)
# a search that is content with any match
CONTENT = {"search.trust_threshold": 1e6, "search.trust_what_is_sure": False}


def swing_up(**changes: object) -> Task:
    task = load_experiment("double_pendulum").with_settings(velocities_alone=False)
    return replace(task, **changes)


def weak_swing_up(limit: float, samples: int) -> Task:
    """The beginning of the swing-up, for motors that are too weak."""
    weak = partial(DoublePendulumEnv, torque_limit=limit)
    beginning = shown(shipped_demonstrations("double_pendulum").positions[:, :samples])
    beginning = beginning.with_settings(num_centres=30)
    return replace(beginning, make_env=weak, actions=actions_of(weak()))


def shown(positions: Tensor) -> Task:
    shipped = shipped_demonstrations("double_pendulum")
    return load_experiment("double_pendulum", replace(shipped, positions=positions))


def rollouts(task: Task, policy: RBFPolicy, starts: int, seed: int) -> TensorDictBase:
    acting = StatePolicy(policy, task.space, task.time_step, task.target_names)
    with torch.no_grad():
        robots = task.robots(starts, seed)
        return robots.rollout(task.horizon, acting.as_tensordict_module())


def new_policy(task: Task) -> RBFPolicy:
    return task.make_policy(torch.Generator().manual_seed(0))


def tracking_policy(task: Task) -> RBFPolicy:
    """What does in the demonstrated states what they ask of the motors."""
    torques, policy = needed_torques(task), new_policy(task)
    before = task.demonstrated_states.unflatten(0, (len(torques), -1))[:, :-1]
    policy.fit_weights(task.space.features(before).flatten(0, 1), torques.flatten(0, 1))
    return policy


def model_of(task: Task, policy: RBFPolicy, steps: int | None = None) -> GPDynamics:
    """Fitted to the first steps of a few rollouts of the policy."""
    lived = rollouts(task, policy, LEARNED_FROM, 1)[:, :steps]
    inputs = torch.cat([task.space.features(lived["observation"]), lived["action"]], -1)
    dynamics, changes = task.make_dynamics(), states_of(lived).diff(dim=-2)
    dynamics.fit(inputs.flatten(0, -2), changes.flatten(0, -2), max_iterations=40)
    return dynamics


def diagnose(
    task: Task,
    policy: RBFPolicy,
    dynamics: GPDynamics,
    horizons: tuple[int, ...] = STUCK,
    starts: int = STARTS,
    recorded: Sequence[TensorDictBase] = (),
) -> dict[str, str]:
    """Messages by cause, in order, of a policy that ran on the robot."""
    loss = task.make_loss(policy, dynamics)
    with torch.no_grad():
        executed = rollouts(task, policy, starts, 2)
        predicted = loss.predict_states(task.initial)
        outcomes = task.outcomes(predicted, executed, task.error(executed))
    reasons = likely_reasons(task, loss, outcomes, horizons, recorded)
    assert len({reason.cause for reason in reasons}) == len(reasons)
    return {reason.cause: reason.message for reason in reasons}


@cache
def learned() -> tuple[RBFPolicy, GPDynamics]:
    """A policy of the swing-up, and a model of its very motions."""
    policy = tracking_policy(swing_up())
    return policy, model_of(swing_up(), policy)


def test_robot_that_changed_makes_its_model_wrong() -> None:
    """The second link is heavier than when the model was fitted."""
    heavier = swing_up(make_env=partial(DoublePendulumEnv, HEAVY))
    found = diagnose(heavier, *learned())
    causes, message = list(found), found["model not right"]
    assert causes.index("model not right") < causes.index("search stuck")
    assert "too little experience" not in found
    assert int(re.match(r"(\d+) % of the one-step errors in d?q[12],", message)[1]) < 75
    assert re.search(r"the rollouts leave the prediction at 0\.\d0 s, first in d?q[12];", message)


def test_model_with_lengthscales_that_are_too_long_is_wrong() -> None:
    """It is too sure of itself between its data."""
    (policy, dynamics), sure = learned(), swing_up().make_dynamics()
    sure.load_state_dict(dynamics.state_dict())
    sure.gp.covar_module.base_kernel.lengthscale = 2 * sure.gp.covar_module.base_kernel.lengthscale
    sure.set_data(dynamics.train_inputs, dynamics.train_targets)
    message = diagnose(swing_up(), policy, sure)["model not right"]
    assert int(message.partition(" %")[0]) < 70


def test_model_of_the_first_steps_alone_knows_little_of_the_others() -> None:
    policy, _ = learned()
    first_steps = model_of(swing_up(), policy, steps=3)
    found = diagnose(swing_up(), policy, first_steps)
    share, when, data = re.match(
        r"in (\d+) % of the executed steps, first at (\d\.\d+) s, the model has few of its (\d+)",
        found["too little experience"],
    ).groups()
    assert int(share) > 20 and float(when) >= 0.3 and int(data) == 3 * LEARNED_FROM


@pytest.mark.parametrize(("delay", "remembered"), [(0.0, 0), (0.1, 0), (0.1, 1)])
def test_torques_that_act_late_are_named_until_the_state_holds_them(
    delay: float, remembered: int
) -> None:
    """Random torques, which do not predict each other."""
    late = with_delay(delay)
    if remembered:
        late = with_history(late, past_actions=remembered)
    torques = Draws(3)
    moved = late.robots(8, 4).rollout(20, lambda state: 1.5 * torques.normal(8, 2))
    evidence = evidence_in(late, late.make_dynamics().targets, [moved])
    reason = check_past(evidence)
    if delay and not remembered:
        assert reason.cause == "robot acts late" and "past_actions=1" in reason.message
        assert reason.message.startswith("the action 0.10 s before explains the motion ")
        found = diagnose(late, *learned(), recorded=[moved])
        assert list(found).index("robot acts late") < list(found).index("search stuck")
    else:
        assert reason is None


def test_velocity_that_is_not_measured_is_named_but_too_short_rollouts_are_no_evidence() -> None:
    torques = Draws(3)
    moved = swing_up().robots(8, 4).rollout(25, lambda state: 1.5 * torques.normal(8, 2))
    angles = ("q1", "q2")
    space = StateSpace(angles, ("rad", "rad"), (0, 1), joint_match(angles, ("rad", "rad")))
    for key in ("observation", ("next", "observation")):
        moved[key] = moved[key][..., [0, 2]]
    known = {"horizon": 25, "history": None, "time_step": swing_up().time_step}
    blind = SimpleNamespace(space=space, **known)
    reason = check_past(evidence_in(blind, "difference", [moved]))
    assert reason.cause == "state does not show all"
    assert evidence_in(swing_up(), "difference", []) is None
    one = [swing_up().robots(2, 4).rollout(4)]
    assert evidence_in(weak_swing_up(1.0, 5), "difference", one) is None


def test_search_is_stuck_where_the_kl_rises_or_wants_more_trials_if_it_came_further() -> None:
    task = swing_up()
    ((cause, message),) = diagnose(task, *learned()).items()  # as the model is right
    assert cause == "search stuck"
    with torch.no_grad():
        kl = task.make_loss(*learned()).step_loss_for_trust(task.initial)
    step = int(re.search(r"\(step (\d+) of 25\)", message)[1])
    assert kl[step - 1] > MATCHED >= kl[: step - 1].max()
    assert message.startswith(
        f"the KL of a step rises from {kl[step - 2]:.3g} at {0.1 * (step - 1):.2f} s to "
        f"{kl[step - 1]:.3g} nats at "
    )
    belief = r"-?\d\.\d\d ± \d\.\d\d m"
    assert re.search(rf"most in [xy][12] \(predicted {belief}, demonstrated {belief}\)", message)
    assert "step 5, 8, 8, 8, 8: 3 trials led them no further, so try another seed" in message
    for horizons in ((5, 5), (5, 8, 8, 8, 11)):
        message = diagnose(task, *learned(), horizons)["too few trials"]
        assert "more trials may lead them further" in message


def test_wrong_demonstrations_come_first_and_few_last() -> None:
    positions = swing_up().demonstrations.positions
    cause, message = next(iter(diagnose(shown(1.3 * positions), *learned()).items()))
    assert cause == "demonstrations out of reach"
    assert message.startswith("demonstration 0 leaves the workspace: at ")
    assert message.endswith(" (and 4 more of this kind)")
    both = torch.cat([positions, positions * torch.tensor([-1.0, 1.0, -1.0, 1.0])])
    assert next(iter(diagnose(shown(both), *learned()))) == "contradictory demonstrations"
    found = list(diagnose(shown(positions[:2]), *learned()))
    assert (found[0], found[-1]) == ("search stuck", "too few demonstrations")


def wrapping_first_entry(rollout: TensorDictBase) -> TensorDictBase:
    """The rollouts as a sensor shows them that wraps the first entry, which turns through pi."""
    states = states_of(rollout)
    turned = torch.linspace(3.0, 4.0, states.shape[-2], dtype=states.dtype)
    states[..., 0] = torch.where(turned < math.pi, turned, turned - 2 * math.pi)
    return rollout.copy().update(rollout_of(states))


def test_sensor_that_wraps_comes_first_unless_its_entry_is_a_declared_angle() -> None:
    """The recordings go on."""
    task = load_experiment("biorob")
    still = new_policy(task)
    moved = wrapping_first_entry(rollouts(task, still, 2, 3))
    found = diagnose(task, still, model_of(task, still, steps=6), starts=3, recorded=[moved])
    cause, message = next(iter(found.items()))
    assert cause == "angles that wrap"
    assert message.startswith("q_yaw of the robot jumps by a turn (6.283) at ")
    assert message.endswith("angles=('q_yaw',)")
    declared = wrapping_first_entry(rollouts(swing_up(), learned()[0], 2, 3))
    assert "angles that wrap" not in diagnose(swing_up(), *learned(), recorded=[declared])


def test_biorob_with_static_friction_that_its_torques_only_hold_did_not_move() -> None:
    task = load_experiment("biorob")
    still = new_policy(task)
    found = diagnose(task, still, model_of(task, still, steps=6), starts=3)
    assert int(re.match(r"the robot moved (\d+) % as far", found["robot did not move"])[1]) < 10


def test_worst_of_several_targets_is_named() -> None:
    task = load_experiment("double_pendulum_targets")
    start = new_policy(task)
    found = diagnose(task, start, model_of(task, start, steps=6), starts=2)
    names = task.demonstrations.target_names
    labels = [
        ", ".join(f"{name} = {value:g}" for name, value in zip(names, target, strict=True))
        for target in task.targets.tolist()
    ]
    stuck = found.pop("search stuck")
    assert any(f" at {label};" in stuck for label in labels)
    begun = tuple(f"at {label}, " for label in labels)
    assert any(message.startswith(begun) for message in found.values())


def test_pilco_is_stuck_where_its_prediction_is_wide() -> None:
    task = load_experiment("double_pendulum_pilco")
    found = diagnose(task, new_policy(task), model_of(swing_up(), learned()[0], steps=6))
    assert "the predicted variance of a step" in found["search stuck"]
    assert "demonstrated" not in found["search stuck"]


def test_success_has_nothing_to_explain() -> None:
    task = swing_up()
    errors = task.error(rollouts(task, learned()[0], 20, 2)).sort().values
    missed = int((1 - LEARNED) * 20)
    enough, few = errors[-1 - missed].item(), errors[-2 - missed].item()
    assert diagnose(replace(task, tolerance=enough), *learned(), starts=20) == {}
    assert diagnose(replace(task, tolerance=few), *learned(), starts=20) != {}


def test_failure_that_nothing_explains_is_left_to_the_criterion() -> None:
    task = swing_up()
    content = task.with_settings(**CONTENT)
    ((cause, message),) = diagnose(content, *learned()).items()
    assert cause == "success criterion"
    assert f"yet {STARTS} of {STARTS} rollouts have an error above 0.25" in message
    assert re.search(
        r"the KL of a step is at most [\d.e+]+ nats, at \d\.\d\d s, most in [xy][12] ", message
    )


@pytest.mark.parametrize(
    ("successes", "cause"), [(495, "chance of few starts"), (500, "success criterion")]
)
def test_failures_that_are_no_rare_chance_are_left_to_it(
    monkeypatch: pytest.MonkeyPatch,
    successes: int,
    cause: str,
) -> None:
    """Of 20 starts, two or more fail by chance in 6.5 % of measurements, and in 0.6 %."""
    monkeypatch.setattr(Promise, "predicted", lambda *asked: PredictedSuccess(successes))
    task = swing_up()
    errors = task.error(rollouts(task, learned()[0], 20, 2)).sort().values
    content = task.with_settings(tolerance=errors[-3].item(), **CONTENT)
    assert list(diagnose(content, *learned(), starts=20)) == [cause]


@pytest.fixture
def summary_of(tmp_path: Path) -> Callable[..., dict]:
    """Of a real run."""
    return lambda task, trials, seed=0: (
        train(task, seed, trials, tmp_path / "run", "", progress_bar=False).summary
    )


@pytest.mark.slow
def test_run_with_weak_motors_names_the_motor_its_limit_and_the_need(
    summary_of: Callable[..., dict],
) -> None:
    summary = summary_of(weak_swing_up(0.7, 9).with_settings(search=SearchSettings(40, 20, 20)), 2)
    first = summary["diagnosis"][0]
    assert first["cause"] == "demonstrations out of reach"
    need = re.match(
        r"demonstration 0 needs (\d\.\d) N·m of motor tau1 at 0\.\d0 s, which has 0\.7 N·m;",
        first["message"],
    )[1]
    assert float(need) > 2


@pytest.mark.slow
def test_run_whose_search_has_no_budget_is_stuck(summary_of: Callable[..., dict]) -> None:
    """Its first search goes a few steps, each later one trusts all, and none comes further."""
    summary = summary_of(swing_up().with_settings(search=SearchSettings(1, 1, 1)), 5)
    ((cause, message),) = ((each["cause"], each["message"]) for each in summary["diagnosis"])
    assert cause == "search stuck"
    assert "25, 25, 25, 25: 3 trials led them no further, so try another seed" in message


@pytest.mark.slow
def test_run_that_learned_has_no_diagnosis(summary_of: Callable[..., dict]) -> None:
    summary = summary_of(load_experiment("gym_pendulum"), 12, seed=2)
    assert summary["saved_success_rate"] >= LEARNED and summary["diagnosis"] == []
    assert max(summary["loss_per_step"]) < 3 and summary["saturated"].keys() == {"0"}
