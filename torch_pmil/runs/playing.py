"""A learned policy at work: its motions from fresh starts, in a window or in a film."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from torch_pmil.control.policy_file import PolicyFileError, load_policy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.envs import AdaptedEnv, MujocoRobotEnv
from torch_pmil.envs.rollouts import pictures_of, states_of
from torch_pmil.files import read_json, short
from torch_pmil.plotting.video import check_film_name, write_film
from torch_pmil.runs.pictures import drawing_of
from torch_pmil.runs.settings import read_settings
from torch_pmil.runs.summaries import RunError
from torch_pmil.runs.viewer import show
from torch_pmil.tasks.registry import EXPERIMENTS, demonstrations_from, load_experiment
from torch_pmil.tasks.task import Task

FRAMES_PER_STEP = {".gif": 2, ".mp4": 5}  # of a simulated robot: at 10 Hz, 20 and 50 per second
REST = 0.5  # s, on the last picture of a motion, before the next one begins
SHIPPED = Path(str(resources.files("torch_pmil.runs"))) / "learned/double_pendulum"

Draw = Callable[[TensorDictBase], Iterator[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Player:
    """A learned policy on its task.

    Example:
        >>> player = load_player(SHIPPED)
        >>> motion = next(player.motions(player.task.first_robot(seed=0)))
        >>> player.succeeds(motion)
        True
    """

    task: Task
    policy: StatePolicy

    @property
    def in_simulator(self) -> bool:
        """Whether the robot is one of MuJoCo's, which a viewer can show."""
        return isinstance(self.task.first_robot(seed=0), MujocoRobotEnv)

    def motions(self, env: MujocoRobotEnv | AdaptedEnv) -> Iterator[TensorDictBase]:
        """Rollouts (T,) of the policy, each from a fresh start, without end."""
        while True:
            yield env.rollout(self.task.horizon, self.policy.as_tensordict_module())

    def succeeds(self, motion: TensorDictBase) -> bool:
        """Whether a rollout is a success, as the task counts them."""
        return bool(self.task.error(motion) <= self.task.tolerance)

    def show(self, seed: int) -> None:
        """Show motions from starts of a seed in MuJoCo's viewer, until its window is closed."""
        env = self.task.first_robot(seed)
        assert isinstance(env, MujocoRobotEnv)
        replays = (
            env.replay(states_of(motion)[0], motion["action"], env.substeps)
            for motion in self.motions(env)
        )
        show(env, replays)

    def film(self, path: Path, starts: int, seed: int) -> int:
        """Film so many motions one after the other, and return how many of them succeeded.

        Args:
            path: the file to write or replace, ending in .gif or .mp4.
            starts: number of motions.
            seed: of the starts.

        Raises:
            ValueError: the name has another ending.
            RuntimeError: the robot gives no pictures.
            OSError: the file cannot be written.
        """
        check_film_name(path)
        env, draw, fps = self._stage(seed, path)
        motions = list(itertools.islice(self.motions(env), starts))
        films = (_then_at_rest(draw(motion), round(REST * fps)) for motion in motions)
        write_film(path, itertools.chain.from_iterable(films), fps)
        return sum(map(self.succeeds, motions))

    def _stage(self, seed: int, path: Path) -> tuple[MujocoRobotEnv | AdaptedEnv, Draw, float]:
        """A robot, how its rollouts are drawn, and the pictures per second."""
        env, frames = self.task.first_robot(seed), FRAMES_PER_STEP[path.suffix]
        if isinstance(env, MujocoRobotEnv):
            draw = drawing_of(env, self.task, path)
            return (
                env,
                lambda motion: draw(states_of(motion)[0], motion["action"], frames),
                frames / env.control_period,
            )
        shown = self.task.make_env(from_pixels=True, seed=seed)
        return shown, pictures_of, 1 / shown.control_period


def load_player(folder: Path) -> Player:
    """The policy of a finished run, on the run's task.

    Raises:
        RunError: the run is not finished, or its robot is not known by name.
        PolicyFileError: the policy is damaged, or of another robot.
        OSError: a file cannot be read.
        ValueError: its settings are damaged, or its demonstrations no longer fit the task.
        ImportError: the task needs another library.

    Example:
        >>> load_player(SHIPPED).task.name
        'double_pendulum'
    """
    for name in ("policy.pt", "summary.json"):
        if not (folder / name).is_file():
            raise RunError(f"{folder} must be the folder of a finished run, but holds no {name}")
    task, policy = _task_of(folder), load_policy(folder / "policy.pt")
    wanted = (*task.space.names, *task.target_names)
    found = (*policy.space.names, *policy.target_names)
    if found != wanted or len(task.actions.names) != len(policy.actions.names):
        raise PolicyFileError(
            f"{folder / 'policy.pt'} must be a policy of {task.name}, from {', '.join(wanted)} to "
            f"{task.actions}, got one from {', '.join(found)} to {policy.actions}"
        )
    return Player(task, policy)


def _task_of(folder: Path) -> Task:
    """The task of a run, with the demonstrations that it was given."""
    try:
        name = read_json(folder / "summary.json")["experiment"]
        if not isinstance(name, str):
            raise TypeError("experiment must be text")
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder}: summary.json is damaged: {error}") from error
    if name not in EXPERIMENTS:
        raise RunError(
            f"{folder} is of {short(name)}, whose robot pmil cannot make: play it in Python, "
            f"env.rollout(steps, load_policy('{folder}/policy.pt').as_tensordict_module())"
        )
    file = folder / "settings.yaml"
    given: dict[str, Any] = read_settings(file) if file.is_file() else {}
    source = given.get("demonstrations")
    task = load_experiment(name, None if source is None else demonstrations_from(source))
    return task.with_settings(tolerance=given["tolerance"]) if "tolerance" in given else task


def _then_at_rest(pictures: Iterator[np.ndarray], rest: int) -> Iterator[np.ndarray]:
    """Pictures, with the last one repeated ``rest`` times."""
    for picture in pictures:
        yield picture
    yield from itertools.repeat(picture, rest)
