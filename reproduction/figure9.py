"""Section 5.2.3, Figure 9: the sampling frequency at which a model of the BioRob predicts best."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch
from tensordict import TensorDict

from reproduction.plots.frequencies import plot_frequencies
from reproduction.reproduction import PaperExperiment, Results, Run
from reproduction.sampling_frequency import (
    FrequencyScore,
    Interval,
    Recording,
    score_frequencies,
)
from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.files import read_json, write_json
from torch_pmil.plotting import Figure
from torch_pmil.runs.run_folder import provenance
from torch_pmil.runs.summaries import RunError
from torch_pmil.tasks.registry import load_experiment

SEEDS = range(3)  # of recordings
FREQUENCIES = (2.0, 2.5, 4.0, 5.0, 6.25, 10.0, 12.5, 20.0, 25.0, 50.0)  # Hz
QUICK_FREQUENCIES = (5.0, 10.0, 20.0)
TIME_STEP = 0.01  # s, of the recordings
HOLD = 10  # time steps for which a torque is held: the robot is controlled at 10 Hz
PARTS, PART = 12, 2.0  # of a recording, and their length in s
# s, of what is used: as long as exploration, and about all that the paper's robot recorded
LENGTHS = (6.0, 24.0)
FORMS = ("raw", "standardised")


def recorded_movements(seed: int) -> list[Recording]:
    """Exploration of 24 s, as at the start of a learning run (Section 5.2.4)."""
    env = BioRobEnv(num_envs=PARTS, control_period=TIME_STEP, seed=seed)
    motion = load_experiment("biorob").exploration.motion(torch.Generator().manual_seed(seed))
    states, torques = [env.reset()["observation"]], []
    for step in range(round(PART / TIME_STEP)):
        if step % HOLD == 0:
            torque = motion(states[-1])
        torques.append(torque)
        stepped = env.step(TensorDict({"action": torque}, batch_size=[PARTS]))
        states.append(stepped["next", "observation"])
    parts = zip(torch.stack(states, 1), torch.stack(torques, 1), strict=True)
    return [Recording(*part) for part in parts]


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """The scores of each recording at each frequency; no policy is learned.

    They take long where there are many transitions.
    """
    lengths, seeds, frequencies = size(quick)
    return [
        Run(
            root / "figure9" / f"{length:g}s_{frequency:g}hz_seed_{seed}",
            partial(_score, length=length, frequency=frequency, seed=seed),
        )
        for length in lengths
        for frequency in frequencies
        for seed in seeds
    ]


def size(quick: bool) -> tuple[Sequence[float], Sequence[int], Sequence[float]]:
    """Lengths of recordings in s, seeds and frequencies that are scored."""
    return (LENGTHS[:1], SEEDS[:2], QUICK_FREQUENCIES) if quick else (LENGTHS, SEEDS, FREQUENCIES)


def results(folders: Sequence[Path], quick: bool) -> Results:
    """For each length, mean scores over the recordings with t intervals, and the best frequency."""
    lengths, seeds, frequencies = size(quick)
    scores = iter([read_score(folder) for folder in folders])
    headline: dict[str, float] = {}
    figures: dict[str, Figure] = {}
    details: dict[str, object] = {"frequencies": list(frequencies)}
    for length in lengths:
        of_length = [[next(scores) for _ in seeds] for _ in frequencies]
        forms = {form: [_interval(of_seeds, form) for of_seeds in of_length] for form in FORMS}
        for form, intervals in forms.items():
            _, best = max(zip(intervals, frequencies, strict=True))
            headline[f"best_frequency_{form}_{length:g}s_hz"] = best
            headline |= {
                f"{form}_{length:g}s_{f:g}hz": interval.mean
                for f, interval in zip(frequencies, intervals, strict=True)
            }
        half_widths = {
            form: [interval.half_width for interval in intervals]
            for form, intervals in forms.items()
        }
        details[f"{length:g}s"] = {
            "transitions": [of_seeds[0].transitions for of_seeds in of_length],
            "half_widths": half_widths,
        }
        drawn = {
            form: ([interval.mean for interval in intervals], half_widths[form])
            for form, intervals in forms.items()
        }
        figures[f"figure9_{length:g}s"] = plot_frequencies(frequencies, drawn)
    return Results(headline, figures, details)


def read_score(folder: Path) -> FrequencyScore:
    """The score that a run wrote.

    Raises:
        RunError: it cannot be read, or is not that of a score.
    """
    try:
        summary = read_json(folder / "summary.json")
        values = (
            torch.tensor(summary[name], dtype=torch.float64)
            for name in ("log_likelihood", "spread")
        )
        return FrequencyScore(summary["frequency"], summary["transitions"], *values)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder}: summary.json is no score of a frequency: {error}") from error


def _score(out: Path, command: str, length: float, frequency: float, seed: int) -> None:
    source, begun = provenance(command), time.perf_counter()
    recordings = recorded_movements(seed)[: round(length / PART)]
    space = load_experiment("biorob").space
    (score,) = score_frequencies(recordings, TIME_STEP, [frequency], space)
    run = {
        "experiment": "figure9",
        "seed": seed,
        **source,
        "length_s": length,
        "frequency": frequency,
        "log_likelihood": score.log_likelihood.tolist(),
        "spread": score.spread.tolist(),
        "transitions": score.transitions,
        "wall_seconds": round(time.perf_counter() - begun, 2),
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "summary.json", run)


def _interval(scores: Sequence[FrequencyScore], form: str) -> Interval:
    """The t interval of the scores over recordings."""
    means = [getattr(score, form).mean for score in scores]
    return Interval.of(torch.tensor(means, dtype=torch.float64))


FIGURE9 = PaperExperiment(
    "figure9",
    "how well models of the BioRob predict at each sampling frequency",
    needed_runs,
    results,
)
