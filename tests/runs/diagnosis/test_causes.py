"""What a diagnosis says at the borders: nothing known, nothing moved, everything at the limit."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping

import pytest
import torch

from tests.helpers.draws import Draws
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.runs.diagnosis.causes import (
    check_experience,
    check_model,
    check_motion,
    check_readings,
    check_saturation,
    check_search,
    group,
    unexplained,
    unpredictable,
)
from torch_pmil.runs.diagnosis.findings import Finding
from torch_pmil.runs.diagnosis.measures import (
    FEWEST_STEPS,
    SATURATED,
    first_departure,
    first_mismatch,
)
from torch_pmil.runs.settings import OF_TASK
from torch_pmil.tasks.registry import load_experiment

NAMES = ("q", "dq")
SETTINGS = {
    "noise_std": 0.05,
    "random_action": 0.4,
    "confirmations": 2,
    "search.stage_iterations": 30,
    "search.trust_threshold": 3.0,
}


def standing(steps: int) -> Gaussian:
    return Gaussian(torch.zeros(steps, 2).double(), torch.eye(2).double().expand(steps, 2, 2))


def of_model(errors: torch.Tensor, executed: torch.Tensor) -> str:
    """What is wrong with a model that predicts standing still, "" if nothing is."""
    reason = check_model(errors, standing(10), executed, NAMES, 0.1, SETTINGS)
    return reason.message if reason else ""


def readings(values: torch.Tensor) -> list[torch.Tensor]:
    """Three rollouts of a joint and its velocity, at values (T + 1,) and a little beside."""
    columns = [values + beside for beside in (0.0, 0.01, 0.02)]
    return [torch.stack([each, torch.zeros_like(each)], -1) for each in columns]


TIMES = torch.arange(26).double() / 10
SWITCHED = torch.tensor([1.0, 1, -1, 1, -1, -1, 1, 1, -1, 1, -1, 1, 1]).double().repeat(2)
OTHERS = {
    "slow": 3 * TIMES.sin(),
    "goes on": 2.5 + 3 * TIMES,
    "steps of 6": 6 * torch.arange(26).sub(9).clamp(0).double(),
    "there and back by 5": 2.5 * SWITCHED,
    "there and back by half a turn more": 0.4 * TIMES + 4.5 * (TIMES > 1),
}


@pytest.mark.parametrize("turn", [2 * math.pi, 360.0])
@pytest.mark.parametrize("low", [-0.5, 0.0])
def test_sensor_that_wraps_is_named_unless_its_entry_is_an_angle(turn: float, low: float) -> None:
    angles = turn * (low + 0.9 + 0.1 * TIMES)
    moved = readings((angles / turn - low) % 1 * turn + low * turn)
    (finding,) = check_readings(moved, NAMES, (), 0.1)
    assert finding.cause == "angles that wrap"
    assert re.match(rf"q of the robot jumps by a turn \({turn:.4g}\) at 1.\d0 s", finding.message)
    assert finding.message.endswith("declare it, by angles=('q',)")
    assert check_readings(moved, NAMES, (0,), 0.1) == []


def test_velocities_are_no_angles() -> None:
    moved = [motion.flip(-1) for motion in readings(3.1 - 6.2 * (TIMES > 1))]
    assert check_readings(moved, ("v", "w"), (), 0.1)
    assert check_readings(moved, NAMES, (), 0.1) == []


@pytest.mark.parametrize("other", OTHERS)
def test_fast_joint_is_no_sensor_that_wraps(other: str) -> None:
    assert check_readings(readings(OTHERS[other]), NAMES, (), 0.1) == []


def test_one_rollout_of_a_fast_joint_that_jumps_by_a_turn_is_chance() -> None:
    turned, fast = readings(3.1 - 6.2 * (TIMES > 1)), readings(OTHERS["there and back by 5"])
    assert check_readings(turned, NAMES, (), 0.1)
    assert check_readings([turned[0], *fast], NAMES, (), 0.1) == []


def test_errors_are_named_with_their_entry_unless_they_are_standard_normal(draws: Draws) -> None:
    executed = draws.normal(50, 11, 2)
    errors = executed[:, 1:].flatten(0, 1)
    assert of_model(errors, executed) == ""
    message = of_model(errors * torch.tensor([1.0, 2.0]), executed)
    assert "of the one-step errors in dq, and 95 % of the executed states" in message
    assert "leave" not in message


def test_trajectory_that_leaves_the_prediction_is_named_though_no_step_is_known(
    draws: Draws,
) -> None:
    executed = draws.normal(50, 11, 2)
    executed[:, 4:, 1] += 6
    message = of_model(torch.zeros(0, 2), executed)
    assert "one-step" not in message
    assert "the rollouts leave the prediction at 0.40 s, first in dq;" in message
    assert first_departure(standing(10), executed) == (4, 1)
    most_stay = torch.cat([executed[:20], draws.normal(30, 11, 2)])
    assert first_departure(standing(10), most_stay) is None


def test_nothing_is_said_from_a_few_steps_or_of_a_robot_that_is_to_stand_still() -> None:
    still, errors = torch.zeros(5, 11, 2).double(), torch.full((FEWEST_STEPS, 2), 9.0)
    assert of_model(errors[1:], still) == "" and of_model(errors, still) != ""
    assert check_motion(still, still, torch.tensor(0.1), SETTINGS) is None


def test_motor_that_is_strong_enough_swings_from_limit_to_limit() -> None:
    full, limits = torch.ones(1, 10, 2), (torch.zeros(2), torch.ones(2))
    torques = ActionSpace.around(*limits, ("a", "b"), ("N·m", "N·m"))
    angles = ActionSpace.around(*limits, ("a", "b"), ("rad", "rad"))
    needed = torch.tensor([0.4, 0.9])
    message = check_saturation(full, torques, needed).message
    assert "though the demonstrations need no more than 0.4 N·m" in message
    for space, known in ((torques, None), (angles, needed)):
        assert "; a wider range, or " in check_saturation(full, space, known).message
    half = torch.cat([torch.ones(1, 10, 2), torch.zeros(1, 10, 2)])
    assert SATURATED == 0.5 and check_saturation(half, torques, None) is None


def test_single_rollout_that_strays_is_no_lack_of_experience() -> None:
    unknown = torch.zeros(20, 25).bool()
    unknown[3] = True
    assert check_experience(unknown, 100, 0.1, SETTINGS) is None


def test_search_that_is_stuck_from_the_first_step_on() -> None:
    assert first_mismatch(torch.tensor([0.1, 0.5, 4.0, 0.5]), 3.0) is None
    step_loss = torch.tensor([14.0, 30.0])
    assert first_mismatch(step_loss, 3.0) == 1
    found = check_search(step_loss, 1, "KL", "nats", "most in q", [2], 0.1, SETTINGS)
    assert found.message.startswith("the KL of a step is 14 nats at 0.10 s (step 1 of 2)")


def test_function_that_is_a_cost_has_no_setting_that_forgives_more() -> None:
    settings = {name: value for name, value in SETTINGS.items() if name != "noise_std"}
    stuck = check_search(torch.tensor([14.0, 30.0]), 1, "cost", "", "", [2] * 9, 0.1, settings)
    assert re.search(r"a larger threshold \(search.trust_threshold=[\d.]+\)$", stuck.message)
    assert (
        "largest at 1 s; more trials with"
        in unexplained(3, 20, 0.25, "largest at 1 s", settings).message
    )


def test_findings_of_one_cause_are_one_reason_in_the_order_in_which_they_came() -> None:
    found = group([Finding(*each) for each in (("b", "1st"), ("a", "2nd"), ("b", "3rd"))])
    assert [(reason.cause, reason.message) for reason in found] == [
        ("b", "1st (and 1 more of this kind)"),
        ("a", "2nd"),
    ]


def advices(settings: Mapping[str, object]) -> Iterator[str]:
    """What each cause that is mended by a setting says."""
    strange = torch.full((FEWEST_STEPS, 2), 9.0)
    way = torch.linspace(0, 1, 5).double()[None, :, None].expand(1, 5, 2)
    still, step_loss = torch.zeros(5, 11, 2).double(), torch.tensor([14.0, 30.0])
    for reason in (
        check_motion(0.1 * way, way, torch.tensor(0.05), settings),
        check_model(strange, standing(10), still, NAMES, 0.1, settings),
        check_experience(torch.ones(20, 25).bool(), 100, 0.1, settings),
        check_search(step_loss, 1, "KL", "nats", "in q", [2] * 9, 0.1, settings),
        unexplained(3, 20, 0.25, "largest at 1 s", settings),
        unpredictable("step 3 failed"),
    ):
        yield reason.message


@pytest.mark.parametrize("name", ["double_pendulum", "biorob"])
def test_settings_that_an_advice_names_can_be_given_so(name: str) -> None:
    experiment = load_experiment(name)
    said = " ".join(advices(experiment.adjustable))
    given = re.findall(r"([a-z_.]+)=(\[[\d.,e-]*\]|[\d.]*\d)", said)
    assert len({name for name, _ in given}) == 5
    for setting, value in given:
        changed = experiment.with_settings(**{setting: json.loads(value)})
        assert changed.adjustable[setting] != experiment.adjustable[setting]
    named = re.findall(r"random_action|exploration\.\w+|search\.\w+", unpredictable("").message)
    assert {*named} <= OF_TASK.keys()
