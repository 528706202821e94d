"""Whether slow, held and partly still motions are learned: the success rate of each saved policy.

Each of five demonstrations begins at the mean start of its robot. ``slow`` moves a joint by 0.3 rad
and back; ``held`` stays within 1 mm; ``part`` moves the last joint by 0.3 rad to a pose that it
holds for half of the time, while the others, if any, are exactly still. A rollout succeeds if all
that is observed stays within three standard deviations of the observation noise of the demonstrated
mean; a run has learned if 95 % of the saved policy's rollouts from fresh starts do. Runs go on
where they were stopped.

Example:
    python -m benchmarks.quiet_motions
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from benchmarks.command_line import add_json, source_of, write_summary
from reproduction.reproduction import root_of_runs
from torch_pmil.demonstrations import Demonstrations, shipped_demonstrations
from torch_pmil.envs.rollouts import of_states
from torch_pmil.runs.diagnosis.measures import LEARNED
from torch_pmil.runs.training import train
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SEEDS, TRIALS = range(5), 12
AMPLITUDE = 0.3  # rad
STEPS = {"double_pendulum": 25, "gym_pendulum": 25, "biorob": 18}
SPREAD = (-0.02, -0.01, 0.0, 0.01, 0.02)  # rad, of the demonstrations' moved joint
TREMOR = 2e-4  # rad, that each of them trembles where it is held
TOLERANCE = 3.0  # standard deviations of the observation noise

Shape = Callable[[Tensor], Tensor]


def ramp(time: Tensor) -> Tensor:
    """From 0 to 1 over times from 0 to 1, at rest at both ends, and constant outside.

    Example:
        >>> ramp(torch.tensor([-1.0, 0.5, 2.0]))
        tensor([0.0000, 0.5000, 1.0000])
    """
    return (1 - (math.pi * time.clamp(0, 1)).cos()) / 2


MOTIONS: dict[str, Shape] = {
    "slow": lambda time: ramp(2 * time) - ramp(2 * time - 1),
    "held": torch.zeros_like,
    "part": lambda time: ramp(2 * time),
}


def main() -> None:
    """Read the command line, learn, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_json(parser, "quiet_motions")
    arguments = parser.parse_args()
    source, rows = source_of("quiet_motions"), []
    command = str(source["command"])
    for seed in SEEDS:
        for task in STEPS:
            for motion in MOTIONS:
                rows.append(row(task, motion, seed, command))
                print(" ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    learned = Counter((each["task"], each["motion"]) for each in rows if each["learned"])
    headline = {"seeds": len(SEEDS)} | {
        f"learned_{task}_{motion}": learned[task, motion] for task in STEPS for motion in MOTIONS
    }
    write_summary(arguments.json, {**source, "headline": headline, "rows": rows})
    print(f"{learned.total()} of {len(rows)} runs learned")


def row(task: str, motion: str, seed: int, command: str) -> dict[str, object]:
    """What a run came to; one that has ended is read, one that was stopped goes on."""
    out = root_of_runs() / "quiet_motions" / f"{task}_{motion}" / f"seed_{seed}"
    if (out / "summary.json").exists():
        summary = json.loads((out / "summary.json").read_text())
    else:
        experiment = quiet_experiment(task, motion)
        summary = train(experiment, seed, TRIALS, out, command, False, resume=out.exists()).summary
    return {
        "task": task,
        "motion": motion,
        "seed": seed,
        "learned": summary["saved_success_rate"] >= LEARNED,
        "success_rate": summary["saved_success_rate"],
        "trials": len(summary["trials"]),
        "kl": round(min(trial["loss"] for trial in summary["trials"]), 2),
        "wall_s": summary["wall_seconds"],
    }


def quiet_experiment(task: str, motion: str) -> Task:
    """A task of the package with a quiet motion, and the distance from its mean as the error.

    Example:
        >>> quiet_experiment("double_pendulum", "held").horizon
        25
    """
    experiment = load_experiment(task, quiet_demonstrations(task, motion))
    mean, space = experiment.demonstrations.positions.mean(0)[1:], experiment.space
    noise_std = torch.as_tensor(experiment.noise_std, dtype=torch.float64)

    def distance(states: Tensor) -> Tensor:
        return ((space.observe(states[..., 1:, :]) - mean) / noise_std).abs().amax((-2, -1))

    known = {"error": of_states(distance), "tolerance": TOLERANCE}
    experiment = replace(experiment, name=f"{task}_{motion}", **known)
    return experiment.with_settings(confirmations=2)


def quiet_demonstrations(task: str, motion: str) -> Demonstrations:
    """Five demonstrations of a quiet motion, as the robot's state would show them."""
    experiment, steps = load_experiment(task), STEPS[task]
    space, period = experiment.space, experiment.demonstrations.time_step
    time = torch.arange(steps + 1, dtype=torch.float64) / steps
    amplitudes = AMPLITUDE + torch.tensor(SPREAD, dtype=torch.float64)
    shape = MOTIONS[motion](time)
    places = [i for i, unit in enumerate(space.units) if unit == "rad"]
    states = experiment.initial.mean.expand(len(SPREAD), steps + 1, -1).clone()
    moved = places[-1] if motion == "part" else places[0]
    states[..., moved] += amplitudes[:, None] * shape
    if motion == "held":
        generator = torch.Generator().manual_seed(0)
        shape = states[..., places].shape
        white = torch.randn(shape, dtype=torch.float64, generator=generator)
        states[..., places] += TREMOR * white
    for place in places:
        speed = space.names.index(f"d{space.names[place]}")
        states[..., speed] = torch.gradient(states[..., place], spacing=period, dim=-1)[0]
    shown = shipped_demonstrations(task)
    return replace(shown, positions=space.observe(states))


if __name__ == "__main__":
    main()
