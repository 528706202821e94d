"""What a first motion decides, on robots whose right sampling is known."""

from __future__ import annotations

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from tensordict import TensorDictBase

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.rollouts import states_of
from torch_pmil.model.past_evidence import PastEvidence
from torch_pmil.tasks import sampling_choice
from torch_pmil.tasks.first_motion import FirstMotion, explore
from torch_pmil.tasks.own_robot import own_robot
from torch_pmil.tasks.own_samplings import samplings_of
from torch_pmil.tasks.resampled import at_step, resampled
from torch_pmil.tasks.sampling import Sampling
from torch_pmil.tasks.sampling_choice import FEWEST_SPANS, SPAN, Choice, choose
from torch_pmil.tasks.task import Task


class Joint(gymnasium.Env):
    """A joint whose action takes effect some periods late, with noisy readings."""

    dt = 0.05

    def __init__(self, late: int = 0, noise: float = 0.0) -> None:
        self.observation_space = Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = Box(-6.0, 6.0, (1,), np.float64)
        self.late, self.noise = late, noise

    def shown(self) -> np.ndarray:
        return self.state + self.noise * np.array([1, 5]) * self.np_random.standard_normal(2)

    def reset(self, *, seed: int | None = None, options: object = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.state, self.waiting = 0.02 * self.np_random.standard_normal(2), [0.0] * self.late
        return self.shown(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        self.waiting.append(float(action[0]))
        torque, (q, dq) = self.waiting.pop(0), self.state
        for _ in range(25):
            dq += 0.002 * (torque - 3 * np.sin(q) - 0.4 * dq) / 0.5
            q += 0.002 * dq
        self.state = np.array([q, dq])
        return self.shown(), 0.0, False, False, {}


class Encoder(Joint):
    """A joint whose velocity is not measured."""

    def __init__(self) -> None:
        super().__init__()
        self.observation_space = Box(-np.inf, np.inf, (1,), np.float64)

    def shown(self) -> np.ndarray:
        return super().shown()[:1]


def demonstrated(steps: int = 100) -> Demonstrations:
    share = torch.linspace(0, 1, steps + 1, dtype=torch.float64)
    way = share**3 * (10 - 15 * share + 6 * share**2)
    return Demonstrations(torch.stack([way, 1.05 * way])[..., None], 0.05, ("q",))


def task_of(robot: Joint | None = None, steps: int = 100, **said: object) -> Task:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        state = ("q",) if isinstance(robot, Encoder) else ("q", "dq")
        return own_robot(robot or Joint(), demonstrated(steps), 0.05, state=state, **said)


def chosen(robot: Joint, steps: int = 100, **said: object) -> Sampling:
    task = task_of(robot, steps, **said)
    return choose(task, explore(task, seed=100)).sampling


def test_robot_that_shows_all_needs_no_past() -> None:
    assert chosen(Joint()).past == {}


@pytest.mark.parametrize("late", [1, 2])
def test_late_robot_needs_the_actions_that_still_act(late: int) -> None:
    assert chosen(Joint(late), steps=60, step=0.05).past == {"past_actions": late}


def test_noisy_readings_ask_for_long_steps() -> None:
    assert chosen(Joint(noise=0.01), past=None).held == 2


def test_steps_are_powers_of_two_that_leave_a_motion_enough_of_them() -> None:
    helds = {steps: [each.held for each in task_of(steps=steps, past=None).samplings] or [1]
             for steps in (24, 49, 50, 99, 100, 400)}  # fmt: skip
    assert helds == {
        24: [1],
        49: [1],
        50: [1, 2],
        99: [1, 2],
        100: [1, 2, 4],
        400: [1, 2, 4, 8, 16],
    }


def travelled(rollout: TensorDictBase) -> torch.Tensor:
    return rollout["observation"][..., 1].abs().sum(-1)


def test_what_is_said_is_not_chosen() -> None:
    assert task_of(step=0.1, past=None).samplings == ()
    assert task_of(step=np.float32(0.1), past=None).held == task_of(step=0.1, past=None).held
    assert task_of(step=0.1, past_actions=1).samplings == ()
    assert {each.past_actions for each in task_of(past_actions=2).samplings} == {2}
    own = task_of(past=None, error=travelled, tolerance=1.0)
    assert (own.samplings, own.held) == ((), 1)


def test_given_step_is_that_of_robot_demonstrations_policy_and_error() -> None:
    task, plain = task_of(step=0.1, past_actions=1), task_of(past=None, step=0.05)
    assert (task.horizon, task.demonstrations.time_step, task.held) == (50, 0.1, 2)
    assert task.robot(0).control_period == pytest.approx(0.1)
    assert task.space.names == ("q", "dq", "0@1")
    states = plain.demonstrated_states[:101][None]
    error = plain.error.of_states
    every = at_step(plain, 2).error.of_states(states[:, ::2])
    deviations = error.space.observe(states[:, 1:]) - error.demonstrated.mean
    expected = (deviations / error.demonstrated.std)[:, 1::2].square().mean((-2, -1)).sqrt()
    assert torch.allclose(every, expected)


def test_tolerance_by_name_is_in_units_of_the_entry() -> None:
    task = task_of(tolerance={"q": 0.05}, past=None)
    states = task.demonstrated_states[:101] * 1.0
    states[:, 0] = torch.cat([states[:1, 0], task.demonstrated.mean[:, 0] + 0.04])
    error = task.error.of_states
    assert task.tolerance == 1 and error(states[None]).item() == pytest.approx(0.04 / 0.05)
    assert error.every(4)(states[None, ::4]).item() == pytest.approx(0.04 / 0.05)
    with pytest.raises(ValueError, match="by entries of the demonstrations, q, got q2"):
        task_of(tolerance={"q2": 0.05})
    with pytest.raises(ValueError, match="tolerance of q must be"):
        task_of(tolerance={"q": 0.0})


@pytest.mark.parametrize("step", [0.0, 0.07, -0.1, True, "long", float("nan")])
def test_step_must_be_a_multiple_of_the_control_period(step: object) -> None:
    with pytest.raises(ValueError, match=r'step must be "auto" or seconds, a multiple of'):
        task_of(step=step)


def test_past_is_chosen_or_not() -> None:
    with pytest.raises(ValueError, match=r'past must be "auto" or None, got'):
        task_of(past="all")


def test_motion_is_seen_as_the_sampled_robot_shows_it() -> None:
    """States and actions are those of a robot that does the same motion."""
    task = task_of()
    motion = explore(task, seed=3)
    assert motion.actions.unflatten(0, (25, 4)).std(1).max() == 0
    sampled = resampled(task, Sampling(held=4, past_actions=1))
    env, actions = sampled.robot(3), iter(motion.actions[::4])
    rollout = env.rollout(25, lambda *_: next(actions))
    seen = motion.as_rollout(sampled)
    assert torch.allclose(states_of(seen), states_of(rollout), atol=1e-12)
    assert torch.equal(seen["action"], rollout["action"])


def test_motion_that_is_too_short_decides_nothing() -> None:
    task = task_of()
    motion = explore(task, seed=100)
    few = FEWEST_SPANS * SPAN * 4 - 1
    short = FirstMotion(motion.states[: few + 1], motion.actions[:few], motion.resting)
    assert choose(task, short) == Choice(task.samplings[0])


@pytest.mark.parametrize(
    ("losses", "held"),
    [((0.10, 0.12, 0.40), 2), ((0.40, 0.12, 0.10), 4), ((2.0, 2.1, 1.9), 1), ((4.0, 2.1, 1.9), 1)],
)
def test_step_is_the_longest_alike_of_good_models_and_the_shortest_of_bad_ones(
    losses: tuple[float, ...], held: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = dict(zip((1, 2, 4), losses, strict=True))
    monkeypatch.setattr(sampling_choice, "_loss", lambda task, *_: of[task.held])
    task = task_of(past=None)
    assert choose(task, explore(task, seed=100)).sampling.held == held


def test_long_motion_without_a_good_model_has_a_hundred_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sampling_choice, "_loss", lambda task, *_: 2.0)
    task = task_of(past=None, steps=400)
    assert choose(task, explore(task, seed=100)).sampling.held == 4


@pytest.mark.parametrize(("with_past", "held"), [(0.3, {"past_actions": 2}), (4.5, {})])
def test_past_that_explains_the_motion_is_held_if_the_model_then_is_good(
    with_past: float, held: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A falling pole gains 27 nats by its past, and its model loses 4.5 with and without."""
    monkeypatch.setattr(
        sampling_choice, "_loss", lambda task, *_: with_past if task.history else 4.8
    )
    task = task_of(Joint(late=2), 60, step=0.05)
    choice = choose(task, explore(task, seed=100))
    assert choice.sampling.past == held and choice.gained["the action 0.1 s before"] > 9
    assert choice.lost == {"steps of 0.05 s": 4.8, "steps of 0.05 s, past_actions=2": with_past}


def test_where_no_model_is_good_without_the_past_steps_are_compared_with_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A strong joint whose torque lags is thrown about: a model of its readings alone loses 2."""
    with_past = {1: 1.9, 2: 0.7, 4: 0.72}

    def loss(task: Task, *_: object) -> float:
        return with_past[task.held] if task.history else 2.4

    monkeypatch.setattr(sampling_choice, "_loss", loss)
    choice = choose(task := task_of(Joint(late=2)), explore(task, seed=100))
    assert (choice.sampling.held, choice.sampling.past) == (4, {"past_actions": 1})
    assert list(choice.lost.values()) == [2.4, 2.4, 2.4, 1.9, 0.7, 0.72]


@pytest.mark.parametrize(("robot", "expected"), [(Encoder(), (4, 1, 1)), (Joint(), (1, 0, 0))])
def test_robot_without_velocities_keeps_its_last_reading_though_no_model_is_good(
    robot: Joint, expected: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three joints that random torques throw about are predicted badly with it and without."""
    likely = PastEvidence({1: 9.0}, 5.0, 100, 0.05)
    monkeypatch.setattr(sampling_choice, "_evidence", lambda *_: (likely, 1))
    monkeypatch.setattr(sampling_choice, "_loss", lambda *_: 2.0)
    choice = choose(task := task_of(robot), explore(task, seed=100))
    assert choice.sampling == Sampling(*expected)
    assert choice.in_words(0.05).partition(": ")[2].startswith("no model predicts the first motion")


def test_samplings_begin_with_that_for_which_nothing_is_chosen() -> None:
    task = replace(task_of(), samplings=())
    assert samplings_of(task, Sampling(), "auto", "auto")[0] == Sampling()
