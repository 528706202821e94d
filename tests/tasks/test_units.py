"""Units: another one than the robot's is named, and none changes what is learned."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torch_pmil import DemonstrationError, Demonstrations, SearchSettings, Task
from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.runs.training import train
from torch_pmil.tasks.own_robot import own_robot
from torch_pmil.tasks.rehearsal import rehearse
from torch_pmil.tasks.unit_checks import check_units

gymnasium = pytest.importorskip("gymnasium")
SHORT = SearchSettings(1, 1, 1, first_horizon=1.0, trust_threshold=1e9)  # one search a trial
SERVO = """<mujoco><worldbody>
<body><joint name="q" range="-170 170"/><geom size="0.1" pos="0.3 0 0"/>
</body></worldbody><actuator><motor name="m" joint="q" ctrlrange="-30 30"/></actuator></mujoco>"""


class Slider(gymnasium.Env):
    """A place and its velocity in a unit of 1 / ``unit`` m, between springs."""

    dt = 0.1

    def __init__(self, unit: float = 1.0, start: float = 0.0, bound: float = math.inf) -> None:
        self.unit, self.start = unit, start
        self.observation_space = gymnasium.spaces.Box(-bound, bound, (2,), np.float64)
        self.action_space = gymnasium.spaces.Box(-2.0, 2.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: object = None) -> tuple:
        super().reset(seed=seed)
        self.state = self.start * np.array([1, 0]) + 0.02 * self.np_random.standard_normal(2)
        return self.unit * self.state, {}

    def step(self, action: np.ndarray) -> tuple:
        x, v = self.state
        for _ in range(10):
            v = v + 0.01 * (action[0] - 0.5 * v - math.sin(3 * x))
            x = x + 0.01 * v
        self.state = np.array([x, v])
        return self.unit * self.state, 0.0, False, False, {}


def reaches(unit: float = 1.0, start: float = 0.0, rate: float = 0.0) -> Demonstrations:
    """Three reaches of 0.5 m, with velocities in a unit of their own if ``rate`` is given."""
    time = torch.linspace(0, 1, 16, dtype=torch.float64)
    shown = [start + (0.5 + 0.02 * k) * time**2 * (3 - 2 * time) for k in range(3)]
    place = unit * torch.stack(shown)[..., None]
    if not rate:
        return Demonstrations(place, 0.1, ("x",))
    speed = rate * torch.gradient(place, spacing=0.1, dim=1)[0]
    return Demonstrations(torch.cat([place, speed], -1), 0.1, ("x", "dx"))


def task(robot: object, shown: Demonstrations, **said: Any) -> Task:
    return own_robot(robot, shown, 0.1, state=("x", "dx"), num_centres=10, **said)


def learned(unit: float, folder: Path) -> Tensor:
    """Actions of the policy in the same four states."""
    made = task(Slider(unit), reaches(unit), search=SHORT)
    policy = train(made, 100, 1, folder, "", progress_bar=False).policy
    states = [[0.0, 0.0], [0.2, 0.5], [0.4, 0.3], [0.5, 0.0]]
    return policy(unit * torch.tensor(states, dtype=torch.float64))


@pytest.fixture(scope="module")
def in_metres(tmp_path_factory: pytest.TempPathFactory) -> Tensor:
    return learned(1.0, tmp_path_factory.mktemp("m"))


# rounding errors of the fit, which a longer search would magnify
@pytest.mark.parametrize("unit", [1e3, 1e6, 1e-3, 1e4, 2.0**10, 2.0**-20])
def test_policy_does_not_depend_on_the_unit(unit: float, in_metres: Tensor, tmp_path: Path) -> None:
    torch.testing.assert_close(learned(unit, tmp_path), in_metres, rtol=0, atol=1e-6)


def test_noise_of_an_entry_is_compared_with_its_own_unit() -> None:
    shown = reaches(rate=1.0)
    wide = torch.cat([1e-4 * shown.positions[..., :1], shown.positions[..., 1:]], -1)
    shown = Demonstrations(wide, 0.1, ("x", "dx"))
    span = wide.flatten(0, 1).amax(0) - wide.flatten(0, 1).amin(0)
    made = task(Slider(), shown, units=("km", "m/s"))
    torch.testing.assert_close(made.noise_std, 0.05 * span)
    with pytest.warns(UserWarning, match="x hardly changes beside the other entries: .* units"):
        task(Slider(), shown)
    assert (task(Slider(), shown, noise_std=0.01).noise_std == 0.01).all()  # and nothing is said


WRONG = [
    (lambda: Slider(bound=3.0), reaches(1e3), {}, "x looks like (milli|thousand).* within -3 to 3"),
    (lambda: Slider(bound=3.0), reaches(180 / math.pi), {}, "x looks like degrees, .* 0 to 30.9"),
    (
        Slider,
        reaches(rate=180 / math.pi),
        {"units": ("rad", "rad/s")},
        "dx .* degrees per s",
    ),
    (Slider, reaches(rate=1e-3), {}, "dx looks like a unit 1000 times larger: it is"),
]


@pytest.mark.parametrize(("robot", "shown", "said", "message"), WRONG)
def test_another_unit_than_the_robots_is_refused(
    robot: Any, shown: Demonstrations, said: dict, message: str
) -> None:
    with pytest.raises(DemonstrationError, match=message):
        task(robot(), shown, **said)


@pytest.mark.parametrize(
    ("robot", "unit", "said", "message"),
    [
        (Slider(start=1.0), 1e3, {"units": ("m", "m/s")}, "x looks like millimetres: rec.* at 1"),
        (Slider(1e3, 1.0), 1.0, {}, "x looks like a unit 1000 times larger"),
        (Slider(start=1.0), 100, {"units": ("m", "m/s")}, "x looks like centimetres"),
    ],
)
def test_start_that_is_a_multiple_of_the_robots_is_doubted(
    robot: Slider, unit: float, said: dict, message: str
) -> None:
    with pytest.warns(UserWarning, match=message):
        task(robot, reaches(unit, 1.0), **said)


def test_limits_name_what_may_be_meant() -> None:
    metres = {"units": ("m", "m/s")}
    with pytest.raises(DemonstrationError, match="x looks like centimetres or millimetres, or is"):
        task(Slider(bound=1.0), reaches(100.0), **metres)
    with pytest.raises(DemonstrationError, match="x is in another unit, or is out of reach"):
        task(Slider(bound=0.1), reaches(), units=("s", ""))


@pytest.mark.parametrize(("bound", "count"), [(0.3, 1), (0.53, 0), (math.pi, 0)])
def test_recordings_beyond_the_limits_are_doubted_unless_these_are_a_turn(
    bound: float, count: int, recwarn: pytest.WarningsRecorder
) -> None:
    """The largest recorded value is 0.54 m, and 3.78 rad beside limits of pi."""
    task(Slider(bound=bound), reaches(7.0 if bound == math.pi else 1.0))
    said = [str(each.message) for each in recwarn if "out of reach" in str(each.message)]
    assert len(said) == count, said


def test_entry_of_unknown_size_is_named() -> None:
    robot = Slider()
    reset = robot.reset
    robot.reset = lambda **given: (0 * reset(**given)[0], {})
    with pytest.warns(UserWarning, match="f starts at 0 each time and is not demonstrated"):
        own_robot(robot, reaches(), 0.1, state=("x", "f"))


def test_degrees_of_a_mujoco_robot_are_refused() -> None:
    robot = MujocoRobot(SERVO, ("q",), rate=10)
    shown = reaches(360 / math.pi).positions
    own_robot(robot, Demonstrations(reaches(2.0).positions, 0.1, ("q",)), 0.1)
    with pytest.raises(DemonstrationError, match=r"q looks like degrees, .* -2\.97 to 2.97 rad"):
        own_robot(robot, Demonstrations(shown, 0.1, ("q",)), 0.1)


@pytest.mark.parametrize(
    ("unit", "said", "message"),
    [
        (180 / math.pi, {"units": ("rad", "rad/s")}, "x looks like degrees: .* 0 to 30.9, where"),
        (1e3, {"units": ("m", "m/s")}, "x looks like milli.* recorded from 0 to 540, where"),
        (1e3, {}, "x looks like .* recorded from 0 to 540, where the robot moved within"),
    ],
)
def test_motion_far_beyond_that_of_the_robot_is_doubted(
    unit: float, said: dict, message: str
) -> None:
    with pytest.warns(RuntimeWarning, match=message):
        rehearse(task(Slider(), reaches(unit), **said))


@pytest.mark.parametrize(
    ("robot", "shown"),
    [
        (Slider, reaches(rate=1.0)),
        (lambda: Slider(start=1.0), reaches(start=1.0)),
        (lambda: Slider(start=1.0), reaches(start=2.0)),
        (lambda: Slider(bound=0.6), reaches()),
        (lambda: Slider(1e3, 1.0), reaches(1e3, 1.0)),
        (Slider, reaches(1e-3)),
        (Slider, reaches(5.0)),
    ],
)
def test_right_units_are_not_doubted(robot: Any, shown: Demonstrations) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rehearse(task(robot(), shown))


@pytest.mark.parametrize(("turns", "refused"), [(2.0, False), (3.9, False), (4.1, True)])
def test_angle_of_known_unit_may_turn_round_a_few_times(turns: float, refused: bool) -> None:
    """A robot whose limits are one turn continues it, and rad and degrees look alike so far."""
    shown = turns * 2 * math.pi * torch.linspace(0, 1, 21).double().expand(3, 21)[..., None]
    args = Demonstrations(shown, 0.1, ("q",)), {"q": "rad"}, {}, {"q": (-math.pi, math.pi)}
    if refused:
        with pytest.raises(DemonstrationError, match=r"^q looks like degrees, or is out of reach"):
            check_units(*args)
    else:
        with pytest.warns(UserWarning, match=r"^q looks like degrees, or turns round"):
            check_units(*args)
