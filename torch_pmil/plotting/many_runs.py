"""Figures of many runs of several tasks: what they promise, and what they need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torch_pmil.plotting.style import BLUE, DARK, GREY, VERMILLION, WIDTH, check_some, style

COLOURS = (BLUE, VERMILLION)
Pairs = Sequence[tuple[float, float]]  # predicted and measured rates


def plot_promises(
    trials: Pairs, groups: Sequence[Mapping[str, float]], claimed: Pairs, others: Pairs
) -> Figure:
    """Predicted success rates beside measured ones.

    On the left those of trials, as predicted before their rollouts: each trial, and the mean of
    each group with its 95 % interval. On the right what is promised of the saved policies at the
    end of their runs, as a lower bound: a promise is kept on and above the dashed diagonal.

    Args:
        trials: predicted and measured rate of each, fractions from 0 to 1.
        groups: of trials, each with the means "predicted" and "measured", and with the interval's
            ends "lower" and "upper".
        claimed: promised and measured rate of the runs that ended since they had learned.
        others: of the other runs.

    Example:
        >>> group = {"predicted": 0.95, "measured": 0.9, "lower": 0.7, "upper": 1.0}
        >>> figure = plot_promises([(0.95, 0.9)], [group], [(0.96, 1.0)], [(0.3, 0.5)])
        >>> [panel.get_xlabel() for panel in figure.axes]
        ['predicted before the rollout (%)', 'promised, as a lower bound (%)']
    """
    figure = Figure(figsize=(WIDTH, 4.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    _scatter(left, trials, GREY, ".", f"a trial (of {len(trials)})", alpha=0.35)
    mean = np.array([group["measured"] for group in groups])
    ends = np.array([[group["lower"], group["upper"]] for group in groups]).reshape(-1, 2).T
    left.errorbar(
        [100 * group["predicted"] for group in groups],
        100 * mean,
        100 * np.abs(ends - mean),
        fmt="o",
        color=BLUE,
        capsize=3,
        label="mean of a tenth, 95 %",
    )
    _scatter(right, claimed, BLUE, "o", f"called itself learned ({len(claimed)} runs)", alpha=0.5)
    _scatter(right, others, VERMILLION, "x", f"out of trials ({len(others)} runs)")
    left.set(xlabel="predicted before the rollout (%)", ylabel="measured (%)")
    right.set(xlabel="promised, as a lower bound (%)")
    for panel in (left, right):
        panel.plot([0, 100], [0, 100], color=GREY, linewidth=1.0, linestyle="--", zorder=1)
        panel.set(xlim=(-3, 103), ylim=(-3, 103), aspect="equal")
        style(panel)
        panel.legend(loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    return figure


def _scatter(
    panel: Axes, pairs: Pairs, colour: str, marker: str, label: str, alpha: float = 1.0
) -> None:
    x, y = 100 * np.reshape(pairs, (-1, 2)).T
    panel.plot(x, y, marker, color=colour, alpha=alpha, markeredgewidth=1.2, label=label)


def plot_experience_by_task(
    experience_s: Mapping[str, Mapping[str, Sequence[float]]],
) -> Figure:
    """How much experience each run of each task took, with the median as a bar.

    Args:
        experience_s: seconds of each run by task, of one or two methods by label; the tasks of the
            first one are drawn.

    Raises:
        ValueError: there is no method, or its first one has no task.

    Example:
        >>> figure = plot_experience_by_task({"ours": {"biorob": [13.2, 15.0]}})
        >>> [tick.get_text() for tick in figure.axes[0].get_yticklabels()]
        ['biorob']
    """
    check_some("experience_s", experience_s)
    tasks = list(next(iter(experience_s.values())))
    check_some("tasks", tasks)
    figure = Figure(figsize=(WIDTH, 1.2 + 0.55 * len(tasks)), layout="constrained")
    panel, places = figure.subplots(), np.arange(len(tasks))
    lanes = (0.17, -0.17) if len(experience_s) > 1 else (0.0,)
    for (label, of_task), lane, colour in zip(experience_s.items(), lanes, COLOURS, strict=False):
        for place, task in zip(places[::-1], tasks, strict=True):
            values = of_task.get(task, ())
            panel.plot(values, np.full(len(values), place + lane), "o", color=colour, alpha=0.35)
            if len(values):
                panel.plot(np.median(values), place + lane, "|", color=DARK, markersize=15, mew=2)
        panel.plot([], [], "o", color=colour, label=label)
    panel.plot([], [], "|", color=DARK, markersize=12, mew=2, label="median")
    panel.set_yticks(places[::-1], [task.replace("_", " ") for task in tasks])
    panel.set(xlabel="experience (s)", ylim=(-0.6, len(tasks) - 0.4))
    panel.set_xlim(left=0)
    style(panel)
    figure.legend(loc="outside upper center", ncols=len(experience_s) + 1, frameon=False)
    return figure
