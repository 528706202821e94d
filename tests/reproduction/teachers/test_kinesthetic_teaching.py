"""Kinesthetic teaching: a hand of finite strength leads a limp robot near what it meant."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources

import mujoco
import numpy as np
import pytest

from reproduction.teachers import kinesthetic_teaching
from reproduction.teachers.hand import Hand
from reproduction.teachers.kinesthetic_teaching import HAND, Strike, Variation, record_strike


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    scene = resources.files("torch_pmil.envs").joinpath("assets", "biorob", "scene.xml")
    return mujoco.MjModel.from_xml_path(str(scene))


def varied(model: mujoco.MjModel, count: int) -> list[Strike]:
    generator = np.random.default_rng(0)
    return [Variation().of(Strike(), model, generator) for _ in range(count)]


def test_path_rests_at_its_ends_and_passes_the_ball_as_meant() -> None:
    strike, path = Strike(), Strike().path()
    for time, angles, velocity in (
        (-kinesthetic_teaching.SETTLING, strike.start, (0, 0, 0)),
        (0.0, strike.start, (0, 0, 0)),
        (0.8, strike.back, (0, 0, 0)),
        (1.25, strike.hit, strike.hit_velocity),
        (1.6, strike.stop, (0, 0, 0)),
        (1.8, strike.stop, (0, 0, 0)),
    ):
        assert path(time) == pytest.approx(angles)
        assert path(time, 1) == pytest.approx(velocity, abs=1e-9)


def test_arm_follows_the_hand_and_hits_the_ball_when_it_is_meant_to(model: mujoco.MjModel) -> None:
    recording = record_strike(model, Strike())
    times = np.arange(len(recording.states)) * recording.time_step
    assert times[-1] == pytest.approx(1.8)
    assert np.abs(recording.states[:, :3] - Strike().path()(times)).max() < np.deg2rad(3)
    assert recording.hit_time == pytest.approx(1.25, abs=0.02)
    slopes = np.gradient(recording.states[:, :3], 0.001, axis=0)
    assert slopes[5:-5] == pytest.approx(recording.states[5:-5, 3:], abs=0.1)
    assert np.array_equal(recording.states, record_strike(model, Strike()).states)


def test_limp_arm_is_pulled_with_the_largest_force_at_the_most_and_no_further_than_it_reaches(
    model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    forces, pull = [], Hand.pull

    def weighed(
        hand: Hand, model: mujoco.MjModel, data: mujoco.MjData, *where: str | np.ndarray
    ) -> None:
        pull(hand, model, data, *where)
        jacobian = np.empty((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, model.site("racket").id)
        forces.append(np.linalg.lstsq(jacobian.T, data.qfrc_applied, rcond=None)[0])
        assert not data.ctrl.any()

    monkeypatch.setattr(Hand, "pull", weighed)
    message = r"the hand must keep the racket within 0\.1 m, it ended \d\.\d\d m away"
    with pytest.raises(RuntimeError, match=message):
        record_strike(model, replace(Strike(), stop=(0.2, 3.5, 0.0)))
    largest = np.linalg.norm(forces, axis=1).max()
    assert HAND.force * 0.99 < largest < HAND.force * 1.001


def test_variation_is_as_large_as_it_says(model: mujoco.MjModel) -> None:
    variation, strikes = Variation(), varied(model, 400)
    for name, size in (
        ("start", variation.start),
        ("back", variation.rest),
        ("stop", variation.rest),
        ("times", variation.time),
    ):
        drawn = np.array([getattr(strike, name) for strike in strikes])
        assert drawn.std(0) == pytest.approx(np.full(3, size), rel=0.12)  # three standard errors
        assert drawn.mean(0) == pytest.approx(getattr(Strike(), name), abs=3.5 * size / 20)
    places = kinesthetic_teaching._racket_path(model, np.array([strike.hit for strike in strikes]))
    assert places.std(0) == pytest.approx(np.full(3, variation.hit), rel=0.12)
    speeds = np.array([strike.hit_velocity for strike in strikes])[:, 1] / Strike().hit_velocity[1]
    assert speeds.std() == pytest.approx(variation.speed, rel=0.12)


def test_all_of_several_people_hit_the_ball_at_times_of_their_own(model: mujoco.MjModel) -> None:
    hits = [record_strike(model, strike).hit_time for strike in varied(model, 6)]
    assert all(hits)
    assert np.std(hits) > 0.01
