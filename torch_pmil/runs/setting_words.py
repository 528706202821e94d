"""All settings of a run in words: what each means, which values it takes, and in which unit.

``pmil train --help``, the report and docs/how_to/settings.md say them from here.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from torch_pmil.runs.run_folder import LOGGERS, MOST_TRIALS, SEEDS
from torch_pmil.tasks.registry import EXPERIMENTS
from torch_pmil.tasks.task import MOST_CENTRES

WIDTH = 100  # characters of a line of help
POSITIVE, FROM_ZERO, SHARE = "above 0", "at least 0", "above 0, at most 1"
RATE = "above 0, below 1"
SWITCH = "true or false"
WHOLE, COUNT = "whole number, at least 0", "whole number, at least 1"
OF_FEATURES = "numbers above 0, one for each feature of the state"
OF_STATE = "numbers, one for each entry of the state"


@dataclass(frozen=True)
class Setting:
    """A setting in words.

    Args:
        meaning: what it is.
        values: which it takes.
        unit: of its numbers; "" where they have none.
    """

    meaning: str
    values: str
    unit: str = ""

    def __str__(self) -> str:
        link = "of" if self.values.startswith("whole number") else "in"
        unit = f", {link} {self.unit}" if self.unit else ""
        return f"{self.meaning} ({self.values}{unit})"


OF_RUN = {
    "experiment": Setting("the task", ", ".join(EXPERIMENTS)),
    "shape": Setting(
        "what handwriting writes", "a shape of the LASA set, as Angle; null: one's own strokes"
    ),
    "robot": Setting("which robot writes", "double_pendulum or biorob; null: double_pendulum"),
    "seed": Setting(
        "of all random numbers: same seed, same run", f"whole number from {SEEDS[0]} to {SEEDS[1]}"
    ),
    "demonstrations": Setting(
        "one's own demonstrations", "a file or folder; null: those that come with the package"
    ),
    "trials": Setting(
        "largest number of trials", f"whole number from 1 to {MOST_TRIALS}", "trials"
    ),
    "out": Setting("folder of the run", "a path"),
    "resume": Setting("go on from the newest checkpoint in out", SWITCH),
    "overwrite": Setting("replace the run in out if it has ended", SWITCH),
    "logger": Setting("kind of TorchRL's logger", f"{', '.join(LOGGERS)} or null"),
}
OF_EXPERIMENT = {
    "num_centres": Setting(
        "basis functions of the policy", f"whole number from 1 to {MOST_CENTRES}", "basis functions"
    ),
    "noise_std": Setting(
        "standard deviation of the observation noise: a larger one forgives more",
        "above 0, one number or one for each entry of the match space",
        "the unit of the entry",
    ),
    "random_action": Setting(
        "how far the actions of the first, random motion go",
        SHARE,
        "half the range of the actions",
    ),
    "explore_demonstrated": Setting(
        "whether the first motion goes along the demonstrations, around what holds the robot there",
        SWITCH,
    ),
    "initial_weight_std": Setting(
        "standard deviation of a new policy's weights", FROM_ZERO, "rad, what the squashing takes"
    ),
    "input_scale": Setting(
        "width of a new policy's basis functions: a larger one reaches further",
        POSITIVE,
        "standard deviations of the demonstrated features",
    ),
    "input_widths": Setting(
        "the widths themselves, in place of input_scale", OF_FEATURES, "the unit of the feature"
    ),
    "least_widths": Setting(
        "what no width by input_scale falls below", OF_FEATURES, "the unit of the feature"
    ),
    "tolerance": Setting(
        "error up to which a rollout is a success", FROM_ZERO, "the unit of the task's error"
    ),
    "promise": Setting(
        "success rate from fresh starts that a run's end promises: a lower one ends sooner",
        RATE,
        "fresh starts",
    ),
    "confirmations": Setting(
        "successes in a row of own rollouts without which no run ends", COUNT, "own rollouts"
    ),
    "evaluated": Setting(
        "whether policies are measured from fresh starts beside their own rollouts", SWITCH
    ),
    "velocities_alone": Setting(
        "whether the model learns velocities alone, from which their positions follow", SWITCH
    ),
    "tied_lengthscales": Setting(
        "whether all outputs of the model have the same lengthscales, and predictions are faster",
        SWITCH,
    ),
    "plan_weight": Setting(
        "weight of the actions in a plan on the mean of the model, from which each search starts "
        "besides",
        f"{POSITIVE}; null: no plan",
    ),
    "target_scale": Setting(
        "width of a new policy's basis functions in the entries of the target",
        POSITIVE,
        "units of the largest distance between two targets",
    ),
    "target": Setting(
        "where PILCO's cost is zero",
        "numbers, one for each entry of the match space",
        "the unit of the entry",
    ),
    "cost_width": Setting(
        "distance from the target at which PILCO's cost saturates",
        POSITIVE,
        "the unit of the entries",
    ),
    "velocity_std": Setting(
        "standard deviation of the velocities near which PILCO's policy begins", POSITIVE, "rad/s"
    ),
    "velocity_limit": Setting("largest velocity in the data of PILCO's model", POSITIVE, "rad/s"),
    "exploration.rollouts": Setting("movements of the first motion", COUNT, "rollouts"),
    "exploration.steps": Setting("length of each movement", COUNT, "control steps"),
    "exploration.hold": Setting("time for which a target of it stays", COUNT, "control steps"),
    "exploration.pose": Setting("state around which it moves", OF_STATE, "rad, rad/s"),
    "exploration.reach": Setting(
        "largest distances of its targets from that state", f"{OF_STATE}, at least 0", "rad, rad/s"
    ),
    "exploration.gain": Setting(
        "stiffness and damping of its controller",
        "a row of numbers for each torque, one for each entry of the state",
        "N·m/rad, N·m·s/rad",
    ),
    "search.mean_iterations": Setting(
        "iterations on the mean alone, for each horizon", WHOLE, "iterations"
    ),
    "search.stage_iterations": Setting(
        "iterations on the loss, for each horizon", WHOLE, "iterations"
    ),
    "search.final_iterations": Setting(
        "iterations on the loss at the last horizon", WHOLE, "iterations"
    ),
    "search.first_horizon": Setting("least length of the first horizon", COUNT, "control steps"),
    "search.horizon_step": Setting("how far the horizon grows at once", COUNT, "control steps"),
    "search.trust_threshold": Setting(
        "mean loss of the last steps up to which the horizon grows",
        FROM_ZERO,
        "nats per step; PILCO: cost of the predicted spread",
    ),
    "search.skip_matched_steps": Setting(
        "whether the horizon goes on to the first step above the threshold at once", SWITCH
    ),
    "search.restarts": Setting("most searches from random policies", WHOLE, "searches"),
}
SETTINGS = OF_RUN | OF_EXPERIMENT


def help_lines(words: Mapping[str, str]) -> Iterator[str]:
    """Settings of a run, each in words, and those that other experiments have.

    Args:
        words: NAME=VALUE of each setting, by its name.

    Example:
        >>> for line in list(help_lines({"seed": "seed=3"}))[:2]:
        ...     print(line)
          seed=3
              of all random numbers: same seed, same run (whole number from 0 to 2147483647)
    """
    for name, word in words.items():
        yield f"  {word}"
        yield _indented(str(SETTINGS[name]))
    yield "\nOther experiments have some of these, as experiment=NAME --help shows:\n"
    for name, setting in SETTINGS.items():
        if name not in words:
            yield _indented(f"{name}: {setting}")


def _indented(text: str) -> str:
    return textwrap.fill(text, WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 6)
