"""Two soaks side by side: what the same tasks and seeds cost, paired."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from reproduction.soak.processes import attempts_in
from reproduction.soak.results import Row, cpu_seconds_of, outcome_of
from torch_pmil.files import read_json
from torch_pmil.runs.summaries import CONFIDENCE, RunError, read_summary

QUANTITIES = ("experience_s", "wall_seconds", "cpu_seconds", "trials", "saved_success_rate")
ALL = "all"

Outcomes = Mapping[tuple[str, int], Row]


def outcomes_in(root: Path) -> dict[tuple[str, int], Row]:
    """Outcomes of the finished runs in the folders of the tasks below a folder, by task and seed.

    The ``summary.json`` of a soak gives those that are written there.

    Raises:
        RunError: there is none, or one is damaged.
    """
    if root.is_file():
        return {(row["task"], row["seed"]): row for row in read_json(root)["runs"]}
    folders = [path.parent for path in sorted(root.glob("*/seed_*/summary.json"))]
    if not folders:
        raise RunError(f"{root} must hold runs as TASK/seed_N/summary.json, got none")
    outcomes = {}
    for folder in folders:
        summary, cpu_seconds = read_summary(folder), cpu_seconds_of(attempts_in(folder))
        outcome = {**outcome_of(summary), "cpu_seconds": cpu_seconds}
        outcomes[folder.parent.name, summary["seed"]] = outcome
    return outcomes


def compared(ours: Outcomes, theirs: Outcomes) -> dict[str, dict[str, dict[str, float | None]]]:
    """What runs needed beside other runs of the same tasks and seeds.

    Args:
        ours, theirs: outcomes by task and seed; those that only one of the two has do not count.

    Returns:
        For each task, and for all together, the numbers of :func:`paired` for each quantity.
    """
    both = sorted(ours.keys() & theirs.keys())
    tasks = {name: [key for key in both if key[0] == name] for name, _ in both}
    return {
        name: {
            quantity: paired([(ours[key].get(quantity), theirs[key].get(quantity)) for key in keys])
            for quantity in QUANTITIES
        }
        for name, keys in {ALL: both, **tasks}.items()
    }


def paired(values: Sequence[tuple[float | None, float | None]]) -> dict[str, float | None]:
    """Medians of a quantity of pairs of runs, and the mean of its difference, ours - theirs.

    The interval of that mean is the percentile bootstrap's, with 95 % confidence: the pairs are
    drawn anew with replacement; None for fewer than two pairs.

    Args:
        values: ours and theirs; pairs in which one has None do not count.

    Example:
        >>> numbers = paired([(10.0, 13.0), (12.0, 14.0), (11.0, 15.0)])
        >>> numbers["ours"], numbers["theirs"], numbers["difference"]
        (11.0, 14.0, -3.0)
        >>> -4 <= numbers["lower"] <= -3 <= numbers["upper"] <= -2
        True
    """
    pairs = np.array([pair for pair in values if None not in pair], dtype=float)
    if not len(pairs):
        return {"pairs": 0}
    ours, theirs = pairs.T
    lower = upper = None
    if len(pairs) > 1:
        interval = stats.bootstrap(
            (ours - theirs,), np.mean, confidence_level=CONFIDENCE, method="percentile", rng=0
        ).confidence_interval
        lower, upper = float(interval.low), float(interval.high)
    return {
        "pairs": len(pairs),
        "ours": float(np.median(ours)),
        "theirs": float(np.median(theirs)),
        "difference": float(np.mean(ours - theirs)),
        "lower": lower,
        "upper": upper,
    }
