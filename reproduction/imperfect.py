"""Demonstrations that are not perfect: what a robot learns of them, and whether the run says so.

One of five swing-ups is wrong, another robot's links have other lengths, one of seven strokes is of
another shape. A policy is measured as if nothing were wrong, on the task with the demonstrations as
they should be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from reproduction.ablation import success_and_experience
from reproduction.handwriting import written
from reproduction.learned import load_learned, measured_success
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.soak.comparison import paired
from reproduction.teachers.swing_up import demonstrate, swing_up_teacher
from torch_pmil.control.recovered_states import rates_of, recover_states
from torch_pmil.control.state_space import MatchSpace
from torch_pmil.demonstrations import Demonstrations, shipped_demonstrations
from torch_pmil.envs import DoublePendulumEnv, MujocoRobotEnv
from torch_pmil.envs.double_pendulum import (
    HANGING,
    START_STD,
    double_pendulum_model,
    link_positions,
)
from torch_pmil.envs.rollouts import of_states
from torch_pmil.runs.diagnosis.before_a_run import check
from torch_pmil.tasks.double_pendulum import double_pendulum
from torch_pmil.tasks.handwriting import (
    SUCCESS_RATIO,
    distance_of_tip,
    input_widths,
)
from torch_pmil.tasks.strokes import distance_spread
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.writers import pendulum_writer, states_of_strokes

SEEDS, TRIALS = range(10), 10
QUICK_SEEDS, QUICK_TRIALS = range(1), 2
STARTS, START_SEED = 20, 11_000_000  # from which policies are measured; no run has seen them
WRONG = 2  # number of the demonstration that is wrong
SHIPPED_SEED = 0  # of the shipped demonstrations: starts and the teacher's noise
WEAK = 0.5  # of the torque, of a robot that never gets up
LATE = 3  # samples
OTHER_LINKS, LONGER_LINKS = (0.4, 0.6), (0.55, 0.55)  # m
SHAPE, OTHER_SHAPE = "Sshape", "GShape"  # which begin at nearly the same place
UNLIKE = (f"demonstration {WRONG} is unlike the others",)
UNREACHED = ("cannot reach", "leaves the workspace")


@dataclass(frozen=True)
class Variant:
    """A task whose demonstrations are not as they should be.

    Args:
        task: what is learned.
        measure: the task with the demonstrations as they should be, which determine success.
        fault: words with one of which a message names the fault; where there is none, those of all
            faults, so that a false alarm counts.
    """

    task: Task
    measure: Task
    fault: tuple[str, ...] = ("is unlike the others", "are two different ways", *UNREACHED)

    def named_in(self, messages: Sequence[str]) -> bool:
        """Whether one of the messages names the fault.

        Example:
            >>> task = double_pendulum()
            >>> Variant(task, task, UNLIKE).named_in(["demonstration 1 jumps in y2"])
            False
        """
        return any(words in message for message in messages for words in self.fault)


@cache
def variants() -> tuple[dict[str, Variant], dict[str, Variant]]:
    """All variants by their names: swing-ups and strokes, what is perfect first.

    The strokes need the LASA recordings.
    """
    task, writing = double_pendulum(), written(SHAPE)
    shown = shipped_demonstrations("double_pendulum")
    own = shown.positions[WRONG]
    links, longer = (swing_ups_of(lengths) for lengths in (OTHER_LINKS, LONGER_LINKS))
    swing_ups = {
        "failed": (_with_one(shown, failed_swing_up()), UNLIKE),
        "late": (_with_one(shown, late(own)), UNLIKE),
        "mirrored": (_with_one(shown, mirrored(own)), UNLIKE),
        "links": (links, UNREACHED),
        "longer": (longer, UNREACHED),
    }
    of_pendulum = {"perfect": Variant(task, task)} | {
        name: Variant(_named(double_pendulum(given), name), task, fault)
        for name, (given, fault) in swing_ups.items()
    }
    of_pendulum["links_tip"] = Variant(_named(of_tip(task, links), "links_tip"), task)
    strokes = {
        "strokes": Variant(writing, writing),
        "wrong_stroke": Variant(
            _named(with_strokes(writing, wrong_strokes(writing)), "wrong_stroke"),
            writing,
            UNLIKE,
        ),
    }
    return of_pendulum, strokes


def failed_swing_up() -> Tensor:
    """Link ends (T + 1, 4) of the demonstrator of that number, with half the torque.

    It swings and hangs back.

    Example:
        >>> bool(failed_swing_up()[-6:, 3].amax() < 0)  # m; upright is 1
        True
    """
    count = len(shipped_demonstrations("double_pendulum").positions)
    strong = DoublePendulumEnv().torque_limits.max().item()
    weak = DoublePendulumEnv(num_envs=count, seed=SHIPPED_SEED, torque_limit=WEAK * strong)
    states, _ = demonstrate(weak, swing_up_teacher(), SHIPPED_SEED)
    return link_positions(states)[WRONG]


def late(motion: Tensor) -> Tensor:
    """A motion (T + 1, M) that begins some samples later, and is cut at its end.

    Example:
        >>> late(torch.arange(6.0)[:, None])[:, 0]
        tensor([0., 0., 0., 0., 1., 2.])
    """
    return torch.cat([motion[:1].expand(LATE, -1), motion[:-LATE]])


def mirrored(motion: Tensor) -> Tensor:
    """Link ends (T + 1, 4) that go to the other side, and end upright all the same.

    Example:
        >>> mirrored(torch.ones(1, 4)).tolist()
        [[-1.0, 1.0, -1.0, 1.0]]
    """
    return motion * motion.new_tensor([-1.0, 1.0, -1.0, 1.0])


def swing_ups_of(lengths: tuple[float, float]) -> Demonstrations:
    """Swing-ups of a double pendulum with links of other lengths (m), as the shipped ones.

    They are of the same starts, by a teacher that knows the lengths.
    """
    shown = shipped_demonstrations("double_pendulum")
    body = MujocoRobotEnv(
        double_pendulum_model(link_lengths=lengths),
        ("q1", "q2"),
        initial_mean=HANGING,
        initial_std=START_STD,
        torque_limit=DoublePendulumEnv().torque_limits.max().item(),
        num_envs=len(shown.positions),
        seed=SHIPPED_SEED,
    )
    states, _ = demonstrate(body, swing_up_teacher(link_lengths=lengths), SHIPPED_SEED)
    ends = MatchSpace.of_links(("q1", "q2"), lengths, ("q1", "dq1", "q2", "dq2"))
    return replace(shown, positions=ends(states))


def of_tip(task: Task, shown: Demonstrations) -> Task:
    """The double pendulum from demonstrations of which only the tip is compared."""
    space, tip = task.space, ["x2", "y2"]
    rows = [space.match_space.names.index(name) for name in tip]
    match_space = replace(
        space.match_space,
        names=tuple(tip),
        units=("m", "m"),
        weights=space.match_space.weights[rows],
    )
    given = replace(shown, positions=shown.positions[..., rows], names=tuple(tip))
    states = recover_states(
        match_space, given.positions, given.time_step, task.initial.mean, rates_of(space.names)
    )
    return replace(
        task,
        space=replace(space, match_space=match_space),
        demonstrations=given,
        demonstrated_states=states.flatten(0, 1),
    )


def wrong_strokes(task: Task) -> Demonstrations:
    """Strokes of a shape among which one is of another shape, from the same start."""
    own, other = task.demonstrations, written(OTHER_SHAPE).demonstrations
    wrong = other.positions[WRONG]
    return _with_one(own, wrong - wrong[0] + own.positions[WRONG, 0])


def with_strokes(task: Task, strokes: Demonstrations) -> Task:
    """The task with other strokes where the robot writes, and what a success is by these."""
    states = states_of_strokes(pendulum_writer(), strokes).flatten(0, 1)
    return replace(
        task.with_settings(input_widths=input_widths(states, task.space)),
        demonstrations=strokes,
        demonstrated_states=states,
        error=of_states(partial(distance_of_tip, space=task.space, strokes=strokes)),
        tolerance=SUCCESS_RATIO * distance_spread(strokes),
    )


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Each variant with each seed."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root / "imperfect", variant.task, seed, trials)
        for known in variants()
        for variant in known.values()
        for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success and experience of each variant, and how often the fault was named."""
    seeds = list(QUICK_SEEDS if quick else SEEDS)
    headline: dict[str, float | None] = {}
    details: dict[str, object] = {"seeds": seeds, "starts": STARTS}
    left = list(folders)
    for known in variants():
        outcomes = {}
        for name, variant in known.items():
            own, left = left[: len(seeds)], left[len(seeds) :]
            outcomes[name] = [outcome_of(folder, variant) for folder in own]
        perfect = next(iter(outcomes.values()))
        for name, variant in known.items():
            numbers, words = compared(variant, outcomes[name], perfect)
            headline |= {f"{quantity}_{name}": value for quantity, value in numbers.items()}
            details[name] = words
    return Results(headline, {}, details)


def outcome_of(folder: Path, variant: Variant) -> dict[str, Any]:
    """What came of a run: success by its own and the variant's measure, experience, KL, reasons.

    The KL is that of the saved policy to what was demonstrated, under the newest model; None where
    that cannot predict it.
    """
    learned = load_learned(folder, variant.task)
    summary = learned.summary
    _, first_success_s, succeeded = success_and_experience(summary)
    per_step = summary.get("loss_per_step")
    return {
        "seed": summary["seed"],
        "own_success": summary["saved_success_rate"],
        "success": measured_success(learned.policy, variant.measure, STARTS, START_SEED),
        "experience_s": summary["experience_s"],
        "first_own_success_s": first_success_s if succeeded else None,
        "kl_nats": None if per_step is None else sum(per_step),
        "stop_reason": summary["stop_reason"],
        "reasons": summary["diagnosis"],
    }


def compared(
    variant: Variant, outcomes: Sequence[dict[str, Any]], perfect: Sequence[dict[str, Any]]
) -> tuple[dict[str, float], dict[str, object]]:
    """The numbers of a variant, and its outcomes beside those of what is perfect, seed by seed."""
    findings = check(variant.task)
    said_after = [
        variant.named_in([reason["message"] for reason in outcome["reasons"]])
        for outcome in outcomes
    ]
    numbers = {
        "success": float(np.mean([outcome["success"] for outcome in outcomes])),
        "experience": float(np.median([outcome["experience_s"] for outcome in outcomes])),
        "said_before": float(variant.named_in([finding.message for finding in findings])),
        "said_after": float(np.mean(said_after)),
    }
    beside = {
        quantity: paired(
            [(own[quantity], other[quantity]) for own, other in zip(outcomes, perfect, strict=True)]
        )
        for quantity in ("success", "experience_s")
    }
    refused = any(finding.fatal for finding in findings)  # by pmil train, not here
    warnings = [asdict(finding) for finding in findings]
    return numbers, {"refused": refused, "warnings": warnings, "beside": beside, "runs": outcomes}


def _with_one(shown: Demonstrations, motion: Tensor) -> Demonstrations:
    positions = shown.positions.clone()
    positions[WRONG] = motion
    return replace(shown, positions=positions)


def _named(task: Task, name: str) -> Task:
    return replace(task, name=f"{task.name}_imperfect_{name}")


IMPERFECT = PaperExperiment(
    "imperfect",
    "demonstrations that are not perfect: does it learn, and say so?",
    needed_runs,
    results,
)
