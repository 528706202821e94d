"""Rollouts as experience of the inverse model, and what the primitive asks of the robot."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from reproduction.baselines.dmp import DMP
from reproduction.baselines.dmp_learning import (
    InverseDynamicsLearner,
    Motion,
    dmp_reference,
    execute,
    random_torques,
)
from reproduction.baselines.learned_inverse_dynamics import InverseDynamics, Reference
from tests.helpers.draws import Draws
from tests.helpers.short_run import quick_fits
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.tasks.double_pendulum import double_pendulum_space

U_MAX = torch.tensor([3.5, 3.5], dtype=torch.float64)
HOLD, STEPS = 5, 4


@pytest.fixture
def dmp(draws: Draws) -> DMP:
    return DMP(draws.normal(2), draws.normal(2), draws.normal(2), draws.normal(6, 2), duration=0.4)


@pytest.fixture
def learner(dmp: DMP) -> InverseDynamicsLearner:
    reference = dmp_reference(dmp, STEPS, 0.1, HOLD)
    return InverseDynamicsLearner(double_pendulum_space(), reference, U_MAX, 0.1)


def motion(draws: Draws) -> Motion:
    return Motion(draws.normal(STEPS + 1, 4), draws.normal(STEPS, 2))


def test_reference_is_the_primitives_motion(dmp: DMP) -> None:
    reference = dmp_reference(dmp, STEPS, 0.1, HOLD)
    y, dy, ddy = dmp(torch.tensor([0.12, 0.3], dtype=torch.float64))
    assert reference.hold == HOLD
    torch.testing.assert_close(reference.states[6], torch.stack([y[0], dy[0]], -1).flatten())
    torch.testing.assert_close(reference.accelerations[3], ddy[1])
    assert len(reference.states) == STEPS * HOLD + 1 and len(reference.accelerations) == STEPS + 1


def test_random_torques_are_held_for_a_control_step_within_their_part_of_the_limits() -> None:
    controller = random_torques(U_MAX, 0.4, HOLD, torch.Generator().manual_seed(0))
    each = [controller(step, torch.zeros(4)) for step in range(200 * HOLD)]
    torques = torch.stack(each).unflatten(0, (200, HOLD))
    assert (torques == torques[:, :1]).all() and len(torques[:, 0].unique(dim=0)) == 200
    assert 1.3 < torques.abs().max() <= 0.4 * 3.5


def test_held_torques_move_the_robot_as_one_control_step_does() -> None:
    motions = []
    for hold in (1, HOLD):
        torques = random_torques(U_MAX, 0.4, hold, torch.Generator().manual_seed(0))
        env = DoublePendulumEnv(control_period=0.1 / hold, seed=0)
        motions.append(execute(env, torques, STEPS, hold))
    torch.testing.assert_close(motions[0].states, motions[1].states)
    torch.testing.assert_close(motions[0].torques, motions[1].torques)


def test_torques_of_a_motion_are_means_over_control_steps() -> None:
    env = DoublePendulumEnv(control_period=0.02, num_envs=3, seed=0)
    ramp = execute(env, lambda step, x: 0.01 * step * torch.ones(3, 2).double(), STEPS, HOLD)
    assert ramp.states.shape == (3, STEPS + 1, 4)
    expected = 0.01 * torch.tensor([2.0, 7.0, 12.0, 17.0], dtype=torch.float64)
    torch.testing.assert_close(ramp.torques[1, :, 0], expected)


def test_transition_is_its_state_the_next_one_the_next_acceleration_and_the_torque_between(
    learner: InverseDynamicsLearner, draws: Draws, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = 0.1 * torch.arange(STEPS + 1, dtype=torch.float64)
    states = torch.stack([t**2, 2 * t, t**3, 3 * t**2], -1)
    fitted = {}
    monkeypatch.setattr(InverseDynamics, "fit", lambda self, *data: fitted.update(data=data))
    learner.add(Motion(states, draws.normal(STEPS, 2)))
    learner.fit()
    now, following, accelerations, torques = fitted["data"]
    torch.testing.assert_close((now, following), (states[:-1], states[1:]))
    expected = torch.stack([2 + 0 * t, 6 * t], -1)[1:]
    torch.testing.assert_close(accelerations, expected)
    assert torques is not None and len(torques) == STEPS


def test_model_is_learned_from_all_motions_in_their_order(
    learner: InverseDynamicsLearner, draws: Draws, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    for _ in range(3):
        learner.add(motion(draws))
    learner.fit()
    torques = torch.cat([past.torques for past in learner.experience])
    torch.testing.assert_close(learner.inverse.gp.train_targets, torques)
    assert learner.experience_s == pytest.approx(3 * STEPS * 0.1)


def test_robot_with_the_right_torques_is_on_the_reference(draws: Draws) -> None:
    """A learned model of a known motion asks for its torques, and feedback has nothing to add."""
    env = DoublePendulumEnv(num_envs=1, seed=0)
    torques, states = draws.uniform(-1, 1, 12, 1, 2), [env.reset()["observation"]]
    for torque in torques:
        states.append(env.simulate(states[-1], torque))
    done = Motion(torch.stack(states, 1)[0], torques[:, 0])
    learner = InverseDynamicsLearner(
        double_pendulum_space(), Reference(done.states, torch.zeros(13, 2)), U_MAX, 0.1
    )
    learner.controller.inverse = iter_torques(torques)
    again = learner.execute(StartAt(done.states[0]))
    assert learner.tracking_error(again) < 1e-12
    assert learner.tracking_error(Motion(again.states + 0.1, again.torques)) == pytest.approx(0.1)


def iter_torques(torques: torch.Tensor) -> object:
    """An inverse model that knows what comes next."""
    remaining = iter(torques[:, 0])
    return lambda *asked: next(remaining)


class StartAt(DoublePendulumEnv):
    """A robot that starts in a given state."""

    def __init__(self, state: torch.Tensor) -> None:
        super().__init__(seed=0)
        self.start = state

    def reset(self, tensordict: TensorDict | None = None, **kwargs: object) -> TensorDict:
        return super().reset(TensorDict({"observation": self.start}), **kwargs)
