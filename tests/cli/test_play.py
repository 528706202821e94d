"""``pmil play``: the learned policy from fresh starts, in a window or in a file."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from PIL import Image, ImageSequence
from torch import Tensor

from tests.helpers.run_script import run_command
from torch_pmil.cli import play
from torch_pmil.control.policy_file import save_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.demonstrations import Demonstrations, shipped_demonstrations
from torch_pmil.envs import DoublePendulumEnv, MujocoRobotEnv
from torch_pmil.envs.mujoco_model import FULL_PHYSICS
from torch_pmil.runs import viewer
from torch_pmil.runs.playing import SHIPPED, load_player
from torch_pmil.runs.run_folder import write_settings
from torch_pmil.tasks.registry import load_experiment

Script = Callable[..., None]
Printed = pytest.CaptureFixture[str]
STEPS = 25  # of the double pendulum's motion
IN_GIF = 2 * STEPS + 1 + 10  # pictures of a motion and of the rest after it, 20 per second


def shade(env: MujocoRobotEnv, physics: Tensor, robot: int = 0) -> np.ndarray:
    """A picture that is brighter, the higher the first link is: no OpenGL is needed."""
    level = 255 * (1 + env.state_of(physics)[0].cos().item()) / 2
    return np.full((16, 16, 3), round(level), dtype=np.uint8)


def no_opengl(env: MujocoRobotEnv, physics: Tensor, robot: int = 0) -> np.ndarray:
    raise RuntimeError("pictures need OpenGL")


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Script:
    """The command, run with arguments in an empty folder, on a machine without a screen."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(play, "has_screen", lambda: False)
    monkeypatch.setattr(MujocoRobotEnv, "draw", shade)
    return partial(run_command, monkeypatch, "play")


def brightness(path: str | Path) -> list[float]:
    """Mean brightness of each picture of a GIF; a picture that stays counts as often."""
    with Image.open(path) as gif:
        return [
            float(np.asarray(frame.convert("L")).mean())
            for frame in ImageSequence.Iterator(gif)
            for _ in range(frame.info["duration"] // 50)
        ]


def run_of(folder: Path, experiment: str = "double_pendulum", **settings: object) -> Path:
    """A finished run of an experiment, with a policy that does nothing."""
    known = load_experiment(experiment)
    folder.mkdir()
    inputs = len(known.space.feature_names)
    policy = RBFPolicy(torch.zeros(3, inputs), known.actions.half_range, torch.ones(inputs))
    save_policy(folder / "policy.pt", policy, known.space, 0.1)
    (folder / "summary.json").write_text(json.dumps({"experiment": experiment}))
    write_settings(folder, settings)
    return folder


def test_shipped_policy_does_what_its_summary_says_from_starts_it_has_not_seen() -> None:
    summary = json.loads((SHIPPED / "summary.json").read_text())
    assert (summary["experiment"], summary["seed"]) == ("double_pendulum", 0)
    player = load_player(SHIPPED)
    env = player.task.first_robot(seed=100)
    motions = player.motions(env)
    assert sum(player.succeeds(next(motions)) for _ in range(20)) >= 19


def test_without_a_run_and_a_screen_a_gif_shows_a_swing_up(script: Script, capsys: Printed) -> None:
    script()
    motion = "1 motion of 2.5 s from a fresh start, 1 of 1 with success"
    assert capsys.readouterr().out == f"wrote play.gif: double_pendulum, {motion}\n"
    levels = np.array(brightness("play.gif"))
    assert len(levels) in range(IN_GIF, IN_GIF + 22)  # it rests at the end for a second
    assert levels[0] < 5 and levels[2 * STEPS] > 250
    assert [path.name for path in Path.cwd().iterdir()] == ["play.gif"]


def test_starts_are_fresh_and_those_of_a_seed_are_the_same(script: Script) -> None:
    for name, seed in (("a", 100), ("b", 100), ("c", 101)):
        script("--out", f"{name}.gif", "--seed", seed, "--starts", 3)
    assert Path("a.gif").read_bytes() == Path("b.gif").read_bytes() != Path("c.gif").read_bytes()
    levels = brightness("a.gif")
    motions = [tuple(levels[first : first + IN_GIF]) for first in range(0, 3 * IN_GIF, IN_GIF)]
    assert len(set(motions)) == 3


def test_file_that_is_asked_for_is_written_where_there_is_a_screen_too_and_is_of_its_kind(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.setattr(play, "has_screen", lambda: True)
    script("--out", "swing up.mp4", "--starts", 1)
    assert b"ftyp" in Path("swing up.mp4").read_bytes()[:16]
    assert "wrote swing up.mp4: double_pendulum, 1 motion of 2.5 s from" in capsys.readouterr().out


def test_motions_of_own_demonstrations_are_as_long_as_they_are_and_their_failures_are_counted(
    script: Script, tmp_path: Path, capsys: Printed
) -> None:
    shown = shipped_demonstrations("double_pendulum")
    Demonstrations(shown.positions[:, :11], 0.1, shown.names).save("short one.npz")
    script(run_of(tmp_path / "run", demonstrations="short one.npz"), "--starts", 3)
    said = "3 motions of 1 s from a fresh start, 0 of 3 with success\n"
    assert capsys.readouterr().out.endswith(said)


def test_without_opengl_the_double_pendulum_is_sketched_and_other_robots_are_one_line(
    script: Script, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(MujocoRobotEnv, "draw", no_opengl)
    with pytest.raises(SystemExit, match=r"^error: pictures need OpenGL$"):
        script(run_of(tmp_path / "run", "biorob"))
    assert not Path("play.gif").exists()
    script("--starts", 1)
    with Image.open("play.gif") as gif:
        assert gif.size == (480, 480)
        assert len({frame.tobytes() for frame in ImageSequence.Iterator(gif)}) > STEPS


OTHER_ROBOT = "run/policy.pt must be a policy of biorob, from q_yaw, q_shoulder, q_elbow, "
OWN_ROBOT = "play it in Python, env.rollout(steps, load_policy('run/policy.pt')"


@pytest.mark.parametrize(
    ("file", "content", "complaint"),
    [
        ("policy.pt", None, "run must be the folder of a finished run, but holds no policy.pt"),
        ("summary.json", None, "but holds no summary.json"),
        ("policy.pt", "cut", "run/policy.pt: must be a file of save_policy"),
        ("summary.json", '{"experiment": "biorob"}', OTHER_ROBOT),
        ("summary.json", '{"experiment": "my arm"}', OWN_ROBOT),
        ("summary.json", '{"experiment": 5}', "summary.json is damaged: experiment must be text"),
        ("summary.json", "{}", "run: summary.json is damaged: 'experiment'"),
        ("settings.yaml", "sead: 1", "run/settings.yaml: there is no setting sead"),
        ("settings.yaml", "demonstrations: gone.npz", "error: there is no file gone.npz"),
    ],
)
def test_what_is_no_run_that_can_be_played_is_one_line(
    script: Script, tmp_path: Path, file: str, content: str | None, complaint: str
) -> None:
    damaged = run_of(tmp_path / "run") / file
    if content is None:
        damaged.unlink()
    else:
        damaged.write_text(content)
    with pytest.raises(SystemExit) as stop:
        script("run")
    assert stop.value.code.startswith("error: ") and "\n" not in stop.value.code
    assert complaint in stop.value.code
    assert not Path("play.gif").exists()


class Window:
    """In place of MuJoCo's viewer: notes the state at each sync, and is closed after some."""

    def __init__(self, env: MujocoRobotEnv, syncs: int) -> None:
        self.env, self.left, self.shown = env, syncs, list[Tensor]()
        self.cam, self.closed = SimpleNamespace(type=None, fixedcamid=None), False

    def launch(self, model: mujoco.MjModel, data: mujoco.MjData, **panels: bool) -> Window:
        self.model, self.data = model, data
        return self

    def __enter__(self) -> Window:
        return self

    def __exit__(self, *error: object) -> None:
        self.closed = True

    def lock(self) -> nullcontext[None]:
        return nullcontext()

    def is_running(self) -> bool:
        return self.left > 0

    def sync(self) -> None:
        self.left -= 1
        physics = np.empty(mujoco.mj_stateSize(self.model, FULL_PHYSICS))
        mujoco.mj_getState(self.model, self.data, physics, FULL_PHYSICS)
        self.shown.append(self.env.state_of(torch.from_numpy(physics)))


class Clock:
    """Time that passes only where it is slept."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def opened(monkeypatch: pytest.MonkeyPatch, syncs: int) -> Window:
    window = Window(DoublePendulumEnv(), syncs)
    module = SimpleNamespace(launch_passive=window.launch)
    monkeypatch.setattr(viewer, "import_module", lambda name: module)
    monkeypatch.setattr(viewer, "time", Clock())
    return window


def test_window_shows_motions_in_real_time_until_it_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    window = opened(monkeypatch, syncs=500)  # of 1/60 s: two motions of 3.5 s with their rest
    load_player(SHIPPED).show(seed=100)
    player = load_player(SHIPPED)
    motions = player.motions(player.task.first_robot(seed=100))
    shown = torch.stack(window.shown)
    for number in range(2):
        expected = next(motions)["next", "observation"]
        seen = shown[round(number * 3.5 * 60) + 6 * torch.arange(1, STEPS + 1)]
        # a picture is of the time step before or after its time: 2 ms at some 10 rad/s
        torch.testing.assert_close(seen[:, ::2], expected[:, ::2], atol=0.1, rtol=0)
    assert window.closed
    camera = window.model.camera("front").id
    assert (window.cam.type, window.cam.fixedcamid) == (mujoco.mjtCamera.mjCAMERA_FIXED, camera)


def test_interrupt_closes_the_window_and_is_no_error(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    window = opened(monkeypatch, syncs=5)

    def interrupted() -> None:
        raise KeyboardInterrupt

    window.sync = interrupted  # type: ignore[method-assign]
    monkeypatch.setattr(play, "has_screen", lambda: True)
    script()
    assert window.closed
    said = "double_pendulum: close the window, or press Ctrl-C, to end\n"
    assert capsys.readouterr().out == said


@pytest.mark.parametrize(
    ("started", "window", "there"), [(False, None, False), (True, None, False), (True, "a", True)]
)
def test_screen_is_there_if_a_window_opens(
    monkeypatch: pytest.MonkeyPatch, started: bool, window: str | None, there: bool
) -> None:
    glfw = SimpleNamespace(
        VISIBLE=1,
        FALSE=0,
        init=lambda: started,
        window_hint=lambda hint, value: None,
        create_window=lambda *arguments: window,
        default_window_hints=lambda: None,
        destroy_window=lambda window: None,
    )
    monkeypatch.setattr(viewer, "import_module", lambda name: glfw)
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    assert viewer.has_screen() is there


@pytest.mark.robot
def test_robot_of_another_simulator_is_shown_as_its_environment_draws_it(
    script: Script, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Printed
) -> None:
    pytest.importorskip("gymnasium", reason="needs the extra gym")
    monkeypatch.setattr(play, "has_screen", lambda: True)  # which its environment does not use
    run = run_of(tmp_path / "run", "gym_pendulum")
    script(run, "--starts", 1)
    assert "gym_pendulum, 1 motion of 4 s from a fresh start" in capsys.readouterr().out
    assert len(brightness("play.gif")) >= 40
