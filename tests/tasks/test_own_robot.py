"""What the task of one's own robot takes from robot and recordings."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from torch_pmil import (
    DemonstrationError,
    Demonstrations,
    Gaussian,
    LinearPolicy,
    MatchSpace,
    SaturatingCost,
    Task,
)
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.envs.double_pendulum import double_pendulum_spec
from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.envs.robot import RobotEnv
from torch_pmil.envs.rollouts import of_states, rollout_of, states_of
from torch_pmil.tasks.method import PolicySettings
from torch_pmil.tasks.own_robot import own_robot
from torch_pmil.tasks.own_starts import STARTS, start_of
from torch_pmil.tasks.site_match import site_match

AXES = ("x_x", "x_y", "x_z", "y_x", "y_y", "y_z")
START = 0.05  # largest absolute value of the first angle


class Arm(EnvBase):
    """One joint that follows its action; it shows angle and velocity, or cosine, sine, velocity."""

    def __init__(self, circle: bool = False, period: float = 0.1) -> None:
        super().__init__()
        self.circle, self.period = circle, period
        self.observation_spec = Composite(joint=Unbounded((3 if circle else 2,)))
        self.action_spec = Bounded(-4.0, 2.0, (1,))
        self.reward_spec = Unbounded((1,))
        self.generator = torch.Generator()

    def _set_seed(self, seed: int) -> None:
        self.generator.manual_seed(seed)

    def _shown(self) -> torch.Tensor:
        q, dq = self.state
        return torch.stack([q.cos(), q.sin(), dq]) if self.circle else self.state

    def _reset(self, tensordict: object) -> object:
        q = START * (2 * torch.rand((), generator=self.generator) - 1) + math.pi * self.circle
        self.state = torch.stack([q, torch.zeros(())])
        return TensorDict({"joint": self._shown()})

    def _step(self, tensordict: object) -> object:
        q, _ = self.state
        dq = tensordict["action"][0]
        self.state = torch.stack([q + self.period * dq, dq])
        end = {"reward": torch.zeros(1), "done": torch.zeros(1, dtype=torch.bool)}
        return TensorDict({"joint": self._shown(), **end})


def reaches(names: tuple[str, ...] = ("q",), count: int = 5) -> Demonstrations:
    time = torch.linspace(0, 1, 21, dtype=torch.float64)
    smooth = time**2 * (3 - 2 * time)
    shown = torch.stack([(1 + 0.05 * k) * smooth for k in range(count)])[..., None]
    return Demonstrations(shown.expand(-1, -1, len(names)), 0.1, names)


def at_rest(*pose: float) -> Gaussian:
    return Gaussian(torch.tensor([*pose, 0.0]).double(), torch.eye(2).double())


def task(robot: EnvBase | None = None, **settings: object) -> Task:
    given = {"demonstrations": reaches(), "control_period": 0.1, "state": ("q", "dq")} | settings
    return own_robot(robot or Arm(), **given)


def farthest(states: torch.Tensor) -> torch.Tensor:
    return states[..., 0].abs().amax(-1)


def test_defaults_are_those_that_are_promised() -> None:
    made = task()
    assert (made.actions.low.tolist(), made.actions.high.tolist()) == ([-4.0], [2.0])
    assert made.noise_std.tolist() == pytest.approx([0.05 * 1.2])
    # of a uniform start, by 20 resets: a standard error of an eighth
    assert made.initial.std[0] == pytest.approx(START / math.sqrt(3), rel=0.5)
    assert made.initial.std[1] > 0  # though all starts are at rest
    assert made.demonstrated_states.shape == (5 * 21, 2)
    assert made.horizon == 20 and made.tolerance == 2


def test_error_is_one_where_a_rollout_is_a_standard_deviation_away_at_all_times() -> None:
    made = task()
    demonstrated = made.demonstrated
    states = torch.zeros(21, 2, dtype=torch.float64)
    states[1:, 0] = demonstrated.mean[:, 0] + demonstrated.std[:, 0]
    assert made.error.of_states(states).item() == pytest.approx(1)


def test_what_is_said_is_kept() -> None:
    made = task(noise_std=0.03, tolerance=1.0, num_centres=7, name="mine", angles=("q",))
    assert made.noise_std.item() == 0.03 and made.tolerance == 1.0
    assert made.method.policy.num_centres == 7 and made.name == "mine"
    assert made.space.feature_names == ("dq", "sin q", "cos q")


def test_what_is_none_is_estimated_like_what_is_left_out() -> None:
    made, plain = task(initial=None, actions=None, noise_std=None, method=None), task()
    assert torch.equal(made.initial.mean, plain.initial.mean)
    assert made.actions is not None and made.adjustable == plain.adjustable


def test_linear_policy_is_searched_in_place_of_the_network() -> None:
    made = task(policy=LinearPolicy, initial_weight_std=0.2)
    policy = made.make_policy(torch.Generator().manual_seed(0))
    assert isinstance(policy, LinearPolicy) and made.settings["policy"] == "LinearPolicy"
    assert (policy.u_max.item(), policy.u_middle.item()) == (3.0, -1.0)
    assert 0 < policy.gains.abs().max() < 1  # 5 standard deviations
    assert made.make_loss(policy, made.make_dynamics()).has_moments


def test_a_start_that_is_said_takes_one_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    resets, reset = [], Arm._reset
    monkeypatch.setattr(Arm, "_reset", lambda arm, td: (resets.append(1), reset(arm, td))[1])
    task()
    assert len(resets) >= STARTS
    resets.clear()
    start = at_rest(0.0)
    assert task(initial=start).initial is start
    assert len(resets) < 5  # one, and those of checks of the environment


TWO_ACTIONS = ActionSpace(("a", "b"), ("", ""), -torch.ones(2).double(), torch.ones(2).double())
SERVO = ActionSpace(("q",), ("deg",), -torch.ones(1).double(), torch.ones(1).double())


class Physical(RobotEnv):
    """A joint of a physical robot."""

    physical = True

    def __init__(self) -> None:
        super().__init__((), 0.1, False, 0)
        self._set_specs(2, torch.tensor([-4.0]).double(), torch.tensor([2.0]).double(), {})

    def _reset(self, tensordict: object) -> object:
        raise AssertionError("a physical robot must not move")

    _step = _reset


@pytest.mark.parametrize("begin", [0.0, -200.0, 300.0])
def test_least_deviation_of_a_start_is_a_share_of_the_way_from_anywhere(begin: float) -> None:
    way = begin + torch.linspace(0, 0.6, 21, dtype=torch.float64)[None, :, None]
    start = start_of(way[:, :1, 0].expand(20, 1), way, ("x",))
    assert start.mean.item() == begin
    assert start.std.item() == pytest.approx(0.01 * 0.6)


def test_physical_robot_is_not_reset_and_starts_where_it_was_shown() -> None:
    robot = Physical()
    made = task(robot)
    assert not made.evaluated and made.robot(0) is robot
    starts = made.demonstrated_states.reshape(5, 21, 2)[:, 0]
    assert torch.equal(made.initial.mean, starts.mean(0))
    shown = made.demonstrated_states
    assert (made.initial.std >= 0.05 * (shown.amax(0) - shown.amin(0)) - 1e-12).all()
    start = at_rest(1.0)
    assert task(robot, initial=start).initial is start


def test_actions_named_like_entries_of_the_state_are_targets_of_them() -> None:
    class Servo(Physical):
        action_names = ("q",)

    made = task(Servo())
    states = torch.tensor([[0.3, 1.0], [-0.2, 0.0]], dtype=torch.float64)
    assert made.holding_actions is not None
    assert made.holding_actions(states).tolist() == [[0.3], [-0.2]]
    assert made.held_states is not None
    assert task().holding_actions is None


def test_robot_of_ones_own_that_must_make_no_more_motions_is_not_reset() -> None:
    class Still(Arm):
        _reset = Physical._reset

    assert task(Still(), evaluated=False).initial.mean.abs().max() < 1


def test_cosine_and_sine_are_one_angle_near_where_the_robot_starts() -> None:
    made = task(Arm(circle=True), state=("cos q", "sin q", "dq"))
    assert made.space.names == ("q", "dq") and made.space.angles == (0,)
    assert made.initial.mean[0].abs().item() == pytest.approx(math.pi, abs=START)
    assert made.initial.std[0] < START


def test_recordings_of_other_lengths_and_another_rate_are_aligned(tmp_path: Path) -> None:
    rows = ["demonstration,time,q"]
    for number, samples in enumerate((180, 200, 220)):
        for step in range(samples + 1):
            rows.append(f"{number},{0.01 * step:.2f},{(step / samples) ** 2}")
    (tmp_path / "recorded.csv").write_text("\n".join(rows) + "\n")
    made = own_robot(Arm(), tmp_path / "recorded.csv", 0.1, state=("q", "dq"))
    assert made.demonstrations.positions.shape == (3, 21, 1)
    assert made.demonstrations.time_step == 0.1


def test_an_empty_cell_is_named_and_does_not_leave_its_column_out(tmp_path: Path) -> None:
    rows = [f"0,{0.1 * step},{(step / 20) ** 2},{step / 200}" for step in range(21)]
    rows[7] = "0,0.7,0.1,"
    path = tmp_path / "recorded.csv"
    path.write_text("\n".join(["demonstration,time,q,dq", *rows]) + "\n")
    with pytest.raises(DemonstrationError, match="row 9, column dq must be a finite number"):
        own_robot(Arm(), path, 0.1, state=("q", "dq"))


def test_times_that_are_not_seconds_are_refused_unless_the_column_says_so(tmp_path: Path) -> None:
    def made(column: str, per_second: int) -> torch.Tensor:
        rows = [f"demonstration,{column},q,dq,note,note"]
        for number, samples in enumerate((180, 200, 220)):
            for step in range(samples + 1):
                s = step / samples
                time = step * per_second / 100
                rows.append(f"{number},{time:.16g},{s**2},{200 * s / samples},slow,")
        (tmp_path / "recorded.csv").write_text("\n".join(rows) + "\n")
        return own_robot(
            Arm(), tmp_path / "recorded.csv", 0.1, state=("q", "dq")
        ).demonstrations.positions

    right = made("time", 1)  # columns that are not entries of the state may hold anything
    assert right.shape == (3, 21, 2)
    torch.testing.assert_close(made("time_ms", 1000), right, rtol=0, atol=1e-9)
    torch.testing.assert_close(made("timestamp [ns]", 10**9), right, rtol=0, atol=1e-9)
    for looks, per_second in (("milliseconds", 1000), ("frame numbers", 100)):
        with pytest.raises(DemonstrationError, match=f"^time looks like {looks}, not seconds: "):
            made("time", per_second)


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"state": ("a", "b")}, DemonstrationError, "entries of the state a, b, got q: name"),
        ({"state": ("q",)}, ValueError, "state must name the 2 entries of the observation, got q"),
        ({"state": ("cos q", "dq")}, ValueError, "state must name sin q too, got cos q, dq"),
        ({"angles": ("p",)}, ValueError, "angles must be entries of the state q, dq, got p"),
        ({"demonstrations": 3}, TypeError, "must be a path, Recordings or Demonstrations, got int"),
        (
            {"demonstrations": Demonstrations(torch.ones(2, 21, 1), 0.1, ("q",))},
            DemonstrationError,
            "q never changes in the demonstrations, .*: give noise_std",
        ),
        ({"tolerance": -1.0}, ValueError, "tolerance must"),
        ({"nose_std": 0.1}, ValueError, "known ones, got 'nose_std': did you mean noise_std?"),
        ({"past_action": 1}, ValueError, "got 'past_action': did you mean past_actions?"),
        ({"space": 1}, ValueError, "settings must be known ones, got 'space'"),
        ({"state": "xd"}, TypeError, r"such as \('xd',\), got the text 'xd'"),
        ({"state": ("q", "")}, ValueError, "each of state must be text of 1 to 100 printable"),
        ({"state": ("q", "x" * 10**6)}, ValueError, "each of state must be text of 1 to 100"),
        ({"state": ("q", "q")}, ValueError, "state must be different names, got"),
        ({"angles": "q"}, TypeError, r"angles must be .*, such as \('q',\), got the text 'q'"),
        ({"units": "rad"}, TypeError, "units must be a sequence, one for each entry, got 'rad'"),
        ({"match": 3}, TypeError, "match must be a MatchSpace or the name of a site, got int"),
        ({"control_period": "0.1"}, TypeError, "must be a number, in seconds, got '0.1'"),
        ({"control_period": True}, TypeError, "control_period must be a number, .* got True"),
        ({"control_period": math.nan}, ValueError, "must be positive and finite, .* got nan"),
        ({"name": "../../up"}, ValueError, "that of a folder within the runs, got '../../up'"),
        ({"name": ""}, ValueError, "name must be text of 1 to 100 printable characters"),
        ({"error": None}, TypeError, "error must be a function, got NoneType"),
        ({"error": of_states(farthest)}, ValueError, "tolerance must be given .* unit, got None"),
        (
            {"error": of_states(farthest), "tolerance": {"q": 0.1}},
            ValueError,
            r"tolerance must be .* one number in its unit, got \{'q': 0.1\}",
        ),
        (
            {"angles": ("q",), "units": ("deg", "deg/s")},
            ValueError,
            "angles must be in rad, got q in deg: convert the observation",
        ),
        ({"initial": 3}, TypeError, "initial must be of type Gaussian, got int"),
        ({"past_actions": 1000}, ValueError, "past_actions must be a whole number from 0 to 20"),
        ({"positions_only": "no"}, TypeError, "positions_only must be True or False, got 'no'"),
        ({"steps_per_action": 0}, ValueError, "steps_per_action must be a whole number of at"),
        ({"explore_demonstrated": True}, ValueError, "needs holding_actions, a function from"),
        ({"control_period": 0.0}, ValueError, "control_period must be positive"),
        ({"match": "tip"}, TypeError, "match by a site needs a MujocoRobot, got Arm"),
        (
            {"robot": Physical(), "control_period": 0.2},
            ValueError,
            "control_period must be that of the robot, 0.1 s, got 0.2 s",
        ),
        (
            {"robot": Physical(), "state": ("cos q", "sin q", "dq")},
            ValueError,
            "a physical robot must show its angles",
        ),
        ({"robot": Physical(), "evaluated": True}, ValueError, "evaluated must be False for a ph"),
        (
            {"actions": TWO_ACTIONS},
            ValueError,
            "as many as the robot's, 0 from -4 to 2, got a from",
        ),
        ({"units": ("rad",)}, ValueError, "units must be one for each of q, dq, got rad"),
        ({"noise_std": "small"}, ValueError, "noise_std must be a number or .* got 'small'"),
        ({"noise_std": True}, ValueError, "noise_std must be a number or .* got True"),
        ({"method": PolicySettings()}, TypeError, "method must be of type Method, got PolicyS"),
        (
            {"cost": lambda states: states},
            ValueError,
            "cost must be a function of states .* and ac",
        ),
        ({"cost": SaturatingCost}, TypeError, "cost must be a SaturatingCost, a Quad"),
        ({"state": ("sin q", "dq")}, ValueError, "state must name cos q too, got sin q, dq"),
    ],
)
def test_misuse_is_one_line(change: dict, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message) as raised:
        task(**change)
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 400


@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (farthest, TypeError, r"error must be a function of rollouts, got one of states: give err"),
        (of_states(lambda states: farthest(states) < 1), ValueError, r"tensor \(3,\).* torch.bool"),
        (of_states(lambda states: states[..., 0]), ValueError, r"a real tensor \(3,\).* \(3, 21\)"),
        (of_states(lambda states: farthest(states).tolist()), ValueError, "success, got list"),
        (of_states(lambda states: states[:, -1, 0]), ValueError, r"for states \(21, 2\)"),
        (lambda rollout: rollout["action"][..., 0], ValueError, r"\(3,\).* \(3, 20\)"),
    ],
)
def test_error_that_does_not_judge_each_motion_is_refused_before_the_robot_moves(
    error: object, kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message) as raised:
        task(Physical(), error=error, tolerance=0.1)
    assert "\n" not in str(raised.value)


def test_error_may_read_what_only_the_robot_shows() -> None:
    assert task(error=lambda rollout: rollout["load"].amax(-1), tolerance=0.1).promised is None


@pytest.mark.parametrize("period", [np.float32(0.5), np.float64(0.5), torch.tensor(0.5), 0.5])
def test_control_period_may_be_any_real_number(period: object) -> None:
    shown = Demonstrations(reaches().positions, 0.5, ("q",))
    made = own_robot(Arm(period=0.5), shown, period, state=("q", "dq"))
    assert made.robot(0).control_period == 0.5


def test_servo_of_ones_own_explores_what_is_demonstrated() -> None:
    made = task(explore_demonstrated=True, holding_actions=lambda states: states[:, :1])
    mean = made.demonstrated_states.unflatten(0, (5, -1)).mean(0)
    assert torch.equal(made.exploration.around, mean[1:, :1])


def test_another_match_space_is_taken() -> None:
    ends = MatchSpace.of_links(("q",), (1.0,), ("q", "dq"), zero=math.pi, names=("x", "y"))
    q = reaches().positions[..., 0]
    shown = Demonstrations(torch.stack([-q.sin(), -q.cos()], -1), 0.1, ("x", "y"))
    found = task(demonstrations=shown, match=ends).demonstrated_states.reshape(5, 21, 2)[..., 0]
    torch.testing.assert_close(found, q, atol=1e-4, rtol=0)


def robot_of_a_file(**changes: object) -> MujocoRobot:
    spec = double_pendulum_spec((0.5, 0.5))
    return MujocoRobot(spec, ("q1", "q2"), rate=10, **changes)


def test_robot_of_a_file_gives_its_state_and_start() -> None:
    robot = robot_of_a_file(start=(3.0, 0.1), start_std=0.05)
    task = own_robot(robot, reaches(("q1", "q2")), 0.1)
    assert task.space.names == ("q1", "q2", "dq1", "dq2")
    assert task.space.units == ("rad", "rad", "rad/s", "rad/s")
    assert task.space.match_space.names == ("q1", "q2")
    assert task.initial.mean.tolist() == [3.0, 0.1, 0.0, 0.0]
    assert task.initial.std.tolist() == pytest.approx([0.05] * 4)
    assert task.robots(3, 0).batch_size == (3,)


@pytest.mark.parametrize("names", [("x", "y", "z"), ("x", "y", "z", *AXES)])
def test_site_of_a_robot_is_what_is_compared(names: tuple[str, ...]) -> None:
    robot = robot_of_a_file(start=(0.3, 0.6))
    time = torch.linspace(0, 1, 21, dtype=torch.float64)
    turned = torch.stack([0.3 + time, 0.6 + 0.5 * time, 0 * time, 0 * time], -1)
    place = site_match(robot, "tip", orientation=len(names) > 3)(turned)
    shown = Demonstrations(place + 1e-3 * torch.arange(3)[:, None, None], 0.1, names)
    task = own_robot(robot, shown, 0.1, match="tip")
    assert task.space.match_space.names == names
    assert (task.demonstrated_states[:21, :2] - turned[:, :2]).abs().max() < 0.01


def test_names_of_the_robot_of_a_file_are_not_changed() -> None:
    with pytest.raises(ValueError, match="q1, q2, dq1, dq2, so leave it out, got q2, q1, dq2, dq1"):
        own_robot(robot_of_a_file(), reaches(("q1", "q2")), 0.1, state=("q2", "q1", "dq2", "dq1"))


def test_control_period_must_be_that_of_the_robot_of_a_file() -> None:
    with pytest.raises(ValueError, match=r"control_period must be that of the robot, 0\.1 s"):
        own_robot(robot_of_a_file(), reaches(("q1", "q2")), 0.05)


def shifted(values: torch.Tensor, steps: int) -> torch.Tensor:
    """Values (N, T, K) so many steps before; before the first they are the first."""
    return torch.cat([values[:, :1].expand(-1, steps, -1), values[:, :-steps]], 1)


@pytest.mark.parametrize(
    ("kind", "past", "names"),
    [
        ("actions", {"past_actions": 1}, ("q", "dq", "0@1")),
        ("entries", {"past_entries": 2}, ("q", "dq", "q@1", "dq@1", "q@2", "dq@2")),
        ("positions", {"positions_only": True, "past_actions": 2}, ("q", "dq", "0@1", "0@2")),
    ],
)
def test_unbatched_robot_remembers(kind: str, past: dict, names: tuple[str, ...]) -> None:
    """Rollouts in turn hold what the same robot shows, and did, in the periods before."""
    made, plain = task(**past), task()
    assert made.space.names == names
    rollouts = made.robots(3, seed=0).rollout(made.horizon)
    actions = iter(rollouts["action"].flatten(0, 1).unbind())
    replayed = TensorDictModule(lambda _: next(actions), ["observation"], ["action"])
    readings = states_of(plain.robots(3, seed=0).rollout(made.horizon, replayed))
    taken = torch.cat([torch.full((3, 1, 1), -1.0).double(), rollouts["action"]], 1)  # at rest: -1
    rates = (readings - shifted(readings, 1))[..., :1] / 0.1
    expected = {
        "actions": [readings, taken],
        "entries": [readings, shifted(readings, 1), shifted(readings, 2)],
        "positions": [readings[..., :1], rates, taken, shifted(taken, 1)],
    }
    torch.testing.assert_close(states_of(rollouts), torch.cat(expected[kind], -1))
    torch.testing.assert_close(made.error(rollouts), plain.error(rollout_of(readings)))


def test_action_in_degrees_is_no_target_of_an_angle() -> None:
    """An angle that is declared is in rad; an action of its name holds the robot if that is too."""
    in_radians = replace(SERVO, units=("rad",))
    assert task(angles=("q",), actions=SERVO).holding_actions is None
    held = task(angles=("q",), actions=in_radians).holding_actions
    assert held(torch.tensor([[0.3, 1.0]])).tolist() == [[pytest.approx(0.3)]]


def test_recordings_of_cosine_and_sine_show_the_angle() -> None:
    """As the environment's own observation does."""
    shown = reaches()
    q = shown.positions[..., 0] + math.pi
    positions = torch.stack([q.cos(), q.sin(), torch.gradient(q, spacing=0.1, dim=1)[0]], -1)
    names = ("cos q", "sin q", "dq")
    made = task(Arm(circle=True), demonstrations=Demonstrations(positions, 0.1, names), state=names)
    assert made.demonstrations.names == ("q", "dq")
    assert torch.allclose(made.demonstrations.positions[..., 0], q)


def test_column_that_is_not_used_in_place_of_a_velocity_is_named(tmp_path: Path) -> None:
    rows = [f"{number},{t},{x},{v}" for number in range(3) for t, x, v in _reach(number)]
    path = tmp_path / "shown.csv"
    path.write_text("\n".join(["demonstration,time,q,qd", *rows]))
    with pytest.warns(UserWarning, match="^qd of the recordings is not used, and dq follows"):
        made = task(demonstrations=path)
    assert made.demonstrations.names == ("q",)


def _reach(number: int) -> list[tuple[float, float, float]]:
    shown = reaches().positions[number, :, 0].tolist()
    return [(0.1 * step, value, 0.0) for step, value in enumerate(shown)]
