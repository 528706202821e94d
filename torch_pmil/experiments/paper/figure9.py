"""Section 5.2.3, Figure 9: at which sampling frequency a model of the BioRob predicts best (Eq. 30)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import joblib
import torch
from tensordict import TensorDict

from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.paper.reproduction import PaperExperiment, Report, Run
from torch_pmil.plotting import plot_frequencies
from torch_pmil.sampling_frequency import FrequencyScore, Interval, Recording, score_frequencies

SEEDS = range(3)  # of recordings
FREQUENCIES = (2.0, 2.5, 4.0, 5.0, 6.25, 10.0, 12.5, 20.0, 25.0, 50.0)  # Hz
QUICK_FREQUENCIES = (5.0, 10.0, 20.0)
TIME_STEP = 0.01  # s, of the recordings
HOLD = 10  # time steps for which a torque is held: the robot is controlled at 10 Hz
PARTS, PART = 12, 2.0  # of a recording, and their length in s: 24 s together, about what the robot records until it has learned
FORMS = ("raw", "standardised")


def recorded_movements(seed: int) -> list[Recording]:
    """24 s of movements as those that a learning run begins with (Section 5.2.4)."""
    env = BioRobEnv(num_envs=PARTS, control_period=TIME_STEP, seed=seed)
    motion = load_experiment("biorob").first_motion.motion(torch.Generator().manual_seed(seed))
    states, torques = [env.reset()["observation"]], []
    for step in range(round(PART / TIME_STEP)):
        if step % HOLD == 0:
            torque = motion(states[-1])
        torques.append(torque)
        states.append(env.step(TensorDict({"action": torque}, batch_size=[PARTS]))["next", "observation"])
    return [Recording(*part) for part in zip(torch.stack(states, 1), torch.stack(torques, 1), strict=True)]


def no_runs(root: Path, quick: bool) -> list[Run]:
    """No policy is learned."""
    return []


def report(folders: Sequence[Path], quick: bool) -> Report:
    """Mean score of each frequency over the recordings, with its t interval, and the best frequency."""
    seeds, frequencies = (SEEDS[:2], QUICK_FREQUENCIES) if quick else (SEEDS, FREQUENCIES)
    jobs = min(joblib.cpu_count(), len(seeds))
    scores = joblib.Parallel(n_jobs=jobs)(joblib.delayed(scores_of_recording)(seed, frequencies) for seed in seeds)
    forms = {form: _intervals([[getattr(score, form).mean for score in recording] for recording in scores]) for form in FORMS}
    headline = {}
    for form, intervals in forms.items():
        headline[f"best_frequency_{form}_hz"] = max(zip(intervals, frequencies, strict=True))[1]
        headline |= {f"{form}_{frequency:g}hz": interval.mean for frequency, interval in zip(frequencies, intervals, strict=True)}
    half_widths = {form: [interval.half_width for interval in intervals] for form, intervals in forms.items()}
    details = {"frequencies": frequencies, "transitions": [score.transitions for score in scores[0]], "half_widths": half_widths}
    drawn = {form: tuple(zip(*intervals, strict=True)) for form, intervals in forms.items()}
    return Report(headline, {"figure9": plot_frequencies(frequencies, drawn)}, details)


def scores_of_recording(seed: int, frequencies: Sequence[float]) -> list[FrequencyScore]:
    """Of one recording, perhaps in another process."""
    torch.set_num_threads(1)  # the matrices are small: more threads wait for each other
    return score_frequencies(recorded_movements(seed), TIME_STEP, frequencies, load_experiment("biorob").space)


def _intervals(scores: Sequence[Sequence[float]]) -> list[Interval]:
    """Of each frequency, over recordings; scores are (recordings, frequencies)."""
    return [Interval.of(column) for column in torch.tensor(scores, dtype=torch.float64).mT]


FIGURE9 = PaperExperiment("figure9", "how well models of the BioRob predict at each sampling frequency", no_runs, report)
