"""The BioRob's results: each number is that of the runs, and the pictures are of the motions that
they say.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from reproduction import biorob
from reproduction.biorob import (
    PHOTOGRAPHED,
    cropped,
    headline_of,
    needed_runs,
    photo_series,
    results,
)
from reproduction.teachers.kinesthetic_teaching import Strike, Variation, record_strike
from tests.helpers.short_run import changed, quick_fits, run
from tests.helpers.summaries import summary
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.registry import load_experiment

ENTRIES = ("q_yaw", "q_shoulder", "q_elbow", "dq_yaw", "dq_shoulder", "dq_elbow")


def run_of(rate: float, error: float, trials: int = 4) -> dict:
    """Of a run whose joints are ``error`` degrees off."""

    def degrees(angle: float) -> dict[str, float]:
        return {name: math.radians(angle) if name.startswith("q") else 9.0 for name in ENTRIES}

    return summary(
        saved_success_rate=rate,
        experience_s=6.0 + 1.8 * trials,
        two_sigma_coverage_by_entry=dict.fromkeys(ENTRIES, 0.95),
        rms_error=degrees(error),
        demonstration_spread=degrees(2.0),
        trials=[{}] * trials,
    )


def test_headline_counts_seeds_that_hit_in_time() -> None:
    runs = [run_of(1.0, 3.0), run_of(0.95, 4.0), run_of(0.9, 4.0), run_of(1.0, 4.0, trials=5)]
    expected = {
        "seeds_solved_by_trial_4": 2,
        "hit_rate": 3.85 / 4,
        "max_experience_s": 15.0,
        "joint_rms_error_deg": math.sqrt((9 + 3 * 16) / 4),
        "worst_joint_rms_error_deg": 4.0,
        "median_joint_rms_error_deg": 4.0,
        "demonstration_spread_deg": 2.0,
        "two_sigma_coverage_q_yaw": 0.95,
    }
    headline = headline_of(runs)
    assert {name: headline[name] for name in expected} == pytest.approx(expected)


def test_ten_seeds_of_four_trials_are_those_of_the_training_script(tmp_path: Path) -> None:
    runs = needed_runs(tmp_path, quick=False)
    assert [run.out for run in runs] == [tmp_path / "biorob" / f"seed_{seed}" for seed in range(10)]
    assert {run.learn.keywords["trials"] for run in runs} == {4}


def test_report_of_a_short_run_has_its_figures_in_degrees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_pictures(*_: object) -> None:
        raise RuntimeError("no OpenGL")

    search = SearchSettings(0, 1, 1, first_horizon=1.0)
    short = changed(load_experiment("biorob"), num_centres=5, search=search)
    quick_fits(monkeypatch)
    run(tmp_path, task=short, seed=0, trials=1)
    monkeypatch.setattr(biorob, "load_experiment", lambda name: short)
    monkeypatch.setattr(biorob, "photo_series", no_pictures)
    with pytest.warns(RuntimeWarning, match="there is no figure 8: no OpenGL"):
        made = results([tmp_path], quick=True)
    assert sorted(made.figures) == ["figure10", "hits_over_experience"]
    panels, joints = made.figures["figure10"].axes, ("yaw", "shoulder", "elbow")
    assert [panel.get_ylabel() for panel in panels] == [f"q {joint} (°)" for joint in joints]
    shoulder = short.demonstrations.positions[:, 1:, 1].mean(0).numpy()
    assert panels[1].lines[0].get_ydata() == pytest.approx(np.rad2deg(shoulder))


def test_pictures_are_of_the_demonstration_and_of_the_rollout_and_said_to_be_rendered() -> None:
    experiment = load_experiment("biorob")
    env = experiment.make_env(seed=3)
    rollout = env.rollout(18)
    try:
        figure = photo_series(rollout, experiment)
    except RuntimeError as error:
        pytest.skip(str(error))
    panels = figure.axes
    assert len(panels) == 12 and "rendered" in figure.get_supxlabel()
    last = cropped(env.draw(env.replay(rollout["observation"][0], rollout["action"], 1)[14]))
    env.close()
    shades = [panel.images[0].get_array().astype(int) for panel in panels]
    assert np.abs(shades[-1] - last).max() <= 2  # a shade may be rounded either way
    assert np.abs(shades[5] - last).max() > 50


def test_the_ball_of_the_demonstration_is_hit_while_pictures_are_taken() -> None:
    model = load_experiment("biorob").make_env(seed=0).model
    strike = Variation().of(Strike(), model, np.random.default_rng(0))
    frames = [round(time / model.opt.timestep) for time in PHOTOGRAPHED]
    ball = 1 + model.joint("ball").qposadr[0]  # a state begins with the time
    places = record_strike(model, strike).physics[frames, ball : ball + 3]
    moved = np.linalg.norm(places - places[0], axis=1)
    assert moved[:4].max() < 1e-3 < 0.1 < moved[4] < moved[5]
