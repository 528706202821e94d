"""Section 5.2.3, Figure 9: at which sampling frequency a model of the BioRob predicts best (Eq. 30)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import joblib
import torch
from tensordict import TensorDict
from torch import Tensor

from torch_pmil.envs.biorob import JOINTS, START, BioRobEnv, holding_torques
from torch_pmil.experiments.paper.reproduction import PaperExperiment, Report, Run
from torch_pmil.plotting import plot_frequencies
from torch_pmil.sampling_frequency import FrequencyScore, Interval, Recording, score_frequencies
from torch_pmil.state_space import StateSpace, joint_match

SEEDS = range(3)  # of recordings
FREQUENCIES = (2.0, 2.5, 4.0, 5.0, 6.25, 10.0, 12.5, 20.0, 25.0, 50.0)  # Hz
QUICK_FREQUENCIES = (5.0, 10.0, 20.0)
TIME_STEP = 0.01  # s, of the recordings
HOLD = 10  # time steps for which a torque is held: the robot is controlled at 10 Hz
PARTS, PART = 12, 2.0  # of a recording, and their length in s: 24 s together, about what the robot records until it has learned
TARGET_PERIOD = 0.5  # s
REACH = torch.tensor([12.0, 25.0, 25.0], dtype=torch.float64).deg2rad()  # of the targets, to either side of the start
STIFFNESS = torch.tensor([20.0, 40.0, 20.0], dtype=torch.float64)  # N·m/rad
DAMPING = torch.tensor([2.0, 4.0, 2.0], dtype=torch.float64)  # N·m·s/rad
FORMS = ("raw", "standardised")


def biorob_states() -> StateSpace:
    """State [q, dq] of yaw, shoulder and elbow; none turns round."""
    names = tuple(f"{quantity}_{joint}" for quantity in ("q", "dq") for joint in JOINTS)
    units = ("rad",) * len(JOINTS) + ("rad/s",) * len(JOINTS)
    return StateSpace(names, units, (), joint_match(names, units))


def recorded_movements(seed: int) -> list[Recording]:
    """24 s of simple movements around the start (Section 5.2.4): PD control with the weight compensated, a new target every 0.5 s."""
    env, generator = BioRobEnv(num_envs=PARTS, control_period=TIME_STEP, seed=seed), torch.Generator().manual_seed(seed)
    start = torch.tensor(START[: len(JOINTS)], dtype=torch.float64)
    states, torques = [env.reset()["observation"]], []
    for step in range(round(PART / TIME_STEP)):
        if step % round(TARGET_PERIOD / TIME_STEP) == 0:
            target = start + REACH * (2 * torch.rand(PARTS, len(JOINTS), dtype=torch.float64, generator=generator) - 1)
        if step % HOLD == 0:
            torque = env.action_spec.project(pd_torques(states[-1], target))
        torques.append(torque)
        states.append(env.step(TensorDict({"action": torque}, batch_size=[PARTS]))["next", "observation"])
    return [Recording(*part) for part in zip(torch.stack(states, 1), torch.stack(torques, 1), strict=True)]


def pd_torques(states: Tensor, target: Tensor) -> Tensor:
    """Motor torques (*batch, 3), N·m, that pull joints with states (*batch, 6) towards a target (*batch, 3), rad."""
    q, dq = states.split(len(JOINTS), -1)
    return holding_torques(q) + STIFFNESS * (target - q) - DAMPING * dq


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
    return score_frequencies(recorded_movements(seed), TIME_STEP, frequencies, biorob_states())


def _intervals(scores: Sequence[Sequence[float]]) -> list[Interval]:
    """Of each frequency, over recordings; scores are (recordings, frequencies)."""
    return [Interval.of(column) for column in torch.tensor(scores, dtype=torch.float64).mT]


FIGURE9 = PaperExperiment("figure9", "how well models of the BioRob predict at each sampling frequency", no_runs, report)
