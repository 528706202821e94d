"""Experience: what went in comes out, and the model's training data follow from it."""

from __future__ import annotations

import logging

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.control.known_part import KnownPart
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.experience import Experience

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))
KEYS = ("observation", "action", ("next", "observation"))


def make_transitions(draws: Draws, *batch: int) -> TensorDict:
    """Random transitions, with a reward that nobody needs."""
    entries = {"observation": draws.normal(*batch, 2), "action": draws.normal(*batch, 1)}
    following = {"observation": draws.normal(*batch, 2), "reward": draws.normal(*batch, 1)}
    return TensorDict({**entries, "next": following}, batch_size=batch)


@pytest.fixture
def transitions(draws: Draws) -> TensorDict:
    return make_transitions(draws, 7)


def filled(transitions: TensorDict, capacity: int = 20) -> Experience:
    experience = Experience(capacity)
    experience.extend(transitions)
    return experience


def test_rollouts_come_back_bit_for_bit_in_float64_one_after_the_other(draws: Draws) -> None:
    rollouts = make_transitions(draws, 2, 4)
    stored = filled(rollouts).transitions
    for key in KEYS:
        assert stored[key].dtype == torch.float64
        assert torch.equal(stored[key], rollouts[key].flatten(0, 1))


def test_order_is_that_of_arrival(draws: Draws) -> None:
    batches = [make_transitions(draws, count) for count in (3, 5, 1)]
    experience = Experience(20)
    for count, batch in zip((3, 8, 9), batches, strict=True):
        experience.extend(batch)
        assert len(experience) == count
    for key in KEYS:
        expected = torch.cat([batch[key] for batch in batches])
        assert torch.equal(experience.transitions[key], expected)


def test_later_changes_of_a_batch_do_not_reach_the_experience(transitions: TensorDict) -> None:
    before, experience = transitions["action"].clone(), filled(transitions)
    transitions["action"].zero_()
    assert torch.equal(experience.transitions["action"], before)


@pytest.mark.parametrize("targets", ["difference", "successor"])
def test_training_data_are_features_and_action_and_where_they_led(
    transitions: TensorDict, targets: str
) -> None:
    inputs, outputs = filled(transitions).training_data(SPACE, targets)
    (q, dq), u = transitions["observation"].unbind(-1), transitions["action"][:, 0]
    successor = transitions["next", "observation"]
    assert_close(inputs, torch.stack([dq, q.sin(), q.cos(), u], -1), rtol=0, atol=0)
    expected = successor if targets == "successor" else successor - transitions["observation"]
    assert_close(outputs, expected, rtol=0, atol=0)


def test_known_part_of_a_model_learns_from_its_data(transitions: TensorDict) -> None:
    known = KnownPart.of_velocities(NAMES, {"q": "dq"}, num_actions=1, time_step=0.1)
    dynamics, states = GPDynamics(4, 1, known), transitions["observation"]
    successors = transitions["next", "observation"]
    successors[:, 0] = states[:, 0] + 0.02 * states[:, 1] + 0.07 * successors[:, 1]
    _, targets = filled(transitions).data_for(dynamics, SPACE)
    expected = torch.tensor([[0.02, 0.07]], dtype=torch.float64)
    assert_close(dynamics.known_part(SPACE).rule, expected, rtol=0, atol=1e-5)
    assert torch.equal(targets, (successors - states)[:, 1:])


def test_no_transitions_are_no_data_of_a_model() -> None:
    with pytest.raises(ValueError, match="a transition at least, got none"):
        Experience(3).data_for(GPDynamics(4, 2), SPACE)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("key", KEYS, ids=["state", "action", "successor"])
def test_entry_that_is_not_finite_is_refused_in_one_line(
    transitions: TensorDict, key: str, value: float
) -> None:
    experience = filled(transitions)
    broken: Tensor = transitions[key]
    broken[2, 0] = value
    with pytest.raises(ValueError, match=r"transitions' .* must be finite, got") as error:
        experience.extend(transitions)
    assert str(value) in str(error.value) and "\n" not in str(error.value)
    assert len(experience) == 7


def test_more_than_the_capacity_is_refused_and_nothing_is_lost(transitions: TensorDict) -> None:
    experience = filled(transitions, capacity=10)
    assert len(filled(transitions, capacity=7)) == 7
    with pytest.raises(ValueError, match="experience holds at most 10 transitions, got 14"):
        experience.extend(transitions)
    assert torch.equal(experience.transitions["action"], transitions["action"])


def test_torchrl_says_nothing_of_its_storage(draws: Draws, monkeypatch: pytest.MonkeyPatch) -> None:
    logger, said = logging.getLogger("torchrl"), []
    handler = logging.Handler()
    monkeypatch.setattr(handler, "emit", said.append)
    monkeypatch.setattr(logger, "disabled", False)  # as Hydra leaves it in a process
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        Experience(capacity=9).extend(make_transitions(draws, 3))
        assert not said and logger.level == logging.INFO
        monkeypatch.setenv("RL_LOGGING_LEVEL", "INFO")
        Experience(capacity=9).extend(make_transitions(draws, 3))
        assert said
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
